"""Dynamics of live valves: who gathers, and what is fitted when."""

import numpy as np

from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.valve_dynamics import AT_ONCE, DynamicsInTurn

WINDOW_S = 60.0


def a_second(valves, k, rate=100):
    """One second of samples of each valve, the k-th."""
    t = (k * rate + np.arange(rate)) * (10**9 // rate)
    one = Samples.of(t, t * 0.0, t * 0.0 + 100.0, t * 0.0, t * 0.0)
    n = np.arange(len(valves)) * rate
    segments = Segments(np.array(valves, np.int64), n, n + rate)
    return ByValve(Samples.concatenate([one] * len(valves)), segments)


def run(turns, valves, seconds, took_s=1.0, rate=100, begin=0):
    """Take samples second by second, do every fit at once; return who was fitted, and when."""
    fits, slow = [], []
    for k in range(begin, begin + seconds):
        slow += turns.take(a_second(valves, k, rate))
        due = turns.job(float(k + 1))
        if due is not None:
            fits.append((due[0], k + 1))
            turns.end(due[0], took_s, k + 1 + took_s)
    return fits, slow


def test_a_valve_is_fitted_once_a_minute_of_its_samples_is_there_and_again_after_a_rest():
    fits, slow = run(DynamicsInTurn(1, 0.1, WINDOW_S, 0.0), [0], 300, took_s=3.0)
    assert [valve for valve, _ in fits] == [0] * len(fits)
    assert WINDOW_S < fits[0][1] <= WINDOW_S + 10.0
    rests = np.diff([at for _, at in fits])
    assert np.all(rests >= 3.0 / 0.1 - 1.0)
    assert not slow


def test_fits_take_no_more_than_their_share_whatever_the_number_of_valves():
    fits, _ = run(
        DynamicsInTurn(3 * AT_ONCE, 0.1, WINDOW_S, 0.0), list(range(3 * AT_ONCE)), 2_000, took_s=2
    )
    assert 2.0 * len(fits) <= 0.11 * 2_000


def test_every_valve_has_its_turn_and_few_gather_at_once():
    turns, many = DynamicsInTurn(3 * AT_ONCE, 1.0, WINDOW_S, 0.0), list(range(3 * AT_ONCE))
    fits, _ = run(turns, many, 400, took_s=0.1)
    assert {valve for valve, _ in fits} == set(many)
    assert len(turns._gathered) <= AT_ONCE


def test_a_slow_valve_is_named_once_and_never_fitted():
    fits, slow = run(DynamicsInTurn(2, 0.1, WINDOW_S, 0.0), [1], 200, rate=10)
    assert not fits
    assert slow == [1]


def test_neither_a_busy_machine_nor_a_step_of_the_clock_makes_a_valve_slow():
    turns = DynamicsInTurn(1, 0.1, WINDOW_S, 0.0)
    slow = [name for k in (*range(100, 103), *range(80)) for name in turns.take(a_second([0], k))]
    assert not slow
    assert turns.job(1_000.0) is not None, "though its samples came late"


def test_no_second_fit_begins_while_one_runs():
    turns = DynamicsInTurn(1, 0.1, WINDOW_S, 0.0)
    for k in range(80):
        turns.take(a_second([0], k))
    assert turns.job(80.0) is not None
    assert turns.job(81.0) is None
