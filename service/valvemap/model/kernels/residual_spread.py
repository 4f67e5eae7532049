"""The loop that learns, region by region, how far measurements lie off the map."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.kernels.prefetch import fetch
from valvemap.model.samples import Codes, Floats, Segments, Singles, Times

CELLS_U, CELLS_S = 10, 12
WIDTH_U, WIDTH_S = 10.0, 1.5  # %, √bar

# Places in a cell, in its stamps, and in `overall`.
WEIGHT, SQUARES, EXPECTED = range(3)
PLACES_OF_CELL = 3
LAST, NUMBER = range(2)
PLACES_OF_STAMPS = 2
AGES = 4  # of a cell: just now, recently, long ago, longer ago or never
COUNT, QUANTILE = 2, 3
TIMES = QUANTILE + AGES
PLACES_OVERALL = TIMES + AGES

CELL_MEMORY, MEMORY = 100.0, 400.0  # samples
BORROWED = 8.0  # samples' worth of the whole map in each cell's mean square
BEYOND = 0.05  # share of measurements that the interval leaves out
PACE, FIRST_PACE = 0.02, 1.0
GAUSSIAN = 1.959963984540054
JUST_NOW, RECENTLY, LONG_AGO = 4, 64, 2000  # samples
SETTLED, LARGEST = 20.0, 16.0
BEYOND_ALL = 1e15  # l/min: an error whose square single precision still holds; more counts nowhere
SECOND = 1_000_000_000  # ns
WRAP = 2**32 - 1  # numbers of samples are kept modulo 2³²: 500 days at 100 Hz
EARLIER = 32  # samples after which every estimator notes its map again; a power of two

Stamps = NDArray[np.uint32]


class Memory(NamedTuple):
    """What is known of the residuals of M maps.

    cells : (M, 120, 3)
        Weight and mean square of the errors of each cell, and the mean square expected as the
        present 32 samples began, in single precision.
    stamps : (M, 120, 2)
        Of the last sample of each cell its time, whole seconds UTC, and its number modulo 2³².
    ages : (M, 120)
        0 where there was none; one more than the cell's age as the present 32 samples began.
    overall : (M, 11)
        The same weight and mean square over all cells; samples counted; by the cell's age, how
        many times its root mean square an error must be to belong to the outer 5 %, and from
        how many that was learnt.
    """

    cells: Singles
    stamps: Stamps
    ages: Codes
    overall: Floats


@kernel
def learn(
    t: Times,
    U: Floats,
    dp: Floats,
    residual: Floats,
    early: Floats,
    memory: Memory,
    segments: Segments,
) -> None:
    """Take N residuals of M maps in, in place; one that is not finite counts nowhere.

    Parameters
    ----------
    residual, early : (N,)
        Against the map just before each sample, and against that of some samples before.
    memory
        Written.
    """
    members, starts, stops = segments
    for s in range(len(members)):
        m = members[s]
        cells, stamps, overall = memory.cells[m], memory.stamps[m], memory.overall[m]
        ages = memory.ages[m]
        if s + 1 < len(members):
            fetch(memory, members[s + 1])
        for i in range(starts[s], stops[s]):
            e = residual[i]
            if not (abs(e) < BEYOND_ALL and np.isfinite(U[i]) and np.isfinite(dp[i])):
                continue
            c = cell_of(U[i], dp[i])
            begun = int(overall[COUNT]) & (EARLIER - 1)  # samples of the present 32 so far
            before = since(overall, stamps, c) - begun
            if before >= 0:  # the first of them in this cell
                ages[c] = 1 + (age(before) if ages[c] > 0 else AGES - 1)
                cells[c, EXPECTED] = mean_square(cells, overall, c)
            if abs(early[i]) < BEYOND_ALL:
                _judge(early[i] * early[i], int(ages[c]) - 1, c, cells, overall)
            stamps[c, LAST] = min(max(t[i] // SECOND, 0), WRAP)
            overall[COUNT] += 1.0
            stamps[c, NUMBER] = int(overall[COUNT]) & WRAP


@inner
def _judge(square: float, a: int, c: int, cells: Singles, overall: Floats) -> None:
    """Take the square of an error in: was it outside, and how far off is the map in its cell.

    ``a`` is the cell's age when its mean square was expected.
    """
    expected = cells[c, EXPECTED]
    if overall[WEIGHT] > SETTLED and expected > 0.0:
        missed = 1.0 if square > overall[QUANTILE + a] ** 2 * expected else 0.0
        overall[TIMES + a] += 1.0
        pace = max(PACE, min(FIRST_PACE, 2.0 / overall[TIMES + a]))
        overall[QUANTILE + a] *= np.exp(pace * (missed - BEYOND))
        square = min(square, LARGEST * expected)
    overall[WEIGHT] = (1.0 - 1.0 / MEMORY) * overall[WEIGHT] + 1.0
    overall[SQUARES] += (square - overall[SQUARES]) / overall[WEIGHT]
    cells[c, WEIGHT] = (1.0 - 1.0 / CELL_MEMORY) * cells[c, WEIGHT] + 1.0
    cells[c, SQUARES] += (square - cells[c, SQUARES]) / cells[c, WEIGHT]


@inner
def cell_of(U: float, dp: float) -> int:
    """Number of the cell that a point falls into; the outermost reach on for ever."""
    row = min(max(U / WIDTH_U, 0.0), CELLS_U - 1.0)
    column = min(np.sqrt(abs(dp)) / WIDTH_S, CELLS_S - 1.0)
    return int(row) * CELLS_S + int(column)


@inner
def since(overall: Floats, stamps: Stamps, c: int) -> int:
    """Samples since the last one of a cell."""
    return (int(overall[COUNT]) - int(stamps[c, NUMBER])) & WRAP


@inner
def age(samples: int) -> int:
    """How long ago, in four steps, a cell was visited: the map may have moved meanwhile."""
    return 0 if samples < JUST_NOW else 1 if samples < RECENTLY else 2 if samples < LONG_AGO else 3


@inner
def mean_square(cells: Singles, overall: Floats, c: int) -> float:
    """Mean square of a cell's residuals, leaning on all others while it has few of its own."""
    own = np.float64(cells[c, WEIGHT])
    total = own * cells[c, SQUARES] + BORROWED * overall[SQUARES]
    return float(total / (own + BORROWED))


@kernel
def spread(cells: Singles, overall: Floats, U: Floats, dp: Floats, out: Floats) -> None:
    """Write the root mean square of the residuals around N points; NaN before the first."""
    for i in range(len(U)):
        out[i] = np.nan
        if overall[WEIGHT] > 0.0 and np.isfinite(U[i]) and np.isfinite(dp[i]):
            out[i] = np.sqrt(mean_square(cells, overall, cell_of(U[i], dp[i])))


@kernel
def reach(
    cells: Singles,
    stamps: Stamps,
    ages: Codes,
    overall: Floats,
    U: Floats,
    dp: Floats,
    out: Floats,
) -> None:
    """Write within what 95 % of the residuals around N points lie; NaN before the first."""
    for i in range(len(U)):
        out[i] = np.nan
        if overall[WEIGHT] > 0.0 and np.isfinite(U[i]) and np.isfinite(dp[i]):
            c = cell_of(U[i], dp[i])
            a = age(since(overall, stamps, c)) if ages[c] > 0 else AGES - 1
            multiple = overall[QUANTILE + a]
            out[i] = multiple * np.sqrt(mean_square(cells, overall, c))
