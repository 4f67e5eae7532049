import io
import math
from types import SimpleNamespace

from rich.console import Console

from valvemap.report.verification import verification_table


def shown(scores):
    console = Console(file=io.StringIO(), width=100)
    console.print(verification_table("Against truth", scores))
    return console.file.getvalue()


def figures(**changes):
    values = {"rmse": 1.23456, "nrmse": 0.00612, "max_abs": 7.5, "r2": 0.998765, "n": 12_345}
    return SimpleNamespace(**(values | changes))


def test_every_estimator_of_every_valve_has_a_row_with_its_figures():
    text = shown({"V1": {"RLS": figures(), "RBF": figures(rmse=99.0)}, "V2": {"RML": figures()}})
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in text.splitlines()]
    assert ["V1", "RLS", "1.235", "0.612", "7.5", "0.99877", "12,345"] in rows
    assert ["", "RBF", "99", "0.612", "7.5", "0.99877", "12,345"] in rows
    assert any(row[:2] == ["V2", "RML"] for row in rows)
    assert text.startswith("Against truth")


def test_what_is_unknown_is_a_dash():
    nan = math.nan
    text = shown({"V1": {"RLS": figures(rmse=nan, nrmse=nan, max_abs=nan, r2=nan, n=0)}})
    assert "nan" not in text
    assert text.count(" - ") == 4


def test_a_table_without_valves_is_empty():
    assert "Against truth" in shown({})
