"""What is installed is whole: the public door, the wheel, what editors and machines need."""

import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

import valvemap
from support.processes import free_port, program, rig_url, service_url, wait_for
from support.soaked import soaked
from valvemap.cli import run
from valvemap.config.models import Config

ROOT = Path(__file__).parents[1]
IMPORT_NAMES = {"guarded_opcua", "valvemap", "valvemap_rig"}
SCRIPT = Path(sys.executable).with_name("valvemap")


def test_every_documented_name_is_there_and_no_other():
    for name in valvemap.__all__:
        assert getattr(valvemap, name) is not None
        assert name == "__version__" or f"`{name}`" in valvemap.__doc__
    assert set(dir(valvemap)) == set(valvemap.__all__)
    assert valvemap.__version__ == version("valvemap")
    with pytest.raises(AttributeError, match="no name 'kalman'"):
        _ = valvemap.kalman


def test_the_door_opens_at_once():
    loaded = "import valvemap, sys; print('numba' in sys.modules, 'pydantic' in sys.modules)"
    asked = [sys.executable, "-c", loaded]
    done = subprocess.run(asked, capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n"


def test_the_schema_knows_every_field_of_a_configuration(capsys):
    assert run(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["properties"].keys() == Config.model_fields.keys()
    shipped = tomllib.loads((ROOT / "config" / "service.toml").read_text(encoding="utf-8"))
    for name, section in shipped.items():
        kind = schema["properties"][name]
        kind = kind.get("items", kind).get("$ref", "").split("/")[-1]
        known = schema["$defs"][kind]
        assert known["additionalProperties"] is False
        for part in section if isinstance(section, list) else [section]:
            assert part.keys() <= known["properties"].keys()


def test_the_unit_serves_the_configuration_by_its_whole_path(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("plant.toml").write_text("[source]\nurl = 'opc.tcp://plc:4840'\n", encoding="utf-8")
    assert run(["unit", "--config", "plant.toml"]) == 0
    text = capsys.readouterr().out
    assert re.search(rf"^ExecStart=\S+ serve --config {tmp_path}/plant.toml$", text, re.MULTILINE)
    assert f"\nWorkingDirectory={tmp_path}\n" in text
    assert "\nKillSignal=SIGINT\n" in text
    assert run(["unit", "--config", "plant.toml", "--user", "a b"]) == 2
    assert run(["unit", "--config", "nowhere.toml"]) == 2


def test_a_shell_completes_commands():
    asked = {"_VALVEMAP_COMPLETE": "complete_bash", "COMP_WORDS": "valvemap con", "COMP_CWORD": "1"}
    done = subprocess.run(
        [SCRIPT], env={**os.environ, **asked}, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["connect"]


def test_the_readme_stands_alone_on_one_screen():
    """An index of packages shows it without the repository around it."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#\s]+)", text)
    assert [target for target in targets if not target.startswith("http")] == []
    assert len(text.splitlines()) <= 60
    for page in re.findall(r"`(docs/[\w/.]+|[A-Z]+\.md)`", text):
        assert (ROOT / page).exists(), page


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Wheel and sdist, as they would be published."""
    folder = tmp_path_factory.mktemp("dist")
    tool = folder / "tool"
    subprocess.run([sys.executable, "-m", "venv", tool], check=True)
    pip = [tool / "bin" / "python", "-m", "pip", "install", "--quiet", "hatchling"]
    subprocess.run(pip, check=True)
    hatchling = [tool / "bin" / "python", "-m", "hatchling", "build", "-d", folder]
    subprocess.run(hatchling, cwd=ROOT, check=True, capture_output=True)
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


@pytest.mark.image
def test_wheel_and_sdist_are_whole(built):
    wheel, sdist = built
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
    parents = ("service/", "virtual_rig/")
    packaged = {file.partition("/")[2] for file in tracked if file.startswith(parents)}
    assert packaged <= inside
    tops = {name.partition("/")[0] for name in inside}
    assert {top for top in tops if not top.endswith(".dist-info")} == IMPORT_NAMES
    licences = {name for name in inside if "/licenses/" in name}
    assert len(licences) == 3, licences
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {file for file in tracked if not file.startswith((".ci/", ".git"))} <= names


@pytest.fixture(scope="module", params=["x86-64-v3", *soaked("x86-64-v3,generic")])
def installed(request, tmp_path_factory):
    """A wheel with kernels compiled for some kinds; the folder where it is installed; the kinds.

    Each kind compiles everything anew: one in short.
    """
    folder = tmp_path_factory.mktemp("platform")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    built = [*pip, "wheel", "--no-deps", "--wheel-dir", folder, ROOT]
    asked = {"VALVEMAP_KERNELS": sys.executable, "VALVEMAP_KERNEL_KINDS": request.param}
    subprocess.run(built, check=True, env=os.environ | asked)
    (wheel,) = folder.glob("*.whl")
    home = folder / "home"
    subprocess.run([*pip, "install", "--no-deps", "--target", home, wheel], check=True)
    return wheel, home, request.param.split(",")


@pytest.mark.image
@pytest.mark.timeout(1800)  # it compiles everything
def test_a_platform_wheel_is_small_and_says_for_whom_it_is(installed):
    wheel, _, kinds = installed
    python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
    assert wheel.name.endswith(f"-{python}-none-manylinux_2_28_x86_64.whl")
    assert wheel.stat().st_size < (5_200_000 if len(kinds) == 1 else 8_000_000)


@pytest.mark.image
@pytest.mark.timeout(1800)
def test_nothing_is_compiled_where_a_platform_wheel_is_installed(installed, tmp_path):
    _, home, kinds = installed
    for kind in kinds:
        check_that_nothing_is_compiled(home, kind, tmp_path / kind)


def check_that_nothing_is_compiled(home, kind, folder):
    folder.mkdir()
    cache = folder / "cache"
    env = os.environ | {"PYTHONPATH": str(home), "NUMBA_CACHE_DIR": str(cache)}
    env |= {"NUMBA_CPU_NAME": kind, "NUMBA_CPU_FEATURES": ""}
    for command in (["warm-up"], ["rig", "--offline", "--duration", "1", "--record", "r.csv"]):
        asked = [sys.executable, "-m", "valvemap", *command]
        subprocess.run(asked, check=True, cwd=folder, env=env, capture_output=True)
    url = {"VALVEMAP_SOURCE__URL": rig_url(free_port())}
    url["VALVEMAP_SERVER__URL"] = service_url(free_port())
    asked = [sys.executable, "-m", "valvemap", "demo", "--duration", "10"]
    subprocess.run(asked, check=True, cwd=folder, env=env | url, capture_output=True)
    assert not list(cache.rglob("*.nbc"))


@pytest.mark.image
def test_a_wheel_for_a_kind_that_is_not_known_is_refused(tmp_path):
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    env = os.environ | {"VALVEMAP_KERNELS": sys.executable, "VALVEMAP_KERNEL_KINDS": "x86-64-v9"}
    asked = [*pip, "wheel", "--no-deps", "--wheel-dir", tmp_path, ROOT]
    done = subprocess.run(asked, capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 1
    line = "VALVEMAP_KERNEL_KINDS: 'x86-64-v9' is none of x86-64-v3, generic"
    assert line in done.stderr + done.stdout


@pytest.mark.image
@pytest.mark.timeout(900)  # nothing is compiled there yet
def test_the_demo_runs_from_the_wheel_alone(built, tmp_path):
    """In an environment that has what the wheel depends on, and nothing of the repository."""
    home = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", home], check=True)
    (packages,) = home.glob("lib/python*/site-packages")
    here = [path for path in sys.path if path.endswith("site-packages")]
    (packages / "others.pth").write_text("\n".join(here), encoding="utf-8")
    python = home / "bin" / "python"
    pip = [python, "-m", "pip", "install", "--quiet", "--no-deps", "--force-reinstall", built[0]]
    subprocess.run(pip, check=True)
    where = "import guarded_opcua, valvemap_rig, valvemap; print(valvemap.__file__)"
    asked = [python, "-c", where]
    found = subprocess.run(asked, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert found.startswith(str(home))
    rig, service, log = free_port(), free_port(), tmp_path / "demo.log"
    env = {
        "VALVEMAP_SOURCE__URL": rig_url(rig),
        "VALVEMAP_SERVER__URL": service_url(service),
        "PYTHONPATH": "",
    }
    with program(python, "-u", "-m", "valvemap", "demo", env=env, log=log, cwd=tmp_path) as process:
        wait_for(log, "samples; RMSE", process, timeout=600.0)
    assert process.returncode == 0


@pytest.mark.image
def test_the_wheel_and_the_package_service_of_pypi_leave_each_other_alone(built, tmp_path):
    home = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", home], check=True)
    (packages,) = home.glob("lib/python*/site-packages")
    pip = [home / "bin" / "python", "-m", "pip", "--quiet", "--disable-pip-version-check"]

    def owned(name):
        (record,) = packages.glob(f"{name}-*.dist-info/RECORD")
        names = [line.split(",")[0] for line in record.read_text(encoding="utf-8").splitlines()]
        files = [packages / each for each in names if each.endswith(".py")]
        return {file: file.read_bytes() for file in files if file.exists()}

    subprocess.run([*pip, "install", "--no-deps", built[0]], check=True)
    ours = owned("valvemap")
    subprocess.run([*pip, "install", "--no-deps", "service"], check=True)
    assert owned("valvemap") == ours
    assert not ours.keys() & owned("service").keys()
    subprocess.run([*pip, "uninstall", "--yes", "service"], check=True)
    assert owned("valvemap") == ours
