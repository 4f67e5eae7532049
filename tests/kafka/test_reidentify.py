"""Recordings on several processes: the models that `replay` makes, whoever is killed meanwhile."""

import json
import sys
from importlib.util import find_spec

import numpy as np
import pytest

from support.plant import plant
from support.processes import program, run

pytest.importorskip("distributed")
if find_spec("quixstreams") is None:  # its import compiles grammars for seconds
    pytest.skip("needs quixstreams", allow_module_level=True)

from valvemap.app.models import save_models
from valvemap.app.replay import replay
from valvemap.app.replay_report import as_json
from valvemap.config.loading import load_config
from valvemap.errors import RecordingError
from valvemap.kafka.reidentify import (
    NOTES,
    Task,
    _tasks,
    _valves_in,
    _where,
    _write_all,
    learn,
)
from valvemap.model.samples import Samples
from valvemap.storage.recording_writer import RecordingWriter

CONFIG = "".join(
    f"[[valves]]\nname = 'V{k}'\n[[valves.estimators]]\nkind = 'RLS'\n"
    "[[valves.estimators]]\nkind = 'RML'\n"
    for k in range(6)
)


def write(file, valves, seed=0, n=400, first=0):
    """A recording of some valves, mixed."""
    with RecordingWriter(file) as recording:
        parts = {valve: plant(n, seed=10 * seed + k, first=first) for k, valve in enumerate(valves)}
        for start in range(0, n, 100):
            for valve, samples in parts.items():
                recording.append(valve, samples[slice(start, start + 100)])
    return file


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Two days of three valves, and one of two others."""
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "site.toml").write_text(CONFIG, encoding="utf-8")
    return folder / "site.toml", [
        write(folder / "a1.parquet", ("V0", "V1", "V2"), 1),
        write(folder / "b.parquet", ("V3", "V4", "X"), 3),
        write(folder / "a2.parquet", ("V0", "V1", "V2"), 2, first=400),
    ]


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.glob("*.json")}


KILLED = """
import os, sys
from pathlib import Path
from valvemap.kafka import reidentify

def once(done, of):
    if done:
        os.kill(os.getpid(), 9)

if __name__ == "__main__":
    reidentify.AT_ONCE = 1
    from valvemap.config.loading import load_config
    files = [Path(name) for name in sys.argv[3:]]
    reidentify.reidentify(files, Path(sys.argv[1]), load_config(Path(sys.argv[2])), progress=once)
"""


@pytest.mark.waits
def test_who_is_killed_goes_on_with_the_rest_and_comes_to_the_bytes_of_replay(recordings, tmp_path):
    config, files = recordings
    script, out = tmp_path / "killed.py", tmp_path / "out"
    script.write_text(KILLED, encoding="utf-8")
    with program(sys.executable, script, out, config, *files, log=tmp_path / "log") as process:
        assert process.wait(240) == -9, (tmp_path / "log").read_text()
    before = {note.name: note.stat().st_mtime_ns for note in (out / NOTES).glob("*.json")}
    assert 1 <= len(before) < 5
    names = [str(file) for file in files]
    command = ("fleet", "reidentify", *names, "-c", str(config), "--out", str(out))
    made = run(*command, "--processes", "2", timeout=240.0)
    assert made.returncode == 0, made.stderr
    assert made.stdout.startswith(f"{out}: 5 valves, ")
    for name, stamp in before.items():
        assert (out / NOTES / name).stat().st_mtime_ns == stamp
    check_bytes(out, config, files)


def check_bytes(out, config, files):
    """The folder holds what `replay --save --json` makes."""
    report = replay(files, load_config(config))
    alone = out.with_name("alone")
    save_models(alone, report)
    expected, found = contents(alone), contents(out)
    assert len(expected) == 10
    assert json.loads(found.pop("models.json")) == as_json(report)
    assert found == expected


def test_tasks_come_to_the_bytes_of_replay_whatever_valves_are_in_each(
    recordings, tmp_path, monkeypatch
):
    config, files = recordings
    loaded, out = load_config(config), tmp_path / "out"
    (out / NOTES).mkdir(parents=True)
    monkeypatch.setattr("valvemap.kafka.reidentify.AT_ONCE", 2)
    where = _where(files, [_valves_in(file, loaded) for file in files])
    tasks, _, digests = _tasks(where, out, loaded, insist=False)
    assert [task.valves for task in tasks] == [("V0", "V1"), ("V2",), ("V3", "V4")]
    for task in reversed(tasks):
        assert learn(task) == []
    _write_all(out, digests)
    check_bytes(out, config, files)


def test_what_is_done_is_done_again_where_files_or_configuration_changed(tmp_path):
    file = write(tmp_path / "a.parquet", ("V0", "V1"))
    where = {"V0": (file,), "V1": (file,)}
    (tmp_path / "out" / NOTES).mkdir(parents=True)
    (task,), known, _ = _tasks(where, tmp_path / "out", None, insist=False)
    assert known == 0
    assert learn(task) == []
    tasks, known, digests = _tasks(where, tmp_path / "out", None, insist=False)
    assert (tasks, known) == ([], 2)
    _, known, others = _tasks(where, tmp_path / "out", None, insist=True)
    assert known == 0
    assert set(others.values()).isdisjoint(digests.values())
    write(file, ("V0", "V1"), n=500)
    assert _tasks(where, tmp_path / "out", None, insist=False)[1] == 0


def test_a_valve_that_cannot_be_what_it_is_called_is_named_and_holds_up_no_other(tmp_path):
    good = plant(600, seed=1)
    swapped = Samples.of(t=good.t, U=good.U, p1=good.p2, p2=good.p1, Q=good.Q, T=good.T)
    with RecordingWriter(tmp_path / "a.parquet") as recording:
        recording.append("V0", good)
        recording.append("V1", swapped)
    out = tmp_path / "out"
    (out / NOTES).mkdir(parents=True)
    task = Task(("V0", "V1"), (tmp_path / "a.parquet",), None, out, False, ("a", "b"))  # noqa: FBT003
    (refused,) = learn(task)
    assert "valve V1" in refused
    assert (out / "V0.RLS.json").exists()
    assert not (out / "V1.RLS.json").exists()
    note = json.loads((out / NOTES / "V0.json").read_text())
    assert np.isfinite(next(iter(note["figures"]["RLS"]["parameters"].values())))


def test_recordings_without_a_valve_that_is_wanted_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="no valve of the configuration"):
        _where([tmp_path / "a.parquet"], [[]])
    with pytest.raises(RecordingError, match=r"a\.parquet is damaged"):
        _where([tmp_path / "a.parquet"], ["a.parquet is damaged"])
