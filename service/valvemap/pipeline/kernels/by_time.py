"""Samples in the order of their time, for sources without running number."""

import numpy as np

from valvemap.pipeline.kernels.compiled import inlined, inner
from valvemap.pipeline.kernels.waiting import (
    CLOCK_STEPS,
    DUPLICATES,
    FILLED,
    HIGH,
    LAST_TIME,
    LATE,
    MISSING,
    NEVER,
    SEEN,
    SET_BACK,
    SET_FORWARD,
    SETTLE,
    SIGNALS,
    SIZE,
    TIME,
    TIMES_KEPT,
    ZERO,
    Aligned,
    Rules,
    Waiting,
    emit,
    find,
    keep_pace,
    move,
    open_slot,
)


@inlined
def place_by_time(
    w: Waiting, v: int, j: int, time: int, value: float, status: int, rules: Rules
) -> int:
    """Add a change to its sample; return the slot of the sample that it completes, or -1."""
    order, seen = w.order[v], w.order[v, SEEN + j]
    if time == seen or _has_left(w, v, time, rules.tolerance):
        w.counters[v, DUPLICATES] += 1
        return -1
    if seen != NEVER and time < seen - rules.max_wait:
        _begin_anew(w, v)
    order[SEEN + j] = max(order[SEEN + j], time)
    if rules.hold[v, j] > 0:
        if time >= w.held_time[v, j]:
            w.held_value[v, j], w.held_status[v, j] = value, status
            w.held_time[v, j] = time
        return -1
    started = order[HIGH] != NEVER  # nothing is missing before the first sample
    if started and time <= order[HIGH]:
        w.counters[v, LATE] += 1
        return -1
    k = find(w.slots[v], order[SIZE], time - rules.tolerance)
    if k == order[SIZE] or w.slots[v, k, TIME] > time + rules.tolerance:
        if order[SIZE] == w.slots.shape[1]:
            w.counters[v, MISSING] += started
            if k == 0:  # the new sample is the oldest
                return -1
            _drop(w, v, 1)
            k -= 1
        open_slot(w, v, k, time)
    elif w.slots[v, k, FILLED] & (1 << j):
        w.counters[v, DUPLICATES] += 1
        return -1
    w.values[v, k, j], w.status[v, k, j] = value, status
    w.slots[v, k, FILLED] |= 1 << j
    return k if w.slots[v, k, FILLED] == rules.required[v] else -1


@inlined
def leave_by_time(
    w: Waiting,
    v: int,
    complete: int,
    command: int,
    rules: Rules,
    out: Aligned,
    n: int,
) -> int:
    """Emit complete samples, oldest first, and carry out a command; return the number in ``out``.

    SETTLE: those that are due. FLUSH, BEGIN_ANEW and SET_BACK: all of them. SET_BACK and
    SET_FORWARD: the source's clock was set, so the next step between samples is no loss.

    Incomplete samples before them are dropped if overdue; otherwise emission stops there.
    ``complete`` is the slot of a complete sample; -1: search for the newest.
    """
    order, reorder = w.order[v], rules.reorder[v] if command == SETTLE else 0
    if command == SET_FORWARD:
        order[LAST_TIME] = NEVER
        w.counters[v, CLOCK_STEPS] += 1
        return n
    if complete < 0:
        for k in range(order[SIZE]):
            if w.slots[v, k, FILLED] == rules.required[v]:
                complete = k
        if complete < 0 and command != SET_BACK:
            return n
    newest = w.slots[v, max(complete, 0), TIME]
    started = order[HIGH] != NEVER
    done = ZERO
    while complete >= 0 and done < order[SIZE]:
        time = w.slots[v, done, TIME]
        if w.slots[v, done, FILLED] == rules.required[v]:
            if reorder > 0 and time > newest - reorder:
                break
            n = emit(w, v, done, rules, out, n)
            keep_pace(order, w.counters[v], time, ZERO)
            order[LAST_TIME] = time
            w.left[v, order[TIMES_KEPT] % w.left.shape[1]] = time
            order[TIMES_KEPT] += 1
        elif time < newest - rules.max_wait or _hopeless(w, v, done, rules):
            w.counters[v, MISSING] += started
        else:
            break
        done += 1
    if done > 0:
        _drop(w, v, done)
    if command == SET_BACK:
        _begin_anew(w, v)
    return n


@inlined
def _drop(w: Waiting, v: int, count: int) -> None:
    """Remove the ``count`` oldest slots."""
    w.order[v, HIGH] = w.slots[v, count - 1, TIME]
    for n in range(count, w.order[v, SIZE]):
        move(w, v, n, n - count)
    w.order[v, SIZE] -= count


@inner
def _begin_anew(w: Waiting, v: int) -> None:
    """Drop pending samples after a backward step of the source's clock: they stay incomplete."""
    order = w.order[v]
    w.counters[v, CLOCK_STEPS] += 1
    w.counters[v, MISSING] += order[SIZE]
    order[SIZE] = order[TIMES_KEPT] = 0
    order[HIGH] = order[LAST_TIME] = NEVER
    for k in range(SIGNALS):
        order[SEEN + k] = NEVER


@inner
def _hopeless(w: Waiting, v: int, k: int, rules: Rules) -> bool:
    """Whether each signal that slot ``k`` lacks has sent a value newer by ``reorder``."""
    limit = w.slots[v, k, TIME] + rules.tolerance + rules.reorder[v]
    for m in range(SIGNALS):
        lacks = rules.required[v] & ~w.slots[v, k, FILLED] & (1 << m)
        if lacks and w.order[v, SEEN + m] <= limit:
            return False
    return True


@inlined
def _has_left(w: Waiting, v: int, time: int, tolerance: int) -> bool:
    """Whether a sample of that time is among the last emitted ones, whose times ascend."""
    if time - tolerance > w.order[v, LAST_TIME]:
        return False
    high, room = w.order[v, TIMES_KEPT], w.left.shape[1]
    if high == 0 or time - tolerance > w.left[v, (high - 1) % room]:
        return False
    low = max(np.int64(0), high - room)
    while low < high:
        middle = (low + high) // 2
        if w.left[v, middle % room] < time - tolerance:
            low = middle + 1
        else:
            high = middle
    return bool(w.left[v, low % room] <= time + tolerance)
