"""The loop that updates the alarms of many valves, sample by sample.

Times are source times, UTC ns; nothing depends on how the samples were cut into batches.
"""

import numpy as np

from valvemap.model.kernels.compiled import inlined, lean_kernel
from valvemap.model.kernels.prefetch import fetch
from valvemap.model.samples import Flags, Floats, Segments
from valvemap.pipeline.kernels.alarm_layout import (
    EXCITED,
    NEVER,
    NEWEST,
    SENSOR_FROZEN,
    SENSOR_LOST,
    T_USUAL,
    UNEXCITED,
    USABLE,
    Conditions,
    Senses,
    Watched,
)
from valvemap.pipeline.kernels.alarm_residuals import look_at_residual
from valvemap.pipeline.kernels.alarm_steps import step
from valvemap.vocabulary.signals import COUNT, IS_OPTIONAL, Signal

STILL_TIMES = 10.0  # times its longest standstill, after which a signal is frozen
ENOUGH_MOVES = 100  # changes of a signal, and of the others since, before it can be frozen
PAUSE_NS = 2_000_000_000  # a longer gap between samples restarts the standstills
OIL_MEMORY_S = 1_800.0  # s; time constant of the oil's usual temperature

_U, _T = int(Signal.U), int(Signal.T)


@lean_kernel
def watch(
    seen: Watched,
    patient: Flags,
    rules: Floats,
    conditions: Conditions,
    senses: Senses,
    segments: Segments,
    Q_span: float,
    shares: Floats,
) -> None:
    """Update the alarms with N samples.

    Parameters
    ----------
    Q_span
        Range of the flow, l/min.
    shares : (CAUSES,)
        Scratch array.
    patient : (M,)
        Mask of the valves with on-change signals: their silence is no loss.
    rules : (A, 3)
        Limit, limit less hysteresis, delay (ns).
    """
    for s in range(len(segments.members)):
        m = segments.members[s]
        if s + 1 < len(segments.members):
            fetch(conditions, segments.members[s + 1])
            fetch(senses, segments.members[s + 1])
        for i in range(segments.starts[s], segments.stops[s]):
            before = senses.times[m, NEWEST]
            _keep_time(m, seen.t[i], seen.values[i, _T], conditions, senses)
            if patient[m] and senses.times[m, USABLE] == before:
                senses.times[m, USABLE] = seen.t[i]
            _look_for_losses(m, i, seen, rules, conditions, senses)
            _look_for_standstills(m, i, seen, rules, conditions, senses)
            _look_at_excitation(m, i, seen, rules, conditions, senses)
            look_at_residual(m, i, seen, rules, conditions, senses, Q_span, shares)


@inlined
def _keep_time(m: int, t: int, T: float, conditions: Conditions, senses: Senses) -> None:
    """Restart timers after a clock step back or an outage; update the usual oil temperature."""
    times, newest, memory = senses.times[m], senses.times[m, NEWEST], senses.memory[m]
    first, back = newest == NEVER, t < newest
    if np.isfinite(T):
        known = np.isfinite(memory[T_USUAL]) and not (first or back)
        share = min((t - newest) * 1e-9 / OIL_MEMORY_S, 1.0) if known else 1.0
        memory[T_USUAL] = memory[T_USUAL] + share * (T - memory[T_USUAL]) if known else T
    if first or back:
        times[USABLE] = t
        if back or times[EXCITED] == NEVER:
            times[EXCITED] = t
        for a in range(conditions.over.shape[1]):
            if not conditions.active[m, a]:
                conditions.over[m, a] = 0
    if first or back or t - newest > PAUSE_NS:
        senses.still[m, :] = t
        senses.others[m, :] = 0
    times[NEWEST] = t


@inlined
def _look_for_losses(
    m: int, i: int, seen: Watched, rules: Floats, conditions: Conditions, senses: Senses
) -> None:
    """Judge the time without a usable sample, s; a usable sample ends it."""
    t, usable = seen.t[i], senses.times[m, USABLE]
    step(m, SENSOR_LOST, t, usable, (t - usable) * 1e-9, rules, conditions)
    if seen.quality[i] != 2:
        senses.times[m, USABLE] = t
        step(m, SENSOR_LOST, t, t, 0.0, rules, conditions)


@inlined
def _look_for_standstills(
    m: int, i: int, seen: Watched, rules: Floats, conditions: Conditions, senses: Senses
) -> None:
    """Judge how long a sensor's value has been bitwise constant while others moved, s.

    The limit is relative to the signal's own longest standstill, so that a signal that often rests
    is not called frozen. U is a command and is exempt; so is a value of 0, as of a meter without
    flow.
    """
    t = seen.t[i]
    values = seen.values[i]
    last, still = senses.last[m], senses.still[m]
    was_dead = conditions.active[m, SENSOR_FROZEN]
    moved = 0
    for j in range(COUNT):
        if values[j] == last[j]:
            continue
        if np.isnan(values[j]):  # a sensor without values is lost, not frozen
            still[j] = t
            continue
        stood = t - still[j]
        if stood > senses.longest[m, j] and not (was_dead and conditions.detail[m, 4, 0] == j):
            senses.longest[m, j] = stood
        last[j] = values[j]
        still[j] = t
        senses.moves[m, j] += 1
        senses.others[m, j] = 0
        moved += 1 if j != _U and not IS_OPTIONAL[j] else 0
    longest, dead = 0.0, 0
    for j in range(1, COUNT):
        if still[j] == t:
            continue
        senses.others[m, j] += moved > 0
        stood = t - still[j]
        own = STILL_TIMES * senses.longest[m, j]
        enough = min(senses.moves[m, j], senses.others[m, j]) >= ENOUGH_MOVES
        if enough and last[j] != 0.0 and stood > own and stood * 1e-9 > longest:
            longest, dead = stood * 1e-9, j
    if step(m, SENSOR_FROZEN, t, still[dead] if dead else t, longest, rules, conditions):
        conditions.detail[m, SENSOR_FROZEN, 0] = dead


@inlined
def _look_at_excitation(
    m: int, i: int, seen: Watched, rules: Floats, conditions: Conditions, senses: Senses
) -> None:
    """Judge the time without excitation, s; rejected samples are ignored."""
    t, times = seen.t[i], senses.times[m]
    if seen.status[i] != 2:  # Status.UNEXCITED
        times[EXCITED] = t
    held = (t - times[EXCITED]) * 1e-9
    step(m, UNEXCITED, t, times[EXCITED], held, rules, conditions)
