"""Support of a map: a grid of boxes around its samples over (U, dp, T), and distances from them.

The cells of the grid over U and dp include outer cells of a whole range. Each stores its number of
samples and their bounding box in bytes: finer than the cells, and as small as a bitmap.
"""

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.kernels.prefetch import fetch
from valvemap.model.samples import Codes, Floats, Segments

INNER_U, INNER_DP = 20, 20
CELLS_U, CELLS_DP = INNER_U + 2, INNER_DP + 2

# Offsets in a cell; boxes in 1/256 of the cell, temperatures by `T_LOWEST` and `T_STEP`.
# No samples between T_COLD and T_HOT: a valve may have been measured cold and hot only.
NUMBER, U_LOW, U_HIGH, DP_LOW, DP_HIGH, T_LOW, T_HIGH, T_COLD, T_HOT = range(9)
PLACES_OF_CELL = 9
FINEST = 256.0
T_LOWEST, T_STEP = -24.0, 0.5  # °C; up to 103.5

NEAR_U, NEAR_DP, NEAR_T = 5.0, 5.0, 5.0  # %, bar, °C: neighbourhood of a sample
NEAR_ROOT = 0.5  # √bar: equals 5 bar at 25 bar
ENOUGH = 3.0  # samples near a point, for it to be inside
BEYOND = 1.0001  # just outside

_LEARNT = 2  # Status.UNEXCITED: samples up to this status were used
_FULL = 255


@kernel
def learn(
    U: Floats,
    dp: Floats,
    T: Floats,
    status: Codes,
    every_cells: Codes,
    every_ranges: Floats,
    segments: Segments,
) -> None:
    """Add the positions of the samples that the estimator used, in place.

    Parameters
    ----------
    every_cells : (M, 484, 9)
        See `NUMBER` and the offsets after it; a cell without samples is all 0, one without a
        temperature has T_LOW > T_HIGH.
    every_ranges : (M, 5)
        Lower and upper limit of U and of dp; the largest flow is not used.
    """
    members, starts, stops = segments
    for s in range(len(members)):
        cells, ranges = every_cells[members[s]], every_ranges[members[s]]
        if s + 1 < len(members):
            fetch((every_cells, every_ranges), members[s + 1])
        for i in range(starts[s], stops[s]):
            if status[i] > _LEARNT or not np.isfinite(U[i] + dp[i]):
                continue
            row, part_U = _place(U[i], ranges[0], ranges[1], INNER_U)
            column, part_dp = _place(dp[i], ranges[2], ranges[3], INNER_DP)
            cell = cells[row * CELLS_DP + column]
            if cell[NUMBER] == 0:
                cell[U_LOW], cell[U_HIGH] = part_U, part_U
                cell[DP_LOW], cell[DP_HIGH] = part_dp, part_dp
                cell[T_LOW], cell[T_HIGH] = _FULL, 0
                cell[T_COLD], cell[T_HOT] = 0, 0
            else:
                _widen(cell, U_LOW, part_U)
                _widen(cell, DP_LOW, part_dp)
            if np.isfinite(T[i]):
                _warm(cell, int(min(max(np.rint((T[i] - T_LOWEST) / T_STEP), 0.0), 255.0)))
            if cell[NUMBER] < _FULL:
                cell[NUMBER] += 1


@kernel
def boxes(cells: Codes, ranges: Floats) -> Floats:
    """Return one row for each cell with samples: their number, then low and high of U, dp and T.

    T is NaN without temperatures. The last two are the ends of its widest gap.
    """
    out = np.empty((np.count_nonzero(cells[:, NUMBER]), PLACES_OF_CELL))
    k = 0
    for c in range(len(cells)):
        if cells[c, NUMBER] == 0:
            continue
        out[k, NUMBER] = cells[c, NUMBER]
        _limits(c // CELLS_DP, ranges[0], ranges[1], INNER_U, cells[c], U_LOW, out[k])
        _limits(c % CELLS_DP, ranges[2], ranges[3], INNER_DP, cells[c], DP_LOW, out[k])
        for p in range(T_LOW, T_HOT + 1):
            measured = cells[c, T_LOW] <= cells[c, T_HIGH]
            out[k, p] = T_LOWEST + T_STEP * cells[c, p] if measured else np.nan
        k += 1
    return out


@kernel
def fill(every_box: Floats, ranges: Floats, cells: Codes) -> None:
    """Write the cells of `boxes`, its inverse; ``cells`` are empty."""
    for k in range(len(every_box)):
        box = every_box[k]
        middle_U, middle_dp = (box[U_LOW] + box[U_HIGH]) / 2.0, (box[DP_LOW] + box[DP_HIGH]) / 2.0
        row, _ = _place(middle_U, ranges[0], ranges[1], INNER_U)
        column, _ = _place(middle_dp, ranges[2], ranges[3], INNER_DP)
        cell = cells[row * CELLS_DP + column]
        cell[NUMBER] = int(box[NUMBER])
        _parts(row, ranges[0], ranges[1], INNER_U, box, U_LOW, cell)
        _parts(column, ranges[2], ranges[3], INNER_DP, box, DP_LOW, cell)
        for p in range(T_LOW, T_HOT + 1):
            cell[p] = 0 if np.isnan(box[p]) else int(np.rint((box[p] - T_LOWEST) / T_STEP))
        if np.isnan(box[T_LOW]):
            cell[T_LOW] = _FULL


@kernel
def distances(
    every_box: Floats, U: Floats, dp: Floats, T: Floats, whole: Floats, level: Floats
) -> None:
    """Distance of N points from three samples, in units of the neighbourhood: 1 is the border.

    Parameters
    ----------
    every_box : (n, 9)
        See `boxes`.
    T : (N,)
        NaN: any temperature.
    whole, level : (N,)
        Written: the distance, and the distance without regard to temperature; infinite with fewer
        than three samples.
    """
    for i in range(len(U)):
        whole[i] = _distance(every_box, U[i], dp[i], T[i])
        level[i] = whole[i]
        if whole[i] > 0.0 and not np.isnan(T[i]):
            level[i] = _distance(every_box, U[i], dp[i], np.nan)


@inner
def _distance(every_box: Floats, U: float, dp: float, T: float) -> float:
    """Return the scale of the neighbourhood at which it contains three samples.

    Samples are assumed to be uniform in their cell's box, so that the expected number in the
    neighbourhood decides whether a point is inside.
    """
    first, second, third = np.inf, np.inf, np.inf
    of_first, of_second, expected = 0.0, 0.0, 0.0
    for k in range(len(every_box)):
        box = every_box[k]
        d = _gap(U, box, U_LOW) / NEAR_U
        if d > max(third, 1.0):
            continue
        d = max(d, _gap(dp, box, DP_LOW) / NEAR_DP)
        if d > max(third, 1.0):
            continue
        if not np.isnan(T) and not np.isnan(box[T_LOW]):
            d = max(d, _gap_T(T, box) / NEAR_T)
        if d <= 1.0:
            share = _share(U, box, U_LOW, NEAR_U) * _share(dp, box, DP_LOW, NEAR_DP)
            if not np.isnan(T) and not np.isnan(box[T_LOW]):
                share *= _share_T(T, box)
            expected += box[NUMBER] * share
        if d < first:
            third, second, of_second = second, first, of_first
            first, of_first = d, box[NUMBER]
        elif d < second:
            third = second
            second, of_second = d, box[NUMBER]
        elif d < third:
            third = d
        if first <= 0.0 and expected >= ENOUGH:
            return 0.0
    if of_first >= ENOUGH:
        third = first
    elif of_first + of_second >= ENOUGH:
        third = second
    return third if expected >= ENOUGH else max(third, BEYOND)


@inner
def _gap(x: float, box: Floats, low: int) -> float:
    return float(max(box[low] - x, x - box[low + 1], 0.0))


@inner
def _gap_T(T: float, box: Floats) -> float:
    """Distance of a temperature from those of a box, which may have a gap between cold and hot."""
    gap = _gap(T, box, T_LOW)
    if gap > 0.0:
        return gap
    return float(max(min(T - box[T_COLD], box[T_HOT] - T), 0.0))


@inner
def _share_T(T: float, box: Floats) -> float:
    """Share of a box's samples within the neighbourhood of T."""
    low, high = T - NEAR_T, T + NEAR_T
    total, within = T_STEP, 0.0
    for start, stop in ((box[T_LOW], box[T_COLD]), (box[T_HOT], box[T_HIGH])):
        total += stop - start
        within += max(min(stop, high) - max(start, low), 0.0)
    return min((within + T_STEP) / total, 1.0)


@inner
def _share(x: float, box: Floats, low: int, near: float) -> float:
    """Share of a box's samples near x: one at either end, the others uniform between them."""
    span = box[low + 1] - box[low]
    within = min(box[low + 1], x + near) - max(box[low], x - near)
    if within >= span or box[NUMBER] < 2.0:
        return 1.0
    return float((1.0 + (box[NUMBER] - 2.0) * within / span) / box[NUMBER])


@inner
def _place(x: float, low: float, high: float, cells: int) -> tuple[int, int]:
    """Return the cell along an axis, and the position in it, in 1/256."""
    share = (x - low) / (high - low)
    if share < 0.0:
        number, part = 0, 1.0 + max(share, -1.0)
    elif share > 1.0:
        number, part = cells + 1, min(share, 2.0) - 1.0
    else:
        number = min(int(share * cells), cells - 1) + 1
        part = share * cells - (number - 1)
    return number, min(int(FINEST * part), _FULL)


@inner
def _limits(
    number: int, low: float, high: float, cells: int, cell: Codes, first: int, out: Floats
) -> None:
    """Write the limits of a cell's samples along one axis."""
    start, width = _cell(number, low, high, cells)
    out[first] = start + width * cell[first] / FINEST
    out[first + 1] = start + width * (cell[first + 1] + 1.0) / FINEST


@inner
def _parts(
    number: int, low: float, high: float, cells: int, box: Floats, first: int, cell: Codes
) -> None:
    """Inverse of `_limits`."""
    start, width = _cell(number, low, high, cells)
    cell[first] = int(np.rint(FINEST * (box[first] - start) / width))
    cell[first + 1] = int(np.rint(FINEST * (box[first + 1] - start) / width)) - 1


@inner
def _cell(number: int, low: float, high: float, cells: int) -> tuple[float, float]:
    """Return the lower limit of a cell, and its width."""
    width = (high - low) / cells
    if number == 0:
        return low - (high - low), high - low
    if number == cells + 1:
        return high, high - low
    return low + (number - 1) * width, width


@inner
def _warm(cell: Codes, T: int) -> None:
    """Extend a cell's temperatures to T, and store their widest gap."""
    low, high = int(cell[T_LOW]), int(cell[T_HIGH])
    cold, hot = int(cell[T_COLD]), int(cell[T_HOT])
    if low > high:  # the first
        cell[T_LOW:] = T
    elif low > T:
        cell[T_LOW] = T
        if low - T > hot - cold:
            cell[T_COLD], cell[T_HOT] = T, low
    elif high < T:
        cell[T_HIGH] = T
        if T - high > hot - cold:
            cell[T_COLD], cell[T_HOT] = high, T
    elif cold < T < hot:
        if T - cold > hot - T:
            cell[T_HOT] = T
        else:
            cell[T_COLD] = T


@inner
def _widen(cell: Codes, low: int, x: int) -> None:
    """Extend a box to x."""
    cell[low] = min(cell[low], x)
    cell[low + 1] = max(cell[low + 1], x)
