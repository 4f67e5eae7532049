"""The loop that counts what speaks for and against a valve's signals being what they are called."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from service.identification.samples import Quality, Segments

SAMPLES, REVERSED, FORWARD, HIGH, LOWEST_U, AT_LOWEST, HIGHEST_U, AT_HIGHEST, WITH_T, HOT = range(
    10
)
HIGHEST_P, BACKWARD, REPEATED, LAST_T, SEEN = range(10, 15)
FIELDS = 15

N, SUM_U, SUM_S, SUM_Q, UU, US, UQ, SS, SQ, QQ = range(10)
SUMS = 10
CELLS = 16

LOWEST_CELL, HIGHEST_CELL = -5.0, 105.0  # %, of U: a sensor may read that much beside the range
CLEAR_DP = 2.0  # bar: less is what sensors are off by
MOST_DP = 700.0  # bar: no hydraulic valve stands more
HOT_T = 95.0  # °C: no hydraulic oil is kept so hot

_BAD = int(Quality.BAD)


@njit(cache=True)
def count(
    t: NDArray[np.int64],
    columns: NDArray[np.float64],
    quality: NDArray[np.uint8],
    counts: NDArray[np.float64],
    times: NDArray[np.int64],
    sums: NDArray[np.float64],
    segments: Segments,
) -> None:
    """Count N samples of many valves in; ``columns`` (N, 5) are U, p1, p2, Q, T.

    ``counts`` (M, FIELDS), ``times`` (M,) of the newest sample and ``sums`` (M, CELLS, SUMS) by
    cells of U are written in place.
    """
    members, starts, stops = segments
    width = (HIGHEST_CELL - LOWEST_CELL) / CELLS
    for k in range(len(members)):
        m = members[k]
        own = counts[m]
        for i in range(starts[k], stops[k]):
            if own[SEEN] > 0:
                if t[i] < times[m]:
                    own[BACKWARD] += 1
                elif t[i] == times[m]:
                    own[REPEATED] += 1
            own[SEEN] += 1
            times[m] = t[i]
            U, p1, p2, Q, T = columns[i]
            if quality[i] == _BAD or not np.isfinite(U + p1 + p2 + Q):
                continue
            dp = p1 - p2
            own[SAMPLES] += 1
            if dp < -CLEAR_DP:
                own[REVERSED] += 1
            elif dp > CLEAR_DP:
                own[FORWARD] += 1
            if max(abs(dp), p1, p2) > MOST_DP:
                own[HIGH] += 1
            own[HIGHEST_P] = max(own[HIGHEST_P], p1, p2)
            if own[LOWEST_U] > U:
                own[LOWEST_U], own[AT_LOWEST] = U, 0
            if own[HIGHEST_U] < U:
                own[HIGHEST_U], own[AT_HIGHEST] = U, 0
            own[AT_LOWEST] += own[LOWEST_U] == U
            own[AT_HIGHEST] += own[HIGHEST_U] == U
            if np.isfinite(T):
                own[WITH_T] += 1
                own[HOT] += T > HOT_T
            if not LOWEST_CELL <= U < HIGHEST_CELL:
                continue
            cell = sums[m, int((U - LOWEST_CELL) / width)]
            s = np.sign(dp) * np.sqrt(abs(dp))
            cell[N] += 1
            cell[SUM_U] += U
            cell[SUM_S] += s
            cell[SUM_Q] += Q
            cell[UU] += U * U
            cell[US] += U * s
            cell[UQ] += U * Q
            cell[SS] += s * s
            cell[SQ] += s * Q
            cell[QQ] += Q * Q
