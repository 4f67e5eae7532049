"""Rank-one steps against the matrices they stand for."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from valvemap.model.kernels import factors
from valvemap.model.kernels.factors import covariance, rotate_in

vectors = arrays(np.float64, 4, elements=st.floats(-10, 10).map(lambda v: round(v, 3)))
weights = st.floats(0.01, 5.0)


def random_factor(seed):
    rng = np.random.default_rng(seed)
    return np.tril(rng.normal(size=(4, 4)), -1) + np.diag(rng.uniform(0.1, 3.0, 4))


def by_python(kernel):
    """The kernel's Python: inner kernels have no entry from Python."""
    return kernel.py_func


def test_the_factor_by_hand():
    # U = [[1, 2], [0, 1]], D = diag(3, 5): P = U·D·Uᵀ = [[23, 10], [10, 5]].
    np.testing.assert_array_equal(
        covariance(np.array([[3.0, 0.0], [2.0, 5.0]])), [[23.0, 10.0], [10.0, 5.0]]
    )


@given(st.integers(0, 1000), vectors)
def test_project_gives_px_and_its_length(seed, x):
    ut, f, Px = random_factor(seed), np.empty(4), np.empty(4)
    P = covariance(ut)
    r = by_python(factors.project)(ut, x, f, Px)
    np.testing.assert_allclose(Px, P @ x, atol=1e-9)
    np.testing.assert_allclose(r, x @ P @ x, atol=1e-9)


@given(st.integers(0, 1000), vectors, weights, weights, weights)
def test_rank_one_takes_away_what_it_says(seed, x, alpha, weight, growth):
    ut, f, Px = random_factor(seed), np.empty(4), np.empty(4)
    P = covariance(ut)
    r = by_python(factors.project)(ut, x, f, Px)
    by_python(factors.rank_one)(ut, f, Px, alpha, weight, growth)
    expected = growth * (P - weight * np.outer(P @ x, P @ x) / (alpha + weight * r))
    np.testing.assert_allclose(covariance(ut), expected, rtol=1e-6, atol=1e-8)
    assert (np.diag(ut) > 0.0).all()


@given(st.integers(0, 1000), vectors)
def test_a_negative_weight_puts_back_what_a_positive_one_took(seed, x):
    ut, f, Px = random_factor(seed), np.empty(4), np.empty(4)
    P = covariance(ut)
    by_python(factors.project)(ut, x, f, Px)
    by_python(factors.rank_one)(ut, f, Px, 1.0, 1.0, 1.0)
    by_python(factors.project)(ut, x, f, Px)
    by_python(factors.rank_one)(ut, f, Px, 1.0, -1.0, 1.0)
    np.testing.assert_allclose(covariance(ut), P, rtol=1e-5, atol=1e-6)


@given(st.integers(0, 1000), st.integers(4, 30), st.floats(0.5, 1.0))
def test_rows_rotated_in_leave_the_triangle_of_their_weighted_sum(seed, N, lam):
    rng = np.random.default_rng(seed)
    X, y = rng.normal(size=(N, 4)), rng.normal(size=N)
    R, z = np.zeros((4, 4)), np.zeros(4)
    squares = 0.0
    for i in range(N):
        squares = lam * squares + rotate_in(R, z, X[i].copy(), y[i], lam, np.ones(4), i) ** 2
    w = lam ** np.arange(N - 1, -1, -1.0)
    np.testing.assert_allclose(R.T @ R, (X.T * w) @ X, atol=1e-9)
    np.testing.assert_allclose(R.T @ z, (X.T * w) @ y, atol=1e-9)
    np.testing.assert_allclose(np.triu(R), R)
    theta = np.linalg.solve((X.T * w) @ X, (X.T * w) @ y)
    np.testing.assert_allclose(squares, np.sum(w * (y - X @ theta) ** 2), atol=1e-8)


def test_the_inverted_triangle_is_the_factor_of_p():
    rng = np.random.default_rng(0)
    R, ut = np.triu(rng.normal(size=(5, 5)) + 3 * np.eye(5)), np.empty((5, 5))
    by_python(factors.invert_triangle)(R, ut)
    np.testing.assert_allclose(covariance(ut), np.linalg.inv(R.T @ R), rtol=1e-9)
