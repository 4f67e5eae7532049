"""Filters, and noise of U and Δp that they average out: that alone is no evidence for a filter."""

import numpy as np
import pytest

from valvemap.model.flow_evidence import Evidence
from valvemap.model.kernels import flow_between as between
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels.flow_basis import axis

HZ, N = 100.0, 1280
BOTH = axis(np.linspace(0.0, 100.0, 11)), axis(np.linspace(0.0, np.sqrt(200.0), 9))
NONE = np.zeros(paths.PARAMETERS)


def rows_at_work(seed, *, of_U=0.0, of_dp=0.2, kept=0.0, rounded=0.0):
    """Rows of a plain valve in 13 s of work; noise as given, that of the flow 0.4 l/min.

    ``kept``: of the flow's noise, from row to row; ``rounded``: step of U and Δp, % and bar.
    """
    rng = np.random.default_rng(seed)
    knots = np.arange(0.0, N, 40.0)
    U, dp = (
        np.interp(np.arange(N), knots, rng.uniform(low, high, len(knots)))
        for low, high in ((5.0, 95.0), (20.0, 180.0))
    )
    noise, white = np.empty(N), np.sqrt(1.0 - kept**2) * 0.4 * rng.standard_normal(N)
    for i in range(N):
        noise[i] = white[i] + (kept * noise[i - 1] if i else 0.0)
    Q = 0.12 * np.maximum(U - 5.0, 0.0) * np.sqrt(dp) + noise
    U, dp = U + of_U * rng.standard_normal(N), dp + of_dp * rng.standard_normal(N)
    rows = np.zeros((N, paths.COLUMNS))
    rows[:, paths.STEP] = 1.0 / HZ
    if rounded:
        U, dp = rounded * np.round(U / rounded), rounded * np.round(dp / rounded)
    rows[:, paths.LEFT_U], rows[:, paths.LEFT_DP], rows[:, paths.LEFT_P1] = U, dp, dp
    rows[:, paths.LEFT_Q] = Q
    return rows


def gain(name, value, **noises):
    """Mean log likelihood ratio, over eight valves, of a filter that none of them has."""
    with_it = NONE.copy()
    with_it[getattr(paths, name)] = value
    found = []
    for seed in range(8):
        evidence = Evidence(*BOTH, rows_at_work(seed, **noises))
        found.append(evidence.gain(with_it, NONE))
    return float(np.mean(found))


@pytest.mark.parametrize(("name", "value"), [("LAG_Q", 0.004), ("AVERAGE", 0.02)])
def test_a_meter_that_would_average_the_noise_of_the_pressures_gains_nothing(name, value):
    """Also where most of the flow's noise is slow, in which what is averaged counts more."""
    assert gain(name, value, of_dp=0.8) < 1.0
    assert gain(name, value, of_dp=0.8, kept=0.9) < 1.0


@pytest.mark.parametrize(("name", "value"), [("PLAY", 0.4), ("LAG_U", 0.004), ("LAG_Q", 0.004)])
def test_what_keeps_the_noise_of_U_from_the_spool_gains_nothing(name, value):
    assert gain(name, value, of_U=0.25) < 1.0
    assert gain(name, value, of_U=0.25, kept=0.9) < 1.0


def test_rounding_is_noise_as_well():
    assert gain("LAG_Q", 0.004, of_dp=0.0, rounded=0.4) < 1.0


def test_a_rounded_signal_is_told_from_one_that_moves_in_steps():
    x = 0.25 * np.random.default_rng(0).integers(0, 400, 500)
    assert between.rounded_to.py_func(x) == pytest.approx(0.25)
    assert (
        between.rounded_to.py_func(np.interp(np.arange(500), np.arange(0, 500, 40), x[:13])) == 0.0
    )
    assert between.rounded_to.py_func(np.full(9, 3.0)) == 0.0


def test_a_command_that_goes_on_by_equal_steps_is_not_rounded():
    """Its steps of 2 % are its own: a play behind it is no filter of their noise."""
    rng, spool, at = np.random.default_rng(3), np.empty(N), 0.0
    U = np.repeat(2.0 * np.abs(np.arange(N // 4) % 100 - 50.0), 4)
    dp = 100.0 + 80.0 * np.sin(np.arange(N) / 37.0)
    for i in range(N):
        at = spool[i] = min(max(at, U[i] - 2.0), U[i] + 2.0)
    rows = np.zeros((N, paths.COLUMNS))
    rows[:, paths.STEP], rows[:, paths.LEFT_U] = 1.0 / HZ, U
    rows[:, paths.LEFT_DP] = rows[:, paths.LEFT_P1] = dp + 0.07 * rng.standard_normal(N)
    rows[:, paths.LEFT_Q] = 0.12 * np.maximum(spool - 5.0, 0.0) * np.sqrt(dp)
    rows[:, paths.LEFT_Q] += 0.4 * rng.standard_normal(N)
    with_play, later = NONE.copy(), NONE.copy()
    with_play[paths.PLAY], later[paths.DEAD_U] = 2.0, 0.04
    evidence = Evidence(*BOTH, rows)
    assert evidence.gain(with_play, NONE) > 200.0
    assert evidence.gain(with_play, later) > 5.0
