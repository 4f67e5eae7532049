import numpy as np
import pytest

from support.plant import plant
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Resetting,
    SlidingWindow,
    Subspace,
    Variable,
    least_lam,
    with_lam,
)
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.survey import survey
from valvemap.vocabulary.statuses import Status

THETA = np.array([1.0, 0.02, 0.3, 0.12, -0.01])
RULES = [
    Exponential(0.99),
    Variable(0.99),
    Resetting(0.99),
    Directional(0.99),
    Subspace(0.99),
    SlidingWindow(100),
    Adaptive(0.99),
]
MAP = FiveTerms().regressors(
    *(a.ravel() for a in np.meshgrid(np.linspace(0, 100, 21), np.linspace(0, 200, 21))),
    np.zeros(441),
)


def scattered(N, seed=0, noise=2.0, theta=THETA):
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(0, 200, N)
    X = FiveTerms().regressors(U, dp, dp)
    return X, X @ theta + noise * rng.normal(size=N)


def structured(levels, per_level, seed=0, noise=2.0, theta=THETA):
    rng = np.random.default_rng(seed)
    U = np.repeat(np.linspace(0, 100, levels), per_level)
    phase = np.tile(np.arange(per_level) / per_level, levels)
    dp = 200.0 * (1.0 - np.abs(2.0 * phase - 1.0))
    X = FiveTerms().regressors(U, dp, dp)
    return X, X @ theta + noise * rng.normal(size=len(U))


def map_rmse(theta, truth=THETA):
    return np.sqrt(np.mean((MAP @ (theta - truth).T) ** 2, axis=0))


@pytest.mark.parametrize("rule", RULES, ids=repr)
def test_every_rule_finds_the_truth_exactly_without_noise(rule):
    X, y = scattered(600, noise=0.0)
    result = recursive_least_squares(X, y, rule)
    np.testing.assert_allclose(result.theta, THETA, rtol=1e-9)
    assert (result.status[5:] == Status.OK).all()


@pytest.mark.parametrize("rule", [Directional(1.0), Subspace(1.0), Variable(1.0), Resetting(1.0)])
def test_every_rule_with_lam_1_is_least_squares(rule):
    X, y = scattered(300)
    np.testing.assert_allclose(
        recursive_least_squares(X, y, rule).theta, batch_least_squares(X, y), rtol=1e-9
    )


@pytest.mark.parametrize("rule", [Directional(0.9), Subspace(0.9)])
def test_for_one_parameter_directional_forgetting_is_exponential(rule):
    rng = np.random.default_rng(3)
    x, y = 1.0 + rng.random((50, 1)), rng.normal(size=50)
    history = recursive_least_squares(x, y, rule).theta_history
    # The warm-up lasts one sample.
    expected = recursive_least_squares(x, y, 0.9).theta_history
    np.testing.assert_allclose(history, expected, rtol=1e-9)


def test_directional_forgetting_by_hand():
    # P = I; X = (1, 0): r = 1, P⁻¹ + (1 - 0.1/1)·XXᵀ = diag(1.9, 1); L = (1/1.9, 0).
    result = recursive_least_squares([[1.0, 0.0]], [1.0], Directional(0.9), p0=1.0)
    np.testing.assert_allclose(result.theta, [1 / 1.9, 0.0])


def test_the_sliding_window_is_least_squares_of_its_samples_alone():
    X, y = scattered(350)
    history = recursive_least_squares(X, y, SlidingWindow(40)).theta_history
    for N in (20, 40, 41, 55, 80, 81, 200, 350):
        first = max(0, N - 40)
        np.testing.assert_allclose(
            history[N - 1], batch_least_squares(X[first:N], y[first:N]), rtol=1e-8
        )


def test_a_window_without_excitation_keeps_what_it_knew():
    X, y = scattered(100, noise=0.0)
    X = np.vstack([X, np.repeat(X[-1:], 300, axis=0)])
    y = np.append(y, np.full(300, y[-1]))
    result = recursive_least_squares(X, y, SlidingWindow(50))
    np.testing.assert_allclose(result.theta, THETA, rtol=1e-6)
    assert (result.status[160:] == Status.UNEXCITED).all()


def test_a_variable_factor_forgets_when_the_plant_jumps():
    X, y = scattered(3000)
    y[2000:] += 0.3 * X[2000:, 3] * THETA[3]
    truth = THETA * [1, 1, 1, 1.3, 1]
    variable = recursive_least_squares(X, y, Variable(0.999)).theta_history
    constant = recursive_least_squares(X, y, 0.999).theta_history
    assert map_rmse(variable[2200], truth) < 0.3 * map_rmse(constant[2200], truth)
    assert map_rmse(variable[1999]) < 0.7


def test_resetting_bounds_p_where_plain_exponential_forgetting_winds_up():
    X, y = scattered(200)
    X, y = np.vstack([X, np.tile(X[0], (3000, 1))]), np.append(y, np.full(3000, X[0] @ THETA))
    bounded = recursive_least_squares(X, y, Resetting(0.98, information=0.01))
    assert (bounded.status[5:] == Status.OK).all()
    np.testing.assert_allclose(bounded.theta, THETA, atol=3.0)


@pytest.mark.parametrize("rule", [Directional(0.99), Subspace(0.99), Adaptive(0.99), Adaptive()])
def test_on_structured_data_the_map_stays_whole_where_plain_forgetting_loses_it(rule):
    for seed in range(20):
        X, y = structured(11, 1000, seed)
        history = recursive_least_squares(X, y, rule).theta_history
        assert map_rmse(history[2000:]).max() <= 2.5
        assert np.abs(MAP @ (history[5500::7] - THETA).T).max() <= 2.5
    plain = recursive_least_squares(X, y, 0.99).theta_history
    assert np.abs(MAP @ (plain[2000::7] - THETA).T).max() > 25.0


def test_with_forgetting_the_interval_is_honest_for_directional_rules_too():
    point = MAP[[220, 30, 400]]
    hits = []
    for seed in range(200):
        X, y = scattered(1500, seed)
        result = recursive_least_squares(X, y, Directional(0.99))
        std = np.sqrt(np.einsum("ij,jk,ik->i", point, result.covariance, point))
        hits.append(np.abs(point @ (result.theta - THETA)) < 1.96 * std)
    assert 0.92 < np.mean(hits) < 0.98


def test_another_factor_keeps_the_rule():
    assert with_lam(Adaptive(0.99, threshold=8.0), 0.9) == Adaptive(0.9, threshold=8.0)
    with pytest.raises(ValueError, match="has a length"):
        with_lam(SlidingWindow(10), 0.9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Exponential(0.0), r"lam = 0\.0 is not in \(0, 1\]"),
        (lambda: Variable(least=1.1), r"least = 1\.1"),
        (lambda: Resetting(information=0.0), r"information = 0\.0"),
        (lambda: SlidingWindow(0), r"length = 0"),
        (lambda: Adaptive(threshold=-1.0), r"threshold = -1\.0"),
        (lambda: Directional(np.nan), r"lam = nan"),
        (lambda: Subspace(2.0), r"lam = 2\.0"),
    ],
)
def test_settings_without_meaning_are_refused_by_name(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def drifting(N, noise, rho=0.0):
    """A slow sweep while a4 drifts by a fifth, noise with correlation rho."""
    rng = np.random.default_rng(9)
    t = np.arange(N)
    U, dp = 50 + 40 * np.sin(t / 3000), 100 + 90 * np.sin(t / 170)
    X = FiveTerms().regressors(U, dp, dp)
    e = rng.normal(size=N)
    for i in range(1, N):
        e[i] = rho * e[i - 1] + np.sqrt(1 - rho**2) * e[i]
    drift = 0.2 * THETA[3] * np.sin(t / 2000)
    return X, X @ THETA, X[:, 3] * drift, noise * e


def test_where_innovations_stay_coloured_adaptive_forgetting_hurries():
    X, Q, drift, e = drifting(20_000, 0.1)
    lagging = recursive_least_squares(X, Q + drift + e, Subspace(0.998)).innovations[1000:]
    hurried = recursive_least_squares(X, Q + drift + e, Adaptive(0.998)).innovations[1000:]
    assert np.mean(hurried**2) < 0.5 * np.mean(lagging**2)


@pytest.mark.parametrize("rho", [0.0, 0.3])
def test_a_plant_that_stays_gives_it_no_reason_to_hurry(rho):
    X, Q, _, e = drifting(20_000, 1.0, rho)
    calm = recursive_least_squares(X, Q + e, Subspace(0.998)).theta
    adaptive = recursive_least_squares(X, Q + e, Adaptive(0.998)).theta
    assert map_rmse(adaptive) < 1.2 * map_rmse(calm) + 0.05


RULES_WITH_LAM = [
    *(Exponential(), Variable(), Resetting(), Directional()),
    *(Subspace(), Adaptive()),
]


@pytest.mark.parametrize("rule", RULES_WITH_LAM, ids=repr)
@pytest.mark.parametrize("lam", [1e-300, 1e-3, -1e308, 0.0, 1.0 + 1e-9, np.nan, np.inf])
def test_a_memory_of_fewer_samples_than_unknowns_is_refused_in_one_sentence(rule, lam):
    with pytest.raises(ValueError, match=r"^forgetting factor .* allowed is 0\.\d+ <= lam <= 1"):
        RecursiveLeastSquares(forgetting=rule).with_forgetting(lam)


@pytest.mark.parametrize("rule", RULES_WITH_LAM, ids=repr)
@pytest.mark.parametrize("rich", [5_000, 500], ids=["rich", "then still"])
def test_the_smallest_forgetting_factor_of_each_rule_leaves_all_numbers_finite(rule, rich):
    n = len(RecursiveLeastSquares().parameter_names)
    rls = RecursiveLeastSquares(forgetting=with_lam(rule, least_lam(rule, n)))
    samples = plant(5_000)
    samples.U[rich:], samples.p2[rich:] = 40.0, 100.0
    state, trace = rls.update(rls.initial_state(), samples)
    assert np.isfinite(rls.parameters(state)[0]).all()
    assert np.isfinite(trace.predicted[n:]).all()
    found = survey(rls, state, ResidualSpread.none().add(samples, trace), int(samples.t[-1]))
    assert 0.0 <= found.suggested_U <= 100.0


@pytest.mark.parametrize("estimator", [MaximumLikelihood(lam=0.5), FlowMap(lam=0.5)], ids=repr)
@pytest.mark.parametrize("rich", [5_000, 500], ids=["rich", "then still"])
def test_the_smallest_forgetting_factor_of_other_estimators_leaves_all_numbers_finite(
    estimator, rich
):
    samples = plant(5_000)
    samples.U[rich:], samples.p2[rich:] = 40.0, 100.0
    state, trace = estimator.update(estimator.initial_state(), samples)
    assert np.isfinite(estimator.parameters(state)[0]).all()
    found = survey(estimator, state, ResidualSpread.none().add(samples, trace), 0)
    assert 0.0 <= found.suggested_U <= 100.0
    with pytest.raises(ValueError, match=r"factor 0\.4: allowed is 0\.5 <= lam <= 1"):
        estimator.with_forgetting(0.4)
