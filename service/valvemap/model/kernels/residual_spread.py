"""Recursion of the local spread of residuals."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.kernels.prefetch import fetch
from valvemap.model.samples import Codes, Floats, Segments, Singles, Times

CELLS_U, CELLS_S = 10, 12
WIDTH_U, WIDTH_S = 10.0, 1.5  # %, √bar

# Offsets in a cell, in its stamps, and in `overall`.
WEIGHT, SQUARES, EXPECTED = range(3)
PLACES_OF_CELL = 3
LAST, NUMBER = range(2)
PLACES_OF_STAMPS = 2
AGES = 4  # age classes of a cell: just now, recently, long ago, longer ago or never
COUNT, QUANTILE = 2, 3
TIMES = QUANTILE + AGES
PLACES_OVERALL = TIMES + AGES

CELL_MEMORY, MEMORY = 100.0, 400.0  # samples
BORROWED = 8.0  # samples' weight of the overall mean square in that of each cell
BEYOND = 0.05  # share of measurements outside the interval
PACE, FIRST_PACE = 0.02, 1.0
GAUSSIAN = 1.959963984540054
JUST_NOW, RECENTLY, LONG_AGO = 4, 64, 2000  # samples
SETTLED, LARGEST = 20.0, 16.0
BEYOND_ALL = 1e15  # l/min: larger errors are ignored, since their square exceeds single precision
SECOND = 1_000_000_000  # ns
WRAP = 2**32 - 1  # sample numbers are stored modulo 2³²: 500 days at 100 Hz
EARLIER = 32  # samples between copies of the map in every estimator; a power of two

Stamps = NDArray[np.uint32]


class Memory(NamedTuple):
    """Residual statistics of M maps.

    cells : (M, 120, 3)
        Weight and mean square of the errors of each cell, and the mean square expected at the
        start of the current 32 samples, in single precision.
    stamps : (M, 120, 2)
        Time of each cell's last sample, whole seconds UTC, and its number modulo 2³².
    ages : (M, 120)
        0 without samples; else one more than the cell's age class at the start of the current
        32 samples.
    overall : (M, 11)
        Weight and mean square over all cells; number of samples; for each age class, the multiple
        of the root mean square that 5 % of the errors exceed, and its number of samples.
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
    """Add N residuals of M maps, in place; residuals that are not finite are ignored.

    Parameters
    ----------
    residual, early : (N,)
        With respect to the map before each sample, and to that of some samples before.
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
            begun = int(overall[COUNT]) & (EARLIER - 1)  # samples of the current 32
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
    """Add a squared error: update the coverage and the mean square of its cell.

    ``a`` is the cell's age class when its mean square was expected.
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
    """Return the cell of a point; the outermost cells are unbounded."""
    row = min(max(U / WIDTH_U, 0.0), CELLS_U - 1.0)
    column = min(np.sqrt(abs(dp)) / WIDTH_S, CELLS_S - 1.0)
    return int(row) * CELLS_S + int(column)


@inner
def since(overall: Floats, stamps: Stamps, c: int) -> int:
    """Return the number of samples since the last one of a cell."""
    return (int(overall[COUNT]) - int(stamps[c, NUMBER])) & WRAP


@inner
def age(samples: int) -> int:
    """Return the age class of a cell: the map may have moved since its last visit."""
    return 0 if samples < JUST_NOW else 1 if samples < RECENTLY else 2 if samples < LONG_AGO else 3


@inner
def mean_square(cells: Singles, overall: Floats, c: int) -> float:
    """Return the mean square of a cell's residuals, shrunk to the overall one while it has few."""
    own = np.float64(cells[c, WEIGHT])
    total = own * cells[c, SQUARES] + BORROWED * overall[SQUARES]
    return float(total / (own + BORROWED))


@kernel
def spread(cells: Singles, overall: Floats, U: Floats, dp: Floats, out: Floats) -> None:
    """Write the root mean square of the residuals around N points; NaN without residuals."""
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
    """Write the half width that covers 95 % of the residuals around N points; NaN without any."""
    for i in range(len(U)):
        out[i] = np.nan
        if overall[WEIGHT] > 0.0 and np.isfinite(U[i]) and np.isfinite(dp[i]):
            c = cell_of(U[i], dp[i])
            a = age(since(overall, stamps, c)) if ages[c] > 0 else AGES - 1
            multiple = overall[QUANTILE + a]
            out[i] = multiple * np.sqrt(mean_square(cells, overall, c))
