"""Signals that are published more rarely than others, and commands that only look so."""

from dataclasses import fields

import numpy as np
import pytest

from benchmarks import circumstances as c
from benchmarks.one_model_rows import averaged, held, lagging, late
from valvemap.model import flow_causes, flow_evidence
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_map_state import axes
from valvemap.model.flow_rivals import Rivals, none
from valvemap.model.kernels import flow_evidence as kernel
from valvemap.model.kernels import flow_memory
from valvemap.model.kernels import flow_path as paths
from valvemap.model.samples import Samples

BOTH = axes((0.0, 100.0), (0.0, 200.0))
VALVE = c.VALVES["ordinary"]


def rows_of(U, dp, Q):
    rows = np.zeros((len(U), paths.COLUMNS))
    rows[:, paths.STEP] = 1.0 / c.FS
    rows[:, paths.LEFT_U], rows[:, paths.LEFT_DP], rows[:, paths.LEFT_P1] = U, dp, dp
    rows[:, paths.LEFT_Q] = Q
    return rows


def searched(how, seed=5, N=1280):
    U, dp = c.cycle(seed, N)
    evidence = flow_evidence.Evidence(*BOTH, rows_of(*how(U, dp, c.white(seed, N))))
    start = np.zeros(paths.PARAMETERS)
    at, _ = flow_causes.search(evidence, start, Rivals(none(), start))
    return {int(k): float(at[k]) for k in np.flatnonzero(at)}


U, P, Q = paths.HELD_U, paths.HELD_P, paths.HELD_Q
HELD = {
    "U": (lambda U, dp, e: (held(U, 10), dp, VALVE(U, dp) + e), {U: 0.1}),
    "p": (lambda U, dp, e: (U, held(dp, 5), VALVE(U, dp) + e), {P: 0.05}),
    "U and p": (lambda U, dp, e: (held(U, 7), held(dp, 10), VALVE(U, dp) + e), {U: 0.07, P: 0.1}),
    "Q": (lambda U, dp, e: (U, dp, held(VALVE(U, dp) + e, 10)), {Q: 0.1}),
    "U behind a dead time": (
        lambda U, dp, e: (held(U, 10), dp, VALVE(late(U, 15), dp) + e),
        {U: 0.1, paths.DEAD_U: 0.15},
    ),
    "U before an average": (
        lambda U, dp, e: (held(U, 10), dp, averaged(VALVE(U, dp), 40) + e),
        {U: 0.1, paths.AVERAGE: 0.4},
    ),
}
COMMANDS = {
    "steps": (lambda U, dp, e: (held(U, 10), dp, VALVE(held(U, 10), dp) + e), {}),
    "steps and a lag": (
        lambda U, dp, e: (held(U, 10), dp, VALVE(lagging(held(U, 10), 0.05), dp) + e),
        {paths.LAG_U: 0.05},
    ),
    "levels": (lambda U, dp, e: (held(U, 40), dp, VALVE(held(U, 40), dp) + e), {}),
    "neither": (lambda U, dp, e: (U, dp, VALVE(U, dp) + e), {}),
}


LONGER = pytest.mark.soak  # a search each
SOME = "U and p", "steps and a lag", "neither"


def each(names):
    return [pytest.param(name, marks=() if name in SOME else LONGER) for name in names]


@pytest.mark.parametrize("name", each(HELD))
def test_a_signal_that_is_held_is_found_with_its_period(name):
    how, wanted = HELD[name]
    assert searched(how) == pytest.approx(wanted, rel=0.07, abs=0.004)


@pytest.mark.parametrize("name", each(COMMANDS))
def test_a_command_that_moves_in_steps_is_not_held(name):
    how, wanted = COMMANDS[name]
    assert searched(how) == pytest.approx(wanted, rel=0.07, abs=0.004)


def joined(x, period):
    rows = rows_of(np.array(x, float), *np.zeros((2, len(x))))
    out = rows.copy()
    given = np.zeros(paths.PARAMETERS)
    given[paths.HELD_U] = period
    kernel.as_they_were(rows, given, out)
    return out[:, paths.LEFT_U]


def test_between_two_values_a_signal_is_on_its_way():
    assert joined([0, 0, 4, 4, 8, 8, 8, 8], 0.02) == pytest.approx([0, 2, 4, 6, 8, 8, 8, 8])
    assert joined([0, 0, 4, 4, 4, 7, 7], 0.02) == pytest.approx([0, 2, 4, 5, 6, 7, 7])


def test_a_signal_that_rests_begins_to_move_a_period_before_its_next_value():
    assert joined([0, 0, 0, 0, 0, 0, 4], 0.02) == pytest.approx([0, 0, 0, 0, 0, 2, 4])


def test_what_is_not_held_is_as_it_is():
    assert joined([0, 1, 1, 3], 0.0) == pytest.approx([0, 1, 1, 3])


def after(state, samples, cuts=()):
    for begin, end in zip((0, *cuts), (*cuts, len(samples)), strict=True):
        state, trace = FlowMap().update(state, samples[begin:end])
    return state, trace


@pytest.fixture(scope="module")
def waiting():
    """A state in which samples wait for U and p, and the samples that come next."""
    U, dp = c.cycle(7, 2_500)
    samples = c.samples_of(held(U, 7), held(dp, 10), VALVE(U, dp) + c.white(7, 2_500))
    state, _ = after(FlowMap().initial_state(), samples[:1_500])
    return state, samples[1_500:]


def test_the_map_behind_held_signals_is_that_of_the_valve_however_samples_are_cut(waiting):
    whole, trace = after(*waiting)
    near = c.inside(waiting[1].U, waiting[1].dp)
    Q, _ = FlowMap().predict(whole, near.U, near.dp, np.full(len(near.U), 40.0))
    assert np.sqrt(np.mean((Q - VALVE(near.U, near.dp)) ** 2)) < 0.6 * c.SIGMA
    assert FlowMap().findings(whole) == ()
    assert "U comes every 0.07 s; pressures come every 0.1 s" in FlowMap().describe(whole)
    assert np.isfinite(trace.predicted).all()
    pieces, _ = after(*waiting, cuts=(1, 7, 8, 500, 548, 900))
    for field in fields(whole):
        np.testing.assert_array_equal(getattr(pieces, field.name), getattr(whole, field.name))


def test_a_stretch_without_samples_ends_what_waits(waiting):
    state, samples = waiting
    seen, learnt = (state.counters[k] for k in (flow_memory.ROWS_SEEN, flow_memory.LEARNT))
    assert 5 < seen - learnt < 20
    later = Samples.of(samples.t + 10**12, samples.U, samples.p1, samples.p2, samples.Q)
    state, _ = after(state, later[:1])
    assert state.counters[flow_memory.LEARNT] == seen
    state, _ = after(state, later[1:])
    assert FlowMap().findings(state) == ()
