"""No command replaces a file that is there, but with --force: of every option that takes a path.

A new option has to be put into one of the two tables, or the first test fails.
"""

from importlib import import_module
from pathlib import Path
from typing import get_type_hints

import pytest
import typer

from valvemap.cli import run
from valvemap.cli.command_table import COMMANDS

READ = {  # what a command reads, or its own folder of certificates, users and states
    "config",
    "data",
    "verify",
    "points",
    "password_file",
    "users",
    "certificate",
    "key",
    "files",
    "ca",
}
READ_OF = {
    *(("invert", "file"), ("export", "file"), ("baseline", "file"), ("state import", "file")),
    *(
        ("axis", "file"),
        ("sheet", "recording"),
        ("dynamics", "recording"),
        ("sheet", "datasheet"),
        ("sheet", "against"),
        ("sheet", "steps"),
    ),
}
AXIS = "axis r.csv --piston 63 --rod 45 --stroke 800 --dead 0.6"
WRITTEN = {  # (command, parameter): the command line, {} is the path; and the file that is there
    ("invert", "out"): ("invert m.json --Q 1 --dp 2 --to {}", "answers.csv", ""),
    ("export", "out"): ("export m.json --to {}", "map.c", ""),
    ("replay", "json_out"): ("replay r.csv --json {}", "figures.json", ""),
    ("replay", "save"): ("replay r.csv --save {}", "model.json", ""),
    ("replay", "save", "folder"): ("replay r.csv --save {}", "models", "V1.RLS.json"),
    ("replay", "plot"): ("replay r.csv --plot {}", "pictures", "index.html"),
    ("replay", "plot", "png"): ("replay r.csv --plot {}", "pictures", "V1.RLS.map.png"),
    ("record", "file"): ("record {}", "r.csv", ""),
    ("record", "file", "timing"): ("record {}/r.csv", ".", "r.csv.timing.json"),
    ("rig", "record"): ("rig --offline --duration 1 --record {}", "r.csv", ""),
    ("connect", "out"): ("connect opc.tcp://127.0.0.1:1 --out {}", "valvemap.toml", ""),
    ("connect", "sheet"): ("connect opc.tcp://127.0.0.1:1 --sheet {}", "sheet.html", ""),
    ("axis", "out"): (f"{AXIS} --to {{}}", "axis.st", ""),
    ("axis", "json_file"): (f"{AXIS} --json {{}}", "axis.json", ""),
    ("sheet", "out"): ("sheet V1 --from r.csv --out {}", "sheet.html", ""),
    ("dynamics", "out"): ("dynamics V1 --from r.csv --out {}", "dynamics.html", ""),
    ("dynamics", "json_file"): ("dynamics V1 --from r.csv --json {}", "dynamics.json", ""),
    ("sheet", "json_file"): ("sheet V1 --from r.csv --json {}", "sheet.json", ""),
    ("report", "out"): ("report --out {}", "reports", "paper.html"),
    ("history export", "file"): ("history export {}", "r.csv", ""),
    ("state export", "file"): ("state export {}", "states.sqlite", ""),
    ("fleet reidentify", "out"): ("fleet reidentify r.csv --out {}", "models", "V1.RLS.json"),
}


def paths():
    """Every parameter that takes a path, with its command."""
    for name, entry in COMMANDS.items():
        command = getattr(import_module(f"valvemap.cli.{entry.module}"), name.replace("-", "_"))
        if isinstance(command, typer.Typer):
            yield from paths_of_group(command, name)
        else:
            yield from paths_of_command(command, name)


def paths_of_group(app, name):
    for group in app.registered_groups:
        yield from paths_of_group(group.typer_instance, f"{name} {group.name}")
    for command in app.registered_commands:
        word = command.name or command.callback.__name__.replace("_", "-")
        yield from paths_of_command(command.callback, f"{name} {word}")


def paths_of_command(function, name):
    for parameter, kind in get_type_hints(function).items():
        if "Path" in str(kind):
            yield name, parameter


def test_every_option_that_takes_a_path_is_known_as_read_or_written():
    found = list(paths())
    assert len(found) > 20
    written = {key[:2] for key in WRITTEN}
    unknown = [
        key for key in found if key[1] not in READ and key not in READ_OF and key not in written
    ]
    assert not unknown
    assert written <= set(found)


@pytest.mark.parametrize("key", WRITTEN, ids=" ".join)
def test_what_is_there_is_not_replaced_without_force(key, tmp_path, monkeypatch, capsys):
    line, target, within = WRITTEN[key]
    monkeypatch.chdir(tmp_path)
    there = Path(target) / within if within else Path(target)
    there.parent.mkdir(parents=True, exist_ok=True)
    there.write_text("mine")
    assert run(line.format(target).split()) == 2
    said = capsys.readouterr()
    assert f"{there}: is there already; another name, or --force, is needed" in said.err
    assert said.err.count("\n") == 1
    assert not said.out
    assert there.read_text() == "mine"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [tmp_path / there]


def test_with_force_it_is_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("r.csv").write_text("mine")
    asked = ["rig", "--offline", "--duration", "2", "--record", "r.csv"]
    assert run([*asked, "--force"]) == 0
    assert Path("r.csv").read_text().startswith("t,")


def test_a_recording_without_a_sample_leaves_the_old_one_as_it_was(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("c.toml").write_text("[history]\nfile = 'h.sqlite'\n")
    from valvemap.storage.history import HistoryFile

    HistoryFile("h.sqlite").close()
    Path("r.csv").write_text("mine")
    assert run(["history", "export", "r.csv", "--config", "c.toml", "--force"]) == 1
    assert "nothing is known of that span" in capsys.readouterr().err
    assert Path("r.csv").read_text() == "mine"
    assert not list(tmp_path.glob("*.part"))


def test_init_keeps_every_password_that_is_there(tmp_path, capsys):
    data = tmp_path / "data"
    assert run(["init", "--data", str(data)]) == 0
    before = {name: (data / name).read_text() for name in ("source-password", "dashboard-password")}
    (data / "users.json").unlink()
    assert run(["init", "--data", str(data)]) == 0
    assert before == {name: (data / name).read_text() for name in before}
