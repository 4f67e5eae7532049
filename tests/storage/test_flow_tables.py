"""The CSV of a map in a spreadsheet: the formulas of the documentation give U within its error."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from support.exported_maps import COARSE, ESTIMATORS, FINE, PART, exported_map
from support.soaked import soaked
from valvemap.model.flow_table import flow_table
from valvemap.model.inverse_map import invert
from valvemap.storage.flow_tables import as_csv

PAGE = Path(__file__).parents[2] / "docs" / "methods" / "models.md"


@pytest.fixture(
    scope="module",
    params=[(name, COARSE) for name in ESTIMATORS if name != "spline"]
    + soaked(*(((name, FINE),) for name in ESTIMATORS)),
    ids=str,
)
def exported(request):
    estimator, state, inverse = exported_map(*request.param)
    return estimator, state, flow_table(estimator, state, inverse)


@pytest.mark.parametrize("n", [10_000, pytest.param(1_000_000, marks=pytest.mark.soak)])
def test_the_stated_error_holds_at_random_points(exported, n):
    estimator, state, table = exported
    rng = np.random.default_rng(5)
    Q, dp = rng.uniform(table.Q[0], table.Q[-1], n), rng.uniform(table.dp[0], table.dp[-1], n)
    U, exact = table.interpolate(Q, dp), invert(estimator, state, Q, dp, 40.0).U
    both = np.isfinite(U) & np.isfinite(exact)
    assert both.mean() > 0.95
    assert np.abs(U - exact)[both].max() <= table.error_U
    T = np.full(int(both.sum()), 40.0)
    flows = [estimator.predict(state, x[both], dp[both], T)[0] for x in (U, exact)]
    assert np.abs(flows[0] - flows[1]).max() <= table.error_Q
    assert table.certified


def sheet(text):
    """The cells of both blocks, as a spreadsheet opens them."""
    rows = [row for row in csv.reader(text.splitlines()) if not row[0].startswith("#")]
    break_at = next(k for k, row in enumerate(rows) if row[0] == "extrapolated")
    blocks = rows[:break_at], rows[break_at:]
    return [
        (
            [float(row[0]) for row in block[1:]],
            [float(x) for x in block[0][1:]],
            [[float(x) if x else np.nan for x in row[1:]] for row in block[1:]],
        )
        for block in blocks
    ]


def test_the_documented_formulas_give_the_tables_U(exported):
    _, _, table = exported
    (axis_Q, axis_dp, cells), (_, _, marks) = sheet(as_csv(table, "V"))
    (page,) = re.findall(r"```text\n(name.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    formulas = [line.split("=", 1) for line in page.splitlines()[1:]]
    functions = {
        "MATCH": lambda x, axis, _: int(np.searchsorted(axis, x, side="right")),
        "INDEX": lambda cells, i, j=None: cells[i - 1] if j is None else cells[i - 1][j - 1],
        "COUNT": len,
        "MIN": min,
        "MAX": max,
    }
    rng = np.random.default_rng(6)
    for Q, dp in zip(
        [*rng.uniform(table.Q[0], table.Q[-1], 200), table.Q[-1]],
        [*rng.uniform(5.0, 200.0, 200), 200.0],
        strict=True,
    ):
        names = {"flow": Q, "drop": dp, "axis_Q": axis_Q, "axis_dp": axis_dp, "table": cells}
        for name, formula in formulas:
            names[name.strip()] = eval(formula, functions, names)  # noqa: S307 - our own page
        (expected,) = table.interpolate(np.array([Q]), np.array([dp]))
        if np.isfinite(expected):
            assert names["U"] == pytest.approx(expected, abs=1e-6)
    assert np.array_equal(np.array(marks, bool), table.guessed)


def test_where_nothing_was_measured_the_csv_says_extrapolated():
    estimator, state, inverse = exported_map("auto", COARSE, PART)
    table = flow_table(estimator, state, inverse)
    (axis_Q, axis_dp, _), (_, _, marks) = sheet(as_csv(table, "V"))
    at = np.array(marks)[
        np.searchsorted(axis_Q, [5.0, 0.9 * axis_Q[-1]]), np.searchsorted(axis_dp, [30, 150])
    ]
    assert at.tolist() == [0.0, 1.0]
