"""A spool that moves by so much per sample at most."""

import math

import numpy as np
import pytest

from valvemap.model.kernels.axis_spool import limited


def of(U, most):
    x = np.empty(len(U))
    limited(np.array(U), most, x)
    return x.tolist()


def by_hand(U, most):
    x = list(U)
    for k in range(1, len(x)):
        if abs(x[k] - x[k - 1]) > most:
            x[k] = x[k - 1] + math.copysign(most, x[k] - x[k - 1])
    return x


def test_a_step_is_followed_by_so_much_per_sample():
    assert of([0.0, 10.0, 10.0, 10.0, -2.0], 4.0) == [0.0, 4.0, 8.0, 10.0, 6.0]


def test_a_spool_that_is_quick_enough_is_where_U_is():
    assert of([0.0, 3.0, -3.0], 6.0) == [0.0, 3.0, -3.0]


@pytest.mark.parametrize("most", [0.7, 4.0, 16.0])
def test_it_has_the_bits_of_the_sum_sample_by_sample(most):
    U = np.random.default_rng(1).normal(0.0, 5.0, 500).cumsum()
    U[100:103] = np.nan
    np.testing.assert_array_equal(of(U, most), by_hand(U.tolist(), most))
