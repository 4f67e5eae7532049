"""The stated error of a table holds at every point that is tried, and is not far above."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.soaked import soaked
from valvemap.model import table_error
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_table import flow_table
from valvemap.model.inverse_map import invert
from valvemap.model.linear_map import LinearMap, LinearMapState
from valvemap.model.lookup_table import lookup_table, place
from valvemap.model.map_pieces import MapPieces
from valvemap.model.model_structures import FiveTerms, Polynomial
from valvemap.model.monotone import Monotone
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.support import Support
from valvemap.model.tensor_spline import TensorSpline
from valvemap.model.valve_tables import valve_tables
from valvemap.vocabulary.statuses import InverseStatus

ESTIMATORS = {
    "eq. (7)": RecursiveLeastSquares(),
    "polynomial": RecursiveLeastSquares(Polynomial(terms=("s", "U*s", "U^2*s", "dp*nu^-1"))),
    "spline": RecursiveLeastSquares(TensorSpline.uniform(6, 4)),
    "kinked spline": RecursiveLeastSquares(
        TensorSpline((0, 30, 100), (0, 7, 15), (), 8.0, 91.0, at_rest="zero")
    ),
    "rising": Monotone(RecursiveLeastSquares(TensorSpline.uniform(6, 4))),
    "network": RbfNetwork(),
    "auto": FlowMap(),
}
GAUSSIANS = RecursiveLeastSquares(RadialBasis.uniform(3, 2))  # inverted by a search, slowly
POINTS = 1_000_000
COARSE, FINE = (21, 16), (41, 31)  # points of a table; FINE by default, and bounded more slowly
SIZES = [(20_000, COARSE), pytest.param(POINTS, FINE, marks=pytest.mark.soak)]
# A form each in short: linear in its parameters, with kinks, without, and found by itself.
OF_A_FORM = ("eq. (7)", "kinked spline", "network", "auto")
SOME = [*OF_A_FORM, *soaked(*(name for name in ESTIMATORS if name not in OF_A_FORM))]
N = 5000
BESIDE = np.array([-1e-9, 0.0, 1e-9])  # of an edge
STEADY = np.full(N, 40.0)
WARMING = np.linspace(25.0, 55.0, N)


def learnt(estimator, dead=6.0, T=STEADY):
    rng = np.random.default_rng(4)
    U, dp = rng.uniform(0, 100, N), rng.uniform(1, 200, N)
    Q = 2.0 * np.clip(U - dead, 0, 90) * np.sqrt(dp / 200) * (1.0 + 0.004 * (T - 40.0))
    Q += 0.3 * rng.normal(size=N)
    samples = Samples.of(np.arange(N), U, dp, 0 * dp, Q, T)
    return estimator.update(estimator.initial_state(), samples)[0]


def edges(axis, more):
    """Each point of an axis, and of others within it, and what is just beside it."""
    points = np.union1d(axis, more[(more > axis[0]) & (more < axis[-1])])
    return np.clip((points[:, None] + BESIDE).ravel(), axis[0], axis[-1])


def points_tried(estimator, state, table, n):
    """Of Q and dp, at random and at all crossings of edges and knots, a little beyond the reach."""
    rng = np.random.default_rng(5)
    pieces = MapPieces.of(estimator, state, (table.dp[0], table.dp[-1]), table.T)
    knots = np.empty(0) if pieces is None else pieces.s**2
    crossings = np.meshgrid(edges(table.r, table.r), edges(table.dp, knots))
    r, dp = rng.uniform(-0.02, 1.02, n), rng.uniform(table.dp[0], table.dp[-1], n)
    beside = rng.integers(0, 2, n // 4) + rng.uniform(-1e-3, 1e-3, n // 4)  # both limits
    r = np.concatenate([r, beside, crossings[0].ravel()])
    dp = np.concatenate([dp, rng.permutation(dp)[: n // 4], crossings[1].ravel()])
    low, high = (np.interp(dp, table.dp, x) for x in (table.lowest, table.highest))
    return low + r * (high - low), dp


@cache
def taught(name):
    """An estimator and its state."""
    estimator = (ESTIMATORS | {"Gaussians": GAUSSIANS})[name]
    return estimator, learnt(estimator)


@cache
def exported(name, points):
    """An estimator, its state and its table."""
    estimator, state = taught(name)
    return estimator, state, lookup_table(estimator, state, points=points)


def largest_errors(estimator, state, table, n):
    """In U and in flow, at points over the table's domain and a little beyond."""
    Q, dp = points_tried(estimator, state, table, n)
    n = len(Q)
    low, high = (np.interp(dp, table.dp, x) for x in (table.lowest, table.highest))
    U, _ = table.interpolate(Q, dp)
    T = np.full(n, table.T)
    known = np.isfinite(U)
    flow = estimator.predict(state, U[known], dp[known], T[known])[0]
    apart_Q = np.abs(flow - np.clip(Q, low, high)[known]).max()
    exact = invert(estimator, state, Q, dp, table.T)
    both = known & (exact.status == InverseStatus.OK)
    return np.abs(U - exact.U)[both].max(), apart_Q


@pytest.mark.parametrize(("n", "points"), SIZES)
@pytest.mark.parametrize("name", SOME)
def test_the_certified_error_holds_at_random_points_and_is_tight(name, n, points):
    estimator, state, table = exported(name, points)
    assert table.certified
    error_U, error_Q = largest_errors(estimator, state, table, n)
    assert error_U <= table.error_U <= 1.5 * error_U
    assert error_Q <= table.error_Q <= 1.2 * error_Q + 2e-4


@pytest.mark.parametrize(("n", "points"), SIZES)
@pytest.mark.parametrize("T", [10.0, *soaked(25.0, 60.0)])
def test_it_holds_for_auto_at_temperatures_that_make_no_polynomial(T, n, points):
    estimator = FlowMap()
    state = learnt(estimator, T=WARMING)
    assert MapPieces.of(estimator, state, (5.0, 200.0), T).slack >= (WARMING[0] != T) * 1e-12
    table = lookup_table(estimator, state, T=T, points=points)
    assert table.certified
    error_U, error_Q = largest_errors(estimator, state, table, n)
    assert error_U <= table.error_U <= 1.5 * error_U
    assert error_Q <= table.error_Q <= 1.2 * error_Q + 2e-4


@pytest.mark.parametrize(("n", "points"), SIZES)
@pytest.mark.parametrize("name", SOME)
def test_the_certified_error_of_the_flow_holds_and_is_tight(name, n, points):
    estimator, state, inverse = exported(name, points)
    support = Support.none()
    forward = valve_tables(estimator, state, inverse, support, 0.3).forward
    assert forward.certified
    rng = np.random.default_rng(6)
    pieces = MapPieces.of(estimator, state, (0.0, forward.s[-1] ** 2), 40.0)
    crossings = np.meshgrid(edges(forward.U, pieces.U), edges(forward.s, pieces.s))
    U = np.concatenate([rng.uniform(0, 100, n), crossings[0].ravel()])
    s = np.concatenate([rng.uniform(0, forward.s[-1], n), crossings[1].ravel()])
    (i, u), (j, v) = place(forward.U, U), place(forward.s, s)
    Q = forward.Q
    mine = (1 - u) * ((1 - v) * Q[i, j] + v * Q[i, j + 1])
    mine += u * ((1 - v) * Q[i + 1, j] + v * Q[i + 1, j + 1])
    exact = estimator.predict(state, U, s**2, np.full(len(U), 40.0))[0]
    largest = np.abs(mine - exact).max()
    assert largest <= forward.error <= 1.2 * largest + 2e-4


any_polynomial_and_grid = given(
    st.lists(st.floats(-0.3, 0.3), min_size=5, max_size=5),
    st.tuples(st.integers(3, 12), st.integers(3, 12)),
    st.floats(0.5, 50.0),
)


@settings(max_examples=3)
@any_polynomial_and_grid
def test_it_holds_for_any_polynomial_and_any_grid(parts, points, dp_min):
    holds(parts, points, dp_min)


@pytest.mark.soak
@settings(max_examples=50)
@any_polynomial_and_grid
def test_it_holds_for_fifty_polynomials_and_grids(parts, points, dp_min):
    holds(parts, points, dp_min)


def holds(parts, points, dp_min):
    theta = np.array([parts[0], parts[1] / 9, parts[2], 0.1 + parts[3] / 9, parts[4] / 9])
    valve, state = LinearMap(FiveTerms()), LinearMapState(theta, np.zeros((5, 5)))
    table = lookup_table(valve, state, dp_min=dp_min, points=points)
    assert table.certified
    error_U, error_Q = largest_errors(valve, state, table, 4_000)
    assert error_U <= table.error_U
    assert error_Q <= table.error_Q


def test_it_holds_for_gaussians_with_fixed_centres():
    _, state = taught("Gaussians")
    table = lookup_table(GAUSSIANS, state, points=(9, 7))
    assert table.certified
    error_U, error_Q = largest_errors(GAUSSIANS, state, table, 2_000)
    assert error_U <= table.error_U
    assert error_Q <= table.error_Q <= 1.2 * error_Q + 2e-4


@pytest.mark.parametrize("name", ["eq. (7)", "kinked spline", "auto", "network", "Gaussians"])
def test_pieces_bound_the_map_and_its_slopes(name):
    estimator, state = taught(name)
    pieces = MapPieces.of(estimator, state, (5.0, 200.0), 40.0)
    rng = np.random.default_rng(1)
    U, s = rng.uniform(0, 99, 2000), rng.uniform(np.sqrt(5), np.sqrt(199), 2000)
    T = np.full(2000, 40.0)
    Q, by_U, by_s = pieces.at(U, s)
    apart = np.abs(Q - estimator.predict(state, U, s**2, T)[0])
    assert (apart <= pieces.slack + 1e-7).all()
    slopes, _, kinked = pieces.over(U, U + 0.5, s, s + 0.01)
    step = (estimator.predict(state, U + 0.5, s**2, T)[0] - Q) / 0.5
    assert (slopes[0] - 1e-6 <= step).all()
    assert (step <= slopes[1] + 1e-6).all()
    assert ((slopes[2] <= by_s + 1e-6) & (by_s <= slopes[3] + 1e-6)).all()
    assert ((slopes[0] <= by_U + 1e-6) & (by_U <= slopes[1] + 1e-6)).all()
    assert kinked.any() == (name in {"kinked spline", "auto"} or bool(pieces.kinks_U.any()))


@pytest.mark.parametrize("name", ["eq. (7)", "kinked spline", "auto", "network", "Gaussians"])
def test_bends_bound_how_slopes_change_in_a_box_without_a_kink(name):
    """Taylor's theorem rests on them: half of a bend, or a kink that is left out, is seen here."""
    pieces = MapPieces.of(*taught(name), (5.0, 200.0), 40.0)
    rng = np.random.default_rng(2)
    n, steps = 20_000, 0.5 ** rng.uniform(0, 12, 20_000)
    low_U, low_s = rng.uniform(0, 95, n), rng.uniform(np.sqrt(5), np.sqrt(200) - 0.5, n)
    by_U, by_s = 5.0 * steps, 0.5 * steps
    _, bends, kinked = pieces.over(low_U, low_U + by_U, low_s, low_s + by_s)
    here = pieces.at(low_U, low_s)
    along_U, along_s = pieces.at(low_U + by_U, low_s), pieces.at(low_U, low_s + by_s)
    changed = np.abs([along_U[1] - here[1], along_s[1] - here[1], along_s[2] - here[2]])
    bounds = bends * np.stack([by_U, by_s, by_s])
    rounding = 1e-9 * np.abs(here).max()
    assert (changed <= bounds + rounding)[:, ~kinked].all()
    bent = bounds.max(axis=1) > 1e3 * rounding
    sharp = (changed > 0.6 * bounds) & (bounds > 1e3 * rounding) & ~kinked
    assert bent.any()
    assert sharp.any(axis=1)[bent].all()  # so the bounds are of use, too


class OfUnknownForm:
    """A map of which nothing is known but its flows."""

    def __init__(self, estimator):
        self.predict = estimator.predict


def test_the_error_of_a_map_of_unknown_form_is_measured_and_says_so():
    network = OfUnknownForm(RbfNetwork())
    _, state = taught("network")
    table = lookup_table(network, state, points=COARSE)
    assert not table.certified
    assert largest_errors(network, state, table, 20_000)[1] <= table.error_Q


def test_a_map_that_has_learnt_nothing_has_no_pieces():
    for estimator in (FlowMap(), RbfNetwork()):
        state = estimator.initial_state()
        assert MapPieces.of(estimator, state, (5.0, 200.0), 40.0) is None


@pytest.mark.parametrize(
    ("seed", "points", "boxes", "n"),
    [
        (1, (6, 4), 3_000, 4_000),
        *(pytest.param(k, (13, 9), 200_000, POINTS, marks=pytest.mark.soak) for k in range(6)),
    ],
)
def test_a_table_for_spreadsheets_is_certified_where_the_map_falls_with_U(
    seed, points, boxes, n, monkeypatch
):
    monkeypatch.setattr(table_error, "MOST", boxes)
    rng = np.random.default_rng(seed)
    structure = TensorSpline.uniform(6, 4)
    U, s = np.meshgrid(np.linspace(0, 100, 9), np.linspace(0, 14.2, 7), indexing="ij")
    theta = (0.05 * U * s + rng.normal(0, 4.0, U.shape) * s / 14.2 + rng.normal(0, 2.0)).ravel()
    valve, state = LinearMap(structure), LinearMapState(theta, np.zeros((63, 63)))
    table = flow_table(valve, state, lookup_table(valve, state, points=points))
    assert table.certified
    Q, dp = rng.uniform(table.Q[0], table.Q[-1], n), rng.uniform(table.dp[0], table.dp[-1], n)
    rise = rng.uniform(0, 1, n // 2) ** 3
    ends = [valve.predict(state, np.full(n, u), dp, np.full(n, 40.0))[0] for u in (0.0, 100.0)]
    Q[: n // 2] = np.clip((ends[0][: n // 2] + rise - 0.3), table.Q[0], table.Q[-1])
    mine, exact = table.interpolate(Q, dp), invert(valve, state, Q, dp, table.T)
    known = np.isfinite(mine) & np.isfinite(exact.U)
    assert known.mean() > 0.5
    assert np.abs(mine - exact.U)[known].max() <= table.error_U
    flows = (valve.predict(state, x[known], dp[known], 0 * x[known])[0] for x in (mine, exact.U))
    assert np.abs(np.subtract(*flows)).max() <= table.error_Q
