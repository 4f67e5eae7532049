"""The hostile table: its bars are judged as the page says, and our server keeps them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import hostile


def row(**changes):
    phase = {
        "median_ms": 1.0,
        "worst_ms": 10.0,
        "gap_ms": 9.0,
        "reads": 9,
        "got": 9,
        "first": 1,
        "last": 9,
    }
    made = {
        "rss_ratio": 1.5,
        "quiet": phase,
        "loaded": {**phase, "median_ms": 2.0, "worst_ms": 250.0},
        "lost": 0,
        "served": True,
        "log_bytes_per_s": 100.0,
    }
    return {**made, **changes}


def felt(**changes):
    return {**row()["loaded"], **changes}


def test_a_row_at_its_bars_misses_none():
    assert hostile.failings(row()) == []
    quiet = {**row()["quiet"], "worst_ms": 100.0}
    assert hostile.failings(row(quiet=quiet, loaded=felt(worst_ms=300.0))) == []


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({"rss_ratio": 1.51}, ["memory"]),
        ({"loaded": felt(median_ms=2.1)}, ["median"]),
        ({"loaded": felt(worst_ms=251.0)}, ["worst"]),
        ({"loaded": felt(gap_ms=251.0)}, ["gap"]),
        ({"lost": 1}, ["lost"]),
        ({"served": False}, ["lost"]),
        ({"loaded": None, "lost": None, "served": False}, ["median", "worst", "gap", "lost"]),
        ({"log_bytes_per_s": 1e6}, ["log"]),
    ],
)
def test_a_row_beyond_a_bar_misses_it(changes, missed):
    assert hostile.failings(row(**changes)) == missed


def test_a_number_that_never_came_is_lost():
    loaded = felt(first=10, last=20, got=9)
    assert hostile.row_of(row()["quiet"], loaded, 100, 120, 0.0)["lost"] == 2


@pytest.mark.alone
@pytest.mark.parametrize("load", ["triggering", "delete_subscriptions"])
async def test_the_others_hardly_notice_who_asks_for_all_that_the_limits_allow(load):
    row = await hostile.measured("ours", load, 2.0)
    assert not {"gap", "lost"} & set(row["missed"]), row


def test_each_load_has_a_name_and_a_line_in_the_page():
    page = (Path(hostile.__file__).parents[1] / "docs" / "hostile.md").read_text(encoding="utf-8")
    assert [load for load in hostile.LOADS if f"`{load}`" not in page] == []


@pytest.mark.soak
def test_our_server_keeps_every_bar_under_every_load():
    command = [sys.executable, "-m", "benchmarks.hostile", "--ours-only"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = json.loads(hostile.RESULTS.read_text(encoding="utf-8"))["rows"]
    missed = {load: kinds["ours"]["missed"] for load, kinds in rows.items()}
    assert not any(missed.values()), missed
    assert done.returncode == 0
