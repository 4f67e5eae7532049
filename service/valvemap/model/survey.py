"""Map of the uncertainty: known and stale regions, and the most informative test point."""

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from valvemap.model.capabilities import Informed
from valvemap.model.estimator import Estimator, State
from valvemap.model.residual_spread import EDGES_DP, EDGES_U, ResidualSpread
from valvemap.model.samples import Floats

S = TypeVar("S", bound=State)
POINTS_U, POINTS_DP = 11, 10
T_DEFAULT: Final = 40.0
OPEN: Final = 1e-6


@dataclass(frozen=True)
class Survey:
    """Uncertainty of a map on a grid.

    Attributes
    ----------
    U, dp : (10,), (n,)
        Middles of the regions, % and bar.
    std : (10, n)
        Standard deviation of Q̂, l/min; NaN where unknown.
    age_s : (10, n)
        Time since the region's last sample, s, rounded up; NaN without one.
    share : float
        Share of the regions with recent samples.
    condition : float
        Ratio of the largest to the smallest standard deviation of parameter combinations, in units
        of their effect on the map; inf while one is not determined or P overflows, NaN without P.
    suggested_U, suggested_dp : float
        The test point (%, bar) that reduces the mean variance of the map most.
    """

    U: Floats
    dp: Floats
    std: Floats
    age_s: Floats
    share: float
    condition: float
    suggested_U: float
    suggested_dp: float


def survey(
    estimator: Estimator[S],
    state: S,
    spread: ResidualSpread,
    t: int,
    T: float = T_DEFAULT,
    *,
    dp_max: float = 200.0,
    Q_max: float = np.inf,
) -> Survey:
    """Survey a map at time ``t`` (UTC ns) and temperature ``T``, for dp up to ``dp_max``.

    If P is known, the suggestion is the next sample of an I-optimal design: with A = X·P·Xᵀ
    over the grid, a sample at point k reduces the sum of the variances by Σ_g A_gk²/(1 + A_kk)
    (in units of the noise). Otherwise it is the point of the largest standard deviation. If that is
    equal at all points (a network), or P overflows, it is the point with the fewest samples.
    Points whose predicted flow lies beyond ``Q_max`` are not suggested.

    References
    ----------
    A. Atkinson, A. Donev, R. Tobias, Optimum Experimental Designs, with SAS, 2007, ch. 10-12.

    Examples
    --------
    >>> from valvemap.model.recursive_least_squares import RecursiveLeastSquares
    >>> from valvemap.model.samples import Samples
    >>> rng = np.random.default_rng(0)
    >>> U, dp, e = rng.uniform(0, 40, 500), rng.uniform(10, 200, 500), rng.normal(size=500)
    >>> samples = Samples.of(np.arange(500), U, dp, 0 * dp, 0.1 * U * np.sqrt(dp) + e)
    >>> rls = RecursiveLeastSquares()
    >>> state, trace = rls.update(rls.initial_state(), samples)
    >>> found = survey(rls, state, ResidualSpread.none().add(samples, trace), 500)
    >>> found.suggested_U, found.share
    (100.0, 0.32)
    """
    T = T if np.isfinite(T) else T_DEFAULT
    middles_U, middles_dp = axes(dp_max)
    cells = slice(len(middles_dp))
    U, dp = (x.ravel() for x in np.meshgrid(middles_U, middles_dp, indexing="ij"))
    _, std = estimator.predict(state, U, dp, np.full_like(U, T))
    seen = spread.weights[:, cells] > 0.0
    U_grid, dp_grid = _grid(dp_max)
    gain, condition = _gain(estimator, state, spread, U_grid, dp_grid, T)
    Q, _ = estimator.predict(state, U_grid, dp_grid, np.full_like(U_grid, T))
    reachable = (Q_max >= Q) | np.isnan(Q)
    best = int(np.argmax(np.where(reachable, gain, -1.0)))
    return Survey(
        U=middles_U,
        dp=middles_dp,
        std=std.reshape(seen.shape),
        age_s=(t - spread.last[:, cells]) / 1e9,
        share=float(seen.mean()),
        condition=condition,
        suggested_U=float(U_grid[best]),
        suggested_dp=float(dp_grid[best]),
    )


def axes(dp_max: float) -> tuple[Floats, Floats]:
    """Middles of the regions over U (10,), % and dp (n,), bar.

    >>> axes(100.0)[1].round(1)
    array([ 0.6,  5.1, 14.1, 27.6, 45.6, 68.1, 95.1])
    """
    low, high = np.sqrt(EDGES_DP[:-1]), np.sqrt(EDGES_DP[1:])
    middles = np.minimum(((low + high) / 2.0) ** 2, dp_max)
    return (EDGES_U[:-1] + EDGES_U[1:]) / 2.0, middles[EDGES_DP[:-1] < dp_max]


def _gain(
    estimator: Estimator[S], state: S, spread: ResidualSpread, U: Floats, dp: Floats, T: float
) -> tuple[Floats, float]:
    """Return the gain of a sample at each of N points, in any unit, and the condition of P."""
    least_visited = 1.0 / (1.0 + spread.density(U, dp))
    if isinstance(estimator, Informed):
        X = estimator.structure.regressors(U, dp, np.full_like(U, T))
        with np.errstate(all="ignore"):
            gain, condition = _gain_of_design(estimator.information(state), X)
        return (gain, condition) if np.isfinite(gain).all() else (least_visited, np.inf)
    _, std = estimator.predict(state, U, dp, np.full_like(U, T))
    known = std[np.isfinite(std)]
    if len(known) < len(std) or np.ptp(known) > 0.0:
        return np.where(np.isfinite(std), std, np.inf), np.nan
    return least_visited, np.nan


def _gain_of_design(information: Floats, X: Floats) -> tuple[Floats, float]:
    """Gain at N points (N,) and condition; NaN and inf where P cannot be computed."""
    try:
        P = _inverse(information, X)
        condition = _condition(P, X)
    except np.linalg.LinAlgError:  # singular
        return np.full(len(X), np.nan), np.inf
    A = X @ P @ X.T
    return (A * A).sum(axis=0) / (1.0 + np.maximum(np.diag(A), 0.0)), condition


def _condition(P: Floats, X: Floats) -> float:
    """Root of the largest over the smallest eigenvalue of P in units of the map."""
    scale = np.sqrt(np.mean(X * X, axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    eigenvalues = np.linalg.eigvalsh(P * np.outer(scale, scale))
    if not eigenvalues[0] > 0.0 or eigenvalues[-1] * OPEN > 0.01:
        return np.inf
    return float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))


def _inverse(information: Floats, X: Floats) -> Floats:
    """P; huge in directions that are not determined."""
    faint = OPEN * np.maximum(np.mean(X * X, axis=0), np.finfo(np.float64).tiny)
    return np.asarray(np.linalg.inv(information + np.diag(faint)))


def _grid(dp_max: float) -> tuple[Floats, Floats]:
    levels = np.linspace(0.0, 100.0, POINTS_U), dp_max * np.linspace(0.1, 1.0, POINTS_DP)
    U, dp = np.meshgrid(*levels, indexing="ij")
    return U.ravel(), dp.ravel()
