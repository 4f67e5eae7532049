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
    own: NDArray[np.int64], line: NDArray[np.int64], rows: NDArray[np.int64], of: NDArray[np.int64]
) -> tuple[int, int, int]:
    """Pair the samples of equal times; return the number of pairs, and of rows of either used up.

    ``rows`` and ``of`` become the rows of the pairs. Of two different times at the front, the
    earlier is dropped. The result for a stream does not depend on how it is cut.
    """
    n, i, k = 0, 0, 0
    while i < len(own) and k < len(line):
        if own[i] == line[k]:
            rows[n], of[n] = i, k
            n, i, k = n + 1, i + 1, k + 1
        elif own[i] < line[k]:
            i += 1
        else:
            k += 1
    return n, i, k


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
