"""The ladder of shapes: which ones there are, their splines, and the steps from one to another.

A shape is six numbers: cells in U (0: eq. (7) alone), axis, dead band and saturation in % (NaN: no
kink), play in %, trend. See :class:`valvemap.model.map_shapes.Shape`.
"""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.samples import Floats

CELLS_OF, AXIS, DEAD_BAND, SATURATION, PLAY, TREND = 0, 1, 2, 3, 4, 5
CELLS = np.array([0, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20])
BREAKS = np.array([4, 5, 7])  # of each axis, as shares of the largest √dp, finest near 0
AXES = np.array(
    [
        [0.0, 0.21, 0.56, 1.0, 0.0, 0.0, 0.0],
        [0.0, 0.1, 0.28, 0.56, 1.0, 0.0, 0.0],
        [0.0, 0.05, 0.106, 0.21, 0.42, 0.7, 1.0],
    ]
)
MOST = 156  # parameters of the largest spline that may be chosen: 16 kB of inverse
MOST_NEIGHBOURS = 72
SMOOTHNESS = 0.3  # root of the prior's weight, in samples: next to nothing where there are data
# %, tried first; 1 % apart where most lie: 2 % beside the best, a kink may not lower the BIC
DEAD_BANDS = np.array([2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0])
SATURATIONS = np.array([98.0, 97.0, 95.0, 93.0, 90.0, 85.0, 80.0, 70.0])  # %, tried first
KINK_STEPS = np.array([0.25, 0.5, 1.0, 2.0])  # %
PLAY_STEPS = np.array([0.25, -0.25, 0.1, -0.1, 0.03, -0.03, 1.0, -1.0])  # %
LEAST_DEAD, MOST_DEAD, LEAST_FULL, MOST_FULL, MOST_PLAY = 0.5, 40.0, 60.0, 99.5, 3.0  # %


@inner
def size(shape: Floats) -> int:
    """Parameters of the spline; 0 without one."""
    cells = int(shape[CELLS_OF])
    if cells == 0:
        return 0
    kinks = int(not math.isnan(shape[DEAD_BAND])) + int(not math.isnan(shape[SATURATION]))
    breaks: int = BREAKS[int(shape[AXIS])]
    return (cells + 3 + 3 * kinks) * (breaks + 2)


@kernel
def neighbours(shape: Floats, least_play: float, trends: int, found: Floats) -> int:
    """Fill the shapes one step away, in a fixed order; their number.

    ``least_play`` is what the samples can tell, %; infinite: none. ``trends``: 1 if they can tell a
    trend with temperature.
    """
    count = 0
    at = shape.copy()
    at[CELLS_OF], at[AXIS], at[DEAD_BAND], at[SATURATION] = 0.0, 0.0, math.nan, math.nan
    count = _offer(at, shape, found, count)
    count = _offer_cells(shape, found, count)
    for axis in range(len(AXES)):
        count = _offer_one(shape, AXIS, float(axis), found, count)
    for change in PLAY_STEPS:
        if shape[PLAY] + change >= least_play:
            count = _offer_play(shape, change, found, count)
    if shape[PLAY] > 0.0:
        count = _offer_play(shape, -shape[PLAY], found, count)
    if trends or shape[TREND] > 0.0:
        count = _offer_one(shape, TREND, 1.0 - shape[TREND], found, count)
    count = _offer_kink(shape, DEAD_BAND, DEAD_BANDS, found, count)
    return _offer_kink(shape, SATURATION, SATURATIONS, found, count)


@maker
def _offer_cells(shape: Floats, found: Floats, count: int) -> int:
    """Offer other numbers of cells, the nearest first."""
    offered = np.zeros(len(CELLS), np.bool_)
    for _ in range(1, len(CELLS)):
        nearest = -1
        for k in range(1, len(CELLS)):
            way = abs(CELLS[k] - shape[CELLS_OF])
            if not offered[k] and (nearest < 0 or way < abs(CELLS[nearest] - shape[CELLS_OF])):
                nearest = k
        offered[nearest] = True
        count = _offer_one(shape, CELLS_OF, float(CELLS[nearest]), found, count)
    return count


@maker
def _offer_play(shape: Floats, change: float, found: Floats, count: int) -> int:
    """More or less play: about the same middle, the same rising or the same falling branch."""
    kinked = not (math.isnan(shape[DEAD_BAND]) and math.isnan(shape[SATURATION]))
    at = shape.copy()
    at[PLAY] = _rounded(shape[PLAY] + change)
    for side in range(3 if kinked else 1):
        shift = (0.0, -change, change)[side]
        at[DEAD_BAND] = _rounded(shape[DEAD_BAND] + shift)
        at[SATURATION] = _rounded(shape[SATURATION] + shift)
        count = _offer(at, shape, found, count)
    return count


@inner
def _offer_kink(shape: Floats, place: int, first: Floats, found: Floats, count: int) -> int:
    if math.isnan(shape[place]):
        for kink in first:
            count = _offer_one(shape, place, kink, found, count)
        return count
    for step in KINK_STEPS:
        count = _offer_one(shape, place, _rounded(shape[place] + step), found, count)
        count = _offer_one(shape, place, _rounded(shape[place] - step), found, count)
    return _offer_one(shape, place, math.nan, found, count)


@maker
def _offer_one(shape: Floats, place: int, number: float, found: Floats, count: int) -> int:
    at = shape.copy()
    at[place] = number
    return _offer(at, shape, found, count)


@inner
def _offer(at: Floats, shape: Floats, found: Floats, count: int) -> int:
    """Add a shape, if it is possible and another one."""
    if not _is_possible(at):
        return count
    same = True
    for k in range(len(at)):
        both_open = math.isnan(at[k]) and math.isnan(shape[k])
        same = same and (both_open or at[k] == shape[k])
    if same:
        return count
    for k in range(len(at)):
        found[count, k] = at[k]
    return count + 1


@inner
def _is_possible(at: Floats) -> bool:
    """Whether kinks and play lie where they can, and the spline is not too large."""
    low, high = at[DEAD_BAND], at[SATURATION]
    plain = math.isnan(low) and math.isnan(high) and at[AXIS] == 0.0
    return (
        (math.isnan(low) or LEAST_DEAD <= low <= MOST_DEAD)
        and (math.isnan(high) or LEAST_FULL <= high <= MOST_FULL)
        and 0.0 <= at[PLAY] <= MOST_PLAY
        and (at[CELLS_OF] > 0.0 or plain)
        and size(at) <= MOST
    )


@inner
def _rounded(x: float) -> float:
    """To a thousandth; NaN stays."""
    return math.floor(x * 1000.0 + 0.5) / 1000.0 if not math.isnan(x) else x


@kernel
def knots_U(shape: Floats) -> Floats:
    """Clamped knots in U, each kink three times; without a spline those of one cell."""
    low, high = shape[DEAD_BAND], shape[SATURATION]
    cells = max(int(shape[CELLS_OF]), 1)
    start = 0.0 if math.isnan(low) else low
    stop = 100.0 if math.isnan(high) else high
    kinks = int(not math.isnan(low)) + int(not math.isnan(high))
    knots = np.zeros(cells + 7 + 3 * kinks)
    at = 4
    if not math.isnan(low):
        knots[at : at + 3] = low
        at += 3
    for k in range(1, cells):
        knots[at] = start + (stop - start) * k / cells
        at += 1
    if not math.isnan(high):
        knots[at : at + 3] = high
        at += 3
    knots[at:] = 100.0
    return knots


@kernel
def knots_s(shape: Floats, top: float) -> Floats:
    """Clamped knots in √dp up to √top; without a spline those of one cell."""
    breaks = BREAKS[int(shape[AXIS])] if shape[CELLS_OF] > 0.0 else 2
    knots = np.zeros(breaks + 6)
    for k in range(1, breaks):
        share = AXES[int(shape[AXIS]), k] if breaks > 2 else 1.0
        knots[3 + k] = share * math.sqrt(top)
    knots[breaks + 2 :] = math.sqrt(top)
    return knots


@kernel
def sites(knots: Floats) -> Floats:
    """Greville points: the means of three inner knots."""
    found = np.empty(len(knots) - 4)
    for i in range(len(found)):
        found[i] = (knots[i + 1] + knots[i + 2] + knots[i + 3]) / 3.0
    return found


@kernel
def roughness(sites: Floats, low: float, high: float) -> Floats:
    """The prior's information (n, n): bends between kinks, steps beyond them, none across.

    ``low`` and ``high`` are NaN where there is no kink.
    """
    n = len(sites)
    rough = np.zeros((n, n))
    row = np.zeros(3)
    for i in range(1, n - 1):
        if not (sites[i] <= low or sites[i] >= high):
            left, right = sites[i] - sites[i - 1], sites[i + 1] - sites[i]
            row[0], row[1], row[2] = -right / (left + right), 1.0, -left / (left + right)
            _add_square(rough, row, i - 1, 3)
    row[0], row[1] = -1.0, 1.0
    for i in range(n - 1):
        if sites[i + 1] <= low or sites[i] >= high:
            _add_square(rough, row, i, 2)
    return rough


@inner
def _add_square(rough: Floats, row: Floats, at: int, width: int) -> None:
    for a in range(width):
        for b in range(width):
            rough[at + a, at + b] += SMOOTHNESS * SMOOTHNESS * row[a] * row[b]
