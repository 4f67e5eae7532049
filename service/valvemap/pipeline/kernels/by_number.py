"""Samples in the order of their running number, each once, in whatever order signals arrive.

A sample is the set of signals with one source time. A sample that has all its signals and its
running number is judged: it is in order, it is old, or the source has restarted. Contiguous numbers
are emitted at once; behind a gap a sample waits until others have spanned ``reorder`` ns.
"""

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.kernels.compiled import inlined, inner
from valvemap.pipeline.kernels.number_course import (
    EARLIER,
    UNKNOWN,
    course_of,
    is_jump,
    is_taken,
    unwrapped,
)
from valvemap.pipeline.kernels.slot_signs import (
    GONE,
    NOT_YET,
    is_missing,
    is_old,
    late_or_twice,
    signals_in,
)
from valvemap.pipeline.kernels.waiting import (
    BASE,
    BEFORE_FIRST,
    BEGIN_ANEW,
    CLOCK_STEPS,
    DUPLICATES,
    ELAPSED,
    ENOUGH,
    FILLED,
    FIRST,
    FIRST_TIME,
    FLOOR,
    FLUSH,
    GAPS,
    GAPS_KEPT,
    GIVEN_UP,
    HIGH,
    LAST,
    LAST_TIME,
    LATE,
    MAKE_ROOM,
    MISSING,
    NEVER,
    NEWEST,
    NO_NUMBER,
    NUMBER,
    OPENED,
    PERIOD,
    REGULAR,
    RESTARTS,
    SEEN,
    SEQUENCE,
    SETTLE,
    SINCE,
    SIZE,
    TIME,
    ZERO,
    Aligned,
    Rules,
    Waiting,
    emit,
    find,
    keep_pace,
    move,
    open_slot,
    severity,
)

_NUMBERED = 1 << SEQUENCE


@inlined
def place_by_number(
    w: Waiting, v: int, j: int, time: int, value: float, status: int, rules: Rules
) -> int:
    """Add a change to its sample; return the slot of the sample that it completes, or -1."""
    order = w.order[v]
    if j == SEQUENCE and (not np.isfinite(value) or severity(status) == 2):
        return -1
    if time == order[SEEN + j]:
        w.counters[v, DUPLICATES] += j != SEQUENCE
        return -1
    order[SEEN + j] = time
    if j != SEQUENCE and rules.hold[v, j] > 0:
        if time >= w.held_time[v, j]:
            w.held_value[v, j], w.held_status[v, j] = value, status
            w.held_time[v, j] = time
        return -1
    k = find(w.slots[v], order[SIZE], time - rules.tolerance)
    if k == order[SIZE] or w.slots[v, k, TIME] > time + rules.tolerance:
        open_slot(w, v, k, time)
    elif w.slots[v, k, FILLED] & (1 << j):
        w.counters[v, DUPLICATES] += j != SEQUENCE
        return -1
    if j == SEQUENCE:
        w.slots[v, k, NUMBER] = np.int64(value) & 0xFFFFFFFF
    else:
        w.values[v, k, j], w.status[v, k, j] = value, status
        if is_old(w.slots[v, k]):
            w.counters[v, late_or_twice(w, v, time)] += 1
    w.slots[v, k, FILLED] |= 1 << j
    return k if w.slots[v, k, FILLED] == rules.required[v] | _NUMBERED else -1


@inlined
def judge(w: Waiting, v: int, k: int, rules: Rules) -> int:
    """Judge a complete sample by its number and time; return the command for `settle`."""
    order, slot, time = w.order[v], w.slots[v, k], w.slots[v, k, TIME]
    number = unwrapped(order, slot[NUMBER])
    last, of_before = order[LAST], order[FLOOR] != NEVER and time <= order[FLOOR]
    if of_before and order[BASE] != NO_NUMBER and number == order[BASE] + 1:
        order[FLOOR] = NEVER  # the source's clock was set back in this run
        of_before = False
    came_before = of_before and (last == NO_NUMBER or number != last + 1)
    at_step = False
    taken = not came_before and is_taken(w, v, k, number)
    if taken or (last != NO_NUMBER and number <= last and not came_before):
        course = course_of(order, number, time, rules.reorder[v])
        at_step = course == EARLIER and number >= order[FIRST]  # lost there, and late
        if taken or course == UNKNOWN or (time > order[HIGH] and not at_step):
            if is_old(slot):
                w.counters[v, late_or_twice(w, v, time)] -= signals_in(rules.required[v])
            slot[OPENED] = NOT_YET  # keep it, whatever is emitted before it
            return BEGIN_ANEW
        came_before = True
    if came_before:
        if at_step and is_old(slot):
            w.counters[v, late_or_twice(w, v, time)] -= signals_in(rules.required[v])
        if at_step or not is_old(slot):
            late = at_step or (of_before and (last == NO_NUMBER or number > last))
            w.counters[v, LATE if late else DUPLICATES] += signals_in(rules.required[v])
        slot[FILLED] = GONE
        return SETTLE
    if is_old(slot):  # the source's clock was set back
        w.counters[v, late_or_twice(w, v, time)] -= signals_in(rules.required[v])
        slot[OPENED] = NOT_YET
    slot[NUMBER] = number
    order[BASE] = max(order[BASE], number)
    step = time - order[NEWEST]
    if order[NEWEST] == NEVER or is_jump(order, step, rules.max_wait, rules.reorder[v]):
        order[NEWEST] = time
    elif step > 0:
        order[ELAPSED] += step
        order[NEWEST] = time
    slot[SINCE] = order[ELAPSED]
    return SETTLE


@inlined
def settle(w: Waiting, v: int, command: int, rules: Rules, out: Aligned, n: int) -> int:
    """Emit all samples that are due; return the number of samples in ``out``.

    SETTLE: samples in order, and those that have waited for ``reorder``. BEGIN_ANEW, MAKE_ROOM: all
    complete samples with a number. FLUSH: these or, if there is none, those without a number: as
    long as numbers come, that of a sample may be on its way.
    """
    order, size = w.order[v], w.order[v, SIZE]
    gone = 0
    while True:
        k = _next(w, v, command, rules)
        if k < 0:
            break
        gone += 1
        if command == FLUSH and w.slots[v, k, SINCE] != NEVER:
            command = MAKE_ROOM
        slot, last = w.slots[v, k], order[LAST]
        number, time = slot[NUMBER], slot[TIME]
        slot[FILLED] = GONE
        if last != NO_NUMBER and number <= last:  # the same number at two times
            w.counters[v, DUPLICATES] += signals_in(rules.required[v])
            continue
        if last == NO_NUMBER or number > last + 1:
            _give_up(w, v, last, number, time, rules.max_wait)
        n = emit(w, v, k, rules, out, n)
        if last == NO_NUMBER:
            order[FIRST], order[FIRST_TIME], order[BEFORE_FIRST] = number, time, NEVER
        else:
            step = (time - order[LAST_TIME]) // (number - last)
            usual = (number - last - 1) * order[PERIOD]  # of the samples between, which are lost
            excess = time - order[LAST_TIME] - usual
            is_early = usual > 0 and time - order[LAST_TIME] < order[PERIOD]
            is_back = step <= 0 or (is_early and order[REGULAR] == ENOUGH)
            w.counters[v, CLOCK_STEPS] += is_back
            jump = max(step, excess)
            if is_back or is_jump(order, jump, rules.max_wait, rules.reorder[v]):
                order[FIRST], order[FIRST_TIME] = last + 1, time - usual
                order[BEFORE_FIRST] = order[LAST_TIME]
        keep_pace(order, w.counters[v], time, 0 if last == NO_NUMBER else number - last)
        order[LAST], order[LAST_TIME] = number, time
        order[HIGH] = max(order[HIGH], time)
        order[GIVEN_UP] = 0
    if command == MAKE_ROOM and gone == 0 and size > 0:
        first = w.slots[v, 0]
        order[GIVEN_UP] += is_missing(first)
        first[SINCE] = NOT_YET
    if command == BEGIN_ANEW:
        order[LAST] = order[BASE] = NO_NUMBER
        order[FLOOR] = order[NEWEST] = NEVER
        order[GIVEN_UP] = 0
        w.counters[v, RESTARTS] += 1
    _sweep(w, v, rules)
    return n


@inner
def resume(order: NDArray[np.int64], slots: NDArray[np.int64], time: int) -> int:
    """Set the bounds of the run after a restart; return the slot of its first sample."""
    if time > order[HIGH]:
        order[FLOOR] = order[HIGH]
    else:
        order[HIGH] = NEVER  # the clock was set back as well
    return find(slots, order[SIZE], time)


@inlined
def _next(w: Waiting, v: int, command: int, rules: Rules) -> int:
    """Return the slot to emit next, or -1."""
    order, lowest, waited = w.order[v], -1, np.int64(-1)
    for k in range(order[SIZE]):
        slot = w.slots[v, k]
        if slot[SINCE] == NEVER or slot[FILLED] == GONE:
            continue
        waited = max(waited, order[ELAPSED] - slot[SINCE])
        if lowest < 0 or slot[NUMBER] < w.slots[v, lowest, NUMBER]:
            lowest = k
    if lowest >= 0:
        number, last = w.slots[v, lowest, NUMBER], order[LAST]
        follows = number == 0 if last == NO_NUMBER else number <= last + 1
        if follows or command != SETTLE or waited > rules.reorder[v]:
            return lowest
        return -1
    if command == FLUSH:
        for k in range(order[SIZE]):
            slot = w.slots[v, k]
            if slot[FILLED] == rules.required[v] and slot[TIME] > order[HIGH]:
                slot[NUMBER] = order[LAST] + (order[LAST] != NO_NUMBER)
                return k
    return -1


@inner
def _give_up(w: Waiting, v: int, last: int, number: int, time: int, max_wait: int) -> None:
    """Drop samples between two numbers: incomplete ones count as missing, the rest as gaps."""
    order = w.order[v]
    given_up = order[GIVEN_UP]
    for k in range(order[SIZE]):
        slot = w.slots[v, k]
        if slot[FILLED] == GONE or slot[SINCE] != NEVER or slot[TIME] >= time:
            continue
        if last == NO_NUMBER:  # nothing is missing before the first sample
            is_before = time - slot[TIME] <= max_wait  # else the clock may have been set back
            if is_before and (order[HIGH] == NEVER or slot[TIME] > order[HIGH]):
                slot[FILLED] = GONE
            continue
        known = slot[FILLED] & _NUMBERED != 0
        if known and not last < unwrapped(order, slot[NUMBER]) < number:
            continue
        if not known and slot[TIME] <= order[HIGH]:
            continue
        given_up += 1
        w.counters[v, MISSING] += 1
        slot[FILLED] = GONE
    if last != NO_NUMBER:
        w.counters[v, GAPS] += max(np.int64(0), number - last - 1 - given_up)
        row = w.lost[v, order[GAPS_KEPT] % w.lost.shape[1]]
        row[0], row[1] = order[LAST_TIME], time
        order[GAPS_KEPT] += 1


@inlined
def _sweep(w: Waiting, v: int, rules: Rules) -> None:
    """Remove emitted and dropped slots, and incomplete ones overtaken for ``max_wait``."""
    order, kept = w.order[v], ZERO
    high = order[HIGH]
    for k in range(order[SIZE]):
        slot = w.slots[v, k]
        if slot[FILLED] == GONE:
            continue
        opened, since = slot[OPENED], slot[SINCE]
        newest = order[LAST_TIME] if opened == NEVER else high  # the clock may have been set back
        passed = since == NEVER and high != NEVER and slot[TIME] <= newest
        if since == NOT_YET or (passed and (opened == NEVER or high - opened > rules.max_wait)):
            w.counters[v, MISSING] += is_missing(slot)
            continue
        if kept != k:
            move(w, v, k, kept)
        kept += 1
    order[SIZE] = kept
