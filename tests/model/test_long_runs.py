"""What 10⁷ and 10⁸ samples do to the arithmetic; `make soak` runs the long ones."""

import numpy as np
import pytest

from valvemap.model.forgetting import Adaptive, Directional, Exponential, Resetting
from valvemap.model.kernels.row_layout import FACTORED
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.vocabulary.statuses import Status

THETA = np.array([1.0, 0.02, 0.3, 0.12, -0.01])
OTHER = THETA * [2.0, 1.0, 0.5, 1.2, 1.0]
BATCH = 100_000
MILLIONS = pytest.param(10_000_000, marks=pytest.mark.soak)
HUNDRED_MILLIONS = pytest.param(100_000_000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])


def flow(U, dp):
    return FiveTerms().regressors(U, dp, dp) @ THETA


def samples_of(U, dp, Q):
    return Samples.of(np.arange(len(U)), U, dp, np.zeros(len(U)), Q)


def scattered(N, seed, noise=2.0):
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(0, 200, N)
    return samples_of(U, dp, flow(U, dp) + noise * rng.normal(size=N))


def d_of(state):
    assert state.counters[FACTORED]
    return np.diag(state.factor)


def scaled_trace(state):
    U = np.tril(state.factor, -1).T + np.eye(5)
    P = (U * d_of(state)) @ U.T
    return np.sum(np.diag(P) * state.scale**2)


@pytest.mark.parametrize("N", [200_000, MILLIONS])
@pytest.mark.parametrize("lam", [0.98, 0.995, 0.9999])
def test_persistently_excited_it_stays_weighted_least_squares(N, lam):
    rls = RecursiveLeastSquares(forgetting=Exponential(lam))
    state = rls.initial_state()
    tail = Samples.empty()
    for batch in range(N // BATCH):
        samples = scattered(BATCH, batch)
        state, trace = rls.update(state, samples)
        assert (trace.status[5:] == Status.OK).all()
        assert (d_of(state) > 0.0).all()
        tail = Samples.concatenate([tail, samples])[-int(40.0 / (1.0 - lam)) :]
    X = FiveTerms().regressors(tail.U, tail.dp, tail.T)
    np.testing.assert_allclose(state.theta, batch_least_squares(X, tail.Q, lam), rtol=1e-8)


DULL = {
    "a point": (np.full(BATCH, 37.3), np.full(BATCH, 81.7)),
    "intercept alone": (np.zeros(BATCH), np.zeros(BATCH)),
}


@pytest.mark.parametrize("N", [1_000_000, HUNDRED_MILLIONS])
@pytest.mark.parametrize("dull", DULL.values(), ids=DULL)
@pytest.mark.parametrize("rule", [Adaptive(), Directional(0.99), Resetting(0.99)], ids=repr)
def test_without_excitation_nothing_moves_and_everything_wakes_up_again(rule, dull, N):
    rls = RecursiveLeastSquares(forgetting=rule)
    state, _ = rls.update(rls.initial_state(), scattered(2000, 1, noise=0.0))
    samples = samples_of(*dull, flow(*dull))
    for _ in range(N // BATCH):
        state, trace = rls.update(state, samples)
    np.testing.assert_allclose(state.theta, THETA, rtol=1e-8)
    assert scaled_trace(state) < 1e6
    assert (d_of(state) > 0.0).all()
    assert set(trace.status.tolist()) <= {Status.OK, Status.UNEXCITED}
    assert_it_learns(rls, state, THETA if isinstance(rule, Directional) else OTHER)


@pytest.mark.parametrize("N", [1_000_000, HUNDRED_MILLIONS])
@pytest.mark.parametrize("dull", DULL.values(), ids=DULL)
@pytest.mark.parametrize("lam", [0.99, 0.999])
def test_plain_exponential_forgetting_says_unexcited_and_holds_p(lam, dull, N):
    rls = RecursiveLeastSquares(forgetting=Exponential(lam))
    state, _ = rls.update(rls.initial_state(), scattered(2000, 1, noise=0.0))
    samples = samples_of(*dull, flow(*dull))
    for _ in range(N // BATCH):
        state, trace = rls.update(state, samples)
    assert (trace.status == Status.UNEXCITED).all()
    assert scaled_trace(state) < 1e11
    held, _ = rls.update(state, samples)
    np.testing.assert_allclose(scaled_trace(held), scaled_trace(state), rtol=1e-6)
    assert_it_learns(rls, state, OTHER if lam <= 0.99 else THETA)


@pytest.mark.parametrize("N", [1_000_000, HUNDRED_MILLIONS])
@pytest.mark.parametrize("rule", [Adaptive(), Exponential(0.99), Exponential()], ids=repr)
def test_zero_regressors_are_no_news_however_many(rule, N):
    rls = RecursiveLeastSquares(NoIntercept(), rule)
    U, dp = np.random.default_rng(0).uniform(1, 100, (2, 2000))
    X = NoIntercept().regressors(U, dp, dp)
    state, _ = rls.update(rls.initial_state(), samples_of(U, dp, X @ THETA[1:]))
    nothing = samples_of(np.zeros(BATCH), np.zeros(BATCH), np.zeros(BATCH))
    for _ in range(N // BATCH):
        state, trace = rls.update(state, nothing)
    assert (trace.status == Status.UNEXCITED).all()
    np.testing.assert_allclose(state.theta, THETA[1:], rtol=1e-8)
    state, _ = rls.update(state, samples_of(U[:1000], dp[:1000], X[:1000] @ (2.0 * THETA[1:])))
    if rls.lam < 1.0:
        np.testing.assert_allclose(X @ state.theta, X @ (2.0 * THETA[1:]), rtol=2e-2)


class NoIntercept(FiveTerms):
    """Eq. (7) without a1: at rest all regressors are 0."""

    @property
    def parameter_names(self):
        return ("a2", "a3", "a4", "a5")

    def regressors(self, U, dp, T):
        return FiveTerms().regressors(U, dp, T)[:, 1:]


def assert_it_learns(rls, state, theta):
    """From 1,000 scattered samples of the same valve or another."""
    samples = scattered(1000, 3, noise=0.0)
    X = FiveTerms().regressors(samples.U, samples.dp, samples.T)
    state, trace = rls.update(state, samples_of(samples.U, samples.dp, X @ theta))
    assert trace.status[-1] == Status.OK
    assert np.sqrt(np.mean((X @ (state.theta - theta)) ** 2)) < 0.5
