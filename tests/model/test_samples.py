"""What is given as samples becomes columns that kernels take as they are."""

import numpy as np
import pytest

from valvemap.model.axis import AxisSamples
from valvemap.model.samples import Samples

N = 5


def read_only():
    """A column as data frames and ``np.broadcast_to`` give it."""
    return np.broadcast_to(40.0, N)


@pytest.mark.parametrize("given", [read_only(), np.arange(2.0 * N)[::2], [1] * N])
def test_every_column_is_contiguous_and_may_be_written(given):
    samples = Samples.of(np.arange(N), given, given, given, given, given, read_only())
    of_axis = AxisSamples.of(np.arange(N), U=given, x=given, T=given)
    for column in (*vars(samples).values(), *vars(of_axis).values()):
        assert column.flags.c_contiguous
        assert column.flags.writeable
    assert samples.U.tolist() == of_axis.x.tolist() == list(given)


def test_a_column_that_fits_is_not_copied():
    U = np.arange(float(N))
    assert Samples.of(np.arange(N), U, U, U, U).U is U
