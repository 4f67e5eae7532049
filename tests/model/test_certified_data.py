"""Certified results, streamed one sample at a time: NIST StRD, R strucchange."""

from fractions import Fraction

import numpy as np
import pytest

from benchmarks import measured_data
from benchmarks.certified import digits, digits_of_std, digits_of_theta, strucchange_errors
from support.plain_qr import plain_qr_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import Polynomial
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples

SETS = ["norris", "pontius", "noint1", "longley", "wampler1", "wampler2", "wampler3"]


@pytest.fixture(scope="module")
def problems():
    return {problem.name: problem for problem in measured_data.nist_problems()}


def test_digits_count_from_the_worst_element_and_end_where_a_double_ends():
    exact = (Fraction(1, 3), Fraction(-2))
    assert digits(np.array([1 / 3, -2.002]), exact) == pytest.approx(3.0)
    assert digits(np.array([0.25, -2.0]), (Fraction(1, 4), Fraction(-2))) == 16.0
    assert digits(np.array([np.nan, -2.0]), exact) is None


def test_all_seven_sets_are_looked_at(problems):
    assert sorted(problems) == sorted(SETS)


@pytest.mark.parametrize("name", SETS)
def test_streamed_theta_is_within_one_digit_of_batch_qr(problems, name):
    problem = problems[name]
    streamed = digits(recursive_least_squares(problem.X, problem.y).theta, problem.theta)
    # Batch QR gains or loses a digit with the order of its rows: the median of nine counts.
    orders = [np.random.default_rng(k).permutation(len(problem.y)) for k in range(9)]
    batch = [plain_qr_least_squares(problem.X[rows], problem.y[rows]) for rows in orders]
    assert streamed >= np.median([digits(theta, problem.theta) for theta in batch]) - 1.0
    assert streamed > 9.0


@pytest.mark.parametrize("name", ["norris", "pontius", "noint1", "longley", "wampler3"])
def test_standard_deviations_have_twelve_digits(problems, name):
    assert digits_of_std(problems[name]) > 12.0


def test_every_step_is_that_of_r_strucchange():
    errors = strucchange_errors(measured_data.strucchange())
    assert errors["theta, valvemap against R"] < 1e-9
    assert errors["residual, valvemap against R"] < 1e-9


def test_against_rational_arithmetic_it_is_closer_than_r():
    errors = strucchange_errors(measured_data.strucchange())
    assert errors["theta, valvemap"] < 1e-10
    assert errors["residual, valvemap"] < 1e-11
    assert errors["theta, valvemap"] < errors["theta, R"]


def test_a_state_that_is_carried_from_sample_to_sample_loses_no_digit(problems):
    # Wampler 3 as a map: U = 0 … 20, one call per sample, the state through bytes each time.
    problem = problems["wampler3"]
    rls = RecursiveLeastSquares(structure=Polynomial(("1", "U", "U^2", "U^3", "U^4", "U^5")))
    state = rls.initial_state()
    for t, (x, y) in enumerate(zip(problem.X[:, 1], problem.y, strict=True)):
        sample = Samples.of([t], [x], [1.0], [0.0], [y])
        state, _ = rls.update(state, sample)
        state = type(state).from_bytes(state.to_bytes("k"), "k")
    assert digits(state.theta, problem.theta) == digits_of_theta(problem, ())["valvemap"]
