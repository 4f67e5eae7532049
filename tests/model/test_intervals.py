"""95 % intervals cover what they say: the true flow, the true opening, the next measurement."""

from dataclasses import fields

import numpy as np
import pytest

from valvemap.model.armax import recursive_maximum_likelihood
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive, Directional, Exponential, Subspace
from valvemap.model.inverse_map import invert
from valvemap.model.kernels import residual_spread as kernel
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms
from valvemap.model.monotone import Monotone
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Samples, Trace
from valvemap.model.tensor_spline import TensorSpline
from valvemap.pipeline.lane_predictions import predicted_measurement
from valvemap.pipeline.valve_state import fresh_lane

SIGMA, SEEDS, N = 1.0, 400, 600
FEW_SEEDS = 150  # in short
FIVE = np.array([-2.0, 0.03, 0.1, 0.14, -0.02])
SPLINE = TensorSpline.uniform(6, 4)


def eq_7(U, dp):
    return FiveTerms().regressors(U, dp, dp) @ FIVE


def spline(U, dp):
    sites_U, sites_s = (x.ravel() for x in np.meshgrid(*SPLINE.sites, indexing="ij"))
    theta = 0.12 * sites_U * sites_s * (1 - 0.003 * sites_U) + 2.0 * sites_s
    return SPLINE.regressors(U, dp, dp) @ theta


def dead_band_and_saturation(U, dp):
    return 2.0 * np.clip(U - 12.0, 0.0, 70.0) * np.sqrt(dp / 200.0)


def rls(structure, forgetting):
    return RecursiveLeastSquares(structure, forgetting)


EXACT = {
    "least squares": (rls(FiveTerms(), Exponential(1.0)), eq_7),
    "exponential .99": (rls(FiveTerms(), Exponential(0.99)), eq_7),
    "directional .99": (rls(FiveTerms(), Directional(0.99)), eq_7),
    "subspace .99": (rls(FiveTerms(), Subspace(0.99)), eq_7),
    "adaptive": (rls(FiveTerms(), Adaptive()), eq_7),
    "rising": (Monotone(rls(FiveTerms(), Exponential(1.0))), eq_7),
    "maximum likelihood": (MaximumLikelihood(), eq_7),
    "maximum likelihood .99": (MaximumLikelihood(lam=0.99), eq_7),
    "spline": (rls(SPLINE, Exponential(1.0)), spline),
    "spline .998": (rls(SPLINE, Exponential(0.998)), spline),
    "adaptive spline": (rls(SPLINE, Adaptive()), spline),
}
ANY = {
    "eq. (7)": rls(FiveTerms(), Adaptive()),
    "eq. (7), λ = .99": rls(FiveTerms(), Exponential(0.99)),
    "maximum likelihood": MaximumLikelihood(lam=0.999),
    "network": RbfNetwork(),
    "spline": rls(SPLINE, Adaptive()),
    "radial basis": rls(RadialBasis.uniform(), Adaptive()),
    "auto": FlowMap(),
}


def recording(truth, seed, n=N, colour=0.0, sigma=SIGMA):
    rng = np.random.default_rng(seed)
    U, dp, v = rng.uniform(0, 100, n), rng.uniform(2, 200, n), sigma * rng.normal(size=n + 1)
    noise = v[1:] + colour * v[:-1]
    return Samples.of(np.arange(n), U, dp, np.zeros(n), truth(U, dp) + noise, np.full(n, 40.0))


def covered(estimator, truth, seeds, n=N, colour=0.0):
    """Shares of true flows and of true openings inside their intervals, pooled over seeds."""
    in_Q, in_U = [], []
    for seed in range(seeds):
        samples = recording(truth, seed, n, colour)
        state, _ = estimator.update(estimator.initial_state(), samples)
        rng = np.random.default_rng(10_000 + seed)
        U, dp, T = rng.uniform(3, 97, 20), rng.uniform(2, 200, 20), np.full(20, 40.0)
        Q, std = estimator.predict(state, U, dp, T)
        in_Q.append(np.abs(Q - truth(U, dp)) <= 1.959964 * std)
        inverse = invert(estimator, state, truth(U, dp), dp, T)
        in_U.append((inverse.lower <= U) & (inverse.upper >= U))
    return float(np.mean(in_Q)), float(np.mean(in_U))


OF_A_SPLINE = [name for name in EXACT if EXACT[name][1] is spline]  # dear: one in short
IN_SHORT = [name for name in EXACT if name not in OF_A_SPLINE[1:]]


@pytest.mark.parametrize(
    ("name", "seeds"),
    [(name, 40 if name in OF_A_SPLINE else FEW_SEEDS) for name in IN_SHORT]
    + [
        pytest.param(name, SEEDS // 4 if name in OF_A_SPLINE else SEEDS, marks=pytest.mark.soak)
        for name in EXACT
    ],
)
def test_of_an_exact_structure_the_true_flow_and_opening_are_covered(name, seeds):
    estimator, truth = EXACT[name]
    in_Q, in_U = covered(estimator, truth, seeds, 5 * N if name in OF_A_SPLINE else N)
    assert 0.93 <= in_Q <= 0.97
    assert 0.93 <= in_U <= 0.97


FIVE_PARAMETERS = [name for name in EXACT if EXACT[name][1] is eq_7]
FEW = {name: 150 if "likelihood" in name else 100 for name in FIVE_PARAMETERS}
# At 100 samples RML covers 92.9 %: its noise model is barely let in. See docs/methods/intervals.md.
COUNTS = [(name, n) for name in FIVE_PARAMETERS for n in (FEW[name], 600, 4000)]


@pytest.mark.soak
@pytest.mark.parametrize(("name", "n"), COUNTS)
def test_of_an_exact_structure_they_are_covered_after_few_and_many_samples(name, n):
    in_Q, in_U = covered(*EXACT[name], SEEDS, n)
    assert 0.93 <= in_Q <= 0.97
    assert 0.93 <= in_U <= 0.97


@pytest.mark.parametrize("seeds", [FEW_SEEDS, pytest.param(SEEDS, marks=pytest.mark.soak)])
@pytest.mark.parametrize("lam", [1.0, 0.99])
def test_in_coloured_noise_the_intervals_of_maximum_likelihood_still_cover(lam, seeds):
    in_Q, in_U = covered(MaximumLikelihood(lam=lam), eq_7, seeds, 2 * N, colour=0.8)
    assert 0.93 <= in_Q <= 0.97
    assert 0.93 <= in_U <= 0.97


def test_auto_finds_eq_7_and_covers_it():
    in_Q, in_U = covered(FlowMap(), eq_7, 40)
    assert 0.91 <= in_Q <= 0.98  # 40 seeds alone, 800 points; 400 seeds: the soak
    assert 0.91 <= in_U <= 0.98


@pytest.mark.soak
def test_auto_covers_eq_7_over_400_seeds():
    in_Q, in_U = covered(FlowMap(), eq_7, SEEDS)
    assert 0.93 <= in_Q <= 0.97
    assert 0.93 <= in_U <= 0.97


@pytest.mark.parametrize("truth", [eq_7, dead_band_and_saturation])
@pytest.mark.parametrize("name", ANY)
def test_whatever_the_structure_the_next_measurement_is_covered(name, truth):
    """Learnt from 4,000 samples; then the interval is asked before each of 20 batches of 50."""
    inside = []
    for seed in range(2):
        samples = recording(truth, seed, 5000, sigma=0.5)
        lane = fresh_lane(ANY[name])
        for start in (0, *range(4000, 5000, 50)):
            batch = samples[start : 4000 if start == 0 else start + 50]
            if start:
                Q, half, _ = predicted_measurement(lane, batch.U, batch.dp, batch.T)
                inside.append(np.abs(batch.Q - Q) <= half)
            state, trace = lane.estimator.update(lane.state, batch)
            spread, support = lane.spread.add(batch, trace), lane.support.add(batch, trace)
            lane = type(lane)(lane.estimator, state, lane.score, spread, support)
    assert 0.93 <= np.mean(inside) <= 0.97


def test_where_the_structure_does_not_fit_the_interval_is_wider_than_where_it_does():
    samples = recording(dead_band_and_saturation, 1, 6000, sigma=0.2)
    estimator = rls(FiveTerms(), Adaptive())
    state, trace = estimator.update(estimator.initial_state(), samples)
    spread = ResidualSpread.none().add(samples, trace)
    U, dp, T = np.array([5.0, 45.0]), np.full(2, 180.0), np.full(2, 40.0)
    at_the_kink, inside = spread.half_width(U, dp, estimator.predict(state, U, dp, T)[1])
    assert at_the_kink > 1.5 * inside


def test_the_same_stream_in_other_batches_gives_the_same_scatter():
    samples = recording(eq_7, 3)
    estimator = rls(FiveTerms(), Adaptive())
    _, trace = estimator.update(estimator.initial_state(), samples)
    whole, parts = ResidualSpread.none().add(samples, trace), ResidualSpread.none()
    for start in range(0, N, 7):
        rows = slice(start, start + 7)
        parts = parts.add(samples[rows], piece_of(trace, rows))
    for f in fields(whole):
        assert getattr(whole, f.name).tobytes() == getattr(parts, f.name).tobytes()


def test_numbers_of_samples_that_begin_anew_change_no_interval():
    samples = recording(eq_7, 3)
    estimator = rls(FiveTerms(), Adaptive())
    _, trace = estimator.update(estimator.initial_state(), samples)
    first, rest = slice(0, N // 2), slice(N // 2, N)
    early = ResidualSpread.none().add(samples[first], piece_of(trace, first))
    later = ResidualSpread.none().add(samples[first], piece_of(trace, first))
    ahead = 2.0**32 - 32.0 * (N // 64) - 64.0  # as if so many had come before
    later.overall[kernel.COUNT] += ahead
    later.stamps[later.ages > 0, kernel.NUMBER] += np.uint32(ahead)
    early, later = (one.add(samples[rest], piece_of(trace, rest)) for one in (early, later))
    assert later.overall[kernel.COUNT] > 2.0**32 > later.stamps[:, kernel.NUMBER].min() + 2.0**31
    assert later.cells.tobytes() == early.cells.tobytes()
    assert later.ages.tobytes() == early.ages.tobytes()
    U, dp = samples.U, samples.dp
    expected = early.half_width(U, dp, 0.0 * U)
    np.testing.assert_array_equal(later.half_width(U, dp, 0.0 * U), expected)


def piece_of(trace, rows):
    return type(trace)(*(getattr(trace, f.name)[rows] for f in fields(trace)))


def test_of_a_cell_the_last_second_is_kept_whatever_the_time():
    U, e = np.full(1, 50.0), np.ones(1)
    trace = Trace(0 * e, e, e, np.zeros(1, np.uint8))
    for t, second in (
        (0, 0),
        (1_999_999_999, 1),
        (1_764_000_000_500_000_000, 1_764_000_000),
        (-5, 0),
    ):
        last = ResidualSpread.none().add(Samples.of([t], U, U, 0 * U, e), trace).last
        assert last[np.isfinite(last)].tolist() == [second * 1e9]


@pytest.mark.parametrize(
    "estimator",
    [
        rls(FiveTerms(), Adaptive()),
        rls(TensorSpline.uniform(4, 3), Exponential(0.99)),
        MaximumLikelihood(lam=0.99),
        RbfNetwork(),
    ],
)
def test_samples_are_held_against_the_map_of_up_to_31_samples_before(estimator):
    samples = recording(dead_band_and_saturation, 4)
    state, _ = estimator.update(estimator.initial_state(), samples[slice(0, 320)])
    ahead = samples[slice(320, 352)]
    Q, _ = estimator.predict(state, ahead.U, ahead.dp, ahead.T)
    for size in (32, 5):
        later, early = state, []
        for start in range(0, 32, size):
            later, trace = estimator.update(later, ahead[slice(start, start + size)])
            early.append(trace.early)
        found = np.concatenate(early)
        looked = np.isfinite(found)
        assert looked.sum() >= 16
        np.testing.assert_allclose(found[looked], (ahead.Q - Q)[looked], atol=1e-9)


def test_nothing_measured_is_nothing_known_and_nonsense_is_passed_over():
    spread = ResidualSpread.none()
    assert np.isnan(spread.noise_std)
    assert np.isnan(spread.around(np.array([50.0]), np.array([100.0]))).all()
    wild = np.array([np.nan, np.inf, 1e308, -1e308, 50.0])
    samples = Samples.of(range(5), wild, wild, np.zeros(5), wild)
    _, trace = RecursiveLeastSquares().update(RecursiveLeastSquares().initial_state(), samples)
    trace = type(trace)(trace.predicted, wild, wild, trace.status)
    after = spread.add(samples, trace)
    assert np.isfinite(after.cells).all()
    assert after.weights.sum() == 1.0


def test_the_covariance_of_maximum_likelihood_is_that_of_its_predictions():
    estimator = MaximumLikelihood()
    state, _ = estimator.update(estimator.initial_state(), recording(eq_7, 1, 2000, 0.5))
    C = estimator.covariance(state)
    assert np.array_equal(C, C.T)
    U, dp = np.array([10.0, 50.0, 90.0]), np.array([5.0, 100.0, 150.0])
    X = FiveTerms().regressors(U, dp, dp)
    std = estimator.predict(state, U, dp, dp)[1]
    np.testing.assert_allclose(np.sqrt(np.einsum("ij,jk,ik->i", X, C, X)), std, rtol=1e-9)
    y = np.random.default_rng(0).normal(size=500)
    found = recursive_maximum_likelihood(y[1:], y[:-1], na=1, nb=1, nd=1).covariance
    assert np.array_equal(found, found.T)
    assert np.linalg.eigvalsh(found).min() > 0.0


@pytest.mark.parametrize("seeds", [FEW_SEEDS, pytest.param(SEEDS, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", ["least squares", "exponential .99", "adaptive", "rising"])
def test_the_true_parameters_lie_within_their_standard_deviations(name, seeds):
    estimator, truth = EXACT[name]
    inside = []
    for seed in range(seeds):
        state, _ = estimator.update(estimator.initial_state(), recording(truth, seed))
        theta, std = estimator.parameters(state)
        inside.append(np.abs(theta - FIVE) <= 1.959964 * std)
    assert 0.93 <= np.mean(inside) <= 0.97
