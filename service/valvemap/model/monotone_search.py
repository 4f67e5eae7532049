"""Safeguarded root finding along U for many points at once, for maps of any kind."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Floats
from valvemap.vocabulary.statuses import InverseStatus

Points = NDArray[np.intp]
Flow = Callable[[Floats, Points], Floats]

CHUNK: Final = 1024
LEVELS: Final = 65
FALL: Final = 0.05
STEPS: Final = 64


def search(
    flow: Flow, Q: Floats, reach: tuple[float, float] = (0.0, 100.0)
) -> tuple[Floats, Floats, Codes]:
    """Return the smallest U on a rising branch with flow = Q, within ``reach``.

    ``flow(U, points)`` gives the flow at U for the named points. The map is evaluated on a grid
    of 65 levels. Features narrower than 1.6 % of U may be missed. A fall of less than 5 % of the
    map's span is ignored when a demand is judged out of reach.

    Returns
    -------
    U, slope, status : (N,)
        U in %, NaN without an answer; dQ/dU by central difference; :class:`InverseStatus`.
    """
    parts = [
        _search(flow, Q[start : start + CHUNK], np.arange(start, min(start + CHUNK, len(Q))), reach)
        for start in range(0, len(Q), CHUNK)
    ]
    if not parts:
        return np.empty(0), np.empty(0), np.empty(0, np.uint8)
    U, slope, status = (np.concatenate(column) for column in zip(*parts, strict=True))
    return U, slope, status


def _search(
    flow: Flow, Q: Floats, points: Points, reach: tuple[float, float]
) -> tuple[Floats, Floats, Codes]:
    grid = np.linspace(*reach, LEVELS)
    levels = flow(np.tile(grid, len(Q)), np.repeat(points, LEVELS)).reshape(len(Q), -1)
    size = np.maximum(np.abs(levels).max(axis=1), np.abs(Q))
    tolerance = 1e-13 * size
    status = _verdict(levels, Q, tolerance)
    demand = Q[:, None]
    rising = (levels[:, :-1] < demand) & (levels[:, 1:] >= demand)
    at_start = (np.abs(levels[:, 0] - Q) <= tolerance) & (levels[:, 1] >= Q - tolerance)
    U = np.select(
        [status == InverseStatus.ABOVE_REACH, status <= InverseStatus.BELOW_REACH],
        [reach[1], reach[0]],
        np.nan,
    )
    inside = np.flatnonzero((status == InverseStatus.OK) & ~at_start)
    left = rising[inside].argmax(axis=1)
    U[inside] = _root(
        lambda u, rows: flow(u, points[inside[rows]]) - Q[inside[rows]],
        grid[left],
        grid[left + 1],
        tolerance[inside],
    )
    return U, _slope(flow, U, points, reach), status


def _verdict(levels: Floats, Q: Floats, tolerance: Floats) -> Codes:
    demand = Q[:, None]
    rises = ((levels[:, :-1] < demand) & (levels[:, 1:] >= demand)).any(axis=1)
    at_start = (np.abs(levels[:, 0] - Q) <= tolerance) & (levels[:, 1] >= Q - tolerance)
    highest, lowest = levels.max(axis=1), levels.min(axis=1)
    dips = FALL * (highest - lowest)
    above = (highest < Q) & (levels[:, -1] >= highest - dips)
    below = (lowest > Q) & (levels[:, 0] <= lowest + dips)
    verdict = np.select(
        [~np.isfinite(levels).all(axis=1), rises | at_start, above, below],
        [
            InverseStatus.UNIDENTIFIED,
            InverseStatus.OK,
            InverseStatus.ABOVE_REACH,
            InverseStatus.BELOW_REACH,
        ],
        InverseStatus.NOT_MONOTONE,
    )
    return np.asarray(verdict, np.uint8)


def _root(f: Flow, low: Floats, high: Floats, tolerance: Floats) -> Floats:
    """Return the smallest root of f in [low, high], where f(low) < 0 <= f(high).

    Illinois steps, with a bisection in every third. A root on a plateau is moved to the plateau's
    left end by bisection.
    """
    start, low, high = low, low.copy(), high.copy()
    every = np.arange(len(low))
    f_low, f_high = f(low, every), f(high, every)
    active = every[f_high > tolerance]
    side = np.zeros(len(low), np.int8)
    for step in range(STEPS):
        if not len(active):
            break
        a, b, fa, fb = low[active], high[active], f_low[active], f_high[active]
        u = (a * fb - b * fa) / (fb - fa)
        middle = 0.5 * (a + b)
        u = np.where((u > a) & (u < b) & (step % 3 != 2), u, middle)
        fu = f(u, active)
        up = fu >= 0.0
        # Illinois: halve the value of an end that is kept twice.
        twice = np.where(side[active] == np.where(up, 1, -1), 0.5, 1.0)
        side[active] = np.where(up, 1, -1)
        low[active], f_low[active] = np.where(up, a, u), np.where(up, twice * fa, fu)
        high[active], f_high[active] = np.where(up, u, b), np.where(up, fu, twice * fb)
        narrow = (high[active] - low[active]) <= 4e-16 * np.abs(high[active])
        active = active[~narrow & (np.abs(fu) > tolerance[active])]
    ends = np.where(np.abs(f(low, every)) < np.abs(f(high, every)), low, high)
    return _left_end(f, ends, start, tolerance)


def _left_end(f: Flow, U: Floats, start: Floats, tolerance: Floats) -> Floats:
    """Move each root on a plateau (flat over 1e-6 %) to its left end, not before ``start``."""
    U = U.copy()
    every = np.arange(len(U))
    near = np.maximum(U - 1e-6, start)
    flat = np.flatnonzero(np.abs(f(near, every)) <= tolerance)
    low, high = start[flat], near[flat]
    for _ in range(STEPS):
        if not len(flat):
            break
        middle = 0.5 * (low + high)
        on = np.abs(f(middle, flat)) <= tolerance[flat]
        low, high = np.where(on, low, middle), np.where(on, middle, high)
    U[flat] = high
    return U


def _slope(
    flow: Flow, U: Floats, points: Points, reach: tuple[float, float], h: float = 1e-3
) -> Floats:
    at = np.clip(np.nan_to_num(U), *reach)
    below, above = np.maximum(at - h, reach[0]), np.minimum(at + h, reach[1])
    return np.asarray((flow(above, points) - flow(below, points)) / (above - below))
