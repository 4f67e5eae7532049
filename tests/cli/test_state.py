"""`valvemap state`: what was learnt is listed, adopted, renamed, exported and imported."""

import numpy as np
import pytest

from support.plant import as_changes, plant
from valvemap.app.axes import axes_file, build_axis_states
from valvemap.app.build import build_identification
from valvemap.cli import run
from valvemap.config.loading import load_config
from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.pipeline.kept_axes import Learnt
from valvemap.pipeline.kept_together import KeptValves
from valvemap.runtime.restoring import restore
from valvemap.storage.checkpoints import CheckpointFile

CONFIG = """
[state]
file = "{folder}/{state}"
[[valves]]
name = "{name}"
estimators = [{{ kind = "RLS" }}, {{ kind = "RML" }}]
[valves.nodes]
U = "ns=2;s=U"
p1 = "ns=2;s=p1"
p2 = "ns=2;s=p2"
Q = "{Q}"
"""


@pytest.fixture
def config(tmp_path):
    def write(state="state.sqlite", name="V1", Q="ns=2;s=Q"):
        file = tmp_path / f"{state}.toml"
        file.write_text(CONFIG.format(folder=tmp_path, state=state, name=name, Q=Q))
        return file

    return write


def start(file):
    """What a service restores from its state file at the start, and saves."""
    loaded = load_config(file)
    identification = build_identification(loaded)
    with CheckpointFile(loaded.state.file) as store:
        restore(KeptValves(identification), store, store.load())
        store.save(identification.states.kept())
    return identification.results.one(0).estimators["RLS"]


@pytest.fixture
def learnt(config):
    file = config()
    loaded = load_config(file)
    identification = build_identification(loaded)
    identification.take(as_changes(plant(200)))
    with CheckpointFile(loaded.state.file) as store:
        store.save(identification.states.kept())
    return file, identification.results.one(0).estimators["RLS"].theta


def valvemap(capsys, *arguments):
    code = run([*map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out.splitlines(), err.splitlines()


def test_the_list_says_what_the_next_start_makes_of_each(learnt, config, capsys):
    file, _ = learnt
    code, lines, _ = valvemap(capsys, "state", "list", "-c", file)
    assert code == 0
    until = "to 2027-01-15T08:00:01Z"
    assert lines == [f"V1.{name}: {until}; fits the configuration" for name in ("RLS", "RML")]
    code, lines, _ = valvemap(capsys, "state", "list", "-c", config(Q="ns=2;s=FT-7"))
    assert lines[0] == f"V1.RLS: {until}; Q came from ns=2;s=Q, now from ns=2;s=FT-7"


def test_it_is_listed_while_a_service_runs_and_changed_only_when_none_does(learnt, capsys):
    file, _ = learnt
    with CheckpointFile(load_config(file).state.file):
        assert valvemap(capsys, "state", "list", "-c", file)[0] == 0
        code, _, err = valvemap(capsys, "state", "rename", "V1", "V2", "-c", file)
    assert (code, len(err)) == (1, 1)
    assert "is in use by process" in err[0]


def test_a_state_that_was_set_aside_is_adopted(learnt, config, capsys):
    _, theta = learnt
    other = config(Q="ns=2;s=FT-7")
    assert start(other).sample_count == 0
    code, lines, _ = valvemap(capsys, "state", "list", "-c", other)
    assert "1 V1.RLS" in " ".join(lines) or "V1.RLS" in " ".join(lines)
    code, lines, err = valvemap(capsys, "state", "adopt", "V1.RLS", "-c", other)
    assert (code, lines, err) == (0, ["V1.RLS: adopted"], [])
    found = start(other)
    assert found.theta.tolist() == theta.tolist()


def test_a_number_or_name_that_is_not_aside_is_refused_in_a_line(learnt, capsys):
    file, _ = learnt
    for what in ("7", "V1.RLS", "nobody"):
        code, _, err = valvemap(capsys, "state", "adopt", what, "-c", file)
        assert (code, len(err)) == (1, 1)
        assert f"{what}: no such state is set aside; there are none" in err[0]


def test_a_renamed_valve_keeps_what_it_learnt(learnt, config, capsys):
    file, theta = learnt
    code, lines, _ = valvemap(capsys, "state", "rename", "V1", "Press", "-c", file)
    assert (code, lines) == (0, ["Press.RLS: renamed", "Press.RML: renamed"])
    assert start(config(name="Press")).theta.tolist() == theta.tolist()
    code, _, err = valvemap(capsys, "state", "rename", "V9", "V1", "-c", file)
    assert (code, len(err)) == (1, 1)
    assert "V9: no such state; there are Press" in err[0]


def test_states_go_to_another_service_by_a_file(learnt, config, capsys, tmp_path):
    file, theta = learnt
    out = tmp_path / "out.sqlite"
    assert valvemap(capsys, "state", "export", out, "-c", file)[:2] == (0, [f"{out}: 2 states"])
    other = config("other.sqlite")
    assert start(other).sample_count == 0
    code, lines, _ = valvemap(capsys, "state", "import", out, "-c", other)
    assert (code, lines) == (0, ["V1.RLS: imported", "V1.RML: imported"])
    assert start(other).theta.tolist() == theta.tolist()


@pytest.mark.parametrize("content", [None, b"no database" * 100])
def test_a_file_that_is_none_is_refused_in_a_line(learnt, capsys, tmp_path, content):
    file, _ = learnt
    given = tmp_path / "given"
    if content is not None:
        given.write_bytes(content)
    code, _, err = valvemap(capsys, "state", "import", given, "-c", file)
    assert (code, len(err)) == (2 if content is None else 1, 1)
    assert str(given) in err[0]


AXIS = """
[state]
file = "{folder}/{state}"
[[axes]]
name = "{name}"
piston_mm = 63
rod_mm = 45
stroke_mm = 800
dead_A_l = 1.2
[axes.nodes]
U = "ns=2;s=U"
position = "{x}"
pA = "ns=2;s=pA"
pB = "ns=2;s=pB"
pS = "ns=2;s=pS"
pT = "ns=2;s=pT"
"""


@pytest.fixture
def axis_config(tmp_path):
    def write(state="axis.sqlite", name="Press", x="ns=2;s=x"):
        file = tmp_path / f"{state}.toml"
        file.write_text(AXIS.format(folder=tmp_path, state=state, name=name, x=x))
        return file

    return write


@pytest.fixture
def learnt_axis(axis_config):
    file = axis_config()
    loaded = load_config(file)
    states = build_axis_states(loaded)
    regression = AxisRegression(AxisGeometry(63, 45, 800, 1.2, 1.2), play_percent=2.0)
    initial = regression.initial_state()
    states._axes[0].learner.continue_from(Learnt(regression, initial, np.zeros((SIZE, SIZE))))
    states._axes[0].t = 1_800_000_000_000_000_000
    with CheckpointFile(axes_file(loaded)) as store:
        store.save(states.kept([0]))
    return file


def started_axis(file):
    """The axis of a service that starts with its state file, and saves."""
    loaded = load_config(file)
    states = build_axis_states(loaded)
    with CheckpointFile(axes_file(loaded)) as store:
        restore(states, store, store.load())
        store.save(states.kept([0]))
    return states._axes[0]


def test_axes_are_listed_with_what_the_next_start_makes_of_them(learnt_axis, axis_config, capsys):
    until = "to 2027-01-15T08:00:00Z"
    code, lines, _ = valvemap(capsys, "state", "list", "-c", learnt_axis)
    assert (code, lines) == (0, [f"Press.Axis: {until}; fits the configuration"])
    _, lines, _ = valvemap(capsys, "state", "list", "-c", axis_config(name="Ram"))
    assert lines == [f"Press.Axis: {until}; was Press.Axis: found again by its nodes"]
    _, lines, _ = valvemap(capsys, "state", "list", "-c", axis_config(x="ns=2;s=XT-7"))
    assert lines == [f"Press.Axis: {until}; position came from ns=2;s=x, now from ns=2;s=XT-7"]


def test_an_axis_that_was_set_aside_is_adopted_by_number_or_name(learnt_axis, axis_config, capsys):
    assert learnt_axis
    other = axis_config(x="ns=2;s=XT-7")
    assert started_axis(other).learner.learnt is None
    _, lines, _ = valvemap(capsys, "state", "list", "-c", other)
    (line,) = (one for one in lines if "Press.Axis:" in one)
    number = line.split()[0]
    assert number.startswith("a")
    code, lines, _ = valvemap(capsys, "state", "adopt", number, "-c", other)
    assert (code, lines) == (0, ["Press.Axis: adopted"])
    assert started_axis(other).learner.learnt is not None


def test_an_axis_is_renamed_exported_and_imported_as_a_valve_is(
    learnt_axis, axis_config, capsys, tmp_path
):
    code, lines, _ = valvemap(capsys, "state", "rename", "Press", "Ram", "-c", learnt_axis)
    assert (code, lines) == (0, ["Ram.Axis: renamed"])
    out = tmp_path / "out.sqlite"
    code, lines, _ = valvemap(capsys, "state", "export", out, "-c", learnt_axis)
    assert (code, lines) == (0, [f"{out}: 1 states"])
    other = axis_config("other.sqlite", name="Ram")
    code, lines, _ = valvemap(capsys, "state", "import", out, "-c", other)
    assert (code, lines) == (0, ["Ram.Axis: imported"])
    assert started_axis(other).learner.learnt is not None
    code, _, err = valvemap(capsys, "state", "rename", "Press", "X", "-c", other)
    assert (code, len(err)) == (1, 1)
    assert "Press: no such state; there are Ram" in err[0]


@pytest.mark.parametrize("new", ["", "a b", "1V", "V" * 65, "V2.RLS", "Presse-ä", "V1"])
def test_a_name_that_no_valve_can_have_is_no_new_name(learnt, capsys, new):
    file, _ = learnt
    code, _, err = valvemap(capsys, "state", "rename", "V1", new, "-c", file)
    assert (code, len(err)) == (2, 1)
    assert "allowed is a letter" in err[0] or "has this name already" in err[0]
    assert valvemap(capsys, "state", "list", "-c", file)[1][0].startswith("V1.RLS")


def test_a_folder_in_place_of_a_file_is_said(learnt, capsys, tmp_path):
    file, _ = learnt
    code, _, err = valvemap(capsys, "state", "export", tmp_path, "--force", "-c", file)
    assert (code, err) == (2, [f"valvemap: FILE {tmp_path}: is a folder; name a file"])
    code, _, err = valvemap(capsys, "state", "import", tmp_path / "nothing", "-c", file)
    assert (code, len(err)) == (2, 1)
    assert "no such file; `valvemap state export` makes it" in err[0]
