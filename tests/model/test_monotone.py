"""Least squares under ∂Q/∂U >= 0."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from valvemap.model.inverse_map import invert
from valvemap.model.model_structures import FiveTerms, Polynomial
from valvemap.model.monotone import Monotone, monotone_rows, nearest
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline
from valvemap.vocabulary.statuses import InverseStatus


def dead_band(U, dp):
    return np.maximum(U - 30.0, 0.0) * np.sqrt(dp) / 7


def learnt(structure, valve=dead_band, N=1500, sigma=0.4):
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, N), rng.uniform(0, 200, N)
    Q = valve(U, dp) + sigma * rng.normal(size=N)
    rising = Monotone(RecursiveLeastSquares(structure=structure))
    state, _ = rising.update(rising.initial_state(), Samples.of(np.arange(N), U, dp, 0 * dp, Q))
    return rising, state


@pytest.mark.parametrize(
    ("structure", "between_the_grid"),
    [(TensorSpline.uniform(6, 4), 1e-9), (Polynomial.of_order(4), 0.15)],
)
def test_the_map_rises_everywhere_where_the_free_one_falls_somewhere(structure, between_the_grid):
    rising, state = learnt(structure)
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(0, 100, 41), np.linspace(1, 200, 21)))
    T = np.full_like(U, 40.0)
    Q = rising.predict(state, U, dp, T)[0].reshape(21, 41)
    free = rising.estimator.predict(state, U, dp, T)[0].reshape(21, 41)
    assert np.diff(free, axis=1).min() < -0.15
    assert np.diff(Q, axis=1).min() >= -between_the_grid


def test_under_much_noise_the_constraint_helps():
    def valve(U, dp):
        return 0.01 * U * np.sqrt(dp)

    rising, state = learnt(TensorSpline.uniform(6, 4), valve, sigma=5.0)
    rng = np.random.default_rng(1)
    at = rng.uniform(0, 100, 500), rng.uniform(0, 200, 500), np.full(500, 40.0)
    errors = [
        np.mean((estimator.predict(state, *at)[0] - valve(*at[:2])) ** 2)
        for estimator in (rising, rising.estimator)
    ]
    assert errors[0] < 0.8 * errors[1]


def test_where_the_free_map_rises_the_constraint_changes_nothing():
    rising, state = learnt(FiveTerms(), lambda U, dp: 0.5 * U + 0.1 * U * np.sqrt(dp))
    assert np.array_equal(rising.parameters(state)[0], rising.estimator.parameters(state)[0])


def test_its_inverse_finds_an_answer_where_the_free_map_falls():
    rising, state = learnt(TensorSpline.uniform(6, 4))
    dp = np.linspace(20.0, 200.0, 50)
    Q = rising.predict(state, np.full(50, 55.0), dp, np.full(50, 40.0))[0]
    answer = invert(rising, state, Q, dp, 40.0)
    assert (answer.status == InverseStatus.OK).all()
    np.testing.assert_allclose(answer.U, 55.0, atol=1e-6)


def test_before_the_parameters_are_known_nothing_is_said():
    rising = Monotone(RecursiveLeastSquares())
    Q, _ = rising.predict(rising.initial_state(), np.zeros(1), np.ones(1), np.ones(1))
    assert np.isnan(Q).all()


@given(theta=arrays(float, 6, elements=st.floats(-5, 5)), seed=st.integers(0, 99))
def test_the_nearest_point_obeys_and_no_other_that_obeys_is_nearer(theta, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) + 2 * np.eye(6)
    P = root @ root.T
    D = np.diff(np.eye(6), axis=0)
    x = nearest(theta, P, D)
    assert (D @ x >= -1e-6).all()

    def distance(y):
        return (y - theta) @ np.linalg.solve(P, y - theta)

    for _ in range(20):
        other = np.sort(x + 0.1 * rng.normal(size=6))
        assert distance(x) <= distance(other) + 1e-6


def test_the_rows_of_a_spline_with_temperature_step_along_U_alone():
    structure = TensorSpline((0, 50, 100), (0, 14), (20, 60), at_rest="zero")
    D = monotone_rows(structure)
    sites_U, sites_s = structure.sites
    plane = np.kron(np.outer(sites_U, np.ones(len(sites_s))).ravel(), np.ones(2))
    assert (D @ plane > 0).all()
    assert D.shape == (4 * 3 * 2, 5 * 3 * 2)
