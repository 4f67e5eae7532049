"""Replay says when the valve changed, and what structure was chosen."""

import json
from pathlib import Path

import numpy as np
import pytest

from valvemap.app.map_checks import MOST_TRIED
from valvemap.app.replay import replay
from valvemap.app.replay_report import as_json
from valvemap.cli import run

STEP, N = 3_000, 4_000


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict]:
    """A valve of eq. (7) on scattered points, that loses a tenth of its flow at sample STEP."""
    rng = np.random.default_rng(3)
    U, dp = rng.uniform(10.0, 100.0, N), rng.uniform(10.0, 180.0, N)
    Q = 0.1 * U * np.sqrt(dp) * np.where(np.arange(N) < STEP, 1.0, 0.9) + rng.normal(0.0, 0.3, N)
    table = np.column_stack([np.arange(N) * 0.1, U, dp + 10.0, np.full(N, 10.0), Q, np.full(N, 40)])
    file: Path = tmp_path_factory.mktemp("recording") / "step.csv"
    np.savetxt(file, table, "%.9g", ",", header="t,U,p1,p2,Q,T", comments="")
    return json.loads(json.dumps(as_json(replay([file])), allow_nan=False))["Valvistor"]


@pytest.mark.parametrize("estimator", ["RLS", "Auto"])
def test_an_estimator_says_when_the_valve_changed_and_how_much(figures, estimator):
    change = figures[estimator]["last_change"]
    assert abs(change["sample"] - STEP) < 100
    assert abs(change["t"] / 1e9 - 0.1 * STEP) < 10.0
    assert change["size"] < -1.0
    assert change["count"] >= 1


def test_auto_names_the_structure_that_it_has_chosen_and_the_others_none(figures):
    assert figures["Auto"]["structure"]
    assert figures["RLS"]["structure"] is None


def test_the_inverse_is_tried_on_a_thousand_samples_at_most_and_the_score_is_of_all(figures):
    for name in ("RLS", "Auto"):
        assert 0 <= figures[name]["inverse"]["infeasible"] <= MOST_TRIED
        assert figures[name]["inverse"]["round_trip_max"] < 0.1
        assert figures[name]["one_step"]["n"] == pytest.approx(N, abs=50)
    after_the_step = 1.0 - STEP / N  # they are spread over the whole of the last batch
    assert figures["RLS"]["interval"]["covered"] == pytest.approx(after_the_step, abs=0.1)


def test_samples_of_the_other_edge_are_counted_and_named(tmp_path, capsys):
    rng = np.random.default_rng(3)
    U, dp = rng.uniform(-100.0, 100.0, N), rng.uniform(10.0, 180.0, N)
    table = np.column_stack(
        [np.arange(N) * 0.1, U, dp, np.zeros(N), 0.1 * U * np.sqrt(dp), np.full(N, 40)]
    )
    file = tmp_path / "both.csv"
    np.savetxt(file, table, "%.9g", ",", header="t,U,p1,p2,Q,T", comments="")
    report = replay([file])["Valvistor"]
    assert {r.beyond_range for r in report.values()} == {int((U < -5.0).sum())}
    assert report["RLS"].parameters["a4"] == pytest.approx(0.1, abs=1e-6)
    assert run(["replay", str(file)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "not learnt from, because U or p1 - p2 lay beyond what an estimator can describe" in said


def test_columns_of_no_valve_are_named_and_absolute_pressures_are_converted(tmp_path):
    rng = np.random.default_rng(3)
    U, dp = rng.uniform(10.0, 100.0, 400), rng.uniform(10.0, 180.0, 400)
    Q = 0.1 * U * np.sqrt(dp)
    time = np.arange(400) * 0.1
    both, drop = tmp_path / "both.csv", tmp_path / "drop.csv"
    table = np.column_stack([time, U, dp + 6.01325, np.full(400, 5.0), Q, U, dp])
    head = "t,U,p1 [bar(a)],p2 [barg],Q,X1,X2"
    np.savetxt(both, table, "%.9g", ",", header=head, comments="")
    table = np.column_stack([time, U, dp, Q])
    np.savetxt(drop, table, "%.9g", ",", header="t,U,dp [bara],Q", comments="")
    said: list[str] = []
    for file in (both, drop):
        (results,) = replay([file], note=said.append).values()
        assert results["RLS"].parameters["a4"] == pytest.approx(0.1, abs=1e-6)
    assert said == ["both.csv: columns not used: X1, X2"]
