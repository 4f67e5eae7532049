"""The loop that counts what speaks for and against a valve's signals being what they are called."""

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
REFUSED, WRONG, CLEAN = range(15, 18)  # why; samples that cannot be, ever, and those since then
FIELDS = 18

NOT_REFUSED, TOO_HIGH, SWAPPED = range(3)

N, SUM_U, SUM_S, SUM_Q, UU, US, UQ, SS, SQ, QQ = range(10)
SUMS = 10
CELLS = 16

LOWEST_CELL, HIGHEST_CELL = -5.0, 105.0  # %, of U: a sensor may read that much beside the range
CLEAR_DP = 2.0  # bar: less is what sensors are off by
MOST_DP = 700.0  # bar: no hydraulic valve stands more
HOT_T = 95.0  # °C: no hydraulic oil is kept so hot

FEW = 10.0  # samples; with fewer nothing is said
SOME_HIGH = 0.05  # share of samples: single spikes are the gate's matter
NEARLY_ALWAYS, SELDOM = 0.9, 0.5  # share of samples with p1 < p2: are swapped, are not
AGAIN = 10.0  # times as many clean samples in a row as there were wrong ones end a refusal …
CLEAN_AGAIN = 2_000.0  # … and so many do where the pressures were swapped

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
    """Count N samples of many valves in; ``columns`` (N, 5) are U, p1, p2, Q, T.

    ``counts`` (M, FIELDS), ``times`` (M,) of the newest sample and ``sums`` (M, CELLS, SUMS) by
    cells of U are written in place, and whether the pressures cannot be, sample by sample, into
    ``refused`` (N,).
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
    """Refuse pressures that cannot be; let them in again once they have been right for long."""
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
