"""The loop that updates the statistics of the signals' plausibility."""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.prefetch import fetch
from valvemap.model.samples import Segments
from valvemap.pipeline.kernels.compiled import inner, kernel
from valvemap.vocabulary.statuses import Quality

SAMPLES, REVERSED, FORWARD, HIGH, LOWEST_U, AT_LOWEST, HIGHEST_U, AT_HIGHEST, WITH_T, HOT = range(
    10
)
HIGHEST_P, BACKWARD, REPEATED, LAST_T, SEEN = range(10, 15)
REFUSED, WRONG, CLEAN = range(15, 18)  # reason; impossible samples in total; samples since then
FIELDS = 18

NOT_REFUSED, TOO_HIGH, SWAPPED = range(3)

N, SUM_U, SUM_S, SUM_Q, UU, US, UQ, SS, SQ, QQ = range(10)
SUMS = 10
CELLS = 16

LOWEST_CELL, HIGHEST_CELL = -5.0, 105.0  # %, of U; tolerance beyond the range for sensor offset
CLEAR_DP = 2.0  # bar; a smaller dp is within the sensors' accuracy
MOST_DP = 700.0  # bar; above the rating of hydraulic valves
HOT_T = 95.0  # °C; above the limit of hydraulic oil

FEW = 10.0  # samples; with fewer nothing is judged
SOME_HIGH = 0.05  # share of samples; single spikes are left to the gate
NEARLY_ALWAYS, SELDOM = 0.9, 0.5  # share of samples with p1 < p2: swapped above, not below
AGAIN = 10.0  # clean samples in a row per wrong one that end a rejection …
CLEAN_AGAIN = 2_000.0  # … and their number if the pressures were swapped

_BAD = int(Quality.BAD)


@kernel
def count(
    t: NDArray[np.int64],
    columns: NDArray[np.float64],
    quality: NDArray[np.uint8],
    counts: NDArray[np.float64],
    times: NDArray[np.int64],
    sums: NDArray[np.float64],
    segments: Segments,
    refused: NDArray[np.bool_],
) -> None:
    """Add N samples of many valves to the statistics; ``columns`` (N, 5) are U, p1, p2, Q, T.

    ``counts`` (M, FIELDS), ``times`` (M,) of the newest sample and ``sums`` (M, CELLS, SUMS) by
    cells of U are updated in place. ``refused`` (N,) is set for each rejected sample.
    """
    members, starts, stops = segments
    width = (HIGHEST_CELL - LOWEST_CELL) / CELLS
    for k in range(len(members)):
        m = members[k]
        own = counts[m]
        if k + 1 < len(members):
            fetch((counts, sums), members[k + 1])
        for i in range(starts[k], stops[k]):
            if own[SEEN] > 0:
                if t[i] < times[m]:
                    own[BACKWARD] += 1
                elif t[i] == times[m]:
                    own[REPEATED] += 1
            own[SEEN] += 1
            times[m] = t[i]
            refused[i] = own[REFUSED] != NOT_REFUSED
            U, p1, p2, Q, T = columns[i]
            if quality[i] == _BAD or not np.isfinite(U + p1 + p2 + Q):
                continue
            dp = p1 - p2
            own[SAMPLES] += 1
            if dp < -CLEAR_DP:
                own[REVERSED] += 1
            elif dp > CLEAR_DP:
                own[FORWARD] += 1
            furthest = p1 if abs(p1) > abs(p2) else p2
            if abs(furthest) <= MOST_DP < abs(dp):
                furthest = dp
            if abs(furthest) > abs(own[HIGHEST_P]):
                own[HIGHEST_P] = furthest
            too_high = abs(furthest) > MOST_DP
            own[HIGH] += too_high
            wrong = too_high or dp < -CLEAR_DP
            if wrong:
                own[WRONG] += 1
                own[CLEAN] = 0
            elif dp > CLEAR_DP:
                own[CLEAN] += 1
            _judge(own)
            undecided = own[REVERSED] + own[FORWARD] < FEW
            refused[i] = own[REFUSED] != NOT_REFUSED or (wrong and undecided)
            if own[LOWEST_U] > U:
                own[LOWEST_U], own[AT_LOWEST] = U, 0
            if own[HIGHEST_U] < U:
                own[HIGHEST_U], own[AT_HIGHEST] = U, 0
            own[AT_LOWEST] += own[LOWEST_U] == U
            own[AT_HIGHEST] += own[HIGHEST_U] == U
            if np.isfinite(T):
                own[WITH_T] += 1
                own[HOT] += T > HOT_T
            if refused[i] or not LOWEST_CELL <= U < HIGHEST_CELL:
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


@inner
def _judge(own: NDArray[np.float64]) -> None:
    """Reject impossible pressures; accept them again after enough clean samples."""
    pressed = own[REVERSED] + own[FORWARD]
    if own[REFUSED] == NOT_REFUSED:
        if own[HIGH] >= FEW and own[HIGH] > SOME_HIGH * own[SAMPLES]:
            own[REFUSED] = TOO_HIGH
        elif own[REVERSED] >= FEW and own[REVERSED] > NEARLY_ALWAYS * pressed:
            own[REFUSED] = SWAPPED
        return
    ended = own[CLEAN] >= AGAIN * own[WRONG]
    if own[REFUSED] == SWAPPED:
        ended = ended or own[REVERSED] < SELDOM * pressed or own[CLEAN] >= CLEAN_AGAIN
    if ended:
        own[REFUSED] = NOT_REFUSED
        own[SAMPLES] = own[REVERSED] = own[FORWARD] = own[HIGH] = own[HIGHEST_P] = 0.0
