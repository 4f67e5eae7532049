"""`valvemap sheet`: a table, a page, JSON, verdicts, and one line where something is wrong."""

import json
import re

import numpy as np
import pytest

from benchmarks.commission_plant import VALVES
from benchmarks.sheet import swept
from cli.test_dynamics import recorded
from valvemap.app.build import build_identification
from valvemap.cli import run
from valvemap.config.loading import load_config
from valvemap.pipeline.commission_plan import Plan
from valvemap.pipeline.operator_ports import Command
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.storage.commission_files import RunFiles, last_run, last_sampled_run
from valvemap.storage.recording_writer import RecordingWriter

DATASHEET = """
rated_dp_bar = 70
[figures.rated_flow]
value = 105
min = 95
max = 115
[figures.hysteresis]
max = 1.5
"""


CONFIG = """
[state]
file = "state.sqlite"
[[valves]]
name = "V1"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sheet")
    valves = {"one": "dead band 8 %, play 2 %", "both": "U of both signs, play 3 %"}
    for file, name in valves.items():
        with RecordingWriter(folder / f"{file}.csv") as recording:
            recording.append("V1", swept(VALVES[name], 5))
    (folder / "datasheet.toml").write_text(DATASHEET, encoding="utf-8")
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


def test_a_sheet_is_printed_written_and_judged(folder, capsys):
    outputs = ["--out", "one.html", "--json", "one.json"]
    code = run(["sheet", "V1", "--from", "one.csv", "--datasheet", "datasheet.toml", *outputs])
    shown = capsys.readouterr().out
    assert code == 1  # the hysteresis is too wide
    assert "rated flow" in shown
    assert "fail" in shown
    assert "Not a test" not in shown
    sheet = json.loads((folder / "one.json").read_text(encoding="utf-8"))
    figures = {figure["key"]: figure for figure in sheet["figures"]}
    assert sheet["is_a_test"]
    assert figures["rated_flow"]["verdict"] == "pass"
    assert figures["hysteresis"]["verdict"] == "fail"
    assert (figures["hysteresis"]["min"], figures["hysteresis"]["max"]) == (None, 1.5)
    assert "105, 95 … 115" in " ".join(page_text(folder / "one.html").split())
    assert figures["threshold"]["value"] is None
    assert figures["hysteresis"]["lower"] < 2.0 < figures["hysteresis"]["upper"]
    page = (folder / "one.html").read_text(encoding="utf-8")
    assert "<svg" in page
    assert "ISO 10770-1" in page
    assert not re.search(r"(src|href)=[\"']?http|url\(http|@import", page)


def page_text(file):
    return re.sub(r"<[^>]+>", " ", file.read_text(encoding="utf-8"))


def guided(folder, name, ended):
    """A recording with four traverses, then moves within the range, and its audit record."""
    whole = swept(VALVES["dead band 8 %, play 2 %"], 5, guided=Plan(24.0, sweep_s=72.0))
    within = (np.abs(whole.U - 50.0) < 35.0) | (np.arange(len(whole)) < 0.82 * len(whole))
    with RunFiles(folder / f"{name}.csv", "V1") as files:
        files.append(whole[within])
        files.note({"event": "started", "phase": "CHECKING"})
        for phase, reason in ended:
            files.note({"event": "ended", "phase": phase, "reason": reason})


@pytest.mark.parametrize(
    ("ended", "said"),
    [
        ([("DONE", "the time is up")], None),
        ([("ABORTED", "the operator aborted")], "guided run was ended: the operator aborted."),
        ([], "Not a test: the guided run did not end."),
    ],
)
def test_a_guided_run_is_a_test_if_it_ended(folder, ended, said, capsys, monkeypatch):
    monkeypatch.setattr("valvemap.model.sheet.IN_TRAVERSES", 1.1)  # of a run, moves are no work
    name = f"V1.2026010{1 + len(ended) + 2 * (said is None)}T000000Z"
    guided(folder, name, ended)
    assert run(["sheet", "V1", "--from", f"{name}.csv"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert said in shown if said else "Not a test" not in shown
    assert "traverses at 8.33 % per s" in shown


def test_a_run_without_samples_is_passed_over(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    guided(tmp_path, "data/commission/V1.20260101T000000Z", [("DONE", "")])
    with RunFiles(tmp_path / "data/commission/V1.20260102T000000Z.csv", "V1"):
        pass
    assert run(["sheet", "V1"]) == 0
    assert "rated flow" in capsys.readouterr().out


def test_a_refused_run_is_passed_over_and_a_refused_continuation_is_not(tmp_path, capsys):
    folder = tmp_path / "commission"
    for hour, notes in enumerate([[{"phase": "DONE", "elapsed_s": 60.0}], [{"phase": "REFUSED"}]]):
        with RunFiles(folder / f"V1.20260101T0{hour}0000Z.csv", "V1") as files:
            files.append(swept(VALVES["ordinary, no play"], 5)[:200])
            for note in notes:
                files.note({"event": "ended", "reason": "samples are too old", **note})
    for found in (last_run, last_sampled_run):
        assert found(folder, "V1").name == "V1.20260101T000000Z.csv"
    with RunFiles(folder / "V1.20260101T000000Z.csv", "V1") as files:
        files.note({"event": "ended", "phase": "REFUSED", "reason": "", "elapsed_s": 60.0})
    assert last_run(folder, "V1").name == "V1.20260101T000000Z.csv"


def test_the_sheet_stands_beside_a_saved_map(capsys):
    assert run(["replay", "one.csv", "--save", "one.model.json"]) == 0
    assert run(["sheet", "V1", "--from", "one.csv", "--against", "one.model.json"]) == 0
    assert re.search(r"Curve less one\.model\.json \(\w+\): \+", capsys.readouterr().out)


def test_recorded_steps_add_dynamics_step_response_and_bode_plot(folder, capsys):
    recorded(folder / "steps.csv", 20.0)
    outputs = ["--out", "with.html", "--json", "with.json"]
    assert run(["sheet", "V1", "--from", "one.csv", "--dynamics", "steps.csv", *outputs]) == 0
    assert "NaturalFrequency" in capsys.readouterr().out
    dynamics = json.loads((folder / "with.json").read_text(encoding="utf-8"))["dynamics"]
    assert dynamics["quantities"]["NaturalFrequency"]["value"] == pytest.approx(8.0, rel=0.03)
    assert dynamics["frequency_response"]["dB"][-1] < -20.0
    assert len(dynamics["step_response"]["t"]) > 100
    page = (folder / "with.html").read_text(encoding="utf-8")
    assert "Dynamics from steps.csv" in page
    assert page.count("<svg") == 2
    assert "phase" in page


def test_the_sheet_stands_beside_the_approved_map_of_the_service(folder, capsys):
    (folder / "v.toml").write_text(CONFIG, encoding="utf-8")
    identification = build_identification(load_config(folder / "v.toml"))
    quick = swept(VALVES["dead band 8 %, play 2 %"], 5, guided=Plan(4.0, sweep_s=60.0))
    identification.take_samples(0, quick)
    identification.do(Command.of("approve", "V1"))
    with CheckpointFile(folder / "state.sqlite") as store:
        store.save(identification.states.kept())
    asked = ["sheet", "V1", "--from", "one.csv", "--config", "v.toml", "--approved"]
    assert run(asked) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "Curve less the approved map 1-" in shown
    mean = float(re.search(r"\(Auto\): ([+-][\d.e-]+) l/min in the mean", shown)[1])
    assert abs(mean) < 1.0


WRONG = {
    "no service": (["--from", "one.csv", "--approved"], 2, "--approved: --config is needed"),
    "no run": (
        [],
        2,
        "V1': data/commission holds no run of it with samples; name a recording with --from",
    ),
    "both ways": (["--from", "both.csv"], 2, "say --both-ways if the valve works both ways"),
    "no valve": (["--from", "one.csv", "V2"], 2, "one.csv has no such valve; there is V1"),
    "Δp": (["--from", "one.csv", "--rated-dp", "300"], 1, "the rated Δp is 300 bar; the recordi"),
    "no datasheet": (["--from", "one.csv", "--datasheet", "x.toml"], 2, "x.toml: no such file"),
    "no map": (
        ["--from", "one.csv", "--against", "one.csv"],
        2,
        "--against one.csv: a saved map (.json) is needed; `valvemap replay RECORDING --save",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named_in_one_line(name, capsys):
    arguments, expected, said = WRONG[name]
    valve = [] if "V2" in arguments else ["V1"]
    assert run(["sheet", *valve, *arguments]) == expected
    captured = capsys.readouterr()
    assert said in captured.err
    assert len(captured.err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[figures.leak]\nmax = 1", "there is no figure 'leak'; allowed are rated_flow, dead_band"),
        ("[figures.leakage]\nmin = 2\nmax = 1", "figures.leakage: min 2 is above max 1"),
        ("rated_dp_bar = -1", "rated_dp_bar = -1: input should be greater than 0"),
        ("rated_dp_bar = inf", "rated_dp_bar = inf: input should be a finite number"),
        ("[figures.leakage]\nmax = nan", "figures.leakage.max = nan: input should be a finite num"),
        ("[figures.leakage]\nmax = true", "figures.leakage.max = True: true is no number"),
        ("[figures.leakage]\nmax = '1 l/min'", "figures.leakage.max = '1 l/min': input should be"),
        ("[figures.leakage]\n", "figures.leakage: value, min or max is needed"),
        ("[figures.hysteresis]\nmax = -1", "figures.hysteresis.max = -1: no hysteresis is below 0"),
        ("[figures.rated_flow]\nvalue = -9", "figures.rated_flow.value = -9: no rated flow is be"),
        ("[figures.symmetry]\nmax = 1", "figures.symmetry: a valve that works one way has no symm"),
        ("x = [", "not valid TOML"),
        ("[figures.leakage]\nvalu = 1", "figures.leakage.valu: there is no such field; is value"),
        ("[figurs.leakage]\nmin = 1", "figurs: there is no such field; is figures meant?"),
        ("[figures]\nleakage = 5", "a section is needed, [figures.leakage] with value, min, max"),
    ],
)
def test_a_wrong_datasheet_is_named_with_its_field(folder, text, said, capsys):
    (folder / "wrong.toml").write_text(text, encoding="utf-8")
    assert run(["sheet", "V1", "--from", "one.csv", "--datasheet", "wrong.toml"]) == 2
    assert said in capsys.readouterr().err


def test_a_valve_that_works_both_ways_has_figures_of_both_sides(capsys):
    assert run(["sheet", "V1", "--from", "both.csv", "--both-ways"]) == 0
    shown = capsys.readouterr().out
    assert "rated flow, U < 0" in shown
    assert "symmetry" in shown


def test_a_side_that_was_not_driven_has_no_symmetry(folder, capsys):
    outputs = ["--json", "half.json"]
    assert run(["sheet", "V1", "--from", "one.csv", "--both-ways", *outputs]) == 0
    capsys.readouterr()
    sheet = json.loads((folder / "half.json").read_text(encoding="utf-8"))
    figures = {(one["key"], one["side"]): one for one in sheet["figures"]}
    for one in (figures["symmetry", ""], figures["rated_flow", "U < 0"]):
        assert one["value"] is None
        assert one["reason"] == "U was 0 % at most of 100 %"
