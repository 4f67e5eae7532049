"""Running numbers of samples: unwrapped, taken, and on which course of the source's clock."""

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.kernels.compiled import inner
from valvemap.pipeline.kernels.slot_signs import GONE
from valvemap.pipeline.kernels.waiting import (
    BASE,
    BEFORE_FIRST,
    FILLED,
    FIRST,
    FIRST_TIME,
    HIGH,
    LAST,
    LAST_TIME,
    NEVER,
    NO_NUMBER,
    NUMBER,
    PERIOD,
    SINCE,
    SIZE,
    Waiting,
)

UNKNOWN, PRESENT, EARLIER = 0, 1, 2  # courses of the source's clock, between its steps
_SLOW = 4  # usual steps; a longer step is a jump of the source's clock
_SLACK_NS = 1e9  # tolerance of a duplicate's time from the line of number over time …
_SLACK = 0.5  # … and as a share of its distance from the newest


@inner
def unwrapped(order: NDArray[np.int64], raw: int) -> int:
    """Unwrap a running number (UInt32)."""
    base: int = order[BASE]
    if base == NO_NUMBER:
        return raw
    step = (raw - base) & 0xFFFFFFFF
    return base + (step if step < 0x80000000 else step - 0x100000000)


@inner
def course_of(order: NDArray[np.int64], number: int, time: int, reorder: int) -> int:
    """Return the course of the clock, present or earlier, on whose line number and time lie.

    The earlier course is continued where the clock was set back by less than ``reorder``: samples
    lost there may come late. Beyond that, numbers that repeat are those of a restarted source.
    """
    step = np.float64(order[PERIOD])
    if order[LAST] > order[FIRST] and order[LAST_TIME] > order[FIRST_TIME]:
        step = (order[LAST_TIME] - order[FIRST_TIME]) / (order[LAST] - order[FIRST])
    last, last_time = order[LAST], order[LAST_TIME]
    for course in (PRESENT, EARLIER):
        behind = np.float64(last - number) * step
        slack = _SLACK_NS + _SLACK * max(behind, 0.0)
        if abs(np.float64(last_time) - behind - np.float64(time)) <= slack:
            return course
        is_continued = order[HIGH] < time <= order[LAST_TIME] + reorder
        if order[BEFORE_FIRST] == NEVER or (number >= order[FIRST] and not is_continued):
            return UNKNOWN
        last, last_time = order[FIRST] - 1, order[BEFORE_FIRST]
    return UNKNOWN


@inner
def is_taken(w: Waiting, v: int, k: int, number: int) -> bool:
    """Whether another waiting sample has the number: the source restarted before it was emitted."""
    for m in range(w.order[v, SIZE]):
        slot = w.slots[v, m]
        if m != k and slot[SINCE] != NEVER and slot[FILLED] != GONE and slot[NUMBER] == number:
            return True
    return False


@inner
def is_jump(order: NDArray[np.int64], step: int, max_wait: int, reorder: int) -> bool:
    """Whether a step of this many ns between samples is a step of the source's clock."""
    longest = max(max_wait, reorder)
    return bool(step > max(longest, _SLOW * order[PERIOD]) or step < -longest)
