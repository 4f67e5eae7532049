"""Region of a map's samples, and the test whether eq. (7) fits them."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Self

import numpy as np

from valvemap.model.kernels import lack_of_fit, support
from valvemap.model.samples import Codes, Floats, Samples, Segments, Trace

SIGNIFICANT: Final = np.array([3.3] * 2 + [3.9] * 4)  # std: 1 false positive in 400 maps
DECIDED: Final = 128.0  # blocks that a test with coloured noise needs
FEW, BEYOND_DOUBT = 8.0, 10.0  # blocks, std: drift and coloured noise reach 7, misfit 30
DOUBT: Final = 4.0  # standard deviations of a curvature that is below the detection limit
BENDS: Final = 2  # terms of curvature, in U and in s, with which eq. (7) extrapolates

U_DEFAULT, DP_DEFAULT, Q_DEFAULT = (0.0, 100.0), (0.0, 200.0), 200.0


@dataclass(frozen=True)
class Support:
    """Region of a map's samples, and the lack-of-fit test of eq. (7).

    A point is *inside* if at least three samples are within 5 % of U, 5 bar and 5 °C. Outside, a
    map is valid only if its structure is. That cannot be tested there, but a structure that does
    not fit inside is rejected. Six terms that eq. (7) lacks (U²s, U·dp, U³s, U², s³, U³) are
    tested: none may explain more of Q than the noise would. The noise is taken as white, or, with
    enough samples, from the long-run covariance of the scores over blocks of 256 samples. The test
    must also have enough power: a curvature below its detection limit must have a small effect.

    Attributes
    ----------
    cells : (484, 9), uint8
        See :mod:`valvemap.model.kernels.support`.
    fit : (225,)
        See :mod:`valvemap.model.kernels.lack_of_fit`.
    ranges : (5,)
        Lower and upper limit of U (%) and of dp (bar), and the largest flow, l/min.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> U, dp, e = rng.uniform(5, 40, 5000), rng.uniform(5, 60, 5000), rng.normal(0, 0.4, 5000)
    >>> status = np.zeros(5000, np.uint8)
    >>> even = Samples.of(np.arange(5000), U, dp, 0 * dp, 0.12 * U * np.sqrt(dp) + e)
    >>> seen = Support.none().add(even, Trace(e, e, e, status))
    >>> seen.distance(np.array([20.0, 50.0]), np.array([30.0, 30.0]), np.full(2, np.nan)).round()
    array([0., 2.])
    >>> seen.is_eq7_enough
    True
    >>> bent = Samples.of(np.arange(5000), U, dp, 0 * dp, 0.003 * U**2 * np.sqrt(dp) + e)
    >>> Support.none().add(bent, Trace(e, e, e, status)).is_eq7_enough
    False
    """

    cells: Codes
    fit: Floats
    ranges: Floats

    @classmethod
    def none(
        cls,
        U_range: tuple[float, float] = U_DEFAULT,
        dp_range: tuple[float, float] = DP_DEFAULT,
        Q_max: float = Q_DEFAULT,
    ) -> Self:
        """Support without samples, for a valve of these ranges (%, bar, l/min)."""
        cells = np.zeros((support.CELLS_U * support.CELLS_DP, support.PLACES_OF_CELL), np.uint8)
        ranges = np.array([*U_range, *dp_range, Q_max], np.float64)
        return cls(cells, np.zeros(lack_of_fit.PLACES), ranges)

    @classmethod
    def of_boxes(cls, boxes: Floats, fit: Floats, ranges: Floats) -> Self:
        """Restore from a file: `boxes` (n, 9), `fit` and `ranges`."""
        cells = cls.none().cells
        support.fill(boxes, ranges, cells)
        return cls(cells, fit, ranges)

    def forgotten(self) -> Self:
        """Support without samples, for the same valve."""
        return replace(self, cells=np.zeros_like(self.cells), fit=np.zeros_like(self.fit))

    def add(self, samples: Samples, trace: Trace) -> "Support":
        """Add the positions of N samples, if the estimator used them."""
        many = self.of_many(1)
        many.learn(samples, trace.status, Segments.one(len(samples)))
        return many.one(0)

    def of_many(self, M: int) -> "SupportOfMany":
        """Copy to M maps."""
        return SupportOfMany(
            cells=np.tile(self.cells, (M, 1, 1)),
            fit=np.tile(self.fit, (M, 1)),
            ranges=np.tile(self.ranges, (M, 1)),
        )

    @property
    def Q_max(self) -> float:
        """The largest flow of the valve, l/min."""
        return float(self.ranges[4])

    @cached_property
    def boxes(self) -> Floats:
        """One row for each cell with samples: count (up to 255), low and high of U, dp and T."""
        return np.asarray(support.boxes(self.cells, self.ranges))

    def distance(self, U: Floats, dp: Floats, T: Floats) -> Floats:
        """Distance of N points from three samples (N,), 1 at the border; see `distances`."""
        return self.distances(U, dp, T)[0]

    def distances(self, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats, Floats]:
        """Distances as in `distance`, without the temperature, and of the temperature alone.

        They are infinite without three samples. If the temperature alone places a point outside,
        the last is its distance there, else that from all temperatures of the samples. A
        temperature that is NaN, or was never measured, has no effect.
        """
        U, dp, T = (np.require(x, np.float64, ["C", "W", "A"]) for x in (U, dp, T))
        far, level = np.empty((2, len(U)))
        support.distances(self.boxes, U, dp, T, far, level)
        measured = self.boxes[~np.isnan(self.boxes[:, support.T_LOW])]
        low = measured[:, support.T_LOW].min(initial=np.inf)
        high = measured[:, support.T_HIGH].max(initial=-np.inf)
        anywhere = np.zeros(len(U))
        if len(measured):
            gap = np.maximum(np.maximum(low - T, T - high), 0.0) / support.NEAR_T
            anywhere = np.where(np.isnan(gap), 0.0, gap)
        return far, level, np.where(far > level, far, anywhere)

    def below(self, dp: Floats) -> Floats:
        """Distance of N pressure drops (bar) below the lowest sample (N,), 1 at the border.

        Measured in √dp, like flows: from 5 bar to 2 is further than from 65 to 60. It is 0 if
        samples lie on both sides of dp = 0, or there are none.
        """
        low = self.boxes[:, support.DP_LOW].min(initial=np.inf)
        high = self.boxes[:, support.DP_HIGH].max(initial=-np.inf)
        least = max(low, -high)
        if not 0.0 < least < np.inf:
            return np.zeros(len(dp))
        roots = np.sqrt(least) - np.sqrt(np.abs(dp))
        return np.asarray(np.maximum(roots, 0.0) / support.NEAR_ROOT)

    @cached_property
    def is_eq7_enough(self) -> bool:
        """Whether no further term explains more of Q than the noise would."""
        variance, white, long_run = self._contrasts
        if np.isnan(variance) or np.isnan(white[:BENDS]).any():
            return False
        if not (white > SIGNIFICANT).any():
            return True
        decided = self.fit[lack_of_fit.BLOCKS] >= DECIDED
        return bool(decided and not (long_run > SIGNIFICANT).any())

    @cached_property
    def is_eq7_refuted(self) -> bool:
        """Whether a further term explains more of Q than coloured noise or drift would.

        With few blocks, the colour of the noise is unknown and it is taken as white. In coloured
        noise the interval is then too wide, which is safer than too narrow where eq. (7) does not
        fit.
        """
        _, white, long_run = self._contrasts
        many = self.fit[lack_of_fit.BLOCKS] >= FEW
        return bool(((np.minimum(white, long_run) if many else white) > BEYOND_DOUBT).any())

    @cached_property
    def _contrasts(self) -> tuple[float, Floats, Floats]:
        """Variance of the noise; contributions of the further terms in white and coloured noise."""
        white, long_run = np.empty((2, lack_of_fit.TERMS - lack_of_fit.FIVE))
        variance = float(lack_of_fit.judge(self.fit, white, long_run))
        return variance, np.abs(white), np.abs(long_run)

    def misfit(self, U: Floats, dp: Floats, Q: Floats) -> Floats:
        """Misfit of a map of eq. (7) with flow ``Q`` at N points, by all terms (N,), l/min."""
        out = np.empty(len(U))
        U, dp = (np.require(x, np.float64, ["C", "W", "A"]) for x in (U, dp))
        lack_of_fit.bent(self.fit, U, dp, out)
        return np.minimum(np.abs(out - Q), self.Q_max)

    def may_hide(self, U: Floats, dp: Floats) -> Floats:
        """Largest effect of undetectable curvature of eq. (7) at N points, l/min."""
        variance, _, _ = self._contrasts
        out = np.empty(len(U))
        U, dp = (np.require(x, np.float64, ["C", "W", "A"]) for x in (U, dp))
        lack_of_fit.hidden(self.fit, U, dp, BENDS, out)
        return np.asarray(np.where(np.isfinite(out), DOUBT * np.sqrt(variance) * out, np.inf))


@dataclass(frozen=True)
class SupportOfMany:
    """Supports of M maps: the arrays of `Support` with a leading axis M, written in place."""

    cells: Codes
    fit: Floats
    ranges: Floats

    def learn(self, samples: Samples, status: Codes, segments: Segments) -> None:
        """Add the positions of the samples that the estimator used."""
        where = samples.U, samples.dp
        support.learn(*where, samples.T, status, self.cells, self.ranges, segments)
        lack_of_fit.learn(*where, samples.Q, status, self.fit, segments)

    def one(self, m: int) -> Support:
        """Return a copy of map ``m``."""
        return Support(self.cells[m].copy(), self.fit[m].copy(), self.ranges[m].copy())

    def view(self, m: int) -> Support:
        """Return map ``m``, not copied."""
        return Support(self.cells[m], self.fit[m], self.ranges[m])

    def put(self, m: int, one: Support) -> None:
        """Replace map ``m``."""
        self.cells[m], self.fit[m], self.ranges[m] = one.cells, one.fit, one.ranges
