"""Where a new measurement will lie: the spread of the residuals, region by region."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from service.identification.kernels import residual_spread as kernel
from service.identification.samples import Floats, Samples, Segments, Trace

TWO_SIDED_95: Final = kernel.GAUSSIAN
EDGES_U: Final = kernel.WIDTH_U * np.arange(kernel.CELLS_U + 1)
EDGES_DP: Final = (kernel.WIDTH_S * np.arange(kernel.CELLS_S + 1)) ** 2


@dataclass(frozen=True)
class ResidualSpread:
    """How far recent measurements lay off the map, by region of (U, dp), for any structure.

    The standard deviation of an estimator's Q̂ says how well the *map* is known if its structure
    is right. A new measurement lies off that map by its noise, by what the structure cannot follow
    *there*, and by how far the map moves until then. All are in the errors of what the map said up
    to 31 samples before, so their mean square is kept in 120 cells of 10 % by 1.5 √bar. The 95 %
    interval of a measurement within the next 32 samples is then::

        Q̂ ± √((k·m(U, dp))² + (1.96·std)²)

    with m the root mean square around the point, std the map's own standard deviation, and k the
    multiple that 5 % of those errors exceed: 1.96 where they are Gaussian, otherwise what they are
    seen to be. k climbs a little with each measurement outside and falls with each inside, so that
    95 % of them are covered in the long run, whatever the structure and the noise. There are four
    k, by how long ago the cell was visited: what a map says of a place that it just left is better
    than what it says of one where it comes back to.

    Attributes
    ----------
    cells : (120, 6), overall : (11,)
        See :mod:`service.identification.kernels.residual_spread`.

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

    cells: Floats
    overall: Floats

    @classmethod
    def none(cls) -> "ResidualSpread":
        """Nothing measured yet."""
        cells = np.zeros((kernel.CELLS_U * kernel.CELLS_S, kernel.PLACES_OF_CELL))
        overall = np.zeros(kernel.PLACES_OVERALL)
        overall[kernel.QUANTILE : kernel.TIMES] = TWO_SIDED_95
        return cls(cells, overall)

    def add(self, samples: Samples, trace: Trace) -> "ResidualSpread":
        """Take in what was predicted of N samples; NaN residuals count nowhere."""
        cells, overall = self.cells.copy(), self.overall.copy()
        one = Segments.one(len(samples))
        kernel.learn(
            samples.t,
            samples.U,
            samples.dp,
            trace.residual,
            trace.early,
            cells[None],
            overall[None],
            one,
        )
        return ResidualSpread(cells, overall)

    @property
    def noise_std(self) -> float:
        """Standard deviation of a measurement about the map, l/min; NaN before the first."""
        return float(noise_std(self.overall))

    @property
    def multiple(self) -> float:
        """Root mean squares that hold 95 % where it was measured just now; 1.96 if Gaussian."""
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
        kernel.reach(self.cells, self.overall, U, dp, out)
        return np.hypot(out, TWO_SIDED_95 * std)

    def density(self, U: Floats, dp: Floats) -> Floats:
        """How many recent samples lie around N points (N,), near ones counting more."""
        middles_U = (EDGES_U[:-1] + EDGES_U[1:]) / 2.0
        middles_s = (np.sqrt(EDGES_DP[:-1]) + np.sqrt(EDGES_DP[1:])) / 2.0
        far_U = (U[:, None] - middles_U) / (2.0 * kernel.WIDTH_U)
        far_s = (np.sqrt(np.abs(dp))[:, None] - middles_s) / (2.0 * kernel.WIDTH_S)
        near_U, near_s = np.exp(-(far_U**2) / 2.0), np.exp(-(far_s**2) / 2.0)
        return np.asarray(((near_U @ self.weights) * near_s).sum(axis=1))

    @property
    def weights(self) -> Floats:
        """Recent samples in each cell, (10, 12) over U and √dp."""
        return self.cells[:, kernel.WEIGHT].reshape(kernel.CELLS_U, kernel.CELLS_S)

    @property
    def last(self) -> NDArray[np.float64]:
        """Time of each cell's last sample, UTC ns, (10, 12); NaN where there was none."""
        seen = self.cells[:, kernel.NUMBER] > 0.0
        last = np.where(seen, self.cells[:, kernel.LAST], np.nan)
        return last.reshape(kernel.CELLS_U, kernel.CELLS_S)


def noise_std(overall: Floats) -> Floats:
    """`ResidualSpread.noise_std` of any number of them, (…, 11) → (…)."""
    known = overall[..., kernel.WEIGHT] > 0.0
    return np.asarray(np.where(known, np.sqrt(overall[..., kernel.SQUARES]), np.nan))
