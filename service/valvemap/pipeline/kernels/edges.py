"""The loops of a valve's edges: samples of an edge meet those of its line, and are split by U."""

import math

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.kernels.compiled import kernel
from valvemap.vocabulary.statuses import Quality

SIDE, SINCE = 0, 1  # places in an edge's state: sign of U; UTC ns of its last change
PLACES = 2
SETTLED_NS = 50_000_000  # after U changed its sign, the spool and the meter still show the other

_BAD = int(Quality.BAD)


@kernel
def meet(
    times: NDArray[np.int64],
    starts: NDArray[np.int64],
    last: NDArray[np.int64],
    rows: NDArray[np.int64],
    past: NDArray[np.int64],
) -> int:
    """Match the samples of equal times of several streams; return the number of matches.

    ``times`` are those of stream after stream, stream k from ``starts[k]`` on. ``last`` (1,) is the
    time of the last match, and is advanced. ``rows`` (streams, matches) become the rows of the
    matches within each stream, ``past`` (streams,) the number of its rows that are used up.

    Of different times at the front, the earliest are dropped. A stream whose front is not behind
    the last match has stepped back; where another has not yet, the other's front is from before the
    step, and is dropped. The result does not depend on how the streams are cut.
    """
    past[:] = 0
    n, streams = 0, len(past)
    while True:
        lowest, highest = times[-1], times[-1]
        for k in range(streams):
            i = starts[k] + past[k]
            if i == starts[k + 1]:
                return n
            lowest = times[i] if k == 0 else min(lowest, times[i])
            highest = times[i] if k == 0 else max(highest, times[i])
        if lowest == highest:
            for k in range(streams):
                rows[k, n] = past[k]
            last[0] = lowest
            n += 1
        has_stepped = lowest <= last[0] < highest
        for k in range(streams):
            front = times[starts[k] + past[k]]
            if front > last[0] if has_stepped else front == lowest:
                past[k] += 1


@kernel
def split(
    t: NDArray[np.int64],
    U: NDArray[np.float64],
    Q: NDArray[np.float64],
    quality: NDArray[np.uint8],
    leakage: NDArray[np.float64],
    opens: float,
    adds: float,
    state: NDArray[np.int64],
    used: NDArray[np.bool_],
) -> None:
    """Turn U and flow of a line into those of one edge, in place; ``used``: where it is open.

    An edge that U closes has U = 0 and Q = 0.
    """
    for i in range(len(t)):
        side = state[SIDE]
        if U[i] > 0.0:
            side = 1
        elif U[i] < 0.0:
            side = -1
        if side != state[SIDE] or t[i] < state[SINCE]:
            state[SIDE], state[SINCE] = side, t[i]
        is_open = side == opens
        used[i] = is_open and t[i] - state[SINCE] >= SETTLED_NS
        if not math.isfinite(leakage[i]):
            quality[i] = _BAD
        if is_open:
            U[i] = opens * U[i]
            Q[i] = adds * (Q[i] - leakage[i])
        elif math.isfinite(U[i]):
            U[i] = Q[i] = 0.0
