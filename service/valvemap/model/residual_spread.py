"""Prediction interval of a new measurement, from the local spread of the residuals."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from valvemap.model.kernels import residual_spread as kernel
from valvemap.model.kernels.residual_spread import Stamps
from valvemap.model.samples import Codes, Floats, Samples, Segments, Singles, Trace

TWO_SIDED_95: Final = kernel.GAUSSIAN
EDGES_U: Final = kernel.WIDTH_U * np.arange(kernel.CELLS_U + 1)
EDGES_DP: Final = (kernel.WIDTH_S * np.arange(kernel.CELLS_S + 1)) ** 2


@dataclass(frozen=True)
class ResidualSpread:
    """Spread of recent residuals by region of (U, dp), for any structure.

    The standard deviation of an estimator's Q̂ is the uncertainty of the *map* if its structure is
    right. A new measurement also deviates by noise, by local structural misfit and by the motion of
    the map until then. The errors of predictions up to 31 samples old contain all three; their mean
    square is stored in 120 cells of 10 % by 1.5 √bar. The 95 % interval of a measurement within the
    next 32 samples is then::

        Q̂ ± √((k·m(U, dp))² + (1.96·std)²)

    with m the root mean square around the point, std the map's standard deviation, and k the
    multiple that 5 % of those errors exceed, 1.96 if they are Gaussian. k increases a little with
    each measurement outside and decreases with each inside, so that the long-run coverage is 95 %
    for any structure and noise. There are four values of k, by the time since the cell was last
    visited: predictions in a cell just left are better than in one revisited later.

    Attributes
    ----------
    cells : (120, 3), stamps : (120, 2), ages : (120,), overall : (11,)
        See :mod:`valvemap.model.kernels.residual_spread`.

    References
    ----------
    I. Gibbs, E. Candès, Adaptive conformal inference under distribution shift, NeurIPS 2021.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> U, dp, e = rng.uniform(0, 100, 5000), rng.uniform(0, 200, 5000), rng.normal(0, 2, 5000)
    >>> samples = Samples.of(np.arange(5000), U, dp, 0 * dp, e)
    >>> spread = ResidualSpread.none().add(samples, Trace(0 * e, e, e, np.zeros(5000, np.uint8)))
    >>> half = spread.half_width(U, dp, np.zeros(5000))
    >>> 3.7 < float(half.mean()) < 4.2
    True
    """

    cells: Singles
    stamps: Stamps
    ages: Codes
    overall: Floats

    @classmethod
    def none(cls) -> "ResidualSpread":
        """Initial state without residuals."""
        n = kernel.CELLS_U * kernel.CELLS_S
        overall = np.zeros(kernel.PLACES_OVERALL)
        overall[kernel.QUANTILE : kernel.TIMES] = TWO_SIDED_95
        return cls(
            cells=np.zeros((n, kernel.PLACES_OF_CELL), np.float32),
            stamps=np.zeros((n, kernel.PLACES_OF_STAMPS), np.uint32),
            ages=np.zeros(n, np.uint8),
            overall=overall,
        )

    def of_many(self, M: int) -> "SpreadOfMany":
        """Copy to M maps."""
        return SpreadOfMany(
            cells=np.tile(self.cells, (M, 1, 1)),
            stamps=np.tile(self.stamps, (M, 1, 1)),
            ages=np.tile(self.ages, (M, 1)),
            overall=np.tile(self.overall, (M, 1)),
        )

    def add(self, samples: Samples, trace: Trace) -> "ResidualSpread":
        """Add the residuals of N predicted samples; NaN residuals are ignored."""
        after = self.of_many(1)
        after.learn(samples, trace, Segments.one(len(samples)))
        return after.one(0)

    @property
    def noise_std(self) -> float:
        """Standard deviation of a measurement about the map, l/min; NaN without residuals."""
        return float(noise_std(self.overall))

    @property
    def multiple(self) -> float:
        """Multiple of the RMS that covers 95 % in a cell just visited; 1.96 if Gaussian."""
        return float(self.overall[kernel.QUANTILE])

    def around(self, U: Floats, dp: Floats) -> Floats:
        """Root mean square of the residuals around N points (N,), l/min."""
        out = np.empty(len(U))
        U, dp = (np.require(x, np.float64, ["C", "W", "A"]) for x in (U, dp))
        kernel.spread(self.cells, self.overall, U, dp, out)
        return out

    def half_width(self, U: Floats, dp: Floats, std: Floats) -> Floats:
        """Half the 95 % interval of a new measurement (N,), l/min; ``std`` is that of Q̂."""
        out = np.empty(len(U))
        U, dp = (np.require(x, np.float64, ["C", "W", "A"]) for x in (U, dp))
        kernel.reach(*self._arrays, U, dp, out)
        return np.hypot(out, TWO_SIDED_95 * std)

    def density(self, U: Floats, dp: Floats) -> Floats:
        """Number of recent samples around N points (N,), weighted by distance."""
        middles_U = (EDGES_U[:-1] + EDGES_U[1:]) / 2.0
        middles_s = (np.sqrt(EDGES_DP[:-1]) + np.sqrt(EDGES_DP[1:])) / 2.0
        far_U = (U[:, None] - middles_U) / (2.0 * kernel.WIDTH_U)
        far_s = (np.sqrt(np.abs(dp))[:, None] - middles_s) / (2.0 * kernel.WIDTH_S)
        near_U, near_s = np.exp(-(far_U**2) / 2.0), np.exp(-(far_s**2) / 2.0)
        return np.asarray(((near_U @ self.weights) * near_s).sum(axis=1))

    @property
    def weights(self) -> Floats:
        """Recent samples in each cell, (10, 12) over U and √dp."""
        weights = self.cells[:, kernel.WEIGHT].astype(np.float64)
        return weights.reshape(kernel.CELLS_U, kernel.CELLS_S)

    @property
    def last(self) -> Floats:
        """Time of each cell's last sample, UTC ns, (10, 12), to the second; NaN without one."""
        seconds = self.stamps[:, kernel.LAST].astype(np.float64)
        last = np.where(self.ages > 0, kernel.SECOND * seconds, np.nan)
        return last.reshape(kernel.CELLS_U, kernel.CELLS_S)

    @property
    def _arrays(self) -> tuple[Singles, Stamps, Codes, Floats]:
        return self.cells, self.stamps, self.ages, self.overall


@dataclass(frozen=True)
class SpreadOfMany:
    """Spread of the residuals of M maps: arrays of `ResidualSpread` with a leading axis M.

    Written in place.
    """

    cells: Singles
    stamps: Stamps
    ages: Codes
    overall: Floats

    def learn(self, samples: Samples, trace: Trace, segments: Segments) -> None:
        """Add the residuals of predicted samples; NaN residuals are ignored."""
        memory = kernel.Memory(self.cells, self.stamps, self.ages, self.overall)
        where = samples.t, samples.U, samples.dp
        kernel.learn(*where, trace.residual, trace.early, memory, segments)

    def one(self, m: int) -> ResidualSpread:
        """Return a copy of map ``m``."""
        return ResidualSpread(
            cells=self.cells[m].copy(),
            stamps=self.stamps[m].copy(),
            ages=self.ages[m].copy(),
            overall=self.overall[m].copy(),
        )

    def view(self, m: int) -> ResidualSpread:
        """Return map ``m``, not copied."""
        return ResidualSpread(self.cells[m], self.stamps[m], self.ages[m], self.overall[m])

    def put(self, m: int, one: ResidualSpread) -> None:
        """Replace map ``m``."""
        self.cells[m], self.stamps[m] = one.cells, one.stamps
        self.ages[m], self.overall[m] = one.ages, one.overall


def noise_std(overall: Floats) -> Floats:
    """Return `ResidualSpread.noise_std` of any number of maps, (…, 11) → (…)."""
    known = overall[..., kernel.WEIGHT] > 0.0
    return np.asarray(np.where(known, np.sqrt(overall[..., kernel.SQUARES]), np.nan))
