"""The search for the numbers of :mod:`~valvemap.model.spool_model` that fit best. Pure.

Levenberg-Marquardt from several starts. U between two samples is either constant, as a controller's
output is, or a line, as a slow signal is. The wrong one biases f, and both fit nearly as well: a
line is taken only if it is significantly better.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Samples
from valvemap.model.spool_model import (
    BEYOND,
    FASTEST,
    LAG,
    NO_SLEW,
    PARTS,
    SLOWEST,
    STEP_S,
    TINY,
    Grid,
    Hold,
    Point,
    residual,
)

SEEN: Final = 0.4  # of the sampling rate: quicker spools do not show
STARTS_HZ: Final = (4.0, 7.0, 12.0, 20.0, 35.0, 60.0, 100.0)
STARTS_LAG_S: Final = (0.003, 0.012, 0.035)
STARTS_SLEW: Final = (math.inf, 0.5, 0.25, 0.12)  # of the fastest that a full step reaches
FASTEST_STEP: Final = 240.0  # %/s per Hz of f: a full step of a spool without a limit
STARTS_DELAY_S: Final = tuple(0.003 * 1.7**k for k in range(12))  # up to 1 s
OF_DELAY: Final = {
    "spool": (0.1, 0.25, 0.5, 1.0),
    "dead": (0.0, 0.15, 0.5),
    "lag": (0.0, 0.15, 0.5, 1.0),
}
START_S: Final = 8.0  # s of samples on which starts are compared
KEPT: Final = 4  # starts that are continued
COLOURS_S: Final = (0.1, 1.0, 5.0)  # s; over which residuals of a misfit hang together
DOUBTED: Final = 2.0  # colour of a residual that is not noise alone: other starts may end lower
FLAT: Final = 8.0  # 2·log likelihood, below which a parameter is not excited
ITERATIONS: Final = 15
DONE: Final = 1e-5  # relative decrease of the sum of squares
MOVES: Final = (1e-3, 1e-3, 1e-3, 0.02, 0.25, 0.02)  # of the free numbers, for their derivatives
PLAYS_PERCENT: Final = (0.5, 1.0, 2.0, 4.0, 8.0)  # at which a search begins


def best_point(samples: Samples, period: float) -> tuple[Grid, Point]:
    """Search for the best point; return it with the samples on their grid of ``period`` s.

    A search may end where it is best only nearby. Its residual is then coloured, and a second one
    begins at shares of the whole delay between U and Q.
    """
    grid = _gridded(samples, period)
    short = _busiest(grid, START_S)
    starts = [
        Point(f, 0.7, min(slew * FASTEST_STEP * f, NO_SLEW), 0.0, lag)
        for f in STARTS_HZ if f < SEEN / period
        for lag in STARTS_LAG_S
        for slew in STARTS_SLEW
    ]  # fmt: skip
    best = sorted(starts, key=lambda p: residual(short, p)[1])[:KEPT]
    found = _descended(grid, short, best)
    r, S, _ = residual(*found)
    if colour(r, period) < DOUBTED:
        return found
    other = _descended(grid, short, _of_delay(short))
    if residual(*other)[1] < S:
        found = other
    return _with_play(*found)


def _with_play(grid: Grid, p: Point) -> tuple[Grid, Point]:
    """Return the best point with a play, if it is significantly better."""
    r, S, _ = residual(grid, p)
    starts = [replace(p, play=play) for play in PLAYS_PERCENT]
    best = min(starts, key=lambda start: residual(grid, start)[1])
    later = 0.5 * grid.period if grid.hold is Hold.LINE else 0.0
    held = replace(grid, hold=Hold.CONSTANT)
    found = _either_hold(held, replace(best, dead=best.dead - later))
    colours = colour(r, grid.period)
    significant = residual(*found)[1] * math.exp(FLAT * colours / len(r)) < S
    return found if significant else (grid, p)


def _descended(grid: Grid, short: Grid, starts: list[Point]) -> tuple[Grid, Point]:
    """Return the end of the best of these starts, and U between the samples."""
    point, _ = min((descend(short, p) for p in starts), key=lambda end: end[1])
    return _either_hold(grid, point)


def _either_hold(grid: Grid, p: Point) -> tuple[Grid, Point]:
    """Descend with a U that is constant between samples, and with lines; return the better."""
    point, S = descend(grid, p)
    as_lines = replace(grid, hold=Hold.LINE)
    line, S_line = descend(as_lines, replace(point, dead=point.dead + 0.5 * grid.period))
    if S_line * math.exp(FLAT / len(grid.t)) < S:
        return as_lines, line
    return grid, point


def _of_delay(short: Grid) -> list[Point]:
    """Return the best start of each share that the spool may have in the delay.

    The whole delay is that of the best lag alone; a spool's is 2ζ/ω.
    """
    quick = Point(min(SEEN / short.period, FASTEST), 0.7, NO_SLEW, 0.0, 0.0)
    delay = min(STARTS_DELAY_S, key=lambda lag: residual(short, replace(quick, lag=lag))[1])
    best = []
    for share in OF_DELAY["spool"]:
        f = min(max(0.7 / (math.pi * share * delay), SLOWEST), quick.f)
        starts = [
            Point(f, 0.7, min(slew * FASTEST_STEP * f, NO_SLEW), dead * delay, lag * delay)
            for dead in OF_DELAY["dead"]
            for lag in OF_DELAY["lag"]
            for slew in STARTS_SLEW
        ]
        best.append(min(starts, key=lambda p: residual(short, p)[1]))
    return best


def colour(r: Floats, period: float) -> float:
    """Return by how much neighbours add to the variance of a mean of residuals, 1 at least."""
    worst, whole = 1.0, max(float(r @ r), TINY)
    for seconds in COLOURS_S:
        many = max(round(seconds / period), 1)
        means = np.add.reduceat(r, np.arange(0, len(r), many))
        worst = max(worst, float(means @ means) / whole)
    return worst


def _gridded(samples: Samples, period: float) -> Grid:
    n = round((samples.t[-1] - samples.t[0]) * 1e-9 / period) + 1
    own = (samples.t - samples.t[0]) * 1e-9
    t = np.arange(n) * period
    nearest = np.clip(np.searchsorted(own, t - 0.5 * period), 0, len(own) - 1)
    U, dp, Q = samples.U[nearest], samples.dp[nearest], samples.Q[nearest]
    s = np.sign(dp) * np.sqrt(np.abs(dp))
    top = max(float(np.abs(s).max()), 1e-9)
    span = float(np.ptp(U))
    low, width = float(U.min()) - BEYOND * span, (1.0 + 2.0 * BEYOND) * span / PARTS
    steps = max(math.ceil(period / STEP_S), 4)
    return Grid(t, U, s / top, Q, period, steps, Hold.CONSTANT, (low, width, top))


def _busiest(grid: Grid, seconds: float) -> Grid:
    """Return the stretch in which U travels farthest."""
    n = min(round(seconds / grid.period), len(grid.t))
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(grid.U)))])
    begin = int(np.argmax(travelled[n - 1 :] - travelled[: len(travelled) - n + 1]))
    part = slice(begin, begin + n)
    return replace(grid, t=grid.t[:n], U=grid.U[part], s=grid.s[part], Q=grid.Q[part])


def jacobian(grid: Grid, x: Floats, r: Floats, free: Sequence[int]) -> Floats:
    """Return the derivatives of the projected residual by finite differences, (N, free)."""
    J = np.empty((len(r), len(free)))
    for column, j in enumerate(free):
        moved = x.copy()
        moved[j] += MOVES[j]
        J[:, column] = (residual(grid, Point.of(moved))[0] - r) / MOVES[j]
    return J


def descend(grid: Grid, p: Point, fixed: tuple[int, ...] = ()) -> tuple[Point, float]:
    """Levenberg-Marquardt on the free numbers; return the point and its sum of squares.

    A play of 0 stays.
    """
    x, damping = p.free, 1e-2
    r, S, _ = residual(grid, p)
    free = [j for j in range(len(x)) if j not in (*fixed, *p.fixed)]
    for _ in range(ITERATIONS):
        J = jacobian(grid, x, r, free)
        H, g = J.T @ J, J.T @ r
        scale = np.diag(H).copy() + 1e-12 * max(float(np.diag(H).max()), 1e-30)
        gained = 0.0
        for _ in range(6):
            new = x.copy()
            new[free] -= np.clip(_step(H + damping * np.diag(scale), g, free, x[LAG]), -3.0, 3.0)
            new = Point.of(new).free
            r_new, S_new, _ = residual(grid, Point.of(new))
            if S_new < S:
                gained = (S - S_new) / S
                x, r, S, damping = new, r_new, S_new, 0.3 * damping
                break
            damping *= 5.0
        if gained < DONE:
            break
    return Point.of(x), S


def _step(H: Floats, g: Floats, free: list[int], lag: float) -> Floats:
    """Return how far to go down; if that were below a lag of 0, the best step to 0."""
    step: Floats = np.asarray(np.linalg.solve(H, g), np.float64)
    if LAG in free and step[free.index(LAG)] > lag:
        j = free.index(LAG)
        others = np.arange(len(free)) != j
        step[j] = lag
        step[others] = np.linalg.solve(H[np.ix_(others, others)], g[others] - H[others, j] * lag)
    return step
