"""`valvemap dynamics`: a table, a page, JSON, and one line where something is wrong."""

import json
import re

import numpy as np
import pytest

from valvemap.cli import run
from valvemap.model.samples import Samples
from valvemap.storage.recording_writer import RecordingWriter
from valvemap_rig.excitation import Scattered
from valvemap_rig.scenario import Scenario, ValveBench
from valvemap_rig.simulation import advance, initial
from valvemap_rig.valvistor import Valvistor


def recorded(file, seconds, rate=100.0):
    """A recording of the rig: steps of U in front of a spool of 8 Hz."""
    scenario = Scenario(
        sample_rate_hz=rate,
        excitation=Scattered(hold_s=0.4),
        valves=(ValveBench(valve=Valvistor(spool_hz=8.0)),),
    )
    _, block = advance(scenario, initial(scenario, 10**18), round(seconds * rate))
    (valve,) = block.valves.values()
    with RecordingWriter(file) as recording:
        columns = (valve.U, valve.p1, valve.p2, valve.Q, valve.T)
        recording.append("V1", Samples.of(valve.t, *map(np.asarray, columns)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dynamics")
    recorded(folder / "steps.csv", 20.0)
    recorded(folder / "short.csv", 5.0)
    recorded(folder / "slow.csv", 60.0, rate=10.0)
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


def test_the_rigs_spool_is_found_printed_and_written(folder, capsys):
    outputs = ["--out", "one.html", "--json", "one.json"]
    assert run(["dynamics", "V1", "--from", "steps.csv", *outputs]) == 0
    shown = capsys.readouterr().out
    assert "NaturalFrequency" in shown
    assert "Slew" in shown
    assert "not excited" in shown
    found = json.loads((folder / "one.json").read_text(encoding="utf-8"))
    frequency = found["quantities"]["NaturalFrequency"]
    assert frequency["status"] == "OK"
    assert frequency["value"] == pytest.approx(8.0, rel=0.03)
    assert found["quantities"]["Damping"]["value"] == pytest.approx(0.7, abs=0.05)
    assert found["quantities"]["Slew"]["value"] is None
    assert found["step_response"]["x"][-1] == pytest.approx(found["step_percent"], rel=0.05)
    page = (folder / "one.html").read_text(encoding="utf-8")
    assert "<svg" in page
    assert not re.search(r"(src|href)=[\"']?http|url\(http|@import", page)


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["V1", "--from", "short.csv"], 1, "short.csv: 500 usable samples are too few"),
        (["V1", "--from", "slow.csv"], 1, "slow.csv: one sample every 100 ms is too slow"),
        (["V2", "--from", "steps.csv"], 2, "steps.csv has no such valve; there is V1"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(arguments, code, said, capsys):
    assert run(["dynamics", *arguments]) == code
    captured = capsys.readouterr()
    assert said in captured.err
    assert len(captured.err.strip().splitlines()) == 1
