"""A valve's sheet, computed of a guided sweep: its figures, their intervals and the conditions.

The standard holds Δp constant; here the flow curve of any Δp is converted to the rated one by the
fit (`sweep_fit`).

A figure is a function of a flow curve and a play. Its value is the median over draws of both, its
95 % interval holds their quantiles and the same mirrored at the estimate: the largest departure of
a drawn curve is larger than that of the curve.
"""

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Samples, Times
from valvemap.model.sheet_figures import ELSEWHERE, GRID, OF_SIDES, OF_VALVE, Row, Side
from valvemap.model.sweep_equations import SweepFit
from valvemap.model.sweep_fit import FEWEST, fit_sweep, usable

TRAVERSES: Final = 2  # in each direction; fewer are no test
WHOLE: Final = 0.95  # of the range of U; less is no traverse
IN_TRAVERSES: Final = 0.8  # of the samples; fewer are no test
SLOWEST_HZ: Final = 45.0  # less are no test; 50 Hz with a few samples lost are one


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
    """Ranges of U (%), Δp (bar) and T (°C), pace of the traverses (%/s), duration (s) of the data.

    ``in_traverses`` is the share of samples in traverses of the range of U.
    """

    U: tuple[float, float]
    dp: tuple[float, float]
    T: tuple[float, float]
    pace: float
    duration: float
    samples: int
    traverses: int
    in_traverses: float


@dataclass(frozen=True)
class Sheet:
    """All figures of a valve, the conditions, and the fit they come of.

    ``not_a_test`` says why the data are no guided sweep; empty if they are one.
    """

    dp_rated: float
    figures: tuple[Figure, ...]
    conditions: Conditions
    not_a_test: str
    fit: SweepFit


class SheetError(ValueError):
    """The samples tell no flow curve; one line says why."""


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
    samples = usable(samples)
    if not len(samples):
        raise SheetError("there are no samples")
    conditions = _conditions(samples, U_range)
    low, high = conditions.dp
    if not low <= dp_rated <= high:
        raise SheetError(
            f"the rated Δp is {dp_rated:g} bar; the recording has {low:.3g} to {high:.3g} bar, "
            "state a value within"
        )
    ends = sorted((end for end in U_range if end != 0.0), reverse=True)
    grid = np.unique(np.concatenate([np.linspace(0.0, end, GRID) for end in ends]))
    fit = fit_sweep(samples, dp_rated, grid)
    if fit is None:
        raise SheetError(
            f"no flow curve: {FEWEST} good samples are needed, and U and Q must change"
        )
    sides = tuple(_side(fit, end) for end in ends)
    figures = [
        _figure(row, name_of(end, len(ends)), (side,), _not_driven(end, conditions))
        for end, side in zip(ends, sides, strict=True)
        for row in OF_SIDES
    ]
    missing = next(filter(None, (_not_driven(end, conditions) for end in ends)), "")
    figures += [
        _figure(row, "", sides, missing if row.sides > 1 else "")
        for row in OF_VALVE
        if row.sides <= len(sides)
    ]
    figures += [
        Figure(row.key, "", row.name, row.unit, "", Measured.NOT_MEASURED, reason=row.reason)
        for row in ELSEWHERE
    ]
    return Sheet(
        dp_rated,
        tuple(figures),
        conditions,
        too_few_traverses(conditions) or _work(conditions),
        fit,
    )


def name_of(end: float, sides: int) -> str:
    """Name of the side that ends at a U; empty for the only one of a valve."""
    return "" if sides == 1 else "U > 0" if end > 0.0 else "U < 0"


def _side(fit: SweepFit, end: float) -> Side:
    own = fit.x >= 0.0 if end > 0.0 else fit.x <= 0.0
    order = np.argsort(np.abs(fit.x[own]))
    Q = math.copysign(1.0, end) * np.vstack([fit.Q, fit.Q_draws])[:, own][:, order]
    known = np.flatnonzero(fit.known[own][order])
    first, top = (int(known[0]), int(known[-1])) if len(known) else (0, 0)
    play = np.concatenate([[fit.play], fit.play_draws])
    return Side(np.abs(fit.x[own][order]), Q, play, first, top)


def _not_driven(end: float, conditions: Conditions) -> str:
    """Return why a side is not measured, empty if it is."""
    reached = max(0.0, conditions.U[1] if end > 0.0 else -conditions.U[0])
    driven = reached >= WHOLE * abs(end)
    return "" if driven else f"U was {reached:.3g} % at most of {abs(end):g} %"


def _figure(row: Row, name: str, sides: tuple[Side, ...], not_driven: str = "") -> Figure:
    """Return a figure: the median of its draws, and their interval mirrored at the estimate."""
    one = Figure(row.key, name, row.name, row.unit, row.definition, Measured.NOT_MEASURED)
    if not_driven:
        return replace(one, reason=not_driven)
    with np.errstate(divide="ignore", invalid="ignore"):  # a curve without flow has no gain
        found = row.of(sides)
    if row.not_reached and not math.isfinite(found[0]):
        return replace(one, measured=Measured.NOT_REACHED, reason=row.not_reached)
    draws = found[1:][np.isfinite(found[1:])]
    if not math.isfinite(found[0]) or len(draws) < 0.5 * (len(found) - 1):
        return replace(one, reason="the curve does not tell it")
    low, value, high = (float(q) for q in np.quantile(draws, [0.025, 0.5, 0.975]))
    low, high = min(low, 2.0 * float(found[0]) - high), max(high, 2.0 * float(found[0]) - low)
    value, low, high = (max(each, row.least) for each in (value, low, high))
    return replace(one, measured=Measured.MEASURED, value=value, lower=low, upper=high)


def _conditions(samples: Samples, U_range: tuple[float, float]) -> Conditions:
    T = samples.T[np.isfinite(samples.T)]
    starts, turns, inside = _traverses(samples.U, U_range)
    took = 1e-9 * (samples.t[turns] - samples.t[starts])
    way = np.abs(samples.U[turns] - samples.U[starts])
    return Conditions(
        U=(float(samples.U.min()), float(samples.U.max())),
        dp=(float(samples.dp.min()), float(samples.dp.max())),
        T=(float(T.min()), float(T.max())) if len(T) else (math.nan, math.nan),
        pace=float(np.median(way / np.maximum(took, 1e-9))) if len(took) else math.nan,
        duration=1e-9 * float(samples.t[-1] - samples.t[0]),
        samples=len(samples),
        traverses=len(turns),
        in_traverses=inside / len(samples),
    )


def _traverses(U: Floats, U_range: tuple[float, float]) -> tuple[Times, Times, int]:
    """First and last sample of each traverse of the range, and the number of samples in them."""
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
    return starts, turns, min(inside, len(U))


def too_few_traverses(conditions: Conditions) -> str:
    """Why there is no sweep among the samples, whatever the others are; empty if there is one."""
    rate = (conditions.samples - 1) / max(conditions.duration, 1e-9)
    if rate < SLOWEST_HZ:
        return f"the samples come at {rate:.3g} Hz; a test has 50 Hz or more"
    if conditions.traverses < 2 * TRAVERSES:
        times = conditions.traverses
        return f"U went through its range {times} times; a test does so {2 * TRAVERSES} times"
    return ""


def _work(conditions: Conditions) -> str:
    if conditions.in_traverses < IN_TRAVERSES:
        share = 100.0 * conditions.in_traverses
        return f"{share:.0f} % of the samples belong to traverses of the range; the rest is work"
    return ""
