"""The stated error of a table holds at every point that is tried, and is not far above."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvemap.model.inverse_map import invert
from valvemap.model.linear_map import LinearMap, LinearMapState
from valvemap.model.lookup_table import lookup_table
from valvemap.model.map_pieces import MapPieces
from valvemap.model.model_structures import FiveTerms, Polynomial, TensorSpline
from valvemap.model.monotone import Monotone
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.vocabulary.statuses import InverseStatus

ESTIMATORS = {
    "eq. (7)": RecursiveLeastSquares(),
    "polynomial": RecursiveLeastSquares(Polynomial(terms=("s", "U*s", "U^2*s", "dp*nu^-1"))),
    "spline": RecursiveLeastSquares(TensorSpline.uniform(6, 4)),
    "kinked spline": RecursiveLeastSquares(
        TensorSpline((0, 30, 100), (0, 7, 15), (), 8.0, 91.0, at_rest="zero")
    ),
    "rising": Monotone(RecursiveLeastSquares(TensorSpline.uniform(6, 4))),
}
POINTS = 1_000_000
N = 5000


def learnt(estimator, dead=6.0):
    rng = np.random.default_rng(4)
    U, dp = rng.uniform(0, 100, N), rng.uniform(1, 200, N)
    Q = 2.0 * np.clip(U - dead, 0, 90) * np.sqrt(dp / 200) + 0.3 * rng.normal(size=N)
    samples = Samples.of(np.arange(N), U, dp, 0 * dp, Q, np.full(N, 40.0))
    return estimator.update(estimator.initial_state(), samples)[0]


def largest_errors(estimator, state, table, n):
    """In U and in flow, at random points over the table's domain and a little beyond."""
    rng = np.random.default_rng(5)
    dp = rng.uniform(table.dp[0], table.dp[-1], n)
    low, high = (np.interp(dp, table.dp, x) for x in (table.lowest, table.highest))
    Q = low + rng.uniform(-0.02, 1.02, n) * (high - low)
    U, _ = table.interpolate(Q, dp)
    T = np.full(n, table.T)
    known = np.isfinite(U)
    flow = estimator.predict(state, U[known], dp[known], T[known])[0]
    apart_Q = np.abs(flow - np.clip(Q, low, high)[known]).max()
    exact = invert(estimator, state, Q, dp, table.T)
    both = known & (exact.status == InverseStatus.OK) & (low < Q) & (high > Q)
    return np.abs(U - exact.U)[both].max(), apart_Q


@pytest.mark.parametrize("n", [100_000, pytest.param(POINTS, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", ESTIMATORS)
def test_the_certified_error_holds_at_random_points_and_is_tight_in_flow(name, n):
    estimator = ESTIMATORS[name]
    state = learnt(estimator)
    table = lookup_table(estimator, state)
    assert table.certified
    error_U, error_Q = largest_errors(estimator, state, table, n)
    assert error_U <= table.error_U
    assert error_Q <= table.error_Q <= 1.2 * error_Q + 2e-4


@settings(max_examples=15)
@given(
    st.lists(st.floats(-0.3, 0.3), min_size=5, max_size=5),
    st.tuples(st.integers(3, 12), st.integers(3, 12)),
    st.floats(0.5, 50.0),
)
def test_it_holds_for_any_polynomial_and_any_grid(parts, points, dp_min):
    theta = np.array([parts[0], parts[1] / 9, parts[2], 0.1 + parts[3] / 9, parts[4] / 9])
    valve, state = LinearMap(FiveTerms()), LinearMapState(theta, np.zeros((5, 5)))
    table = lookup_table(valve, state, dp_min=dp_min, points=points)
    assert table.certified
    error_U, error_Q = largest_errors(valve, state, table, 20_000)
    assert error_U <= table.error_U
    assert error_Q <= table.error_Q


@pytest.mark.parametrize("name", ["eq. (7)", "kinked spline"])
def test_pieces_bound_the_map_and_its_slopes(name):
    estimator = ESTIMATORS[name]
    state = learnt(estimator)
    pieces = MapPieces.of(estimator, state, (5.0, 200.0), 40.0)
    rng = np.random.default_rng(1)
    U, s = rng.uniform(0, 99, 2000), rng.uniform(np.sqrt(5), np.sqrt(199), 2000)
    T = np.full(2000, 40.0)
    Q, by_U, by_s = pieces.at(U, s)
    np.testing.assert_allclose(Q, estimator.predict(state, U, s**2, T)[0], atol=1e-7)
    slopes, _, kinked = pieces.over(U, U + 0.5, s, s + 0.01)
    step = (estimator.predict(state, U + 0.5, s**2, T)[0] - Q) / 0.5
    assert (slopes[0] - 1e-6 <= step).all()
    assert (step <= slopes[1] + 1e-6).all()
    assert ((slopes[2] <= by_s + 1e-6) & (by_s <= slopes[3] + 1e-6)).all()
    assert ((slopes[0] <= by_U + 1e-6) & (by_U <= slopes[1] + 1e-6)).all()
    assert kinked.any() == (name == "kinked spline" or bool(pieces.kinks_U.any()))


def test_the_error_of_a_network_is_measured_and_says_so():
    network = RbfNetwork()
    state = learnt(network)
    table = lookup_table(network, state)
    assert not table.certified
    assert largest_errors(network, state, table, 100_000)[1] <= table.error_Q
