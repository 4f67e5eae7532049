"""Spool and meter behind a static map: its columns, and the residual of the best map. Pure.

    x'' = ω²·(u(t - d) - x) - 2ζω·x',  |x'| ≤ slew,  τ·y' + y = g(x, Δp),  g = Σ θ_j·φ_j(x)·ψ_j(Δp)

u is U behind a play. Nonlinear in ω = 2πf, ζ, slew, d, τ and the play; the map is linear inside
and eliminated by variable projection (Golub and Pereyra 1973, doi 10.1137/0710036). Between samples
U is constant or a line; Δp is a line.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from valvemap.model.kernels import dynamics as kernels
from valvemap.model.samples import Floats

FREE: Final = 6  # numbers of a point
STEP_S: Final = 2.5e-4  # s; of the integration
PARTS: Final = 40  # intervals of the map's B-splines along U
OF_DROP: Final = 4  # functions of s in the map: s, s·|s|, and two that bend
COLUMNS: Final = OF_DROP * (PARTS + 2)  # B-splines times these
BEYOND: Final = 0.2  # share of the range of U by which the spool may overshoot it
RIDGE: Final = 1e-9  # of the largest diagonal: columns without samples
BEND: Final = (
    1e-5  # of the largest diagonal: weight of third differences along U, of what goes with s
)
APART: Final = 1e-3  # the same of second differences of what departs from that
SLOWEST, FASTEST = 0.5, 200.0  # Hz; bounds of f
TINY: Final = 1e-300  # instead of a variance of 0
NO_SLEW: Final = 1e6  # %/s; no limit
SLEW, LAG, PLAY = 2, 4, 5  # places among the free numbers; the last two end at 0


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
    G += most * _BENDS
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
    size = np.abs(s)
    of_drop = s, s * size, s / (size + kernels.SHARP), s / (size + kernels.SOFT)
    for i, spline in enumerate((first, 1.0 - first - last, last)):
        for p, value in enumerate(of_drop):
            X[rows, p * (PARTS + 2) + j + i] = spline * value
    return X


def static_residual(grid: Grid) -> float:
    """Return the sum of squares of a map without dynamics."""
    return _left(static_columns(grid.U, grid.s, grid.axis), grid.Q)[1]


def response(p: Point, step: float, seconds: float) -> tuple[Floats, Floats]:
    """Return times (s) and the spool's travel after a step, % each."""
    h = 0.5 * STEP_S
    n = max(math.ceil(seconds / h), 2)
    x = np.empty(n)
    kernels.spool(np.full(n, step), _transition(p, h), p.slew * h, x)
    return np.asarray(np.arange(1, n + 1) * h + p.dead, np.float64), x


def _bends() -> Floats:
    """Return the weights of the coefficients' differences along U, (COLUMNS, COLUMNS).

    Where the spool was seldom or never, the map is extrapolated smoothly from the range beside it.
    """
    third, second = (np.diff(np.eye(PARTS + 2), order, axis=0) for order in (3, 2))
    proportional = np.eye(OF_DROP)[0]
    of_s, of_others = np.diag(BEND * proportional), np.diag(APART * (1.0 - proportional))
    return np.asarray(np.kron(of_s, third.T @ third) + np.kron(of_others, second.T @ second))


_BENDS: Final = _bends()
