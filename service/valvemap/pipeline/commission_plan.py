"""Where a commissioning run goes: crossing triangles, then where the map is unsure. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from valvemap.model.samples import Floats
from valvemap.pipeline.commission_limits import Limits, Point, Range

GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0  # ratio of the periods: least like any fraction
CANDIDATES_U, CANDIDATES_LOAD = 9, 5  # ends of moves that are compared
STOPS: Final = 6  # moves planned at once
ALONG: Final = 12  # points of a move
REACH_U, REACH_S = 0.08, 0.12  # share of the ranges of U and √Δp that one sample informs
FLAT: Final = 1e-9


@dataclass(frozen=True)
class Plan:
    """A run: triangles for ``sweep_s``, then refinement, ``most_s`` in all; times in s.

    ``period_s`` is the time from end to end of the range of U and back. The last triangle takes
    ``last_period_s`` or somewhat longer, 0: it is like the others. Two paces tell hysteresis from
    lag.
    """

    period_s: float = 4.0
    sweep_s: float = 24.0
    most_s: float = 60.0
    last_period_s: float = 0.0

    def last(self) -> tuple[float, float]:
        """Start and duration of the last triangle, s."""
        if self.last_period_s == 0.0:
            return self.sweep_s, self.period_s
        start = self.period_s * math.floor((self.sweep_s - self.last_period_s) / self.period_s)
        return start, self.sweep_s - start

    def period_of_load(self) -> float:
        """Period of the load's triangle, s; its ratio to that of U is no fraction."""
        return self.period_s / GOLDEN

    def paced_period(self, limits: Limits) -> float:
        """Time from end to end of U and back that the limits' slew permits, ``period_s`` at least.

        >>> Plan(period_s=4.0).paced_period(Limits(slew_percent_per_s=20.0))
        10.0
        """
        return self.period_s / min(self.ahead(limits), 1.0)

    def pace(self, limits: Limits) -> Point:
        """Fastest planned changes, %/s and bar/s, within the limits."""
        U = min(3.0 * limits.U_span / self.period_s, limits.slew_percent_per_s)
        if limits.load_range is None:
            return Point(U)
        low, high = limits.load_range
        return Point(U, min(3.0 * (high - low) / self.period_of_load(), limits.load_slew_bar_per_s))

    def ahead(self, limits: Limits) -> float:
        """How much faster than the triangles U and load may move within their slew."""
        of_U = limits.slew_percent_per_s * self.period_s / (2.0 * limits.U_span)
        if limits.load_range is None:
            return of_U
        low, high = limits.load_range
        return min(of_U, limits.load_slew_bar_per_s * self.period_of_load() / (2.0 * (high - low)))


def triangle(t: float, period_s: float, bounds: Range) -> float:
    """Triangle from the low end at t = 0.

    >>> [triangle(t, 4.0, (0.0, 100.0)) for t in (0.0, 1.0, 2.0, 3.0, 4.0)]
    [0.0, 50.0, 100.0, 50.0, 0.0]
    """
    phase = (t / period_s) % 1.0
    return bounds[0] + (bounds[1] - bounds[0]) * (1.0 - abs(2.0 * phase - 1.0))


def sweep(plan: Plan, limits: Limits, t: float) -> Point:
    """Return the point of the crossing triangles ``t`` s after their start."""
    start, last_s = plan.last()
    since, period_s = (t, plan.period_s) if t < start else (t - start, last_s)
    U = triangle(since, period_s, limits.U_range)
    if limits.load_range is None:
        return Point(U)
    load = triangle(t, plan.period_of_load(), (limits.load_range[1], limits.load_range[0]))
    return Point(U, load)


@dataclass(frozen=True)
class Uncertainty:
    """Variance of the map, (l/min)², at points of (U, dp), all (N,)."""

    U: Floats
    dp: Floats
    variance: Floats

    @property
    def rms(self) -> float:
        """Standard deviation of the map over its range, RMS; NaN where it is not known."""
        return float(np.sqrt(np.mean(self.variance))) if len(self.variance) else math.nan


def route(
    limits: Limits, pace: Point, start: Point, drop_of: Point, at: Uncertainty
) -> tuple[Point, ...]:
    """Return the next moves from ``start``: greedily the largest decrease of variance per second.

    A sample lowers the variance around it (Gaussian, `REACH_U`, `REACH_S`). Moves are judged by
    I-optimality: the sum over the map of what the samples along them lower, over travel time.

    Parameters
    ----------
    drop_of
        Newest measured U and Δp: ``drop_of.load`` + ``start.load`` is taken as the supply.
    """
    if not len(at.variance) or not np.isfinite(at.variance).any():
        return ()
    variance = np.where(np.isfinite(at.variance), at.variance, np.nanmax(at.variance))
    supply = drop_of.load + (0.0 if math.isnan(start.load) else start.load)
    ends = _ends(limits)
    moves: list[Point] = []
    for _ in range(STOPS):
        gains = [
            _gain(limits, pace, start, end, supply, drop_of.load, at, variance) for end in ends
        ]
        best = int(np.argmax([gain for gain, _ in gains]))
        if gains[best][0] <= FLAT:
            break
        variance = variance * gains[best][1]
        start = ends[best]
        moves.append(start)
    return (*moves, *reversed(moves[:-1]))  # both ways: play must not lean to one side


def _ends(limits: Limits) -> Sequence[Point]:
    U = np.linspace(*limits.U_range, CANDIDATES_U).tolist()
    if limits.load_range is None:
        return [Point(u) for u in U]
    loads = np.linspace(*limits.load_range, CANDIDATES_LOAD).tolist()
    return [Point(u, load) for u in U for load in loads]


def _gain(
    limits: Limits,
    pace: Point,
    start: Point,
    end: Point,
    supply: float,
    drop: float,
    at: Uncertainty,
    variance: Floats,
) -> tuple[float, Floats]:
    """Return the decrease of variance per second, and the factor that is left of it, (N,)."""
    share = np.linspace(0.0, 1.0, ALONG + 1)[1:]
    U = start.U + share * (end.U - start.U)
    seconds = abs(end.U - start.U) / pace.U
    if math.isnan(end.load):
        dp = np.full(ALONG, drop)
    else:
        seconds = max(seconds, abs(end.load - start.load) / pace.load)
        dp = supply - (start.load + share * (end.load - start.load))
    if seconds < 1e-3:
        return 0.0, np.ones(len(variance))
    span_s = max(float(np.sqrt(np.abs(at.dp)).max()), 1e-9)
    in_U = (U[:, None] - at.U) / (REACH_U * limits.U_span)
    in_s = (np.sqrt(np.abs(dp))[:, None] - np.sqrt(np.abs(at.dp))) / (REACH_S * span_s)
    near = np.exp(-0.5 * (in_U**2 + in_s**2)).sum(axis=0) * seconds / ALONG
    left = 1.0 / (1.0 + near * 4.0)
    return float(np.sum(variance * (1.0 - left)) / (seconds + 0.2)), left
