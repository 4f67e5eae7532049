"""The benchmark's spool and meter are the differential equations, not their steps of 10 µs."""

import math

import numpy as np
import pytest

from benchmarks.dynamics import FINE_HZ, NEVER, metered, spool_of

h = 1.0 / FINE_HZ


@pytest.mark.parametrize(("f", "zeta"), [(8.0, 0.5), (60.0, 0.95)])
def test_a_step_is_the_closed_form(f, zeta):
    t, w = h * np.arange(1, 5_001), 2.0 * math.pi * f
    x = spool_of(np.concatenate([[0.0], np.full(5_000, 100.0)]), f, zeta, NEVER, h)[1:]
    swing = math.sqrt(1.0 - zeta**2)
    wave = np.cos(w * swing * t) + zeta / swing * np.sin(w * swing * t)
    assert x == pytest.approx(100.0 * (1.0 - np.exp(-zeta * w * t) * wave), abs=1e-8)


def test_a_limited_spool_moves_as_in_steps_of_a_tenth():
    U = np.concatenate([[0.0], np.full(3_000, 100.0)])
    fine = spool_of(np.concatenate([[0.0], np.repeat(U[1:], 10)]), 30.0, 0.7, 4_000.0, h / 10)
    x = spool_of(U, 30.0, 0.7, 4_000.0, h)
    assert x[1:] == pytest.approx(fine[10::10], abs=0.003)  # % of 4 % that it moves in 1 ms


def test_a_ramp_is_shown_later_by_the_meters_lag():
    lag, t = 0.02, h * np.arange(1, 50_001)  # at the ends of steps
    shown = metered(100.0 * t, lag, 100)
    at = 1e-3 * np.arange(500)
    late = at[400:] - shown[400:] / 100.0
    assert late == pytest.approx(lag, abs=1e-7)
