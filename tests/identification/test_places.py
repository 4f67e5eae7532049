"""The memory of places."""

import numpy as np

from service.identification.kernels import places
from service.identification.kernels.row_layout import CLOCK, PLACES_OF_DETECTOR


def test_the_clock_of_places_stands_while_the_valve_rests():
    s, g = np.zeros(PLACES_OF_DETECTOR), 0
    for count in range(0, 1_000_000, 8):
        places.tick.py_func(s, g, 3.0, 4.0, float(count))
    assert s[CLOCK] == places.REST
    for count in range(1_000_000, 1_008_000, 8):
        places.tick.py_func(s, g, 3.0 + 1e-4 * (count - 1_000_000), 4.0, float(count))
    assert 7_400 <= s[CLOCK] - places.REST <= 8_000
