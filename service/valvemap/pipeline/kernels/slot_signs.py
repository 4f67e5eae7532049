"""Signs of a slot: emitted, old, missing; late or twice; the number of its signals."""

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.kernels.compiled import inner
from valvemap.pipeline.kernels.waiting import (
    DUPLICATES,
    GAPS_KEPT,
    LATE,
    NEVER,
    OPENED,
    SIGNALS,
    TIME,
    Waiting,
)

GONE = 1 << 8  # a slot that was emitted or dropped; swept at once
NOT_YET = np.int64(2**62)  # later than any time


@inner
def is_missing(slot: NDArray[np.int64]) -> bool:
    """Whether an incomplete sample counts as missing: not before the first, nor dropped already."""
    return bool(slot[OPENED] != NEVER and slot[TIME] > slot[OPENED])


@inner
def is_old(slot: NDArray[np.int64]) -> bool:
    """Whether a newer sample was emitted before this one began to arrive."""
    return bool(slot[TIME] <= slot[OPENED] < NOT_YET)


@inner
def late_or_twice(w: Waiting, v: int, time: int) -> int:
    """Counter of a signal older than the last sample: LATE if dropped before, else DUPLICATES."""
    for row in range(min(w.order[v, GAPS_KEPT], w.lost.shape[1])):
        if w.lost[v, row, 0] < time < w.lost[v, row, 1]:
            return LATE
    return DUPLICATES


@inner
def signals_in(filled: int) -> int:
    """Number of signals in a slot, without the running number."""
    count = 0
    for m in range(SIGNALS):
        count += (filled >> m) & 1
    return count
