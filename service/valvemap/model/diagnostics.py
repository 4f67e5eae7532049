"""Diagnostics of samples, innovations and states; pure functions on arrays.

Change detection is part of the recursion, see
:class:`~valvemap.model.forgetting.Adaptive`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc

from valvemap.model.least_squares_answers import matrix_P
from valvemap.model.least_squares_state import RlsState
from valvemap.model.samples import Floats, Samples
from valvemap.vocabulary.statuses import Quality


@dataclass(frozen=True)
class Whiteness:
    """Test whether innovations are white.

    Attributes
    ----------
    correlations : (lags,)
        Autocorrelation at lags 1 …; within ±2/√N in 95 of 100 lags of white noise.
    statistic : float
        Ljung and Box: N·(N + 2)·Σ ρ²(k)/(N - k), χ² with as many degrees of freedom as lags.
    p_value : float
        Probability of a statistic at least this large if the innovations are white.
    """

    correlations: Floats
    statistic: float
    p_value: float


def whiteness(innovations: ArrayLike, lags: int = 20) -> Whiteness:
    """Test innovations (N,) for whiteness; NaN (samples not used) are omitted.

    A low p-value indicates structural misfit, unmodelled dynamics or coloured noise (for which
    recursive maximum likelihood is the better method).

    Raises
    ------
    ValueError
        if there are not more innovations than lags.

    References
    ----------
    Ljung, Box: On a measure of lack of fit in time series models, Biometrika 65 (1978).

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(size=1000)
    >>> whiteness(noise).p_value > 0.01
    True
    >>> whiteness(noise[1:] + 0.5 * noise[:-1]).p_value < 1e-6
    True
    """
    e = np.asarray(innovations, np.float64)
    e = e[np.isfinite(e)]
    N = len(e)
    if not 1 <= lags < N:
        raise ValueError(f"lags = {lags}; 1 to {N - 1} are allowed for {N} innovations")
    e = e - e.mean()
    power = np.sum(e * e)
    if power == 0.0:
        return Whiteness(np.zeros(lags), 0.0, 1.0)
    k = np.arange(1, lags + 1)
    rho = np.array([np.sum(e[i:] * e[:-i]) for i in k]) / power
    statistic = float(N * (N + 2) * np.sum(rho**2 / (N - k)))
    return Whiteness(rho, statistic, float(chdtrc(lags, statistic)))


@dataclass(frozen=True)
class Excitation:
    """Excitation by the samples, in units of the regressors' scales.

    Attributes
    ----------
    rank : int
        Number of parameter combinations that the samples determine, out of n.
    condition : float
        Largest over smallest singular value of the scaled regressors; inf if rank < n. The
        standard deviation of the weakest combination is about condition/√N times that of one
        sample's noise.
    weakest : (n,)
        That combination, in scaled parameters, of length 1.
    """

    rank: int
    condition: float
    weakest: Floats


def excitation(X: ArrayLike) -> Excitation:
    """Return the excitation by N rows of regressors (N, n); rows that are not finite are omitted.

    Examples
    --------
    >>> excitation([[1.0, 50.0], [1.0, 50.0], [1.0, 50.0]]).rank
    1
    """
    rows = np.atleast_2d(np.asarray(X, np.float64))
    rows = rows[np.isfinite(rows).all(axis=1)]
    n = rows.shape[1]
    scale = np.max(np.abs(rows), axis=0, initial=0.0)
    scaled = rows / np.where(scale > 0.0, scale, 1.0)
    padded = np.vstack([scaled, np.zeros((max(0, n - len(rows)), n))])
    singular, directions = np.linalg.svd(padded, full_matrices=False)[1:]
    tolerance = max(padded.shape) * np.finfo(float).eps * singular[0]
    rank = int(np.sum(singular > tolerance))
    condition = float(singular[0] / singular[-1]) if rank == n else np.inf
    return Excitation(rank, condition, directions[-1])


def conditioning(state: RlsState) -> float:
    """Condition number of P in units of the regressors' scales; inf while not determined.

    Its square root is the ratio of the largest to the smallest standard deviation of parameter
    combinations.
    """
    scaled = matrix_P(state) * np.outer(state.scale, state.scale)
    if np.isnan(scaled).any():
        return np.inf
    eigenvalues = np.linalg.eigvalsh((scaled + scaled.T) / 2.0)
    return float(eigenvalues[-1] / eigenvalues[0]) if eigenvalues[0] > 0.0 else np.inf


@dataclass(frozen=True)
class Coverage:
    """Distribution of the samples over the map.

    Attributes
    ----------
    counts : (cells_U, cells_dp)
        Samples in each cell; those outside the ranges are ignored.
    share : float
        Share of the cells with samples.
    """

    counts: NDArray[np.int64]
    share: float


def coverage(
    samples: Samples,
    U_range: tuple[float, float] = (0.0, 100.0),
    dp_range: tuple[float, float] = (0.0, 200.0),
    cells: tuple[int, int] = (10, 10),
) -> Coverage:
    """Count good samples on a grid over U (%) and dp (bar)."""
    good = (samples.quality != Quality.BAD) & np.isfinite(samples.U) & np.isfinite(samples.dp)
    counts = np.histogram2d(samples.U[good], samples.dp[good], cells, [U_range, dp_range])[0]
    return Coverage(counts.astype(np.int64), float(np.mean(counts > 0.0)))
