"""The inverse map: exact where feasible, a status elsewhere, never out of [0, 100] %."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from valvemap.model.estimator import State
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive
from valvemap.model.inverse_map import inverse_table, invert
from valvemap.model.kernels import flow_memory, flow_play
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms, Polynomial
from valvemap.model.monotone import Monotone
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples, Trace
from valvemap.model.tensor_spline import TensorSpline
from valvemap.vocabulary.statuses import InverseStatus

Q_MAX = 200.0
POWERS = Polynomial(terms=("s", "U^5", "U^2*s", "U*s"))
WARM = Polynomial(terms=("1", "U*T", "U*s"))
THETA = np.array([-2.0, 0.03, 0.1, 0.14, -0.02])
STATE = State()
ANYTHING = st.floats(width=64)


@dataclass(frozen=True)
class KnownMap:
    """An estimator that has learnt a function of (U, dp, T)."""

    function: Callable[[Floats, Floats, Floats], Floats]
    std: float = 0.5
    parameter_names: tuple[str, ...] = ()

    def initial_state(self) -> State:
        return STATE

    def update(self, state: State, samples: Samples) -> tuple[State, Trace]:
        raise NotImplementedError

    def predict(self, state, U, dp, T):
        with np.errstate(all="ignore"):
            Q = self.function(U, dp, T)
        return Q, np.where(np.isnan(Q), np.nan, self.std)

    def parameters(self, state):
        return np.empty(0), np.empty(0)


@dataclass(frozen=True)
class KnownTheta(KnownMap):
    """An estimator that has learnt eq. (7), with a noise model's parameter beside it."""

    theta: tuple[float, ...] = tuple(THETA)
    structure: Polynomial | TensorSpline = field(default_factory=FiveTerms)
    parameter_names: tuple[str, ...] = ("d1", "a1", "a2", "a3", "a4", "a5")

    def predict(self, state, U, dp, T):
        Q = np.array([x @ self.theta for x in self.structure.regressors(U, dp, T)])
        return Q, np.where(np.isnan(Q), np.nan, self.std)

    def parameters(self, state):
        theta = np.array([0.9, *self.theta])
        return theta, np.full_like(theta, 0.1)


def known(structure, theta, std=0.5) -> KnownTheta:
    names = ("d1", *structure.parameter_names)
    return KnownTheta(np.exp, std, names, theta=tuple(theta), structure=structure)


def five_terms(*theta: float, std: float = 0.5) -> KnownTheta:
    return KnownTheta(np.exp, std, theta=theta or tuple(THETA))


def spline(structure, valve, std=0.5) -> KnownTheta:
    """A spline that follows a valve (its parameters are the valve's flow at their sites)."""
    sites_U, sites_s = structure.sites
    T = np.array(structure.T or (40.0,))
    theta = valve(sites_U[:, None, None], sites_s[None, :, None] ** 2, T[None, None, :])
    theta = np.broadcast_to(theta, (len(sites_U), len(sites_s), len(T))).ravel()
    return known(structure, theta, std)


def dead_band_and_saturation(U, dp, T):
    return 2.0 * np.clip(U - 8.0, 0.0, 80.0) * np.sqrt(dp / 200.0)


MAPS = {
    "eq. (7)": five_terms(),
    "fifth order": known(POWERS, (0.2, 1e-9, 1e-3, 0.1)),
    "affine with temperature": known(WARM, (-0.5, 0.01, 0.2)),
    "spline": spline(TensorSpline.uniform(6, 4), lambda U, dp, T: U * np.sqrt(dp) / 10 + dp / 50),
    "kinked spline with temperature": spline(
        TensorSpline(
            (0, 30, 100), (0, 2, 15), (20, 60), dead_band=8, saturation=91, at_rest="zero"
        ),
        lambda U, dp, T: np.clip(U - 7, 1, 80) * np.sqrt(dp) * (1 - 0.002 * (T - 40)) / 10,
    ),
    "s-shaped": KnownMap(lambda U, dp, T: 100 / (1 + np.exp(-(U - 50) / 9)) * np.sqrt(dp / 100)),
    "dead band": KnownMap(dead_band_and_saturation),
    "with temperature": KnownMap(lambda U, dp, T: U * np.sqrt(dp) * (1 - 0.002 * (T - 40)) / 10),
}


@pytest.mark.parametrize("name", MAPS)
@given(
    U=arrays(float, 20, elements=st.floats(0, 100)),
    dp=arrays(float, 20, elements=st.floats(1, 200)),
)
def test_from_U_to_Q_and_back_delivers_the_demand_exactly(name, U, dp):
    estimator = MAPS[name]
    T = np.full_like(U, 45.0)
    Q = estimator.predict(STATE, U, dp, T)[0]
    answer = invert(estimator, STATE, Q, dp, T)
    assert (answer.status == InverseStatus.OK).all()
    delivered = estimator.predict(STATE, answer.U, dp, T)[0]
    np.testing.assert_allclose(delivered, Q, rtol=0, atol=1e-9 * Q_MAX)


@pytest.mark.parametrize("name", MAPS)
@given(data=arrays(float, (3, 12), elements=ANYTHING))
def test_whatever_is_asked_the_answer_is_a_status_and_a_U_within_the_range(name, data):
    answer = invert(MAPS[name], STATE, *data)
    given_U = answer.status <= InverseStatus.BELOW_REACH
    assert np.array_equal(given_U, ~np.isnan(answer.U))
    assert ((answer.U[given_U] >= 0) & (answer.U[given_U] <= 100)).all()
    known = ~np.isnan(answer.lower)
    assert (answer.lower[known] <= answer.U[known]).all()
    assert (answer.U[known] <= answer.upper[known]).all()
    assert ((answer.lower[known] >= 0) & (answer.upper[known] <= 100)).all()
    bad = ~np.isfinite(data[0]) | ~np.isfinite(data[1])
    assert (answer.status[bad] == InverseStatus.NOT_FINITE).all()


@given(theta=arrays(float, 5, elements=ANYTHING), data=arrays(float, (3, 8), elements=ANYTHING))
def test_whatever_was_identified_eq_7_inverts_without_a_warning(theta, data):
    answer = invert(five_terms(*theta), STATE, *data)
    U = answer.U[answer.status <= InverseStatus.BELOW_REACH]
    assert ((U >= 0) & (U <= 100)).all()


@pytest.mark.parametrize("name", MAPS)
def test_demands_out_of_reach_get_the_nearer_end_and_say_so(name):
    answer = invert(MAPS[name], STATE, [1e4, -1e4], [100.0, 100.0], [40.0, 40.0])
    assert answer.U.tolist() == [100.0, 0.0]
    assert answer.status.tolist() == [InverseStatus.ABOVE_REACH, InverseStatus.BELOW_REACH]


def test_the_printed_inverse_of_eq_7_blows_up_at_its_singularity_and_ours_says_not_monotone():
    a1, a2, a3, a4, a5 = theta = (1.0, -1.0, 0.1, 0.1, 0.02)  # slope a2 + a4·s = 0 at 100 bar
    dp = np.array([100.0 * (1 - 1e-12), 81.0, 100.0, 100.0 * (1 + 1e-9), 144.0])
    Q, s = 10.0, np.sqrt(dp)
    with np.errstate(divide="ignore"):
        printed = (Q - a1 - a3 * s - a5 * s**2) / (a2 + a4 * s)
    assert np.abs(printed[[0, 2]]).min() > 1e9
    assert printed[1] < 0
    answer = invert(five_terms(*theta), STATE, Q, dp, 40.0)
    assert answer.status.tolist() == [
        InverseStatus.NOT_MONOTONE,
        InverseStatus.NOT_MONOTONE,
        InverseStatus.NOT_MONOTONE,
        InverseStatus.ABOVE_REACH,
        InverseStatus.OK,
    ]
    assert np.isnan(answer.U[:3]).all()
    assert answer.U[4] == pytest.approx((10 - 1 - 1.2 - 2.88) / 0.2)


def test_without_pressure_drop_nothing_flows_and_zero_needs_no_opening():
    answer = invert(five_terms(0, 0, 0, 0.14, 0), STATE, [0.0, 5.0, -5.0], 0.0, 40.0)
    assert answer.U.tolist() == [0, 100, 0]
    assert answer.status.tolist() == [
        InverseStatus.OK,
        InverseStatus.ABOVE_REACH,
        InverseStatus.BELOW_REACH,
    ]


def test_on_a_plateau_the_smallest_U_is_given():
    valve = KnownMap(dead_band_and_saturation)
    answer = invert(valve, STATE, [0.0, 160.0], 200.0, 40.0)
    assert answer.status.tolist() == [InverseStatus.OK, InverseStatus.OK]
    np.testing.assert_allclose(answer.U, [0.0, 88.0], atol=1e-9)


def test_a_plateau_in_the_middle_is_entered_at_its_left_end():
    valve = KnownMap(lambda U, dp, T: np.minimum(U, 40.3) + np.maximum(U - 60, 0))
    answer = invert(valve, STATE, 40.3, 100.0, 40.0)
    assert answer.U.tolist() == pytest.approx([40.3], abs=1e-9)


def test_where_the_map_falls_with_U_no_U_is_given():
    falling = KnownMap(lambda U, dp, T: 100.0 - U)
    answer = invert(falling, STATE, [50.0, 120.0, -10.0], 100.0, 40.0)
    assert answer.status.tolist() == [InverseStatus.NOT_MONOTONE] * 3
    assert np.isnan([answer.U, answer.lower, answer.upper]).all()


def test_a_map_that_overshoots_is_inverted_on_its_rising_branch_alone():
    hill = KnownMap(lambda U, dp, T: U * (150.0 - U))
    answer = invert(hill, STATE, [2600.0, 5400.0, 6000.0], 100.0, 40.0)
    np.testing.assert_allclose(answer.U[:2], [20.0, 60.0], atol=1e-9)
    assert answer.status[2] == InverseStatus.NOT_MONOTONE


def test_an_estimator_that_knows_nothing_yet_is_unidentified():
    blank = KnownMap(lambda U, dp, T: np.full_like(U, np.nan))
    vague = KnownMap(lambda U, dp, T: U, std=np.inf)
    no_theta = five_terms(*[np.nan] * 5)
    for estimator in (blank, vague, no_theta):
        assert invert(estimator, STATE, 5.0, 9.0, np.nan).status == InverseStatus.UNIDENTIFIED


def test_a_missing_temperature_matters_only_to_a_map_that_depends_on_it():
    needs = invert(MAPS["with temperature"], STATE, 5.0, 9.0, np.nan)
    assert needs.status == InverseStatus.NOT_FINITE
    does_not = invert(MAPS["eq. (7)"], STATE, 5.0, 9.0, np.nan)
    assert does_not.status == InverseStatus.OK


def test_the_interval_is_the_predictions_own_divided_by_the_slope():
    slope = THETA[1] + THETA[3] * 10.0
    for estimator in (five_terms(), KnownMap(_eq_7)):
        answer = invert(estimator, STATE, 50.0, 100.0, 40.0)
        assert answer.upper - answer.U == pytest.approx(1.959964 * 0.5 / slope, rel=1e-5)
        assert answer.U - answer.lower == pytest.approx(1.959964 * 0.5 / slope, rel=1e-5)


def _eq_7(U, dp, T):
    return FiveTerms().regressors(U, dp, T) @ THETA


def test_out_of_reach_the_interval_still_tells_how_near_the_end_is():
    reach = five_terms().predict(STATE, np.array([100.0]), np.array([100.0]), np.array([40.0]))[0]
    for estimator in (five_terms(), KnownMap(_eq_7)):
        near = invert(estimator, STATE, reach + 0.1, 100.0, 40.0)
        far = invert(estimator, STATE, reach + 50.0, 100.0, 40.0)
        assert near.status == far.status == InverseStatus.ABOVE_REACH
        assert near.lower < 100.0
        assert far.lower == far.upper == 100.0


def test_the_search_and_the_closed_form_of_eq_7_agree():
    rng = np.random.default_rng(7)
    Q, dp = rng.uniform(-20, 250, 500), rng.uniform(0, 200, 500)
    closed = invert(five_terms(), STATE, Q, dp, 40.0)
    searched = invert(KnownMap(_eq_7), STATE, Q, dp, 40.0)
    assert np.array_equal(closed.status, searched.status)
    np.testing.assert_allclose(closed.U, searched.U, atol=1e-9)
    np.testing.assert_allclose(closed.lower, searched.lower, atol=1e-5)


def test_the_table_has_the_axes_shape_and_is_blank_where_the_flow_cannot_be_had():
    table = inverse_table(five_terms(), STATE, [0.0, 50.0, 1e4], [0.0, 100.0], 40.0)
    assert table.shape == (3, 2)
    assert np.isnan(table[2]).all()
    assert table[1, 1] == invert(five_terms(), STATE, 50.0, 100.0, 40.0).U


def a_spline_learnt_by_rls(noise=0.4, **spline_options):
    rng = np.random.default_rng(3)
    U, dp, T = rng.uniform(0, 100, 3000), rng.uniform(0, 200, 3000), rng.uniform(20, 60, 3000)
    Q = dead_band_and_saturation(U, dp, T) * (1 + 0.001 * (T - 40)) + noise * rng.normal(size=3000)
    rls = RecursiveLeastSquares(structure=TensorSpline.uniform(6, 4, **spline_options))
    state, _ = rls.update(rls.initial_state(), Samples.of(np.arange(3000), U, dp, 0 * dp, Q, T))
    return rls, state


@pytest.mark.parametrize("T", [(), (20.0, 40.0, 60.0)])
def test_the_interval_of_a_spline_is_that_of_its_prediction(T):
    rls, state = a_spline_learnt_by_rls(T=T)
    dp, warm = np.array([20.0, 90.0, 180.0]), np.array([30.0, 40.0, 45.0])
    answer = invert(rls, state, [20.0, 60.0, 100.0], dp, warm)
    h = 1e-4
    slope = (
        rls.predict(state, answer.U + h, dp, warm)[0]
        - rls.predict(state, answer.U - h, dp, warm)[0]
    ) / (2 * h)
    std = rls.predict(state, answer.U, dp, warm)[1]
    np.testing.assert_allclose(answer.upper - answer.U, 1.959964 * std / slope, rtol=1e-4)
    np.testing.assert_allclose(answer.U - answer.lower, 1.959964 * std / slope, rtol=1e-4)


def test_a_learnt_spline_is_inverted_as_the_search_through_its_predictions_would():
    rls, state = a_spline_learnt_by_rls()
    rng = np.random.default_rng(4)
    Q, dp = rng.uniform(-10, 170, 300), rng.uniform(0.5, 200, 300)
    exact = invert(rls, state, Q, dp, 40.0)
    searched = invert(
        KnownMap(lambda U, dp, T: rls.predict(state, U, dp, T)[0]), STATE, Q, dp, 40.0
    )
    same = exact.status == searched.status
    assert same.mean() > 0.97  # features narrower than the search's grid are seen by one alone
    both = same & (exact.status == InverseStatus.OK) & (np.abs(exact.U - searched.U) < 1.0)
    np.testing.assert_allclose(exact.U[both], searched.U[both], atol=1e-8)
    assert both[same & (exact.status == InverseStatus.OK)].mean() > 0.97


@given(
    theta=arrays(float, 24, elements=st.floats(-200, 200)),
    Q=arrays(float, 6, elements=st.floats(-300, 300)),
)
def test_whatever_a_spline_looks_like_its_inverse_delivers_or_says_why_not(theta, Q):
    structure = TensorSpline((0, 25, 50, 100), (0, 14))
    estimator = known(structure, theta)
    dp, T = np.full(6, 50.0), np.full(6, 40.0)
    answer = invert(estimator, STATE, Q, dp, T)
    ok = answer.status == InverseStatus.OK
    delivered = estimator.predict(STATE, answer.U[ok], dp[ok], T[ok])[0]
    np.testing.assert_allclose(delivered, Q[ok], rtol=0, atol=1e-9 * Q_MAX)
    levels = estimator.predict(STATE, np.linspace(0, 100, 2001), *np.full((2, 2001), 50.0))[0]
    crossed = (levels[:-1, None] < Q - 1e-9) & (levels[1:, None] > Q + 1e-9)
    assert ok[crossed.any(axis=0)].all()
    first = np.linspace(0, 100, 2001)[1:][crossed.argmax(axis=0)]
    assert (answer.U[crossed.any(axis=0)] <= first[crossed.any(axis=0)] + 1e-9).all()


def test_a_spline_that_does_not_span_all_of_U_is_searched():
    part = spline(TensorSpline((20, 80), (0, 15)), lambda U, dp, T: U * np.sqrt(dp) / 10 + 0 * T)
    answer = invert(part, STATE, 9.0, 100.0, 40.0)
    assert answer.U.tolist() == pytest.approx([9.0])


def test_no_points_are_no_trouble():
    for estimator in (five_terms(), KnownMap(_eq_7)):
        assert len(invert(estimator, STATE, [], [], []).U) == 0


GRID = np.linspace(0.0, 100.0, 65)
LEARNERS = {
    "eq. (7)": RecursiveLeastSquares(),
    "eq. (7), adaptive": RecursiveLeastSquares(forgetting=Adaptive()),
    "maximum likelihood": MaximumLikelihood(),
    "rising eq. (7)": Monotone(RecursiveLeastSquares()),
    "spline": RecursiveLeastSquares(TensorSpline.uniform(6, 4), Adaptive()),
    "rising spline": Monotone(RecursiveLeastSquares(TensorSpline.uniform(6, 4))),
    "spline with temperature": RecursiveLeastSquares(TensorSpline.uniform(4, 3, T=(30.0, 50.0))),
    "radial basis": RecursiveLeastSquares(RadialBasis.uniform(), Adaptive()),
    "network": RbfNetwork(),
    "polynomial of third order": RecursiveLeastSquares(Polynomial.of_order(3)),
    "auto": FlowMap(),
}


@pytest.fixture(scope="module")
def learnt():
    """Every structure, taught by a valve with dead band, saturation and noise."""
    rng = np.random.default_rng(5)
    U, dp, T = rng.uniform(0, 100, 6000), rng.uniform(0, 200, 6000), rng.uniform(25, 55, 6000)
    Q = dead_band_and_saturation(U, dp, T) * (1 + 0.001 * (T - 40)) + 0.4 * rng.normal(size=6000)
    samples = Samples.of(np.arange(6000), U, dp, 0 * dp, Q, T)
    return {name: e.update(e.initial_state(), samples)[0] for name, e in LEARNERS.items()}


@pytest.mark.parametrize("name", LEARNERS)
def test_whatever_was_learnt_the_inverse_delivers_or_says_why_not(name, learnt):
    estimator, state = LEARNERS[name], learnt[name]
    rng = np.random.default_rng(6)
    Q, dp, T = rng.uniform(-20, 220, 400), rng.uniform(0.5, 200, 400), rng.uniform(25, 55, 400)
    answer = invert(estimator, state, Q, dp, T)
    ok = np.isin(answer.status, (InverseStatus.OK, InverseStatus.UNCERTAIN))
    assert 0.2 < ok.mean() < 0.9
    delivered = estimator.predict(state, answer.U[ok], dp[ok], T[ok])[0]
    np.testing.assert_allclose(delivered, Q[ok], rtol=0, atol=1e-9 * Q_MAX)
    levels = np.stack([estimator.predict(state, np.full(400, U), dp, T)[0] for U in GRID])
    highest, lowest = levels.max(axis=0), levels.min(axis=0)
    assert (~ok[highest + 1e-9 < Q]).mean() > 0.99
    above, below = (answer.status == s for s in InverseStatus if s.name.endswith("REACH"))
    assert (Q[above] >= highest[above] - 1e-9).all()
    assert (Q[below] <= lowest[below] + 1e-9).all()
    assert (answer.U[above] == 100.0).all()
    assert (answer.U[below] == 0.0).all()
    rises = ((levels[:-1] < Q - 1e-6) & (levels[1:] > Q + 1e-6)).any(axis=0)
    assert ok[rises].all()


@pytest.fixture(scope="module")
def hysteretic():
    """`Auto`, taught by a valve whose U lags by 2 %."""
    rng = np.random.default_rng(8)
    n = 12_000
    U = 50.0 + 50.0 * np.sin(np.arange(n) / 60.0) * rng.uniform(0.5, 1, n // 200).repeat(200)
    held = np.empty(n)
    last = U[0]
    for i, u in enumerate(U):
        last = held[i] = min(max(last, u - 1.0), u + 1.0)
    dp = 100.0 + 90.0 * np.sin(np.arange(n) / 37.3)
    Q = 0.12 * held * np.sqrt(dp) + 0.2 * rng.normal(size=n)
    auto = FlowMap()
    samples = Samples.of(10_000_000 * np.arange(n), U, dp, 0 * dp, Q, np.full(n, 40.0))
    return auto, auto.update(auto.initial_state(), samples)[0]


@pytest.mark.parametrize("direction", [-1.0, 0.0, 1.0])
def test_on_either_branch_of_a_hysteresis_the_inverse_delivers(hysteretic, direction):
    auto, state = hysteretic
    assert "play" in auto.describe(state)
    rng = np.random.default_rng(9)
    Q, dp, T = rng.uniform(5, 110, 200), rng.uniform(20, 180, 200), np.full(200, 40.0)
    answer = invert(auto, state, Q, dp, T, direction)
    ok = answer.status == InverseStatus.OK
    assert 0.3 < ok.mean() < 1.0
    d = np.full(int(ok.sum()), direction)
    delivered, _ = auto.predict_along(state, answer.U[ok], dp[ok], T[ok], d)
    np.testing.assert_allclose(delivered, Q[ok], rtol=0, atol=1e-9 * Q_MAX)
    ends = auto.predict_along(state, np.full(200, 100.0), dp, T, np.full(200, direction))[0]
    assert (answer.status[ends + 1e-6 < Q] == InverseStatus.ABOVE_REACH).all()


def test_the_way_to_a_place_leads_through_the_play_and_none_leads_to_where_the_valve_is(hysteretic):
    auto, state = hysteretic
    play, stands = auto.half_play(state), float(state.play[flow_play.SPOOL])
    last = state.recent[(state.counters[flow_memory.ROWS_SEEN] - 1) % len(state.recent), 1]
    goals = np.array([stands - 5.0, stands - play / 8, stands + play / 8, stands + 5.0])
    U = auto.approached(state, goals)
    np.testing.assert_allclose(U[[0, 3]], goals[[0, 3]] + [-play, play])
    assert (U[1:3] == last).all()


@pytest.mark.soak
def test_a_point_of_a_spline_of_63_parameters_takes_at_most_a_microsecond_and_a_half():
    from benchmarks.inverse import microseconds

    us, ratio = microseconds()["spline, 63 parameters"]
    assert us <= 1.5
    assert ratio > 20.0
