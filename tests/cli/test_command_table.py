"""The command line reads one table: help imports no command, and a command only its own needs."""

import json
import math
import os
import resource
import statistics
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import valvemap
from valvemap.cli import run
from valvemap.cli.command_table import COMMANDS, load_command

MOST_HELP_S, MOST_INVERT_S = 0.3, 0.7
SLOW_MACHINE = 3.5  # times the libraries: an absolute time on a slow machine proves nothing
RUNS = 5
FEW = ["--points-q", 12, "--points-dp", 9]  # fewer take longer: the error within a cell is bounded

_SERVERS = {
    "asyncua",
    "guarded_opcua",
    "valvemap.opcua_results",
    "starlette",
    "uvicorn",
    "structlog",
}
_HEAVY = _SERVERS | {"numpy", "numba", "scipy", "rich", "valvemap.config", "valvemap_rig"}


def loaded_by(*commands):
    """Which modules have been imported at the end of some commands, all in one process."""
    code = (
        "import json, sys\n"
        "from valvemap.cli import main\n"
        "for arguments in json.loads(sys.argv[1]):\n"
        "    sys.argv = ['valvemap', *arguments]\n"
        "    try:\n"
        "        main()\n"
        "    except SystemExit as end:\n"
        "        print('\\n' + json.dumps([arguments, end.code or 0, sorted(sys.modules)]))\n"
    )
    said = json.dumps([[str(word) for word in arguments] for arguments in commands])
    done = subprocess.run([sys.executable, "-c", code, said], capture_output=True, check=True)
    ends = [json.loads(line) for line in done.stdout.splitlines() if line.startswith(b"[[")]
    assert len(ends) == len(commands)
    return [code for _, code, _ in ends], set(ends[-1][2])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A recording, and the model of eq. (7) saved from it."""
    folder = tmp_path_factory.mktemp("quick")
    recording = folder / "plant.csv"
    U, dp = [(37 * k) % 101 for k in range(900)], [55 + (7 * k) % 90 for k in range(900)]
    rows = [
        f"{k / 100},{U[k]},{5 + dp[k]},5,{0.05 * U[k] * math.sqrt(dp[k]):.3f},40\n"
        for k in range(900)
    ]  # of a valve: the error of another map's table takes long to bound
    recording.write_text("t,U,p1,p2,Q,T\n" + "".join(rows), encoding="utf-8")
    assert run(["replay", str(recording), "--save", str(folder / "models")]) == 0
    return recording, sorted((folder / "models").glob("*.json"))


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_s_line_of_help_is_the_first_of_its_docstring(name):
    assert COMMANDS[name].help == load_command(name).help.splitlines()[0]


def test_every_command_is_listed_with_its_line(capsys):
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    for name, entry in COMMANDS.items():
        assert f"\n  {name} " in text
        assert entry.help.split()[0] in text


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["nonsense"], []])
def test_help_imports_no_command_and_nothing_heavy(arguments):
    _, modules = loaded_by(arguments)
    assert modules & _HEAVY == set()
    commands = {f"valvemap.cli.{entry.module}" for entry in COMMANDS.values()}
    assert modules & commands == set()


@pytest.mark.parametrize("name", ["history", "invert", "serve", "trust"])
def test_a_command_imports_no_other_command(name):
    _, modules = loaded_by([name, "--help"])
    commands = {f"valvemap.cli.{entry.module}" for entry in COMMANDS.values()}
    assert modules & commands == {f"valvemap.cli.{COMMANDS[name].module}"}


def test_invert_of_a_saved_map_loads_no_server_and_no_configuration(files):
    codes, modules = loaded_by(
        *(["invert", model, "--Q", "20", "--dp", "70"] for model in files[1])
    )
    assert set(codes) == {0}
    assert modules & (_SERVERS | {"valvemap.config.models", "valvemap.app.replay"}) == set()
    assert modules & {"numba", "scipy.linalg", "scipy.optimize", "valvemap.runtime.live"} == set()


def test_export_of_a_saved_map_loads_no_server_and_no_configuration(files, tmp_path):
    kinds = ("st", "c", "csv")  # each writer; RML's map is of the form of RLS'
    codes, modules = loaded_by(
        *(
            ["export", model, "--to", tmp_path / f"{model.stem}.{kind}", *FEW]
            for model, kind in zip(files[1], kinds, strict=False)
        )
    )
    assert set(codes) == {0}
    assert modules & (_SERVERS | {"valvemap.config.models", "valvemap.app.replay"}) == set()


def test_a_recording_is_read_without_a_server(files, tmp_path):
    more = {
        "invert": ["--Q", "20", "--dp", "70"],
        "export": ["--to", tmp_path / "table.csv", *FEW],
        "replay": [],
    }
    codes, modules = loaded_by(*([command, files[0], *words] for command, words in more.items()))
    assert set(codes) == {0}
    assert modules & (_SERVERS - {"structlog"}) == set()


@pytest.mark.parametrize("given", [{}, {"OPENBLAS_NUM_THREADS": "2"}])
def test_a_command_computes_in_one_thread_unless_its_environment_has_another_number(given):
    code = (
        "import os\n"
        "from valvemap.cli import main\n"
        "try:\n"
        "    main()\n"
        "except SystemExit:\n"
        "    import numpy\n"
        "    print('\\n', len(os.listdir('/proc/self/task')))\n"
    )
    without = {name: value for name, value in os.environ.items() if "OPENBLAS" not in name}
    asked = [sys.executable, "-c", code, "--version"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True, env=without | given)
    allowed = min(int(given.get("OPENBLAS_NUM_THREADS", 1)), os.cpu_count())
    assert int(done.stdout.splitlines()[-1]) == allowed


def test_the_version_is_that_of_the_package(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"valvemap {version('valvemap')}\n"


def test_a_mistyped_command_is_one_line_that_suggests_a_near_one(capsys):
    assert run(["invrt"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "'invrt'" in line
    assert "'invert'" in line


@pytest.mark.alone  # processor time, which a neighbour on the same core raises
def test_help_and_invert_are_quick(files):
    model = next(file for file in files[1] if "Auto" in file.name)
    assert median_s("-m", "valvemap", "--help") <= MOST_HELP_S
    libraries_s = median_s("-c", "import numpy, pydantic, typer")  # what it cannot do without
    invert_s = median_s("-m", "valvemap", "invert", model, "--Q", "20", "--dp", "70")
    assert invert_s <= max(MOST_INVERT_S, SLOW_MACHINE * libraries_s)


def median_s(*arguments):
    """Processor time of Python with arguments, the median of some runs."""
    asked = [sys.executable, *map(str, arguments)]
    seconds = []
    for _ in range(RUNS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(asked, capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return statistics.median(seconds)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
@pytest.mark.parametrize("command", ["schema", "--help", "--version"])
def test_an_output_that_is_full_is_one_line(command):
    with Path("/dev/full").open("w") as full:
        asked = [sys.executable, "-m", "valvemap", command]
        done = subprocess.run(asked, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "valvemap: standard output: no space left on device\n"


def test_an_output_without_our_signs_gets_others(tmp_path):
    U, dp = np.meshgrid(np.linspace(0, 100, 20), np.linspace(5, 180, 20))
    U, dp = U.ravel(), dp.ravel()
    table = {"t": np.arange(400), "U": U, "p1": dp, "p2": 0 * dp, "Q": 0.1 * U * np.sqrt(dp)}
    valvemap.fit(table, estimator="RLS").save(model := tmp_path / "m.json")
    asked = [sys.executable, "-m", "valvemap", "invert", str(model), "--Q", "20", "--dp", "100"]
    own = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(asked, capture_output=True, check=True, env=own)
    assert b"T, ?C" in done.stdout
