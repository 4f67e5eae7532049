"""How well a flow map fits: figures, and the table that shows them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from service.identification.samples import Floats


@dataclass(frozen=True)
class Score:
    """Errors of predicted against measured (or true) flow over n samples; NaN where undefined.

    Attributes
    ----------
    rmse : float
        Root of the mean squared error, l/min.
    nrmse : float
        ``rmse`` over the range max Q - min Q.
    max_abs : float
        Largest absolute error, l/min.
    r2 : float
        Coefficient of determination, 1 - Σ(Q - Q̂)²/Σ(Q - mean Q)².
    n : int
        Samples that count: Q and Q̂ are both finite.
    """

    rmse: float
    nrmse: float
    max_abs: float
    r2: float
    n: int


def score(Q: Floats, Q_hat: Floats) -> Score:
    """Score predictions, arrays of shape (N,), l/min.

    >>> score(np.array([0.0, 10.0, 20.0, np.nan]), np.array([0.0, 13.0, 16.0, 7.0]))
    Score(rmse=2.886..., nrmse=0.144..., max_abs=4.0, r2=0.875, n=3)
    """
    return Tally().add(Q, Q_hat).score


@dataclass(frozen=True)
class Tally:
    """Running sums of a :class:`Score`, so that a stream of any length is scored as it passes.

    The sums run from sample to sample in their order: the same stream cut into other batches
    gives the same bits.

    >>> Q, Q_hat = np.array([0.0, 10.0, 20.0]), np.array([0.0, 13.0, 16.0])
    >>> Tally().add(Q[:1], Q_hat[:1]).add(Q[1:], Q_hat[1:]).score == score(Q, Q_hat)
    True
    """

    n: int = 0
    origin: float = 0.0
    deviations: float = 0.0
    squared_deviations: float = 0.0
    squared_errors: float = 0.0
    max_abs: float = 0.0
    lowest: float = math.inf
    highest: float = -math.inf

    def add(self, Q: Floats, Q_hat: Floats) -> "Tally":
        """Take N samples more, arrays of shape (N,), l/min; those not finite do not count."""
        with np.errstate(all="ignore"):
            error = Q - Q_hat
            counts = np.isfinite(error)
            Q, error = Q[counts], error[counts]
            if not len(Q):
                return self
            origin = self.origin if self.n else float(Q[0])
            deviation = Q - origin  # from a value nearby: the sums do not cancel
            return Tally(
                n=self.n + len(Q),
                origin=origin,
                deviations=_continued(self.deviations, deviation),
                squared_deviations=_continued(self.squared_deviations, deviation**2),
                squared_errors=_continued(self.squared_errors, error**2),
                max_abs=max(self.max_abs, float(np.abs(error).max())),
                lowest=min(self.lowest, float(Q.min())),
                highest=max(self.highest, float(Q.max())),
            )

    @property
    def score(self) -> Score:
        """The figures of all samples so far."""
        if not self.n:
            return Score(math.nan, math.nan, math.nan, math.nan, 0)
        rmse = math.sqrt(self.squared_errors / self.n)
        span = self.highest - self.lowest
        total = self.squared_deviations - self.deviations**2 / self.n
        return Score(
            rmse=rmse,
            nrmse=rmse / span if span > 0 else math.nan,
            max_abs=self.max_abs,
            r2=1 - self.squared_errors / total if span > 0 and total > 0 else math.nan,
            n=self.n,
        )


def verification_table(title: str, scores: Mapping[str, Mapping[str, Score]]) -> Table:
    """Table of valves and their estimators × figures, for a terminal.

    Parameters
    ----------
    title
        What was compared with what.
    scores
        Valve → estimator → its score, shown in this order.
    """
    table = Table(title=title, title_justify="left")
    for heading in ("Valve", "Estimator"):
        table.add_column(heading)
    for heading in ("RMSE\nl/min", "NRMSE\n% of range", "max |e|\nl/min", "R²", "samples"):
        table.add_column(heading, justify="right")
    for valve, estimators in scores.items():
        for i, (estimator, figures) in enumerate(estimators.items()):
            table.add_row(
                valve if i == 0 else "",
                estimator,
                _figure(figures.rmse),
                _figure(100 * figures.nrmse),
                _figure(figures.max_abs),
                "-" if math.isnan(figures.r2) else f"{figures.r2:.5f}",
                f"{figures.n:,}",
            )
        table.add_section()
    return table


def _continued(start: float, terms: Floats) -> float:
    return float(np.add.accumulate(np.concatenate([[start], terms]))[-1])


def _figure(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"
