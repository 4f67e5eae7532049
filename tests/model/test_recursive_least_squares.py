from fractions import Fraction

import numpy as np
import pytest

from support.plain_qr import plain_qr_least_squares
from valvemap.model.fleet import stack
from valvemap.model.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Subspace,
    Variable,
)
from valvemap.model.kernels import row_layout
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.vocabulary.statuses import Quality, Status

THETA = np.array([1.0, 0.02, 0.3, 0.12, -0.01])


def scattered(N, seed=0, noise=2.0):
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(0, 200, N)
    X = FiveTerms().regressors(U, dp, dp)
    return X, X @ THETA + noise * rng.normal(size=N)


def samples_of(X, y):
    return Samples.of(np.arange(len(y)), X[:, 1], X[:, 4], np.zeros(len(y)), y)


def test_three_samples_of_a_line_by_hand():
    result = recursive_least_squares([[1, 0], [1, 1], [1, 2]], [1, 3, 6])
    np.testing.assert_allclose(result.theta_history, [[1, 0], [1, 2], [5 / 6, 2.5]], atol=1e-14)
    assert np.isnan(result.innovations[0])
    assert np.isnan(result.innovations[1])
    assert result.innovations[2] == pytest.approx(1.0)
    assert result.status.tolist() == [Status.WARMING_UP, Status.OK, Status.OK]
    # One degree of freedom: σ² = 1/6, covariance σ²·(XᵀX)⁻¹.
    np.testing.assert_allclose(
        result.covariance, np.linalg.inv([[3, 3], [3, 5]]) / 6, rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("lam", [1.0, 0.995, 0.9])
def test_it_equals_weighted_batch_least_squares_as_soon_as_the_samples_determine_theta(lam):
    X, y = scattered(400)
    history = recursive_least_squares(X, y, lam).theta_history
    for N in (5, 6, 7, 20, 100, 400):
        np.testing.assert_allclose(
            history[N - 1], batch_least_squares(X[:N], y[:N], lam), rtol=1e-9
        )


def test_with_lam_1_the_covariance_is_that_of_batch_least_squares():
    X, y = scattered(200)
    result = recursive_least_squares(X, y)
    rest = y - X @ result.theta
    expected = np.linalg.inv(X.T @ X) * (rest @ rest) / (200 - 5)
    np.testing.assert_allclose(result.covariance, expected, rtol=1e-8)


def test_with_forgetting_the_covariance_is_that_of_the_estimate_not_p():
    # σ²·P·S·P with S = Σ λ^{2(N-i)}·X·Xᵀ, given the noise variance found.
    lam, (X, y) = 0.98, scattered(1000)
    result = recursive_least_squares(X, y, lam)
    weight = lam ** np.arange(999, -1, -1.0)
    P = np.linalg.inv((X.T * weight) @ X)
    PSP = P @ (X.T * weight**2) @ X @ P
    ratio = result.covariance / PSP
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-6)
    assert ratio[0, 0] == pytest.approx(4.0, rel=0.4)


def test_the_95_percent_interval_of_the_map_covers_95_percent():
    point = np.array([[1.0, 50.0, 10.0, 500.0, 100.0]])
    hits = []
    for seed in range(300):
        X, y = scattered(600, seed)
        rls = RecursiveLeastSquares(forgetting=Exponential(0.99))
        state, _ = rls.update(rls.initial_state(), samples_of(X, y))
        Q, std = rls.predict(state, point[:, 1], point[:, 4], point[:, 0])
        hits.append(abs(Q[0] - point[0] @ THETA) < 1.96 * std[0])
    assert 0.91 < np.mean(hits) < 0.985


def test_within_one_level_of_u_the_map_is_known_there_and_nowhere_else():
    rng = np.random.default_rng(1)
    dp = rng.uniform(1, 200, 50)
    X = FiveTerms().regressors(np.full(50, 30.0), dp, dp)
    rls = RecursiveLeastSquares()
    state, trace = rls.update(rls.initial_state(), samples_of(X, X @ THETA))
    assert (trace.status == Status.WARMING_UP).all()
    assert np.isnan(trace.residual[:3]).all()
    np.testing.assert_allclose(trace.residual[3:], 0.0, atol=1e-10)
    Q, std = rls.predict(state, np.array([30.0, 31.0]), np.array([64.0, 64.0]), np.zeros(2))
    assert Q[0] == pytest.approx(FiveTerms().regressors(*np.array([[30.0], [64.0], [0.0]])) @ THETA)
    assert np.isnan(Q[1])
    assert np.isnan(std).all()
    theta, std = rls.parameters(state)
    assert np.isnan(theta[:4]).all()
    assert theta[4] == pytest.approx(THETA[4])  # a5·dp alone does not depend on U
    assert np.isnan(std).all()


def test_a_finite_p0_is_ridge_regression():
    X, y = scattered(30)
    theta = recursive_least_squares(X, y, p0=1e-4).theta
    np.testing.assert_allclose(
        theta, np.linalg.solve(X.T @ X + 1e4 * np.eye(5), X.T @ y), rtol=1e-9
    )


def test_units_of_the_regressors_do_not_matter():
    X, y = scattered(300)
    units = np.array([1.0, 2.0**-40, 2.0**30, 2.0**-7, 2.0**60])
    for rule in (Exponential(0.99), Directional(0.99)):
        theta = recursive_least_squares(X, y, rule).theta
        in_units = recursive_least_squares(X * units, y, rule).theta
        np.testing.assert_array_equal(in_units * units, theta)


@pytest.mark.parametrize("degree", [3, 5, 8, 10])
def test_it_is_as_exact_as_batch_qr_however_ill_conditioned_and_sorted_the_samples(degree):
    # One order or another may be kind to batch QR: its worst is the yardstick for all of ours.
    ascending = np.round(np.linspace(-8.8, -3.1, 82), 9)
    shuffled = np.random.default_rng(0).permutation(ascending)
    orders = [
        (np.vander(x, degree + 1, increasing=True), np.round(0.8 + 0.1 * np.sin(x), 3))
        for x in (ascending, ascending[::-1], shuffled)
    ]
    exact = exact_least_squares(*orders[0])  # the same fractions in any order
    ours, batch = [], []
    for X, y in orders:
        ours.append(lost_digits(recursive_least_squares(X, y).theta, exact))
        batch.append(lost_digits(plain_qr_least_squares(X, y), exact))
    assert max(ours) <= max(*batch, 2.0) + 1.0


def exact_least_squares(X, y):
    rows = [[Fraction(v) for v in (*row, q)] for row, q in zip(X.tolist(), y.tolist(), strict=True)]
    n = X.shape[1]
    A = [[sum(r[i] * r[j] for r in rows) for j in range(n + 1)] for i in range(n)]
    for i in range(n):
        for j in range(n):
            if j != i:
                factor = A[j][i] / A[i][i]
                A[j] = [a - factor * b for a, b in zip(A[j], A[i], strict=True)]
    return [A[i][n] / A[i][i] for i in range(n)]


def lost_digits(theta, exact):
    error = max(abs((Fraction(a) - b) / b) for a, b in zip(theta.tolist(), exact, strict=True))
    return 16.0 + float(np.log10(max(float(error), 1e-16)))


def test_unusable_samples_leave_the_state_untouched():
    X, y = scattered(40)
    good = samples_of(X, y)
    bad = Samples.of(
        t=range(6),
        U=[np.nan, 50, np.inf, 1e200, 50, 50],
        p1=[100, 100, 100, 100, 100, -np.inf],
        p2=[0, 0, 0, 0, 0, 0],
        Q=[10, np.nan, 10, 10, 1e308, 10],
        quality=[Quality.GOOD] * 6,
    )
    rls = RecursiveLeastSquares(forgetting=Exponential(0.99))
    state, _ = rls.update(rls.initial_state(), good)
    after, trace = rls.update(state, bad)
    assert after.to_bytes("k") == state.to_bytes("k")
    assert np.isnan(trace.residual).all()
    assert trace.status.tolist() == [
        Status.REJECTED,
        Status.REJECTED,
        Status.REJECTED,
        Status.REJECTED,
        Status.HELD,
        Status.REJECTED,
    ]
    refused = Samples.of([0], [50], [100], [0], [10], quality=[Quality.BAD])
    after, trace = rls.update(state, refused)
    assert after.to_bytes("k") == state.to_bytes("k")
    assert trace.status.tolist() == [Status.REJECTED]
    assert np.isfinite(trace.predicted).all()


def test_two_equal_regressors_never_determine_theta_but_predict():
    rng = np.random.default_rng(2)
    x = rng.normal(size=1000)
    result = recursive_least_squares(np.column_stack([x, x]), 3 * x)
    assert (result.status == Status.WARMING_UP).all()
    np.testing.assert_allclose(result.theta, [3, 0])
    np.testing.assert_allclose(result.innovations[1:], 0, atol=1e-12)
    assert np.isnan(result.covariance).all()


@pytest.mark.parametrize(("X", "y"), [(np.empty((0, 3)), []), ([[1.0, 2.0]], [3.0])])
def test_no_sample_or_one_are_enough_for_an_answer(X, y):
    result = recursive_least_squares(X, y)
    assert np.isfinite(result.theta).all()
    assert len(result.theta_history) == len(y)


def test_shapes_and_factors_that_cannot_be_are_refused_by_name():
    with pytest.raises(ValueError, match=r"X \(3,\) and y \(3,\)"):
        recursive_least_squares([1, 2, 3], [1, 2, 3])
    with pytest.raises(ValueError, match=r"lam = 1\.5"):
        recursive_least_squares([[1.0]], [1.0], 1.5)
    with pytest.raises(ValueError, match="p0 = 0"):
        recursive_least_squares([[1.0]], [1.0], p0=0.0)


def test_another_forgetting_factor_goes_on_from_the_same_state():
    rls = RecursiveLeastSquares(forgetting=Directional(0.99))
    assert rls.lam == 0.99
    faster = rls.with_forgetting(0.9)
    assert faster.forgetting == Directional(0.9)
    X, y = scattered(100)
    state, _ = rls.update(rls.initial_state(), samples_of(X, y))
    _, trace = faster.update(state, samples_of(X, y))
    assert (trace.status == Status.OK).all()
    with pytest.raises(ValueError, match=r"forgetting factor 0\.0"):
        rls.with_forgetting(0.0)


@pytest.mark.parametrize(
    "rule",
    [Exponential(1.0), Exponential(0.99), Variable(), Directional(), Subspace(), Adaptive()],
    ids=repr,
)
def test_many_models_are_as_sure_as_the_covariance_of_each_says(rule):
    rng = np.random.default_rng(4)
    rls = RecursiveLeastSquares(forgetting=rule)
    states = []
    for N in (40, 700):
        U, dp = rng.uniform(0, 100, N), rng.uniform(1, 200, N)
        Q = 0.1 * U * np.sqrt(dp) + rng.normal(size=N)
        samples = Samples.of(np.arange(N), U, dp, np.zeros(N), Q)
        states.append(rls.update(rls.initial_state(), samples)[0])
    _, std = rls.parameters_many(stack(states))
    for state, own in zip(states, std, strict=True):
        np.testing.assert_array_equal(rls.parameters(state)[1], own)
        np.testing.assert_allclose(own, np.sqrt(np.diag(rls.covariance(state))), rtol=1e-6)


@pytest.mark.soak
def test_a_kernel_for_so_many_terms_alone_gives_the_bits_of_the_one_for_any_number(monkeypatch):
    rng = np.random.default_rng(3)
    X = rng.normal(size=(3_000, 9))
    y = X @ np.arange(9.0) + rng.normal(size=3_000)
    own = recursive_least_squares(X, y, Exponential(0.998))
    monkeypatch.setattr(row_layout, "_KNOWN", ())
    common = recursive_least_squares(X, y, Exponential(0.998))
    for name in ("theta", "theta_history", "innovations", "covariance"):
        assert np.array_equal(getattr(own, name), getattr(common, name), equal_nan=True)
