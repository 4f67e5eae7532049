"""Auto's thresholds are explained where they stand, and the table says what they move."""

import ast
import json

import pytest

from benchmarks import sensitivity, thresholds
from benchmarks.thresholds import KERNELS, PURE


def values(tree):
    return {n.targets[0].id: n.value for n in tree.body if isinstance(n, ast.Assign)}


def test_every_threshold_of_auto_has_a_comment_on_its_line():
    assert thresholds.unexplained((*PURE, *KERNELS)) == []


def test_thresholds_are_found_and_places_are_not():
    found = set(thresholds.thresholds((*PURE, *KERNELS)))
    assert {("drift", "CLEAR"), ("kernels.cells", "ALARM_LEVEL"), ("lag_search", "SHARES")} <= found
    assert not {("kernels.cells", "USED"), ("kernels.lag", "TIME"), ("map_search", "RICH")} & found
    assert {name for module, name in found if module == "kernels.grid"} >= {"CELLS_U", "COLD"}


@pytest.mark.parametrize(
    ("line", "factor", "made"),
    [
        ("A = 3  # s", 0.5, 2),
        ("A = 1  # s", 0.5, 1),
        ("A = 0.5  # s", 2.0, 1.0),
        ("A = 1.02**2  # share", 2.0, 2 * 1.02**2),
        ("A = (1.0, 4.0)  # s", 0.5, (0.5, 2.0)),
    ],
)
def test_a_threshold_is_scaled_and_a_whole_number_stays_one(line, factor, made):
    scaled = thresholds.scaled(f"{line}\nB = 7  # other", "A", factor)
    found = values(scaled)
    assert ast.literal_eval(found["A"]) == pytest.approx(made)
    assert type(ast.literal_eval(found["A"])) is type(made)
    assert ast.literal_eval(found["B"]) == 7


def test_the_page_lists_what_moves_a_figure_by_more_than_a_tenth():
    tried = {
        "drift.CLEAR": {"0.5": {"a": 1.05, "b": 4.0}, "2.0": {"a": 1.2, "b": 4.5}},
        "drift.SURE": {"0.5": {}, "2.0": {"a": 1.0, "b": 4.0}},
    }
    page = sensitivity.page({"base": {"a": 1.0, "b": 4.0}, "tried": tried})
    assert "| `drift.CLEAR` | 2.0 | a: 1.20, b: 1.12 |" in page
    assert "| `drift.SURE` | 0.5 | *fails* |" in page
    assert page.count("| `") == 2
    assert "Tried: 2 thresholds of `drift`." in page


def test_the_page_says_so_where_nothing_was_tried():
    assert "Nothing has been tried yet" in sensitivity.page({"base": {}, "tried": {}})


def test_the_page_is_what_the_record_makes_of_it():
    record = json.loads(sensitivity.RESULTS.read_text(encoding="utf-8"))
    assert sensitivity.PAGE.read_text(encoding="utf-8") == sensitivity.page(record)


def test_what_was_tried_of_another_auto_is_tried_anew(monkeypatch, tmp_path):
    monkeypatch.setattr(sensitivity, "RESULTS", tmp_path / "sensitivity.json")
    monkeypatch.setattr(sensitivity, "figures", lambda: {"a": 2.0})
    monkeypatch.setattr(sensitivity, "thresholds", lambda _: [("m", "X"), ("m", "Y")])
    asked = []

    def measured(module, name, factor):
        asked.append((name, factor))
        return {"a": 2.0 * factor}

    monkeypatch.setattr(sensitivity, "_measured", measured)
    old = {"sources": "another", "base": {"a": 1.0}, "tried": {"m.X": {}}}
    first = sensitivity._try(["m"], old)
    assert sorted(asked) == [("X", 0.5), ("X", 2.0), ("Y", 0.5), ("Y", 2.0)]
    del first["tried"]["m.Y"]
    asked.clear()
    second = sensitivity._try(["m"], first)
    assert asked == [("Y", 0.5), ("Y", 2.0)]
    assert second["tried"]["m.X"]["2.0"] == {"a": 4.0}
    assert json.loads(sensitivity.RESULTS.read_text()) == second
