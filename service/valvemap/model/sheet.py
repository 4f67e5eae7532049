"""A valve's sheet, computed of a guided sweep: its figures, their intervals and the conditions.

The standard holds Δp constant; here the flow curve of any Δp is converted to the rated one by the
fit (`sweep_fit`).

A figure is a function of a flow curve and a play. Its value is the median over draws of both, its
95 % interval holds their quantiles and the same mirrored at the estimate: the largest departure of
a drawn curve is larger than that of the curve.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Samples
from valvemap.model.sheet_figures import FIGURES, GRID, Row, Side
from valvemap.model.sweep_fit import SweepFit, fit_sweep

TRAVERSES: Final = 2  # in each direction; fewer are no test
WHOLE: Final = 0.95  # of the range of U; less is no traverse
IN_TRAVERSES: Final = 0.8  # of the samples; fewer are no test
SLOWEST_HZ: Final = 45.0  # of a test at 50 Hz, some samples of which are lost


class Measured(StrEnum):
    """Whether a figure was measured."""

    MEASURED = "measured"
    NOT_REACHED = "not reached"
    NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Figure:
    """One line of the sheet; ``value`` and its 95 % interval are NaN where it is not measured.

    ``side`` is ``U > 0``, ``U < 0`` or empty; ``reason`` says why it is not measured.
    """

    key: str
    side: str
    name: str
    unit: str
    definition: str
    measured: Measured
    value: float = math.nan
    lower: float = math.nan
    upper: float = math.nan
    reason: str = ""


@dataclass(frozen=True)
class Conditions:
    """Under which the data were taken: ranges of U (%), Δp (bar) and T (°C), pace, duration."""

    U: tuple[float, float]
    dp: tuple[float, float]
    T: tuple[float, float]
    pace: float
    duration: float
    samples: int
    traverses: int


@dataclass(frozen=True)
class Sheet:
    """All figures of a valve, the conditions, and the fit they come of.

    ``not_a_test`` says why the data are no guided sweep; empty if they are one.
    """

    dp_rated: float
    U_rated: float
    figures: tuple[Figure, ...]
    conditions: Conditions
    not_a_test: str
    fit: SweepFit


class SheetError(ValueError):
    """The samples tell no flow curve; one line says why."""


HYSTERESIS: Final = (
    "Width of the loop between rising and falling signal, one for the whole range. The standard "
    "takes the largest width."
)
SYMMETRY: Final = "Difference of the flow gains of both sides over the larger one."
ELSEWHERE: Final = (
    ("threshold", "threshold", "% of U", "needs small steps of U about a standstill"),
    ("pressure_gain", "pressure gain", "bar per % of U", "needs blocked service ports"),
)


KEYS: Final = (
    *(row.key for row in FIGURES),
    *("hysteresis", "symmetry"),
    *(row[0] for row in ELSEWHERE),
)
"""Keys of all figures."""


def make_sheet(
    samples: Samples, dp_rated: float = 70.0, U_range: tuple[float, float] = (0.0, 100.0)
) -> Sheet:
    """Compute the sheet of a valve.

    Parameters
    ----------
    samples
        Of a guided sweep: triangles of U through its whole range, at 50 Hz or more.
    dp_rated
        Pressure drop for which the figures hold, bar.
    U_range
        Rated signal, %: 0 to 100, or -100 to 100 for a valve that works both ways.

    Raises
    ------
    SheetError

    Examples
    --------
    >>> t = np.arange(4000)
    >>> U = 100 * np.abs((t / 500) % 2 - 1)
    >>> Q = 0.1 * U * np.sqrt(70) + np.random.default_rng(0).normal(0, 0.2, 4000)
    >>> samples = Samples.of(t=t * 10**7, U=U, p1=0 * U + 70, p2=0 * U, Q=Q)
    >>> [f"{f.value:.1f}" for f in make_sheet(samples).figures if f.key == "rated_flow"]
    ['83.7']
    """
    conditions = _conditions(samples, U_range)
    low, high = conditions.dp
    if not low <= dp_rated <= high:
        raise SheetError(
            f"the rated Δp is {dp_rated:g} bar; the recording has {low:.3g} to {high:.3g} bar, "
            "state a value within"
        )
    sides = [end for end in U_range if end != 0.0]
    grid = np.unique(np.concatenate([np.linspace(0.0, end, GRID) for end in sides]))
    fit = fit_sweep(samples, dp_rated, grid)
    if fit is None:
        raise SheetError("there are too few good samples for a flow curve: 500 are needed")
    figures: list[Figure] = []
    gains = []
    for end in sorted(sides, reverse=True):
        side = _side(fit, end)
        name = "" if len(sides) == 1 else "U > 0" if end > 0.0 else "U < 0"
        figures += [_figure(row, side, name, end, conditions) for row in FIGURES]
        gains.append(side.line()[0])
    figures += _of_the_whole(fit, gains)
    return Sheet(
        dp_rated=dp_rated,
        U_rated=max(map(abs, U_range)),
        figures=tuple(figures),
        conditions=conditions,
        not_a_test=_not_a_test(samples, U_range),
        fit=fit,
    )


def true_figures(
    flow: Callable[[Floats], Floats], play: float, U_range: tuple[float, float] = (0.0, 100.0)
) -> dict[tuple[str, str], float]:
    """Figures of a known flow curve at the rated Δp, by key and side: what tests compare with."""
    found: dict[tuple[str, str], float] = {}
    gains = []
    sides = [end for end in U_range if end != 0.0]
    for end in sides:
        x = np.linspace(0.0, abs(end), GRID)
        Q = np.sign(end) * flow(np.sign(end) * x)
        first, top = (int(np.searchsorted(x, end)) for end in (0.5 * play, x[-1] - 0.5 * play))
        side = Side(x, Q[None, :], np.array([play]), first, top)
        name = "" if len(sides) == 1 else "U > 0" if end > 0.0 else "U < 0"
        found |= {(row.key, name): float(row.of(side)[0]) for row in FIGURES}
        gains.append(side.line()[0])
    if len(gains) > 1:
        found["symmetry", ""] = float(_symmetry(gains)[0])
    return found | {("hysteresis", ""): play}


def _side(fit: SweepFit, end: float) -> Side:
    own = fit.x >= 0.0 if end > 0.0 else fit.x <= 0.0
    order = np.argsort(np.abs(fit.x[own]))
    sign = math.copysign(1.0, end)
    Q = sign * np.vstack([fit.Q, fit.Q_draws])[:, own][:, order]
    play = np.concatenate([[fit.play], fit.play_draws])
    known = np.flatnonzero(fit.known[own][order])
    first, top = (int(known[0]), int(known[-1])) if len(known) else (0, 0)
    return Side(np.abs(fit.x[own][order]), Q, play, first, top)


def _figure(row: Row, side: Side, name: str, end: float, conditions: Conditions) -> Figure:
    reached = conditions.U[1] if end > 0.0 else -conditions.U[0]
    if reached < WHOLE * abs(end):
        reason = f"U was {reached:.3g} % at most of {abs(end):g} %"
        return _without(row, name, Measured.NOT_MEASURED, reason)
    found = row.of(side)
    if row.not_reached and not math.isfinite(found[0]):
        return _without(row, name, Measured.NOT_REACHED, row.not_reached)
    return _summed_up(row.key, name, row.name, row.unit, row.definition, found, row.least)


def _without(row: Row, side: str, measured: Measured, reason: str) -> Figure:
    return Figure(row.key, side, row.name, row.unit, row.definition, measured, reason=reason)


def _summed_up(
    key: str, side: str, name: str, unit: str, definition: str, found: Floats, least: float = 0.0
) -> Figure:
    """Summarise the estimate, found[0], and the draws behind it; no value is below ``least``."""
    draws = found[1:][np.isfinite(found[1:])]
    if not math.isfinite(found[0]) or len(draws) < 0.5 * (len(found) - 1):
        reason = "the curve does not tell it"
        return Figure(key, side, name, unit, definition, Measured.NOT_MEASURED, reason=reason)
    low, value, high = (float(q) for q in np.quantile(draws, [0.025, 0.5, 0.975]))
    low, high = min(low, 2.0 * found[0] - high), max(high, 2.0 * found[0] - low)
    value, low, high = (max(each, least) for each in (value, low, high))
    return Figure(*(key, side, name, unit, definition, Measured.MEASURED), value, low, high)


def _of_the_whole(fit: SweepFit, gains: list[Floats]) -> list[Figure]:
    play = np.concatenate([[fit.play], fit.play_draws])
    figures = [_summed_up("hysteresis", "", "hysteresis", "% of U", HYSTERESIS, play)]
    if len(gains) > 1:
        apart = _symmetry(gains)
        figures.append(_summed_up("symmetry", "", "symmetry", "% of flow gain", SYMMETRY, apart))
    for key, name, unit, reason in ELSEWHERE:
        figures.append(Figure(key, "", name, unit, "", Measured.NOT_MEASURED, reason=reason))
    return figures


def _symmetry(gains: list[Floats]) -> Floats:
    return np.asarray(100.0 * np.abs(gains[0] - gains[1]) / np.maximum(gains[0], gains[1]))


def _conditions(samples: Samples, U_range: tuple[float, float]) -> Conditions:
    if not len(samples):
        raise SheetError("there are no samples")
    dp, T = samples.dp[np.isfinite(samples.dp)], samples.T[np.isfinite(samples.T)]
    seconds = 1e-9 * float(samples.t[-1] - samples.t[0])
    dt = np.maximum(np.diff(samples.t) * 1e-9, 1e-9)
    pace = np.abs(np.diff(samples.U)) / dt
    traverses, _ = _traverses(samples.U, U_range)
    return Conditions(
        U=(float(np.nanmin(samples.U)), float(np.nanmax(samples.U))),
        dp=(float(dp.min()), float(dp.max())) if len(dp) else (math.nan, math.nan),
        T=(float(T.min()), float(T.max())) if len(T) else (math.nan, math.nan),
        pace=float(np.nanmedian(pace)) if len(pace) else math.nan,
        duration=seconds,
        samples=len(samples),
        traverses=traverses,
    )


def _traverses(U: Floats, U_range: tuple[float, float]) -> tuple[int, int]:
    """Number of traverses of the range, and of the samples in them."""
    low, high = U_range
    margin = (1.0 - WHOLE) * (high - low)
    ends = np.where(low + margin >= U, -1, np.where(high - margin <= U, 1, 0))
    at = np.flatnonzero(ends)
    turns = at[1:][np.diff(ends[at]) != 0]
    starts = at[:-1][np.diff(ends[at]) != 0]
    inside = 0
    for a, b in zip(starts.tolist(), turns.tolist(), strict=True):
        steps = np.diff(U[a : b + 1]) * (1.0 if U[b] > U[a] else -1.0)
        forth = float(steps[steps > 0.0].sum())
        if float(-steps[steps < 0.0].sum()) < 0.1 * forth:  # it goes one way
            inside += b - a
    if len(at):
        inside += int(np.count_nonzero(ends))
    return len(turns), min(inside, len(U))


def _not_a_test(samples: Samples, U_range: tuple[float, float]) -> str:
    traverses, inside = _traverses(samples.U, U_range)
    rate = (len(samples) - 1) / max(1e-9 * float(samples.t[-1] - samples.t[0]), 1e-9)
    if rate < SLOWEST_HZ:
        return f"the samples come at {rate:.3g} Hz; a test has 50 Hz or more"
    if traverses < 2 * TRAVERSES:
        return f"U went through its range {traverses} times; a test does so {2 * TRAVERSES} times"
    if inside < IN_TRAVERSES * len(samples):
        share = 100.0 * inside / len(samples)
        return f"{share:.0f} % of the samples belong to traverses of the range; the rest is work"
    return ""
