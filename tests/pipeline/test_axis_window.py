"""The window of a search: bounded in time and samples, each batch as cheap as the first."""

import numpy as np

from valvemap.model.axis import AxisSamples
from valvemap.pipeline.axis_window import AxisWindow


def batch(first, n):
    numbers = np.arange(first, first + n)
    return AxisSamples.of(10_000_000 * numbers, x=numbers.astype(float))


def test_the_newest_seconds_stay_however_they_are_cut():
    for n in (1, 7, 50):
        window = AxisWindow(20.0, 10_000)
        for first in range(0, 12_000, n):
            window.append(0.01 * n, batch(first, n))
        whole = window.whole()
        assert len(whole) == len(window)
        assert 2_000 - n <= len(whole) <= 2_000 + n
        assert np.diff(whole.x).tolist() == [1.0] * (len(whole) - 1)
        window.clear()
        assert len(window) == 0


def test_samples_that_come_quickly_are_bounded_by_their_number_and_the_newest_batch_stays():
    window = AxisWindow(20.0, 100)
    for first in range(0, 1_000, 10):
        window.append(0.001, batch(first, 10))
    assert len(window) == 100
    window.append(0.001, batch(1_000, 500))
    assert len(window) == 500


class Counted(AxisSamples):
    """Samples that count how often their length is asked for."""

    asked = 0

    def __len__(self):
        Counted.asked += 1
        return super().__len__()


def test_a_batch_costs_the_same_however_many_are_in_the_window():
    window, n = AxisWindow(1e9, 10**9), 3_000
    one = Counted(**vars(batch(0, 1)))
    for _ in range(n):
        window.append(0.01, one)
    assert Counted.asked <= 3 * n
