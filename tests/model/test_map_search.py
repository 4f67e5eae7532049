"""Shapes of a map: their fit is least squares, their steps stay on the ladder, BIC tells them."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from valvemap.model.kernels import climb as criterion
from valvemap.model.kernels import grid, held, ladder, map_fit
from valvemap.model.kernels import surface as kernel
from valvemap.model.kernels.cells import NODES_T
from valvemap.model.map_search import (
    STARTS,
    climb,
    fit,
    fresh_start,
    is_better,
    noise,
    variety,
)
from valvemap.model.map_shapes import MOST, Shape, Variety, dp_top
from valvemap.model.model_structures import FiveTerms, Polynomial

ALL = Variety(least_play=0.1, temperatures=True)
BLIND = Variety(least_play=math.inf, temperatures=False)
SHAPES = [
    Shape(),
    Shape(trend=1),
    Shape(cells=3, axis=1),
    Shape(cells=5, axis=2, dead_band=8.0, saturation=95.0, play=0.7, trend=1),
]


def cells_of(valve, N=900, seed=0, sigma=0.0):
    """Points of a memory: weight, U, s, T, direction, Q."""
    rng = np.random.default_rng(seed)
    weight, direction = rng.integers(1, 20, N).astype(float), rng.choice([-1.0, 1.0], N)
    U, s, T = rng.uniform(0, 100, N), rng.uniform(0, 14, N), rng.uniform(20, 60, N)
    Q = valve(U, s, T, direction) + sigma * rng.normal(size=N) / np.sqrt(weight)
    return np.stack([weight, U, s, T, direction, Q], axis=1)


def columns(shape):
    plan = shape.plan(200.0)
    return plan.first, plan.last


def dense_rows(shape, points):
    _, U, s, T, direction, _ = points.T
    at = U - shape.play * direction
    warmth, root = (T - 40) / 20, s / 10
    beside = FiveTerms().regressors(at, s**2, T) / [1, 100, 10, 1000, 100]
    trend = np.stack([warmth * root, warmth * root * at / 100, warmth * root**2], axis=1)
    border = np.concatenate([beside, trend], axis=1)[:, slice(*columns(shape))]
    spline = shape.spline(200.0).regressors(at, s**2, T)
    return np.concatenate([spline, border], axis=1) if shape.cells else border


def dense_prior(shape):
    n, (first, last) = shape.size, columns(shape)
    prior = np.zeros((n + last - first, n + last - first))
    if n:
        rows = shape.spline(200.0).prior()[0]
        prior[:n, :n] = rows.T @ rows
    ridge = [map_fit.RIDGE] * n + [
        map_fit.BORDER_RIDGE if k < kernel.FIVE_TERMS else map_fit.TREND_RIDGE
        for k in range(first, last)
    ]
    return prior, prior + np.diag(ridge)


@pytest.mark.parametrize("shape", SHAPES, ids=Shape.describe)
def test_a_fit_is_weighted_least_squares_with_the_prior(shape):
    points = cells_of(lambda U, s, T, d: 0.1 * (U - d) * s + 0.01 * (T - 40) * s, sigma=1.0)
    got = fit(points, shape, 200.0)
    X, (prior, ridge) = dense_rows(shape, points), dense_prior(shape)
    w, Q = points[:, 0], points[:, 5]
    data = X.T @ (w[:, None] * X)
    inverse = np.linalg.inv(data + ridge)
    theta = inverse @ (X.T @ (w * Q))
    first, last = columns(shape)
    used = np.r_[0 : shape.size, shape.size + first : shape.size + last]
    np.testing.assert_allclose(X @ got.theta[used], X @ theta, atol=1e-8)
    assert got.rss == pytest.approx(np.sum(w * (Q - X @ theta) ** 2))
    assert got.penalty == pytest.approx(theta @ prior @ theta, abs=1e-6)
    assert got.n_effective == pytest.approx(np.trace(inverse @ data))
    knots = shape.spline(200.0).knots
    for i in range(0, 900, 100):
        at = points[i].copy()
        at[1] -= shape.play * at[4]
        h = kernel.spread(*knots, got.inverse, got.mixed, got.corner, at, np.empty((4, 4)))
        assert h == pytest.approx(X[i] @ inverse @ X[i], rel=1e-6)


@pytest.mark.parametrize("shape", SHAPES, ids=Shape.describe)
def test_the_coefficients_of_the_surface_are_the_fit(shape):
    points = cells_of(lambda U, s, T, d: 0.1 * (U - d) * s + 0.01 * (T - 40) * s)
    got = fit(points, shape, 200.0)
    first, last = columns(shape)
    used = np.r_[0 : shape.size, shape.size + first : shape.size + last]
    knots = shape.spline(200.0).knots
    coefficients = np.empty((*(len(k) - 4 for k in knots), 2))
    map_fit.coefficients(shape.plan(200.0), got.theta, coefficients)
    surface = [
        kernel.value(*knots, NODES_T, coefficients, U - shape.play * d, s, T, np.empty((4, 4)))
        for _, U, s, T, d, _ in points
    ]
    np.testing.assert_allclose(surface, dense_rows(shape, points) @ got.theta[used], atol=1e-9)


@pytest.mark.parametrize("shape", SHAPES, ids=Shape.describe)
def test_every_step_leads_to_another_shape_that_can_be_fitted(shape):
    points = cells_of(lambda U, s, T, d: 0.1 * U * s)
    around = shape.neighbours(ALL)
    assert len(set(around)) > 12
    assert shape not in around
    for neighbour in around:
        assert neighbour == Shape.from_array(neighbour.to_array())
        assert np.isfinite(criterion.bic(points, neighbour.to_array(), 200.0, 1.0))


def test_there_is_room_for_the_neighbours_of_every_shape():
    kinks = product((None, 8.0), (None, 90.0), (0.0, 1.5), (0, 1))
    shapes = [Shape(cells, axis, *rest) for cells, axis, rest in product((3, 8), (0, 1), kinks)]
    assert max(len(shape.neighbours(ALL)) for shape in shapes) <= ladder.MOST_NEIGHBOURS


def test_play_and_trend_are_tried_only_where_the_samples_can_tell():

    around = Shape(cells=3).neighbours(BLIND)
    assert {s.play for s in around} == {0.0}
    assert {s.trend for s in around} == {0}


def test_what_the_samples_can_tell_is_seen_in_the_memory():
    cells = np.zeros((20, 7), np.float32)
    cells[:, 0], cells[:, 3] = 5.0, 40.0
    from_above = slots_of(range(0, 40, 2))
    assert variety(held.shared(from_above, cells), held.points(cells)) == BLIND
    cells[::4, 3] = 50.0
    from_both_sides = slots_of([*range(0, 20, 2), *range(1, 20, 2)])
    assert variety(held.shared(from_both_sides, cells), held.points(cells)) == ALL


def slots_of(numbers):
    """A slot for each of these cells, one after another."""
    slots = np.zeros(grid.PLACES + grid.SLOTS, np.uint16)
    for slot, number in enumerate(numbers):
        place, cell = divmod(number, grid.CELLS_OF_A_PLACE)
        slots[grid.PLACES + slot] = (1 << (grid.SERVED + cell)) + slots[place]
        slots[place] = slot + 1
    return slots


@pytest.mark.parametrize(
    ("valve", "expected"),
    [
        (lambda U, s, T, d: 0.1 * U * s, "eq. (7)"),
        (lambda U, s, T, d: 0.1 * (U - d) * s, "eq. (7), hysteresis 2 %"),
        (
            lambda U, s, T, d: 0.1 * np.clip(U, 11, 95) * s - s,
            "spline, 2 x 3 cells, dead band 11 %, saturation 95 %",
        ),
        (lambda U, s, T, d: (0.1 * U + (T - 40) / 50) * s, "eq. (7), trend with temperature"),
    ],
    ids=["eq. (7)", "hysteresis", "kinks", "temperature"],
)
def test_the_climb_ends_at_the_shape_that_made_the_data(valve, expected):
    points = cells_of(valve, sigma=0.4)
    best = summit(points, Shape())
    for number in range(len(STARTS)):
        other = summit(points, fresh_start(number, best))
        best = other if is_better(points, other, best, 200.0) else best
    assert best.describe() == expected


def summit(points, shape):
    progress = np.zeros(2, np.int64)
    for _ in range(12):
        shape = climb(points, shape, 200.0, ALL, 100, progress)
    return shape


def test_bic_prefers_fewer_parameters_where_the_fit_is_the_same():
    points = cells_of(lambda U, s, T, d: 0.1 * U * s, sigma=0.4)
    assert is_better(points, Shape(), Shape(cells=6, axis=1), 200.0)
    assert not is_better(points, Shape(cells=6, axis=1), Shape(), 200.0)


def test_the_noise_is_what_the_richest_shape_leaves():
    points = cells_of(lambda U, s, T, d: 0.1 * np.maximum(U - 8, 0) * s, sigma=0.4)
    assert noise(points, Shape(dead_band=8.0, cells=2), 200.0) == pytest.approx(0.16, rel=0.15)


def test_the_axis_reaches_as_far_as_the_pressures_seen():
    assert [dp_top(x**0.5) for x in (0.0, 18.0, 199.0, 330.0, 1e6)] == [5, 20, 200, 350, 1000]


def test_the_largest_shape_fits_the_state():
    largest = Shape(8, 2, 8.0, 95.0, 0.0, 1)
    assert largest.size == len(fit(cells_of(lambda U, s, T, d: U), largest, 200.0).inverse)
    assert largest.size <= MOST
    assert all(shape.size <= MOST for shape in largest.neighbours(ALL))


def test_a_shape_knows_how_to_describe_itself():
    shape = replace(SHAPES[-1], play=0.2)
    assert shape.describe() == (
        "spline, 5 x 6 cells, dead band 8 %, saturation 95 %, hysteresis 0.4 %, "
        "trend with temperature"
    )


def test_eq_7_is_the_first_rung():
    points = cells_of(lambda U, s, T, d: 1 + 0.1 * U + 2 * s + 0.1 * U * s + 0.3 * s**2)
    theta = fit(points, Shape(), 200.0).theta[:5] / [1, 100, 10, 1000, 100]
    np.testing.assert_allclose(theta, [1, 0.1, 2, 0.1, 0.3], atol=1e-6)
    assert isinstance(FiveTerms(), Polynomial)


def test_a_kink_beyond_which_no_cell_lies_is_none():
    points = cells_of(lambda U, s, _T, _direction: 9 * np.tanh(U / 45) * s, sigma=0.4)
    points = points[(points[:, 1] > 3.0) & (points[:, 1] < 96.0)]
    for kinks in ({"dead_band": 3.0}, {"saturation": 96.0}):
        shape = Shape(8, 1, **kinks)
        assert criterion.bic(points, shape.to_array(), 200.0, 0.16) == np.inf
    seen = Shape(8, 1, dead_band=6.0, saturation=93.0)
    assert np.isfinite(criterion.bic(points, seen.to_array(), 200.0, 0.16))


def test_cells_of_less_than_a_sample_tell_no_kink_but_where_most_are_such():
    points = cells_of(lambda U, s, _T, _direction: 9 * np.tanh(U / 45) * s, sigma=0.4)
    beyond, kink = points[:, 1] < 6.0, Shape(8, 1, dead_band=6.0).to_array()
    assert np.isfinite(criterion.bic(points, kink, 200.0, 0.16))
    points[beyond, 0] = 0.1
    assert criterion.bic(points, kink, 200.0, 0.16) == np.inf
    points[:, 0] = 0.01
    assert np.isfinite(criterion.bic(points, kink, 200.0, 0.16))
