"""Asked where nothing was measured, a map says so, or its interval holds: benchmarks.outside."""

import numpy as np
import pytest

from benchmarks.outside import Q_MAX, SURE, VALVES, figures, learnt
from support.missed import missed
from support.soaked import soaked
from valvemap.model.inverse_map import invert
from valvemap.model.residual_spread import TWO_SIDED_95
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.lane_predictions import predicted, predicted_measurement
from valvemap.vocabulary.statuses import InverseStatus, Status

PARTS = (((5, 40), (5, 60)), ((45, 90), (80, 190)))
ESTIMATORS = ("RLS", "RML", "RBF", "Auto")


# A curve of the usual form, one with a kink, and one that eq. (7) can follow.
IN_SHORT = ("ordinary", "dead band", "eq. (7)")


@pytest.fixture(
    scope="module",
    params=[*IN_SHORT, *soaked(*(name for name in VALVES if name not in IN_SHORT))],
)
def asked(request):
    """Figures of each estimator on one valve, pooled over two parts of its range."""
    valve, total = VALVES[request.param], {}
    for seed, part in enumerate(PARTS):
        fleet, samples = learnt(valve, part, seed)
        for name in ESTIMATORS:
            found = figures(fleet.lane(0, name), samples, valve, seed, points=800)
            total[name] = total[name] + found if name in total else found
    return request.param, total


@pytest.mark.parametrize("name", ESTIMATORS)
def test_outside_a_point_is_covered_or_extrapolated_and_inside_it_is_not(asked, name):
    found = asked[1][name]
    assert found.honest >= 0.99 * found.outside
    assert found.inside_called <= 0.01 * found.inside
    assert found.answered_honestly >= 0.99 * found.demands


@pytest.mark.parametrize("name", ["RLS", "RML", "Auto"])
def test_eq_7_that_suffices_is_followed_as_far_as_exact_least_squares_are_sure(
    asked, name, request
):
    valve, total = asked
    found = total[name]
    if (name, valve) == ("Auto", "eq. (7)"):
        request.applymarker(missed("643 of 1,247 points are followed"))
    if valve == "eq. (7)":
        assert found.followed == found.sure > 300
        assert found.widths <= 2.0 * found.sure
    else:
        assert found.followed <= 0.01 * found.sure


@pytest.fixture(scope="module")
def fleet():
    return learnt(VALVES["ordinary"], PARTS[0], 3)[0]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_interval_grows_with_the_distance_from_the_samples(fleet, name):
    lane = fleet.lane(0, name)
    for U, dp, T in (
        (np.linspace(38, 100, 20), 30.0, 40.0),
        (20.0, np.linspace(58, 200, 20), 40.0),
        (35.0, 50.0, np.linspace(42, 90, 20)),
    ):
        points = (np.array(x, np.float64) for x in np.broadcast_arrays(U, dp, T))
        _, std, status = predicted(lane, *points)
        assert (np.diff(std) > -0.1 * std[:-1]).all()
        assert std[-1] > 3.0 * std[0]
        assert status[0] != Status.EXTRAPOLATING == status[-1]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_another_temperature_is_extrapolation_and_none_is_not(fleet, name):
    lane = fleet.lane(0, name)
    T = np.array([35.5, 40.0, 44.5, 46.0, 60.0, 20.0, np.nan])
    status = predicted(lane, np.full(7, 20.0), np.full(7, 30.0), T)[2]
    assert (status == Status.EXTRAPOLATING).tolist() == [False] * 3 + [True] * 3 + [False]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_an_opening_never_seen_is_a_guess_with_a_wide_interval(fleet, name):
    lane, dp = fleet.lane(0, name), np.array([195.0])
    Q = VALVES["ordinary"](np.array([100.0]), dp)
    answer = invert(lane.estimator, lane.state, Q, dp, 40.0, support=lane.support)
    if answer.status[0] != InverseStatus.NOT_MONOTONE:  # there a network falls, and gives no U
        assert answer.status[0] == InverseStatus.EXTRAPOLATING
        assert answer.lower[0] <= 100.0 <= answer.upper[0] + 1e-9
        assert answer.upper[0] - answer.lower[0] > 3.0
    inside = VALVES["ordinary"](np.array([20.0]), np.array([30.0]))
    answer = invert(lane.estimator, lane.state, inside, 30.0, 40.0, support=lane.support)
    assert answer.status[0] == InverseStatus.OK
    assert answer.U[0] == pytest.approx(20.0, abs=2.0)


@missed("NOT_MONOTONE where the smooth map falls far outside of the data")
def test_where_a_map_says_nothing_its_inverse_is_a_guess_of_any_opening():
    valve, (U, dp) = VALVES["laminar"], np.full((2, 50), 80.0) + np.linspace(0.0, 20.0, 50)
    fleet, _ = learnt(valve, PARTS[0], 3)
    lane, at = fleet.lane(0, "Auto"), np.full(50, 40.0)
    answer = invert(
        lane.estimator, lane.state, valve(U, dp + 90.0), dp + 90.0, at, support=lane.support
    )
    assert (answer.status == InverseStatus.EXTRAPOLATING).all()
    assert (answer.lower <= U).all()
    assert (answer.upper >= U).all()


def test_below_the_least_pressure_that_was_seen_the_interval_grows_as_roots_do(fleet):
    lane, dp, T = fleet.lane(0, "RBF"), np.array([1.0, 2.0, 4.5, 30.0]), np.full(4, 40.0)
    below = lane.support.below(dp)
    assert below == pytest.approx(np.maximum(np.sqrt(5.0) - np.sqrt(dp), 0.0) / 0.5, abs=0.05)
    _, std, status = predicted(lane, np.full(4, 20.0), dp, T)
    assert (status != Status.EXTRAPOLATING).all()
    assert std[0] > std[1] > 2.0 * std[2]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_a_measurement_to_come_is_as_uncertain_as_the_map(fleet, name):
    lane = fleet.lane(0, name)
    points = np.array([20.0, 90.0]), np.array([30.0, 180.0]), np.full(2, 40.0)
    _, std, _ = predicted(lane, *points)
    _, half, status = predicted_measurement(lane, *points)
    assert half[1] > 0.9 * TWO_SIDED_95 * std[1] > 10.0
    assert status[1] == Status.EXTRAPOLATING != status[0]


@pytest.mark.parametrize("valve", ["dead band", "S-shape", "ordinary", "saturating"])
@pytest.mark.parametrize("n", [600, 1_500])
def test_a_young_map_of_eq_7_that_misfits_widens_its_interval(valve, n):
    fleet, samples = learnt(VALVES[valve], ((0, 60), (20, 120)), 1, n=n)
    Q, std, _ = predicted(fleet.lane(0, "RLS"), samples.U, samples.dp, samples.T)
    off = np.abs(Q - VALVES[valve](samples.U, samples.dp)) > TWO_SIDED_95 * std
    assert off.mean() < 0.3


def test_eq_7_stops_being_followed_where_its_interval_is_no_longer_narrow():
    fleet, _ = learnt(VALVES["eq. (7)"], ((5, 40), (5, 60)), 1, n=60)
    U, dp = np.linspace(20, 100, 50), np.linspace(30, 200, 50)
    _, std, status = predicted(fleet.lane(0, "RLS"), U, dp, np.full(50, 40.0))
    far = status == Status.EXTRAPOLATING
    assert 10 < far.sum() < 50
    assert TWO_SIDED_95 * std[~far].max() <= SURE * Q_MAX


@pytest.mark.parametrize("name", ["RLS", "RML", "Auto"])
def test_eq_7_is_not_followed_beyond_the_ranges_of_its_estimator(name):
    fleet, _ = learnt(VALVES["eq. (7)"], PARTS[1], 3)
    lane = fleet.lane(0, name)
    whole, T = np.array([150.0, 102.0, 60.0, 60.0]), np.full(4, np.nan)
    dp = np.array([100.0, 100.0, 205.0, 900.0])
    guessed = predicted(lane, whole, dp, T)[2] == Status.EXTRAPOLATING
    assert guessed[:2].all()  # RLS and RML describe U of 0 ... 100 %
    if name == "Auto":  # its map ends at 200 bar and gives its border beyond
        answer = invert(lane.estimator, lane.state, 20.0, dp, np.nan, support=lane.support)
        assert guessed[3]
        assert answer.status[3] == InverseStatus.EXTRAPOLATING


def test_what_was_reset_has_seen_nothing_and_what_is_frozen_sees_no_more(fleet):
    frozen = fleet.lane(0, "RBF")
    before = frozen.support.boxes.copy()
    far = Samples.of(np.arange(9), np.full(9, 80.0), np.full(9, 150.0), np.zeros(9), np.ones(9))
    fleet.put(0, "RBF", type(frozen)(**{**vars(frozen), "frozen": True}))
    fleet.take(far, Segments.one(9))
    np.testing.assert_array_equal(fleet.lane(0, "RBF").support.boxes, before)
    assert len(fleet.lane(0, "RLS").support.boxes) == len(before) + 1
