"""The page about speed says what was measured, and no figure of it comes from elsewhere."""

import importlib.util
import json

import pytest

from benchmarks import speed, speed_page
from benchmarks.speed_page import BARS, FLEETS, live_title


def a_record(**tables):
    titles = {title: {"part": "x", "command": "python -m x", "on": "today"} for title in tables}
    about = {"machine": "a machine", "versions": {"x": "1"}, "measured": titles}
    return {**about, "ratios to ours": {}, **tables}


def row(bar, record):
    return speed_page.bars(record)[[b.what for b in BARS].index(bar)]


@pytest.fixture(scope="module")
def latest():
    return json.loads(speed.RESULTS.read_text(encoding="utf-8"))


def test_the_page_is_what_the_record_makes_of_it(latest):
    assert speed.PAGE.read_text(encoding="utf-8") == speed_page.page(latest)


def test_the_record_holds_its_bars_as_they_are(latest):
    assert latest["bars"] == speed_page.bars(latest)


def test_every_table_of_the_record_names_a_part_that_can_be_measured_anew(latest):
    parts = speed.parts()
    for title in set(latest) - set(speed_page.ABOUT):
        made = latest["measured"][title]
        assert made["command"] == f"python -m benchmarks.{parts[made['part']].command}"


def test_every_command_of_the_page_is_a_module():
    commands = [bar.command for bar in BARS]
    commands += [f"python -m benchmarks.{part.command}" for part in speed.parts().values()]
    for command in commands:
        assert importlib.util.find_spec(command.split()[2]) is not None, command


def test_a_bar_is_met_up_to_its_edge_and_missed_beyond():
    what = "memory of a valve, default configuration"
    for kB, met in ((100.0, True), (100.1, False)):
        record = a_record(**{speed_page.MEMORY: {"resident": kB}})
        assert row(what, record)["met"] is met
    what = "`Auto` alone, after the first 1,000 samples of each valve"
    for slower, met in ((100_000.0, True), (99_999.0, False)):
        speeds = {"scattered: first 1,000 samples": 1.0, "scattered: after them": 2e5}
        record = a_record(**{speed_page.AUTO: {**speeds, "cycle: after them": slower}})
        assert row(what, record)["met"] is met


def test_what_was_not_measured_is_neither_met_nor_missed():
    found = speed_page.bars(a_record())
    assert {bar["met"] for bar in found} == {None}
    assert "not measured" in speed_page.page(a_record())


def test_what_users_run_comes_first_with_every_fleet():
    fleets = {
        live_title(valves, hz): {
            "samples/s": valves * hz,
            "lost": 3,
            "age when published, p99, s": 0.25,
            "cores of the service": 0.5,
        }
        for valves, hz in FLEETS
    }
    page = speed_page.page(a_record(other={"a": 1.0}, **fleets))
    assert page.index("## What users run") < page.index("## Bars") < page.index("## other")
    assert "| live | 1,000 | 10 | 10,000 | 3 | 0.25 s | 0.50 |" in page


def test_what_has_a_who_becomes_a_table_of_them():
    page = speed_page.page(a_record(clients={"a: speed": 2.0, "a: lost": 0.0, "b: speed": 1_000.0}))
    assert "| | speed | lost |" in page
    assert "| a | 2 | 0 |" in page
    assert "| b | 1,000 |  |" in page


def test_parts_measured_anew_leave_the_others_as_they_were(monkeypatch):
    made = {"one": speed.Part("a", lambda _: {"A": {"x": 2.0, "y": 4.0}}, compares=True)}
    made["two"] = speed.Part("b", lambda seconds: {"B": {"z": seconds}})
    monkeypatch.setattr(speed, "parts", lambda: made)
    first = speed.measured(["one", "two"], 7.0, {})
    made["two"] = speed.Part("b", lambda seconds: {"C": {"z": seconds}})
    second = speed.measured(["two"], 8.0, first)
    assert (first["A"], first["B"]) == (second["A"], {"z": 7.0})
    assert second["C"] == {"z": 8.0}
    assert "B" not in second
    assert second["ratios to ours"] == {"A": {"x": 1.0, "y": 2.0}}


def test_the_picture_is_drawn_of_whatever_was_measured(tmp_path, latest):
    for record in (a_record(), latest):
        speed_page.draw(record, tmp_path / "picture.png")
        assert (tmp_path / "picture.png").stat().st_size > 5_000
