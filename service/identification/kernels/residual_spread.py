"""The loop that learns, region by region, how far measurements lie off the map."""

import numpy as np

from service.identification.kernels.compiled import inner, kernel
from service.identification.samples import Floats, Segments, Times

CELLS_U, CELLS_S = 10, 12
WIDTH_U, WIDTH_S = 10.0, 1.5  # %, √bar

# Places in a cell, and in `overall`.
WEIGHT, SQUARES, LAST, NUMBER, BEFORE, EXPECTED = range(6)
PLACES_OF_CELL = 6
AGES = 4  # of a cell: just now, recently, long ago, longer ago or never
COUNT, QUANTILE = 2, 3
TIMES = QUANTILE + AGES
PLACES_OVERALL = TIMES + AGES

CELL_MEMORY, MEMORY = 100.0, 400.0  # samples
BORROWED = 8.0  # samples' worth of the whole map in each cell's mean square
BEYOND = 0.05  # share of measurements that the interval leaves out
PACE, FIRST_PACE = 0.02, 1.0
GAUSSIAN = 1.959963984540054
JUST_NOW, RECENTLY, LONG_AGO = 4.0, 64.0, 2000.0  # samples
SETTLED, LARGEST = 20.0, 16.0
NEVER = -1e18
EARLIER = 32  # samples after which every estimator notes its map again; a power of two


@kernel
def learn(
    t: Times,
    U: Floats,
    dp: Floats,
    residual: Floats,
    early: Floats,
    every_cells: Floats,
    every_overall: Floats,
    segments: Segments,
) -> None:
    """Take N residuals of M maps in, in place; one that is not finite counts nowhere.

    Parameters
    ----------
    residual, early : (N,)
        Against the map just before each sample, and against that of some samples before.
    every_cells : (M, 120, 6)
        Weight, mean square of the errors, time and number of the last sample of each cell; as the
        present 32 samples began, number of the last one and the mean square expected.
    every_overall : (M, 11)
        The same weight and mean square over all cells; samples counted; by the cell's age, how
        many times its root mean square an error must be to belong to the outer 5 %, and from
        how many that was learnt.
    """
    members, starts, stops = segments
    for s in range(len(members)):
        cells, overall = every_cells[members[s]], every_overall[members[s]]
        for i in range(starts[s], stops[s]):
            e = residual[i]
            if not (abs(e) < 1e100 and np.isfinite(U[i]) and np.isfinite(dp[i])):
                continue
            c = cell_of(U[i], dp[i])
            began = EARLIER * np.floor(overall[COUNT] / EARLIER)
            if cells[c, NUMBER] <= began:
                cells[c, BEFORE] = cells[c, NUMBER] if cells[c, NUMBER] > 0.0 else NEVER
                cells[c, EXPECTED] = mean_square(cells, overall, c)
            if abs(early[i]) < 1e100:
                _judge(early[i] * early[i], age(began - cells[c, BEFORE]), c, cells, overall)
            cells[c, LAST] = t[i]
            overall[COUNT] += 1.0
            cells[c, NUMBER] = overall[COUNT]


@inner
def _judge(square: float, a: int, c: int, cells: Floats, overall: Floats) -> None:
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
def age(samples: float) -> int:
    """How long ago, in four steps, a cell was visited: the map may have moved meanwhile."""
    return 0 if samples < JUST_NOW else 1 if samples < RECENTLY else 2 if samples < LONG_AGO else 3


@inner
def mean_square(cells: Floats, overall: Floats, c: int) -> float:
    """Mean square of a cell's residuals, leaning on all others while it has few of its own."""
    weight = cells[c, WEIGHT] + BORROWED
    total = cells[c, WEIGHT] * cells[c, SQUARES] + BORROWED * overall[SQUARES]
    return float(total / weight)


@kernel
def spread(cells: Floats, overall: Floats, U: Floats, dp: Floats, out: Floats) -> None:
    """Write the root mean square of the residuals around N points; NaN before the first."""
    for i in range(len(U)):
        out[i] = np.nan
        if overall[WEIGHT] > 0.0 and np.isfinite(U[i]) and np.isfinite(dp[i]):
            out[i] = np.sqrt(mean_square(cells, overall, cell_of(U[i], dp[i])))


@kernel
def reach(cells: Floats, overall: Floats, U: Floats, dp: Floats, out: Floats) -> None:
    """Write within what 95 % of the residuals around N points lie; NaN before the first."""
    for i in range(len(U)):
        out[i] = np.nan
        if overall[WEIGHT] > 0.0 and np.isfinite(U[i]) and np.isfinite(dp[i]):
            c = cell_of(U[i], dp[i])
            seen = cells[c, NUMBER] > 0.0
            a = age(overall[COUNT] - cells[c, NUMBER]) if seen else AGES - 1
            multiple = overall[QUANTILE + a]
            out[i] = multiple * np.sqrt(mean_square(cells, overall, c))
