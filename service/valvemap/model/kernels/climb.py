"""The climb on the ladder: shapes fitted to the cells of the memory, compared by BIC."""

import math

import numpy as np

from valvemap.model.kernels import ladder
from valvemap.model.kernels.compiled import inner, kernel, maker, spliced
from valvemap.model.kernels.grid import DIRECTION, MEAN_Q, MEAN_U, WEIGHT
from valvemap.model.kernels.map_fit import fit_rows, plan_of
from valvemap.model.kernels.map_rows import RowsInS, rows_in_s
from valvemap.model.kernels.surface import BORDER
from valvemap.model.samples import Floats

RICH_CELLS, RICH_AXIS = 20.0, 2.0  # the richest spline, whose residual is taken for the noise
LEAST_GAIN = 0.1  # in BIC: less is rounding
NEVER_BELOW = 1e-5  # of the largest flow: the noise of samples without any
BEYOND = 2  # points beyond a kink, at least: of one, the flow's level there and its slope are one
MOVE, IDLE = 0, 1


@kernel
def climb(
    points: Floats, shape: Floats, top: float, least_play: float, trends: int,
    steps: int, progress: np.ndarray, least: float, rich: Floats,
) -> None:  # fmt: skip
    """Try the next ``steps`` neighbours in turn; go to each that lowers the BIC, and on that way.

    A trend is tried each time, where there is none and the samples can tell one: temperature may
    have moved just now. ``shape`` (6,) and ``progress`` (2,) are written: the number of the next
    neighbour, and how many were tried in vain since the last gain. σ² is ``least`` at least:
    coloured noise is the same in neighbouring cells, and a rich spline follows it. ``rich`` (5,)
    holds what the richest spline has left before, see `noise`, and is written.
    """
    around = np.empty((ladder.MOST_NEIGHBOURS, len(shape)))
    in_s = _of_axes(points, top)
    sigma_2 = max(_noise(points, in_s, shape, top, rich), least)
    best = _bic(points, in_s, shape, top, sigma_2)
    if trends and shape[ladder.TREND] == 0.0:
        around[0] = shape
        around[0, ladder.TREND] = 1.0
        warm = _bic(points, in_s, around[0], top, sigma_2)
        if warm < best - LEAST_GAIN:
            shape[:], best, progress[IDLE] = around[0], warm, 0
    count = ladder.neighbours(shape, least_play, trends, around)
    for _ in range(steps):
        candidate = around[progress[MOVE] % count]
        if _bic(points, in_s, candidate, top, sigma_2) >= best - LEAST_GAIN:
            progress[MOVE] += 1
            progress[IDLE] += 1
        else:
            shape[:] = candidate
            progress[IDLE] = 0
            count = ladder.neighbours(shape, least_play, trends, around)
            sigma_2 = max(_noise(points, in_s, shape, top, rich), least)
            best = _bic(points, in_s, shape, top, sigma_2)


@kernel
def bic(points: Floats, shape: Floats, top: float, sigma_2: float) -> float:
    """(Σ w·e² + penalty + fall) / σ² + n_effective · ln(points).

    Infinite if no number, or if fewer than BEYOND points lie beyond a kink.
    """
    return float(_bic(points, _of_axes(points, top), shape, top, sigma_2))


@kernel
def noise(points: Floats, shape: Floats, top: float, rich: Floats) -> float:
    """σ² that the richest spline with the shape's kinks, play and trend leaves.

    Its fit costs as much as four others. ``rich`` (5,) is the last σ² with those kinks, play and
    trend, and is written; a σ² of 0 there says that nothing is known.
    """
    return float(_noise(points, _of_axes(points, top), shape, top, rich))


@maker
def _of_axes(points: Floats, top: float) -> list[RowsInS]:
    """What hangs on s alone, for the shapes of each axis."""
    shape = np.array([1.0, 0.0, math.nan, math.nan, 0.0, 0.0])
    found = []
    for axis in range(len(ladder.AXES)):
        shape[ladder.AXIS] = axis
        found.append(rows_in_s(points, ladder.knots_s(shape, top)))
    return found


@spliced
def _bic(points: Floats, in_s: list[RowsInS], shape: Floats, top: float, sigma_2: float) -> float:
    if not _is_seen(points, shape):
        return math.inf
    rss, penalty, fall, n_effective = _fit(points, in_s, shape, top)
    criterion = (rss + penalty + fall) / sigma_2 + n_effective * math.log(len(points))
    return criterion if math.isfinite(criterion) else math.inf


@inner
def _is_seen(points: Floats, shape: Floats) -> bool:
    """Whether points lie beyond the shape's kinks, by the least step of one.

    A kink without any costs nothing, as no point tells anything of what lies beyond it. Nor does
    one of less than a sample, but where most are such: after a change, of which the shape is kept.
    """
    low, high = shape[ladder.DEAD_BAND], shape[ladder.SATURATION]
    below, above, known = 0, 0, 0
    for i in range(len(points)):
        known += points[i, WEIGHT] >= 1.0
    least = 1.0 if 2 * known >= len(points) else 0.0
    for i in range(len(points)):
        if points[i, WEIGHT] < least:
            continue
        at = points[i, MEAN_U] - shape[ladder.PLAY] * points[i, DIRECTION]
        below += at < low - ladder.KINK_STEPS[0]
        above += at > high + ladder.KINK_STEPS[0]
    return (math.isnan(low) or below >= BEYOND) and (math.isnan(high) or above >= BEYOND)


@spliced
def _noise(points: Floats, in_s: list[RowsInS], shape: Floats, top: float, rich: Floats) -> float:
    own = shape[ladder.DEAD_BAND :]
    if rich[0] == 0.0 or not _are_same(own, rich[1:]):
        rich[0], rich[1:] = _left_by_richest(points, in_s, shape, top), own
    return float(rich[0])


@inner
def _are_same(a: Floats, b: Floats) -> bool:
    for i in range(len(a)):
        if a[i] != b[i] and not (math.isnan(a[i]) and math.isnan(b[i])):
            return False
    return True


@spliced
def _left_by_richest(points: Floats, in_s: list[RowsInS], shape: Floats, top: float) -> float:
    richest = shape.copy()
    richest[ladder.CELLS_OF], richest[ladder.AXIS] = RICH_CELLS, RICH_AXIS
    rss, _, _, n_effective = _fit(points, in_s, richest, top)
    largest = 0.0
    for i in range(len(points)):
        largest = max(largest, abs(points[i, MEAN_Q]))
    floor = (NEVER_BELOW * largest) ** 2
    return max(rss / max(len(points) - n_effective, 1.0), floor, 1e-30)


@spliced
def _fit(
    points: Floats, in_s: list[RowsInS], shape: Floats, top: float
) -> tuple[float, float, float, float]:
    plan = plan_of(shape, top)
    n, band = plan.n, 3 * len(plan.sites_s) + 4
    return fit_rows(
        points,
        in_s[int(shape[ladder.AXIS])],
        plan,
        np.empty(n + BORDER),
        np.zeros(n * (2 * band - 1)),
        np.empty((n, BORDER)),
        np.empty((BORDER, BORDER)),
    )
