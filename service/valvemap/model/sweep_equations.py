"""The spool of a sweep behind play and lag, and the equations of its flow curve."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy import linalg, sparse

from valvemap.model.samples import Flags, Floats, Samples
from valvemap.model.sweep_curves import EXACT, bends_of, hats_of, knots_of, of_hats
from valvemap.model.sweep_law import DropLaw

KNOT_K, KNOT_L = 1.0, 12.0  # % of U; distances of knots
SMOOTH: Final = tuple(10.0**k for k in range(-4, 5))  # weights of bends, per sample and knot
DEPARTS: Final = tuple(10.0**k for k in range(-6, 2))  # noise variances over those of L and M
USUAL_LAG: Final = 0.02  # s; standard deviation of the lag before anything is known
NEAR: Final = (0.35, 0.5, 0.7, 1.0, math.inf)  # of the rated √Δp; widths of the weight about it
STUDENT: Final = 1.0  # degrees of freedom of the bends
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
        self.knots = [knots_of(low, high, step) for step in (KNOT_K, KNOT_L, KNOT_L)]
        sizes = [len(knots) for knots in self.knots]
        self.smooth = SMOOTH[1]
        self.D: Floats = linalg.block_diag(*(bends_of(size) for size in sizes))
        self.per_knot = np.concatenate([np.full(max(size - 2, 0), 1.0 / size) for size in sizes])
        self.share = np.ones(len(self.D))  # weight of each bend
        self.departs = DEPARTS[0]
        self.of_rated = np.arange(sum(sizes)) < sizes[0]
        self.law = DropLaw(self.s, self.s_rated)
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
            _, squares = self._solved(self._equations(play, lag))
            return len(self.s) * math.log(squares) - 2.0 * self.log_weight

        self._weigh_rows(min(NEAR, key=surprise))

    def prior(self) -> Floats:
        """Information of coefficients before anything is measured, (K, K)."""
        by_bend = self.smooth * self.per_bend * self.share
        sizes = np.where(self.of_rated, DEPARTS[0], self.departs)
        return np.asarray((self.D.T * by_bend) @ self.D + np.diag(sizes))

    def weigh_bends(self, play: float, lag: float) -> None:
        """Choose scales of departures and bends by the evidence, weigh each bend by its size."""
        equations = self._equations(play, lag)
        self.departs = min(DEPARTS, key=lambda one: self._evidence(equations, self.smooth, one))
        self.smooth = min(SMOOTH, key=lambda one: self._evidence(equations, one, self.departs))
        theta, squares = self._solved(equations)
        size = self.smooth * self.per_bend * (self.D @ theta) ** 2 * self.many / squares
        self.share = (STUDENT + 1.0) / (STUDENT + size)

    def _evidence(self, equations: "Equations", smooth: float, departs: float) -> float:
        """Minus twice the log marginal likelihood of a weight of bends and one of departures."""
        self.smooth, self.departs = smooth, departs
        theta, squares = self._solved(equations)
        prior = self.prior()
        left = squares + float(theta @ prior @ theta)
        determinant, before = (np.linalg.slogdet(one)[1] for one in (equations.AA + prior, prior))
        return self.many * math.log(left) + float(determinant - before)

    def cost(self, at: Floats | tuple[float, float]) -> float:
        """Minus twice the log posterior of play and lag, with the best coefficients."""
        theta, squares = self._solved(self._equations(float(at[0]), float(at[1])))
        left = squares + float(theta @ self.prior() @ theta)
        return self.many * math.log(left / self.many) + float(at[1] / USUAL_LAG) ** 2

    def _equations(self, play: float, lag: float) -> "Equations":
        A = self._weighted(play, lag)
        return Equations(A, np.asarray((A.T @ A).todense()), np.asarray(A.T @ self.Q))

    def _solved(self, equations: "Equations") -> tuple[Floats, float]:
        """Return the best coefficients (K,), and the sum of squared residuals, never 0."""
        theta: Floats = np.asarray(
            np.linalg.solve(equations.AA + self.prior(), equations.AQ), np.float64
        )
        return theta, float(np.sum((self.Q - equations.A @ theta) ** 2)) + self.many * EXACT**2

    def _weighted(self, play: float, lag: float) -> sparse.csr_matrix:
        x = spool(self.U, self.dt, play, lag)
        rows = self.rows(x, self.law.factor, self.s / self.s_rated - 1.0)
        rows.data *= np.repeat(self.weight, 2 * len(self.knots))
        return rows

    def _by_law(self, play: float, lag: float, K: Floats) -> Floats:
        """Derivatives of the weighted flow by the law's values, (N, J)."""
        flow = hats_of(self.knots[0], spool(self.U, self.dt, play, lag)) @ K
        return np.asarray(self.law.columns * (self.weight * flow)[:, None])

    def fit_law(self, play: float, lag: float) -> None:
        """Fit what all openings share of the departure from √Δp, without L and M."""
        hats, own = hats_of(self.knots[0], spool(self.U, self.dt, play, lag)), self.of_rated
        self.law.fit(hats, self.weight, self.Q, self.prior()[np.ix_(own, own)], self.many)

    def rows(self, x: Floats, factor: Floats, apart: Floats) -> sparse.csr_matrix:
        """Regressors at positions, the law's factors and departures δ, sparse (N, K)."""
        return of_hats(self.knots, x, (factor, apart, apart**2))

    def posterior(self, play: float, lag: float, U_grid: Floats, seed: int) -> SweepFit | None:
        """Evaluate the fit at its optimum."""
        moved = np.maximum.accumulate(self.U) - np.minimum.accumulate(self.U) > play
        if not moved.any():
            return None
        equations = self._equations(play, lag)
        A = equations.A
        theta, _ = self._solved(equations)
        left = self.Q - A @ theta
        by = [
            (self._weighted(play + d, lag + g) @ theta - A @ theta) / (d + g)
            for d, g in ((0.05, 0.0), (0.0, 0.002))
        ]
        columns = np.column_stack(
            [np.asarray(A.todense()), *by, self._by_law(play, lag, theta[self.of_rated])]
        )
        size, every = len(theta), columns.shape[1]
        known = DEPARTS[0] * np.eye(every)  # of the prior
        known[size : size + 2] = 0.0
        known[size + 2 :, size + 2 :] = self.law.prior()
        known[:size, :size] = self.prior()
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
        draws = linalg.cho_solve(factor, spread @ rng.standard_normal((every, DRAWS)))
        apart = math.sqrt(variance) * draws.T
        been = spool(self.U, self.dt, play, lag)[
            moved
        ]  # before that it is not known where in its play the spool began
        at_grid = self.rows(U_grid, np.ones(len(U_grid)), np.zeros(len(U_grid)))
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
