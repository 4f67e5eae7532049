"""Misprints of the paper's least squares: the printed form fails where the right one holds."""

import numpy as np
import pytest

from valvemap.model.least_squares import batch_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms

LAM = 0.97


@pytest.fixture
def data():
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, 300), rng.uniform(0, 200, 300)
    X = FiveTerms().regressors(U, dp, dp)
    return X, X @ [1.0, 0.02, 0.3, 0.12, -0.01] + rng.normal(size=300)


def weighted(X, y, weights):
    w = np.sqrt(weights)
    return np.linalg.lstsq(X * w[:, None], y * w, rcond=None)[0]


def distance(a, b):
    return np.max(np.abs(a - b) / np.abs(b))


def test_eq_18_with_a_finite_p0_is_not_eq_16_but_p0_infinite_is(data):
    X, y = data[0][:20], data[1][:20]
    exact = batch_least_squares(X, y)
    assert distance(recursive_least_squares(X, y, p0=np.inf).theta, exact) < 1e-9
    assert distance(recursive_least_squares(X, y, p0=1.0).theta, exact) > 1e-3


def test_before_eq_26_the_flow_is_weighted_like_the_regressors(data):
    X, y = data
    w = np.sqrt(LAM ** np.arange(len(y) - 1, -1, -1.0))
    printed = np.linalg.lstsq(X * w[:, None], y, rcond=None)[0]
    ours = recursive_least_squares(X, y, LAM).theta
    assert distance(ours, weighted(X, y, w**2)) < 1e-9
    assert distance(printed, ours) > 0.1


def test_eqs_26_and_27_hold_for_the_inverse_of_p_with_lam_itself(data):
    X, y = data
    before = recursive_least_squares(X[:-1], y[:-1], LAM)
    after = recursive_least_squares(X, y, LAM)
    weights = LAM ** np.arange(len(y) - 1, -1, -1.0)
    information = (X.T * weights) @ X
    earlier = (X[:-1].T * weights[1:]) @ X[:-1]
    x = X[-1]
    np.testing.assert_allclose(LAM * earlier + np.outer(x, x), information, rtol=1e-12)
    printed = earlier / LAM + np.outer(x, x)
    assert distance(printed, information) > 0.05
    # The gain that was used in the last step is P(t)·X(t) of the right form.
    gain = (after.theta - before.theta) / after.innovations[-1]
    np.testing.assert_allclose(gain, np.linalg.solve(information, x), rtol=1e-7)
    assert distance(np.linalg.solve(printed, x), gain) > 0.02


def printed_eq_28(X, y, lam):
    """(27) applied first, as the text says, and λ used once more in (28)."""
    n = X.shape[1]
    theta, P = np.zeros(n), 1e8 * np.eye(n)
    for x, q in zip(X, y, strict=True):
        P_lam = P / lam
        L = P_lam @ x / (lam + x @ P_lam @ x)
        theta = theta + L * (q - x @ theta)
        P = (P_lam - np.outer(L, x @ P_lam)) / lam
        P = (P + P.T) / 2
    return theta


def test_eq_28_as_printed_forgets_with_lam_squared(data):
    X, y = data
    ours = recursive_least_squares(X, y, LAM).theta
    printed = printed_eq_28(X, y, LAM)
    assert distance(printed, recursive_least_squares(X, y, LAM**2).theta) < 1e-5
    assert distance(printed, ours) > 0.01
