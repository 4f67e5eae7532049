"""Steps on packed triangles against the matrices they stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from valvemap.model.kernels import triangles
from valvemap.model.kernels.covariance_form import is_nth
from valvemap.model.kernels.factors import covariance
from valvemap.model.kernels.row_layout import PLACES_OF_DETECTOR, places, size_of

N = 4
SIZE = size_of(N)
AT = places(N)
LOWER = np.tril_indices(N)
vectors = arrays(np.float64, N, elements=st.floats(-10, 10).map(lambda v: round(v, 3)))
weights = st.floats(0.01, 5.0)
seeds = st.integers(0, 1000)


def row_with(seed, **what):
    """A row with a random factor, a random symmetric spread and the given vectors."""
    rng = np.random.default_rng(seed)
    s = np.full(AT.end, np.nan)
    factor = np.tril(rng.normal(size=(N, N)), -1) + np.diag(rng.uniform(0.1, 3.0, N))
    root = rng.normal(size=(N, N))
    s[AT.factor : AT.spread] = factor[LOWER]
    s[AT.spread : AT.variance] = (root @ root.T)[LOWER]
    for name, value in what.items():
        start = getattr(AT, name)
        s[start : start + N] = value
    return s


def square(s, place):
    lower = np.zeros((N, N))
    lower[LOWER] = s[place : place + len(LOWER[0])]
    return lower


def P_of(s):
    return covariance(square(s, AT.factor))


def symmetric(s, place):
    lower = square(s, place)
    return lower + np.tril(lower, -1).T


def vector(s, place):
    return s[place : place + N].copy()


def test_the_places_do_not_overlap_and_leave_nothing_out():
    triangle = N * (N + 1) // 2
    lengths = [N] * 9 + [triangle] * 6 + [4, PLACES_OF_DETECTOR] + [N] * 5 + [triangle]
    assert list(AT) == np.concatenate([[0], np.cumsum(lengths)]).tolist()


@given(seeds, vectors)
def test_whiten_gives_the_length_of_x_in_p(seed, x):
    s = row_with(seed, x=x)
    r = triangles.whiten.py_func(SIZE, s, AT.factor, AT.x, AT.f)
    np.testing.assert_allclose(r, x @ P_of(s) @ x, atol=1e-9)


@given(seeds, vectors, weights, weights, weights)
def test_take_in_takes_away_what_it_says(seed, x, alpha, weight, growth):
    s = row_with(seed, x=x)
    P = P_of(s)
    r = triangles.whiten.py_func(SIZE, s, AT.factor, AT.x, AT.f)
    gain = triangles.take_in.py_func(SIZE, s, AT.factor, AT.f, AT.Px, alpha, weight, growth)
    Px = P @ x
    expected = growth * (P - weight * np.outer(Px, Px) / (alpha + weight * r))
    np.testing.assert_allclose(P_of(s), expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(vector(s, AT.Px), Px, atol=1e-9)
    np.testing.assert_allclose(gain, 1.0 / (alpha + weight * r), rtol=1e-9)


@given(seeds, vectors, weights)
def test_add_rank_one_adds_what_it_says(seed, v, weight):
    s = row_with(seed, Px=v)
    expected = P_of(s) + weight * np.outer(v, v)
    triangles.add_rank_one.py_func(SIZE, s, AT.factor, AT.Px, weight)
    np.testing.assert_allclose(P_of(s), expected, rtol=1e-7, atol=1e-8)


@given(seeds, vectors)
def test_inform_is_the_inverse(seed, v):
    s = row_with(seed, Px=v)
    length = triangles.inform.py_func(SIZE, s, AT.factor, AT.Px, AT.g)
    g = np.linalg.solve(P_of(s), v)
    np.testing.assert_allclose(vector(s, AT.g), g, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(length, v @ g, rtol=1e-6, atol=1e-9)


@given(seeds, vectors, vectors, weights, weights)
def test_rotate_rotates_a_symmetric_matrix(seed, x, v, taken, added):
    s = row_with(seed, x=x, Px=v)
    B = np.eye(N) - taken * np.outer(x, v)
    expected = B @ symmetric(s, AT.spread) @ B.T + added * np.outer(x, x)
    triangles.rotate.py_func(SIZE, s, AT.spread, AT.x, AT.Px, AT.g, taken, added)
    np.testing.assert_allclose(symmetric(s, AT.spread), expected, rtol=1e-7, atol=1e-6)


@given(seeds, vectors, weights)
def test_add_square_lets_the_old_decay(seed, v, decay):
    s = row_with(seed, x=v)
    expected = decay * symmetric(s, AT.spread) + np.outer(v, v)
    triangles.add_square.py_func(SIZE, s, AT.spread, AT.x, decay)
    np.testing.assert_allclose(symmetric(s, AT.spread), expected, rtol=1e-12, atol=1e-9)


@given(seeds)
def test_scaled_trace_is_that_of_p_in_units_of_the_scales(seed):
    scale = np.array([1.0, 10.0, 0.1, 3.0])
    s = row_with(seed, scale=scale)
    trace = triangles.scaled_trace.py_func(SIZE, s, AT.factor, AT.scale)
    np.testing.assert_allclose(trace, np.sum(np.diag(P_of(s)) * scale**2), rtol=1e-9)


@given(seeds, vectors)
def test_squared_length_is_that_in_the_inverse(seed, b):
    s = row_with(seed, score=b)
    V = symmetric(s, AT.spread) + 0.1 * np.eye(N)
    s[AT.variance : AT.omega] = V[LOWER]
    length = triangles.squared_length.py_func(SIZE, s, AT.score, AT.variance, AT.f, AT.Px, AT.L)
    np.testing.assert_allclose(length, b @ np.linalg.solve(V, b), rtol=1e-4, atol=1e-9)


def test_a_direction_that_others_explain_counts_nothing():
    s = row_with(0, score=np.ones(N))
    s[AT.variance : AT.omega] = np.ones((N, N))[LOWER]
    length = triangles.squared_length.py_func(SIZE, s, AT.score, AT.variance, AT.f, AT.Px, AT.L)
    np.testing.assert_allclose(length, 1.0)


@pytest.mark.parametrize("n", [1, 8])
def test_every_nth_comes_as_often_as_it_should_in_step_with_nothing(n):
    taken = np.array([is_nth.py_func(count, n) for count in range(1, 64_001)])
    assert taken.mean() == pytest.approx(1 / n, abs=1e-3)
    for period in range(2, 65):
        shares = [taken[phase::period].mean() for phase in range(period)]
        np.testing.assert_allclose(shares, 1 / n, atol=0.02)
