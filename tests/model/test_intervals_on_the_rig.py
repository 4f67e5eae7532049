"""95 % intervals of a new measurement on the virtual rig, whose map no structure fits."""

from dataclasses import replace

import pytest

from benchmarks.intervals import coverage
from support.soaked import soaked
from valvemap.model.estimator import StateMismatchError, key_of
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.pipeline.kept_lanes import lane_from_bytes, lane_to_bytes
from valvemap.pipeline.valve_state import fresh_lane


@pytest.mark.parametrize(
    ("name", "excitation"),
    [
        ("RLS, λ = 1", "structured"),
        ("RLS, λ = .99", "cycle"),
        ("RLS, default", "structured"),
        ("RML, default", "cycle"),
        ("RBF", "scattered"),
        ("spline, λ = 1", "scattered"),
        *soaked(
            ("RLS, λ = 1", "scattered"),
            ("RLS, λ = 1", "cycle"),
            ("RLS, λ = .99", "scattered"),
            ("RLS, λ = .99", "structured"),
            ("RLS, default", "cycle"),
            ("RML, default", "structured"),
            ("RBF", "structured"),
            ("spline, λ = 1", "structured"),
            ("spline, λ = 1", "cycle"),
        ),
    ],
)
def test_on_the_rig_a_new_measurement_is_covered_half_a_second_ahead(name, excitation):
    within, width = coverage(name, excitation, seeds=1)
    assert 0.93 <= within <= 0.97
    assert width < 1.5


def test_a_lane_whose_residuals_were_kept_in_another_way_is_not_taken():
    lane = fresh_lane(RecursiveLeastSquares())
    spread = lane.spread
    old = replace(
        lane, spread=replace(spread, cells=spread.cells[:, :2], overall=spread.overall[:3])
    )
    with pytest.raises(StateMismatchError, match="cells is of shape"):
        lane_from_bytes(
            lane_to_bytes(old, key_of(lane.estimator)), lane.estimator, None, frozen=False, t=0
        )
