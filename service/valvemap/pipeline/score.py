"""One-step-ahead prediction error of an estimator: each sample is predicted before its update."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvemap.model.samples import Floats, Samples, Segments, Trace
from valvemap.pipeline.kernels import score as kernel


@dataclass(frozen=True)
class Score:
    """One-step-ahead figures over all samples; ``sums`` is an array of constant size.

    Examples
    --------
    >>> samples = Samples.of(t=[0, 1], U=[1, 1], p1=[1, 1], p2=[0, 0], Q=[10, 20])
    >>> trace = Trace(np.array([9.0, 19.0]), np.ones(2), np.ones(2), np.zeros(2, np.uint8))
    >>> Score.none().add(samples, trace).rmse
    1.0
    """

    sums: Floats

    @classmethod
    def none(cls) -> "Score":
        """Return the score before the first prediction."""
        sums = np.zeros(kernel.FIELDS)
        sums[kernel.LOWEST_Q], sums[kernel.HIGHEST_Q] = np.inf, -np.inf
        return cls(sums)

    @classmethod
    def merged(cls, scores: Sequence["Score"]) -> "Score":
        """Merge scores of several sets of samples (Chan); ``recent_rmse`` is that of the last."""
        merged = cls.none().sums
        for score in scores:
            n = merged[kernel.N] + score.n
            if score.n == 0:
                continue
            step = score.sums[kernel.MEAN_Q] - merged[kernel.MEAN_Q]
            between = step * step * merged[kernel.N] * score.n / n
            sums = score.sums.copy()
            sums[kernel.N] = n
            sums[kernel.SQUARES] += merged[kernel.SQUARES]
            sums[kernel.MEAN_Q] = merged[kernel.MEAN_Q] + step * score.n / n
            sums[kernel.SCATTER_Q] += merged[kernel.SCATTER_Q] + between
            sums[kernel.LOWEST_Q] = min(sums[kernel.LOWEST_Q], merged[kernel.LOWEST_Q])
            sums[kernel.HIGHEST_Q] = max(sums[kernel.HIGHEST_Q], merged[kernel.HIGHEST_Q])
            sums[kernel.LARGEST] = max(sums[kernel.LARGEST], merged[kernel.LARGEST])
            merged = sums
        return cls(merged)

    def add(self, samples: Samples, trace: Trace) -> "Score":
        """Add the predictions of N samples; NaN residuals are ignored."""
        sums = self.sums.copy()
        one = Segments.one(len(samples))
        kernel.accumulate(trace.residual, samples.Q, sums[None], one)
        return Score(sums)

    @property
    def n(self) -> int:
        """Number of predicted samples."""
        return int(self.sums[kernel.N])

    @property
    def rmse(self) -> float:
        """Root mean square of all residuals, l/min; NaN before the first."""
        return float(np.sqrt(self.sums[kernel.SQUARES] / self.n)) if self.n else np.nan

    @property
    def max_abs(self) -> float:
        """Largest residual, l/min; NaN before the first."""
        return float(self.sums[kernel.LARGEST]) if self.n else np.nan

    @property
    def recent_rmse(self) -> float:
        """Root mean square over about the last 1,000 residuals, l/min; NaN before the first."""
        return float(recent_rmse(self.sums))

    @property
    def nrmse(self) -> float:
        """``rmse`` over the range of Q; NaN if Q is constant."""
        span = self.sums[kernel.HIGHEST_Q] - self.sums[kernel.LOWEST_Q]
        return float(self.rmse / span) if span > 0 else np.nan

    @property
    def r2(self) -> float:
        """Coefficient of determination R² of the predictions; NaN if Q is constant."""
        scatter = self.sums[kernel.SCATTER_Q]
        return float(1.0 - self.sums[kernel.SQUARES] / scatter) if scatter > 0 else np.nan


def recent_rmse(sums: Floats) -> Floats:
    """`Score.recent_rmse` of any number of scores, (…, fields) → (…)."""
    weight = sums[..., kernel.WEIGHT]
    known = np.where(weight > 0.0, weight, np.nan)
    return np.asarray(np.sqrt(sums[..., kernel.RECENT] / known))
