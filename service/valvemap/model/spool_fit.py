"""Spool and meter behind a static map: the search for the numbers of their motion. Pure.

    x'' = ω²·(u(t - d) - x) - 2ζω·x',  |x'| ≤ slew,  τ·y' + y = g(x, Δp),  g = Σ θ_j·φ_j(x)·ψ_j(Δp)

u is U behind a play. Nonlinear in ω = 2πf, ζ, slew, d, τ and the play; the map is linear inside
and eliminated by variable projection (Golub and Pereyra 1973, doi 10.1137/0710036). Between samples
U is either constant, as a controller's output is, or a line, as a slow signal is. The wrong one
biases f, and both fit nearly as well: a line is taken only if it is significantly better. Δp is a
line.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

import numpy as np

from valvemap.model.kernels import dynamics as kernels
from valvemap.model.samples import Floats, Samples

FREE: Final = 6  # numbers of a point
STEP_S: Final = 2.5e-4  # s; of the integration
PARTS: Final = 40  # intervals of the map's B-splines along U
COLUMNS: Final = 3 * (PARTS + 2)  # of the map: B-splines times s, s·|s| and s³
BEYOND: Final = 0.2  # share of the range of U by which the spool may overshoot it
RIDGE: Final = 1e-9  # of the largest diagonal: columns without samples
BEND: Final = 1e-5  # of the largest diagonal: weight of the map's third differences along U
SLOWEST, FASTEST = 0.5, 200.0  # Hz; bounds of f
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
TINY: Final = 1e-300  # instead of a variance of 0
NO_SLEW: Final = 1e6  # %/s; no limit
ITERATIONS: Final = 15
DONE: Final = 1e-5  # relative decrease of the sum of squares
MOVES: Final = (1e-3, 1e-3, 1e-3, 0.02, 0.25, 0.02)  # of the free numbers, for their derivatives
SLEW, LAG, PLAY = 2, 4, 5  # places among the free numbers; the last two end at 0
PLAYS_PERCENT: Final = (0.5, 1.0, 2.0, 4.0, 8.0)  # at which a search begins


class Hold(Enum):
    """U between two samples."""

    CONSTANT = "constant"
    LINE = "a line"


@dataclass(frozen=True)
class Point:
    """Nonlinear parameters: Hz, 1, %/s, s, s, %."""

    f: float
    zeta: float
    slew: float
    dead: float
    lag: float
    play: float = 0.0

    @property
    def free(self) -> Floats:
        """As free numbers (FREE,): logarithms of the first three, times in ms, the play."""
        logs = np.log([self.f, self.zeta, self.slew])
        return np.array([*logs, 1e3 * self.dead, 1e3 * self.lag, self.play])

    @property
    def fixed(self) -> tuple[int, ...]:
        """The free numbers that stay: without a play, the play."""
        return () if self.play > 0.0 else (PLAY,)

    @classmethod
    def of(cls, x: Floats) -> "Point":
        """Return the point of free numbers."""
        f, zeta, slew = np.exp(x[:3])
        return cls(
            float(np.clip(f, SLOWEST, FASTEST)), float(np.clip(zeta, 0.05, 5.0)),
            float(np.clip(slew, 1.0, NO_SLEW)), 1e-3 * float(x[3]), 1e-3 * max(float(x[4]), 0.0),
            max(float(x[PLAY]), 0.0),
        )  # fmt: skip


@dataclass(frozen=True)
class Grid:
    """Samples on a regular grid."""

    t: Floats
    U: Floats
    s: Floats
    Q: Floats
    period: float
    steps: int
    hold: Hold
    axis: tuple[float, float, float]

    @property
    def h(self) -> float:
        """Length of a step, s."""
        return self.period / self.steps


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


def _columns(grid: Grid, p: Point) -> Floats:
    """Return the map's columns behind spool and meter, (N, COLUMNS)."""
    h = grid.h
    X = np.zeros((len(grid.t), COLUMNS))
    left = math.exp(-h / p.lag) if p.lag > 1e-5 else 0.0
    low, width, _ = grid.axis
    kernels.regressors(
        _commands(grid, p), grid.s, _transition(p, h), p.slew * h, left, low, width, PARTS,
        grid.steps, X,
    )  # fmt: skip
    return X


def _commands(grid: Grid, p: Point) -> Floats:
    """Return the mean command of every step, after play and dead time, %."""
    n = (len(grid.t) - 1) * grid.steps
    begin, U = np.arange(n) * grid.h - p.dead, grid.U
    if p.play > 0.0:
        U = np.empty_like(grid.U)
        kernels.behind(grid.U, 0.5 * p.play, U)
    if grid.hold is Hold.LINE:
        return np.asarray(np.interp(begin + 0.5 * grid.h, grid.t, U))
    total = np.concatenate([[0.0], np.cumsum(U[:-1]) * grid.period])  # ∫U, piecewise linear
    ends = np.concatenate([begin, begin[-1:] + grid.h])
    before = np.minimum(ends - grid.t[0], 0.0) * U[0]  # U was constant before the first sample
    after = np.maximum(ends - grid.t[-1], 0.0) * U[-1]
    return np.asarray(np.diff(np.interp(ends, grid.t, total) + before + after) / grid.h)


def _transition(p: Point, h: float) -> Floats:
    """Return the spool's transition of (x - U, h·x') over a step, (4,)."""
    w = 2.0 * math.pi * p.f
    A = np.array([[0.0, 1.0], [-((w * h) ** 2), -2.0 * p.zeta * w * h]])
    scaled, E = A / 64.0, np.eye(2)
    term = np.eye(2)
    for k in range(1, 9):
        term = term @ scaled / k
        E = E + term
    for _ in range(6):
        E = E @ E
    return np.ascontiguousarray(E.ravel())


def residual(grid: Grid, p: Point) -> tuple[Floats, float, Floats]:
    """Return what the best map leaves (N,), its sum of squares, and the map."""
    return _left(_columns(grid, p), grid.Q)


def _left(X: Floats, Q: Floats) -> tuple[Floats, float, Floats]:
    G = X.T @ X
    most = G.diagonal().max()
    G += BEND * most * _BENDS
    G[np.diag_indices_from(G)] += RIDGE * most + 1e-30
    theta: Floats = np.asarray(np.linalg.solve(G, X.T @ Q), np.float64)
    r = Q - X @ theta
    return r, float(r @ r), theta


def static_columns(U: Floats, s: Floats, axis: tuple[float, float, float]) -> Floats:
    """Return the map's columns of a spool that stands at U, (N, COLUMNS); ``s`` as in `Grid`."""
    low, width, _ = axis
    place = np.clip((U - low) / width, 0.0, PARTS - 1e-9)
    j = place.astype(np.int64)
    z = place - j
    first, last = 0.5 * (1.0 - z) ** 2, 0.5 * z * z
    X, rows = np.zeros((len(U), COLUMNS)), np.arange(len(U))
    for i, spline in enumerate((first, 1.0 - first - last, last)):
        for p, power in enumerate((s, s * np.abs(s), s**3)):
            X[rows, p * (PARTS + 2) + j + i] = spline * power
    return X


def static_residual(grid: Grid) -> float:
    """Return the sum of squares of a map without dynamics."""
    return _left(static_columns(grid.U, grid.s, grid.axis), grid.Q)[1]


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


def response(p: Point, step: float, seconds: float) -> tuple[Floats, Floats]:
    """Return times (s) and the spool's travel after a step, % each."""
    h = 0.5 * STEP_S
    n = max(math.ceil(seconds / h), 2)
    x = np.empty(n)
    kernels.spool(np.full(n, step), _transition(p, h), p.slew * h, x)
    return np.asarray(np.arange(1, n + 1) * h + p.dead, np.float64), x


def _bends() -> Floats:
    """Return the sum of squares of the coefficients' third differences along U, (COLUMNS, COLUMNS).

    Where the spool was seldom or never, the map goes on as beside it.
    """
    third = np.diff(np.eye(PARTS + 2), 3, axis=0)
    return np.asarray(np.kron(np.eye(3), third.T @ third))


_BENDS: Final = _bends()
