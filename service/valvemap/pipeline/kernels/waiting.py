"""State of the alignment, and the loops shared by both orders of samples."""

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.kernels.compiled import inlined, inner
from valvemap.vocabulary.signals import COUNT, PER_VALVE, Signal

SIGNALS, STRIDE, SEQUENCE = COUNT, PER_VALVE, int(Signal.SEQUENCE)

(
    LATE,
    MISSING,
    DUPLICATES,
    CLOCK_STEPS,
    GAPS,
    EMITTED,
    LOST_BY_TIME,
    RESTARTS,
    COUNTERS,
) = range(9)

ZERO = cast("int", np.int64(0))  # with a literal 0 numba would compile the callee again
NEVER = np.iinfo(np.int64).min
NO_NUMBER = np.int64(-(2**62))  # lower than any running number

# Fields of a slot, beside values: time, a bit per signal (SEQUENCE too), running number, ELAPSED at
# its completion, newest emitted time when the slot was opened.
TIME, FILLED, NUMBER, SINCE, OPENED, SLOT_FIELDS = range(6)

# The fields of a valve's row of ``order``.
(
    SIZE,  # slots in use
    LAST,  # running number, unwrapped, of the last emitted sample; NO_NUMBER: none in this run
    BASE,  # highest running number seen, the reference for unwrapping
    LAST_TIME,  # time of the last emitted sample
    HIGH,  # newest emitted time
    FLOOR,  # newest time of the previous run, if this one began later
    NEWEST,  # time of the last complete sample
    ELAPSED,  # ns of source time spanned by complete samples, without clock steps
    FIRST,  # running number and time at which the present course of the source's clock began …
    FIRST_TIME,
    BEFORE_FIRST,  # … and the time of the sample before
    GIVEN_UP,  # samples dropped singly since the last emitted sample
    GAPS_KEPT,  # rows of ``lost`` written
    PERIOD,  # usual time between samples, ns; 0: unknown
    REGULAR,  # confidence in PERIOD, up to ENOUGH
    DOUBTFUL,  # samples that seem lost by time; the next sample decides
    LONG_STEPS,  # successive long steps behind DOUBTFUL
    TIMES_KEPT,  # columns of ``left`` written
    SEEN,  # newest time of every signal, the running number's last
) = range(19)
ORDER_FIELDS = SEEN + STRIDE

# commands for a valve; SET_BACK and SET_FORWARD are for those without running number
NOTHING, JUDGE, SETTLE, FLUSH, BEGIN_ANEW, MAKE_ROOM, SET_BACK, SET_FORWARD = range(8)

ENOUGH = 8  # regular steps after which a long one is a loss
NEW_PACE = 4  # successive long steps: the source has become slower


class Changes(NamedTuple):
    """Data changes, all (N,): see :class:`valvemap.pipeline.data_changes.DataChanges`."""

    item: NDArray[np.int32]
    value: NDArray[np.float64]
    status: NDArray[np.uint32]
    source_time: NDArray[np.int64]


class Rules(NamedTuple):
    """Alignment settings of V valves; times in ns.

    ``required`` (V,) has a bit for every signal that a sample must have, ``hold`` (V, SIGNALS) is
    the time for which a signal's last value is held, ``numbered`` (V,) masks valves with a running
    number, ``reorder`` (V,) is how long a sample waits for an earlier one.
    """

    required: NDArray[np.int64]
    hold: NDArray[np.int64]
    numbered: NDArray[np.bool_]
    reorder: NDArray[np.int64]
    tolerance: int
    max_wait: int


class Waiting(NamedTuple):
    """State of the alignment; the first axis of every array is the valve (V).

    A row of ``slots`` (V, K, SLOT_FIELDS), ``values`` and ``status`` (V, K, SIGNALS) holds the
    pending samples of a valve in the order of their time; the first SIZE are in use.
    ``held_value``, ``held_status`` and ``held_time`` (V, SIGNALS) are the last of each held signal,
    ``lost`` (V, LOST_KEPT, 2) the times before and after the last dropped stretches, ``left``
    (V, R) the last emitted times of valves without running number, ``order`` (V, ORDER_FIELDS) the
    fields above, ``counters`` (V, COUNTERS) counts since the start.
    """

    slots: NDArray[np.int64]
    values: NDArray[np.float64]
    status: NDArray[np.uint32]
    held_value: NDArray[np.float64]
    held_status: NDArray[np.uint32]
    held_time: NDArray[np.int64]
    lost: NDArray[np.int64]
    left: NDArray[np.int64]
    order: NDArray[np.int64]
    counters: NDArray[np.int64]


class Aligned(NamedTuple):
    """Arrays of emitted samples: ``valve``, ``time``, ``quality`` (N,), ``values`` (N, SIGNALS)."""

    valve: NDArray[np.int64]
    time: NDArray[np.int64]
    values: NDArray[np.float64]
    quality: NDArray[np.uint8]


@inlined
def find(slots: NDArray[np.int64], size: int, time: int) -> int:
    """Position of the first of a valve's slots not before ``time``."""
    low, high = 0, size
    while low < high:
        middle = (low + high) // 2
        if slots[middle, TIME] < time:
            low = middle + 1
        else:
            high = middle
    return low


@inner
def move(w: Waiting, v: int, here: int, there: int) -> None:
    """Copy a slot, element by element: numba takes seconds to compile a copy of rows."""
    for f in range(SLOT_FIELDS):
        w.slots[v, there, f] = w.slots[v, here, f]
    for m in range(SIGNALS):
        w.values[v, there, m] = w.values[v, here, m]
        w.status[v, there, m] = w.status[v, here, m]


@inner
def open_slot(w: Waiting, v: int, k: int, time: int) -> None:
    """Insert an empty slot at place ``k``."""
    for n in range(w.order[v, SIZE], k, -1):
        move(w, v, n - 1, n)
    slot = w.slots[v, k]
    slot[TIME], slot[FILLED] = time, 0
    slot[NUMBER], slot[SINCE] = NO_NUMBER, NEVER
    slot[OPENED] = w.order[v, HIGH]
    w.order[v, SIZE] += 1


@inner
def severity(status: int) -> int:
    """0 Good, 1 Uncertain, 2 Bad: the top two bits of a StatusCode (Part 4, 7.39)."""
    return min(status >> 30, 2)


@inlined
def emit(w: Waiting, v: int, k: int, rules: Rules, out: Aligned, n: int) -> int:
    """Write slot ``k`` as sample ``n``; its quality is that of its worst signal."""
    worst, time = 0, w.slots[v, k, TIME]
    for m in range(SIGNALS):
        out.values[n, m] = np.nan
        hold = rules.hold[v, m]
        if rules.required[v] & (1 << m):
            out.values[n, m] = w.values[v, k, m]
            worst = max(worst, severity(w.status[v, k, m]))
        elif hold > 0:
            if w.held_time[v, m] == NEVER or time - w.held_time[v, m] > hold:
                worst = 2
            else:
                out.values[n, m] = w.held_value[v, m]
                worst = max(worst, severity(w.held_status[v, m]))
    out.valve[n] = v
    out.time[n] = time
    out.quality[n] = worst
    w.counters[v, EMITTED] += 1
    return n + 1


@inlined
def keep_pace(
    order: NDArray[np.int64], counters: NDArray[np.int64], time: int, numbers: int
) -> None:
    """Update the usual step between samples, and count the losses that it implies.

    ``numbers`` is the increment of the running number; 0 without one. A long step counts as a loss
    once the next sample has the usual step; several in a row are a slower source.
    """
    if order[LAST_TIME] == NEVER or time <= order[LAST_TIME]:
        return
    step = (time - order[LAST_TIME]) // max(numbers, 1)
    period = order[PERIOD]
    if period > 0 and 4 * abs(step - period) <= period:
        order[PERIOD] += (step - period) // 8
        order[REGULAR] = min(order[REGULAR] + 1, ENOUGH)
        counters[LOST_BY_TIME] += order[DOUBTFUL]
        order[DOUBTFUL] = order[LONG_STEPS] = 0
    elif numbers == 0 and order[REGULAR] == ENOUGH and 2 * step >= 3 * period:
        order[DOUBTFUL] += (step + period // 2) // period - 1
        order[LONG_STEPS] += 1
        if order[LONG_STEPS] == NEW_PACE:
            order[DOUBTFUL] = order[LONG_STEPS] = 0
            order[PERIOD], order[REGULAR] = step, 1
    else:
        order[REGULAR] -= 1
        if order[REGULAR] <= 0:
            order[PERIOD], order[REGULAR] = step, 1
