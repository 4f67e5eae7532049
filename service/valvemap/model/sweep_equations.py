"""The spool of a sweep behind play and lag, and the equations of its flow curve."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from scipy import linalg, sparse

from valvemap.model.samples import Flags, Floats, Samples

KNOT_K, KNOT_L = 1.0, 12.0  # % of U; distances of knots
SMOOTH: Final = tuple(10.0**k for k in range(-4, 5))  # weights of bends, per sample and knot
USUAL_LAG: Final = 0.02  # s; standard deviation of the lag before anything is known
NEAR: Final = (0.35, 0.5, 0.7, 1.0, math.inf)  # of the rated √Δp; widths of the weight about it
STUDENT: Final = 1.0  # degrees of freedom of the bends
EXACT: Final = 1e-6  # l/min; least residual: a recording without flow or noise has none
DRAWS: Final = 600
COMMON_LAGS: Final = 200  # samples; over which residuals may have something in common


@dataclass(frozen=True)
class SweepFit:
    """What a sweep tells.

    Attributes
    ----------
    x : float64
        Positions of the spool, in % of U, (G,).
    known : bool
        Where the sweep has been, within a knot, (G,).
    Q : float64
        Flow at the rated pressure drop, l/min, (G,).
    Q_draws : float64
        Draws of ``Q`` from its posterior, (D, G).
    play, lag : float
        Width of the loop, % of U; time constant, s.
    play_draws : float64
        Draws of ``play``, (D,).
    noise : float
        Standard deviation of a flow, l/min.
    """

    x: Floats
    known: Flags
    Q: Floats
    Q_draws: Floats
    play: float
    lag: float
    play_draws: Floats
    noise: float

    def interval(self) -> tuple[Floats, Floats]:
        """95 % interval of ``Q``, both (G,)."""
        lower, upper = np.quantile(self.Q_draws, [0.025, 0.975], axis=0)
        return lower, upper


def spool(U: Floats, dt: Floats, play: float, lag: float) -> Floats:
    """Position of the spool (N,) behind play (%) and a lag (s); ``dt`` (N,) s since the last.

    >>> spool(np.array([0.0, 4.0, 8.0, 6.0]), np.full(4, 0.1), 2.0, 0.0)
    array([0., 3., 7., 7.])
    """
    shares = 1.0 - np.exp(-dt / lag) if lag > 0.0 else np.ones(len(U))
    x, follows = [], float(U[0])
    for at, share in zip(_behind_play(U, 0.5 * play).tolist(), shares.tolist(), strict=True):
        follows += share * (at - follows)
        x.append(follows)
    return np.array(x)


def _behind_play(U: Floats, half: float) -> Floats:
    """Return the positions (N,): each U limits the one before to U ± half.

    Two limits in sequence are limits again, so 2, 4, 8 … of them are joined at once.
    """
    low, high = U - half, U + half
    many = 1
    while many < len(U):
        lower, upper = low[many:], high[many:]
        low[many:], high[many:] = (np.clip(one[:-many], lower, upper) for one in (low, high))
        many *= 2
    return np.asarray(np.clip(U[0], low, high))


class Equations(NamedTuple):
    """Regressors A (N, K), sparse, with AᵀA and AᵀQ, of one play and lag."""

    A: sparse.csr_matrix
    AA: Floats
    AQ: Floats


class Problem:
    """The samples of a fit, and their equations for a play and a lag."""

    def __init__(self, samples: Samples, dp_rated: float, U_grid: Floats) -> None:
        self.U, self.dt = samples.U, np.diff(samples.t, prepend=samples.t[0]) * 1e-9
        self.s = np.sign(samples.dp) * np.sqrt(np.abs(samples.dp))
        self.s_rated = math.sqrt(dp_rated)
        self.measured = samples.Q
        low = min(float(self.U.min()), float(U_grid[0]))
        high = max(float(self.U.max()), float(U_grid[-1]))
        self.knots = [_knots(low, high, step) for step in (KNOT_K, KNOT_L, KNOT_L)]
        sizes = [len(knots) for knots in self.knots]
        self.smooth = SMOOTH[1]
        self.D: Floats = linalg.block_diag(*(_bends(size) for size in sizes))
        self.per_knot = np.concatenate([np.full(max(size - 2, 0), 1.0 / size) for size in sizes])
        self.share = np.ones(len(self.D))  # weight of each bend
        self.tiny = 1e-6 * np.eye(sum(sizes))
        self._weigh_rows(NEAR[0])

    def _weigh_rows(self, near: float) -> None:
        """Let each row count the less, the further its pressure drop is from the rated one."""
        exponents = -0.25 * ((self.s / self.s_rated - 1.0) / near) ** 2
        self.weight, self.log_weight = np.exp(exponents), float(np.sum(exponents))
        self.many = float(np.sum(self.weight**2))
        self.Q = self.weight * self.measured
        self.per_bend = self.many * self.per_knot

    def weigh_drops(self, play: float, lag: float) -> None:
        """Choose by the evidence how far from the rated pressure drop the equations hold.

        A weight w stands for their error there, as noise of the standard deviation σ/w.
        """

        def surprise(near: float) -> float:
            self._weigh_rows(near)
            _, squares = self._solved(self._equations(play, lag), self.smooth)
            return len(self.s) * math.log(squares) - 2.0 * self.log_weight

        self._weigh_rows(min(NEAR, key=surprise))

    def prior(self, weight: float) -> Floats:
        """Information of coefficients before anything is measured, (K, K)."""
        by_bend = weight * self.per_bend * self.share
        return np.add((self.D.T * by_bend) @ self.D, self.tiny)

    def weigh_bends(self, play: float, lag: float) -> None:
        """Choose the scale of bends by the evidence, then weigh each bend by its size."""
        equations = self._equations(play, lag)
        self.smooth = min(SMOOTH, key=lambda weight: self._evidence(equations, weight))
        theta, squares = self._solved(equations, self.smooth)
        size = self.smooth * self.per_bend * (self.D @ theta) ** 2 * self.many / squares
        self.share = (STUDENT + 1.0) / (STUDENT + size)

    def _evidence(self, equations: "Equations", weight: float) -> float:
        """Minus twice the log marginal likelihood of a weight of bends."""
        theta, squares = self._solved(equations, weight)
        left = squares + float(theta @ self.prior(weight) @ theta)
        determinant = float(np.linalg.slogdet(equations.AA + self.prior(weight))[1])
        return self.many * math.log(left) + determinant - len(self.D) * math.log(weight)

    def cost(self, at: Floats | tuple[float, float]) -> float:
        """Minus twice the log posterior of play and lag, with the best coefficients."""
        theta, squares = self._solved(self._equations(float(at[0]), float(at[1])), self.smooth)
        left = squares + float(theta @ self.prior(self.smooth) @ theta)
        return self.many * math.log(left / self.many) + float(at[1] / USUAL_LAG) ** 2

    def _equations(self, play: float, lag: float) -> "Equations":
        A = self._weighted(play, lag)
        return Equations(A, np.asarray((A.T @ A).todense()), np.asarray(A.T @ self.Q))

    def _solved(self, equations: "Equations", weight: float) -> tuple[Floats, float]:
        """Return the best coefficients (K,), and the sum of squared residuals, never 0."""
        theta: Floats = np.asarray(
            np.linalg.solve(equations.AA + self.prior(weight), equations.AQ), np.float64
        )
        return theta, float(np.sum((self.Q - equations.A @ theta) ** 2)) + self.many * EXACT**2

    def _weighted(self, play: float, lag: float) -> sparse.csr_matrix:
        rows = self.rows(spool(self.U, self.dt, play, lag), self.s)
        return sparse.csr_matrix(sparse.diags(self.weight) @ rows)

    def rows(self, x: Floats, s: Floats) -> sparse.csr_matrix:
        """Regressors at positions and pressures, sparse (N, K)."""
        apart = s / self.s_rated - 1.0
        by = s / self.s_rated, apart, apart**2
        parts = [
            sparse.diags(each) @ _hats(knots, x) for each, knots in zip(by, self.knots, strict=True)
        ]
        return sparse.csr_matrix(sparse.hstack(parts))

    def posterior(
        self, play: float, lag: float, dp_rated: float, U_grid: Floats, seed: int
    ) -> SweepFit | None:
        """Evaluate the fit at its optimum."""
        moved = np.maximum.accumulate(self.U) - np.minimum.accumulate(self.U) > play
        if not moved.any():
            return None
        equations = self._equations(play, lag)
        A = equations.A
        theta, _ = self._solved(equations, self.smooth)
        left = self.Q - A @ theta
        by = [
            (self._weighted(play + d, lag + g) @ theta - A @ theta) / (d + g)
            for d, g in ((0.05, 0.0), (0.0, 0.002))
        ]
        columns = np.column_stack([np.asarray(A.todense()), *by])
        size = len(theta)
        known = np.zeros((size + 2, size + 2))  # of the prior
        known[:size, :size] = self.prior(self.smooth)
        variance = (
            max(float(left @ left), self.many * EXACT**2)
            / max(self.many - size, 1.0)
            * _in_common(left)
        )
        known[size + 1, size + 1] = variance / USUAL_LAG**2
        noises = self.weight[:, None] * columns
        try:
            spread = np.linalg.cholesky(noises.T @ noises + known)
            factor = linalg.cho_factor(columns.T @ columns + known)
        except np.linalg.LinAlgError:
            return None
        rng = np.random.default_rng(seed)
        draws = linalg.cho_solve(factor, spread @ rng.standard_normal((size + 2, DRAWS)))
        apart = math.sqrt(variance) * draws.T
        been = spool(self.U, self.dt, play, lag)[
            moved
        ]  # before that it is not known where in its play the spool began
        s = np.full(len(U_grid), math.sqrt(dp_rated))
        at_grid = self.rows(U_grid, s)
        Q = at_grid @ theta
        return SweepFit(
            x=U_grid,
            known=(U_grid >= been.min() - KNOT_K) & (U_grid <= been.max() + KNOT_K),
            Q=np.asarray(Q),
            Q_draws=Q + np.asarray((at_grid @ apart[:, :size].T).T),
            play=play,
            lag=lag,
            play_draws=play + apart[:, size],
            noise=math.sqrt(float(left @ left) / self.many),
        )


def _knots(low: float, high: float, step: float) -> Floats:
    """Knots about ``step`` apart, with 0 among them where it lies between."""
    inside = sorted({low, high, 0.0} if low < 0.0 < high else {low, high})
    found: list[float] = []
    for a, b in pairwise(inside):
        found += np.linspace(a, b, max(math.ceil((b - a) / step), 1) + 1)[:-1].tolist()
    return np.array([*found, inside[-1]])


def _hats(knots: Floats, x: Floats) -> sparse.csr_matrix:
    """Piecewise linear functions, 1 at a knot and 0 at the others, sparse (N, K)."""
    n = len(x)
    right = np.clip(np.searchsorted(knots, x, side="right"), 1, len(knots) - 1)
    share = np.clip((x - knots[right - 1]) / (knots[right] - knots[right - 1]), 0.0, 1.0)
    rows = np.tile(np.arange(n), 2)
    columns = np.concatenate([right - 1, right])
    values = np.concatenate([1.0 - share, share])
    return sparse.csr_matrix((values, (rows, columns)), shape=(n, len(knots)))


def _bends(size: int) -> Floats:
    """Second differences of coefficients, (size - 2, size)."""
    return np.asarray(np.diff(np.eye(size), n=2, axis=0)) if size > 2 else np.zeros((0, size))


def _in_common(left: Floats) -> float:
    """By how much residuals that follow one another have less to say than independent ones."""
    centred = left - left.mean()
    power = float(centred @ centred)
    total = 1.0
    for lag in range(1, min(COMMON_LAGS, len(left) // 4)):
        rho = float(centred[:-lag] @ centred[lag:]) / power if power > 0.0 else 0.0
        if rho < 2.0 / math.sqrt(len(left)):
            break
        total += 2.0 * rho
    return total
