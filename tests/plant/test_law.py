"""The lag of a flow meter in the orifice law, against the convolution that it stands for."""

import numpy as np
import pytest

from valvemap.plant.law import _lagged


@pytest.mark.parametrize("rows", [20, 61, 400])
@pytest.mark.parametrize("steps", [0.3, 0.6, 1.0, 5.0, 20.0, 100.0])
def test_a_lag_is_the_convolution_with_a_response_of_six_time_constants(rows, steps):
    columns = np.random.default_rng(1).normal(size=(rows, 3)).cumsum(axis=0)
    decay = np.exp(-1.0 / steps)
    response = (1.0 - decay) * decay ** np.arange(int(np.ceil(6.0 * steps)))
    moves = columns - columns[0]
    expected = [np.convolve(column, response)[:rows] for column in moves.T]
    found = _lagged(columns, steps)
    np.testing.assert_allclose(found, np.stack(expected, axis=1) + columns[0], atol=1e-12)


def test_a_lag_that_is_shorter_than_the_steps_is_none():
    columns = np.arange(12.0).reshape(6, 2)
    assert _lagged(columns, 0.29) is columns
