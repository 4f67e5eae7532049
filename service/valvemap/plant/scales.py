"""How the numbers of a variable may be meant: unit or raw span, with a prior probability.

A stated unit settles it. Otherwise the data type, the range and the values leave some readings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.pipeline.units import (
    Measure,
    Quantity,
    Unit,
    absolute,
    inside,
    relative,
    scaling_of,
    unit_of,
)
from valvemap.plant.candidates import Candidate
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.span_texts import raw_and_scaled
from valvemap.plant.unit_systems import USUAL
from valvemap.plant.unit_texts import is_of_vacuum, known_unit

COUNTS: Final = ((0.0, 27_648.0), (0.0, 32_767.0), (0.0, 16_383.0), (0.0, 4_095.0), (0.0, 65_535.0))
"""Raw spans of analogue inputs: S7, 16 bit, 14 bit, 12 bit, unsigned 16 bit."""
PRESSURE_SENSORS: Final = (250.0, 400.0)  # bar, the usual full scales
FLOW_METERS: Final = (100.0, 300.0)  # l/min
_SPANS: Final = {
    "mA": ((4.0, 20.0), (0.0, 20.0), (-20.0, 20.0)),
    "V": ((0.0, 10.0), (-10.0, 10.0), (0.0, 5.0)),
    "mV": ((0.0, 10_000.0), (-10_000.0, 10_000.0)),
}
_USUAL_SPAN: Final = 0.9  # probability of the first of them where no range states it
_COUNTS_FROM: Final = 1_000.0  # an integer beyond it is none of our units, except psi and kPa
_CLOSE: Final = 0.02  # of a span
_MOST_PERCENT: Final = 105.0  # of U
_ASSUMED: Final = 0.999  # of our unit, once it is accepted

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scale:
    """One reading of a variable's numbers; ``prior`` in nats; ``stated`` if the plant says it.

    ``guessed`` if nothing is known of the unit: its prior is that of the plant's system of units.
    ``scaled`` if a span is described and the numbers are those that it leads to.
    """

    measure: Measure
    prior: float
    reason: str
    stated: bool = True
    guessed: bool = False
    scaled: bool = False

    @property
    def card(self) -> float | None:
        """The end of the raw span, 1 of numbers scaled already; None where there is no span."""
        if self.measure.raw is not None:
            return abs(self.measure.raw[1])
        return 1.0 if self.scaled else None

    def __call__(self, values: Floats, role: Role) -> Floats:
        """Return values in the internal unit of a role's quantity."""
        unit = self.measure.unit or inside(QUANTITY[role])
        return scaling_of(unit, self.measure.raw, self.measure.scaled)(values)

    @property
    def text(self) -> str:
        """The reading as an answer: ``psi``, or ``0..27648:0..250bar``."""
        unit = "" if self.measure.unit is None else self.measure.unit.symbol
        if self.measure.raw is None or self.measure.scaled is None:
            return unit
        low, high = self.measure.raw
        least, most = self.measure.scaled
        return f"{low:g}..{high:g}:{least:g}..{most:g}{unit}"


def scales(
    candidate: Candidate, role: Role, values: Floats, *, assume: bool = False
) -> list[Scale]:
    """Return the readings of a variable in a role; ``assume`` accepts our unit if none is stated.

    >>> found = scales(Candidate("p", ("pIn_MPa",)), Role.P1, np.array([18.0]))
    >>> [(scale.text, scale.stated) for scale in found]
    [('MPa', True)]
    """
    quantity = QUANTITY[role]
    described = list(_as_described(candidate, role, values))
    if described:
        return described
    units = [unit for unit in candidate.label.units if unit.quantity is quantity]
    if role is Role.DP:
        units = [relative(unit) for unit in units]  # a difference has no reference
    electrical = [u for u in candidate.label.units if u.quantity is Quantity.ELECTRICAL]
    if _are_counts(candidate, values, units):
        return list(_of_counts(candidate, role, values, units))
    if len(units) == 1 and _may_have_decimals(candidate, role, values):
        return list(_of_decimals(units[0]))
    if units:
        return list(_of_stated(units))
    if electrical:
        return list(_of_electrical(candidate, role, values, electrical[0]))
    return list(
        _of_command(candidate, values, assume=assume)
        if role is Role.U
        else _of_unstated(quantity, assume=assume)
    )


def _as_described(candidate: Candidate, role: Role, values: Floats) -> Iterator[Scale]:
    """Yield the readings of a variable whose description states raw numbers and their values.

    The numbers may be the raw ones or, where no property says so, be scaled already.
    """
    found = raw_and_scaled(candidate.description, QUANTITY[role])
    if found is None:
        return
    raw, scaled = found
    unit = scaled.unit
    if unit is not None and is_of_vacuum(candidate.description):
        unit = absolute(unit)
    of_raw = Measure(None, unit, raw.ends, scaled.ends)
    of_scaled = Measure(unit=unit)
    stated = candidate.unit or known_unit(candidate.symbol)
    if stated is not None:
        is_share = stated.quantity is Quantity.OPENING and raw.is_share
        if stated.quantity is Quantity.ELECTRICAL or is_share:
            yield Scale(of_raw, 0.0, "span as described")
        return
    fitting = [
        Scale(measure, 0.0, reason, scaled=measure is of_scaled)
        for measure, span, reason in (
            (of_raw, raw, "span as described"),
            (of_scaled, scaled, "unit as described"),
        )
        if _lies_in(values, span.ends)
    ]
    for one in fitting:
        yield replace(one, prior=-log(len(fitting)), stated=len(fitting) == 1)


def _lies_in(values: Floats, span: tuple[float, float]) -> bool:
    good = values[np.isfinite(values)]
    slack = 2 * _CLOSE * (span[1] - span[0])
    return bool(((good >= span[0] - slack) & (good <= span[1] + slack)).all())


def _of_stated(units: Sequence[Unit]) -> Iterator[Scale]:
    reason = "unit as stated" if len(units) == 1 else "name and property differ in the unit"
    for unit in units:
        yield Scale(Measure(unit=unit), log(1 / len(units)), reason)


def _largest(values: Floats) -> float:
    good = values[np.isfinite(values)]
    return float(np.abs(good).max(initial=0.0))


def _are_counts(candidate: Candidate, values: Floats, units: Sequence[Unit]) -> bool:
    """Whether an integer holds raw counts: far beyond its range, or beyond any unit's values."""
    if candidate.largest is None:
        return False
    top = _largest(values)
    if candidate.bounds is not None and candidate.bounds not in COUNTS:
        low, high = candidate.bounds
        return top > 2.0 * max(abs(low), abs(high))
    return not units and top > _COUNTS_FROM


def _may_have_decimals(candidate: Candidate, role: Role, values: Floats) -> bool:
    """Whether an integer without a range may be in tenths or hundredths of its unit."""
    if candidate.largest is None or candidate.bounds is not None:
        return False
    return role is not Role.U or _largest(values) > _MOST_PERCENT


def _of_decimals(unit: Unit) -> Iterator[Scale]:
    yield Scale(Measure(unit=unit), log(0.85), "unit as stated", stated=False)
    for raw, share in ((1_000.0, 0.1), (10_000.0, 0.05)):
        measure = Measure(None, unit, (0.0, raw), (0.0, 100.0))
        parts = f"{raw / 100:g}ths"
        yield Scale(measure, log(share), f"an integer in {parts} of its unit", stated=False)


def _of_counts(
    candidate: Candidate, role: Role, values: Floats, units: Sequence[Unit]
) -> Iterator[Scale]:
    unit = units[0] if units else inside(QUANTITY[role])
    top = _largest(values)
    spans = [s for s in COUNTS if top <= (1 + _CLOSE) * s[1] and s[1] <= (candidate.largest or 0)]
    known = [candidate.bounds] if candidate.bounds in COUNTS else spans
    stated = [b for b in (candidate.bounds,) if b is not None and b not in COUNTS]
    ends: list[tuple[float, float]]
    if role is Role.U:
        both = bool(np.nanmin(values) < 0.0)
        ends = stated or [(0.0, 100.0)]
        known = [(-s[1] if both else s[0], s[1]) for s in known if s is not None]
        ends = [(-e[1] if both and e[0] == 0.0 else e[0], e[1]) for e in ends]
    elif role is Role.T:
        ends = stated or [(0.0, 100.0)]
    else:
        usual = FLOW_METERS if role in {Role.Q, Role.QB} else PRESSURE_SENSORS
        ends = stated or [(0.0, most) for most in usual]
    spans_known = [s for s in known if s is not None][:3]
    n = max(len(spans_known) * len(ends), 1)
    for raw in spans_known:
        for end in ends:
            reason = f"counts of an integer, {raw[0]:g} to {raw[1]:g}"
            is_sure = n == 1 and bool(candidate.bounds)
            yield Scale(Measure(None, unit, raw, end), log(1 / n), reason, stated=is_sure)


def _of_electrical(candidate: Candidate, role: Role, values: Floats, unit: Unit) -> Iterator[Scale]:
    low = float(np.nanmin(values)) if np.isfinite(values).any() else 0.0
    top = _largest(values)
    if candidate.bounds is not None and candidate.bounds[1] <= 10_000:
        spans: list[tuple[float, float]] = [candidate.bounds]
    else:
        given = _SPANS.get(unit.symbol, ())
        spans = [s for s in given if low >= s[0] - 0.5 and top <= 1.05 * s[1]]
        spans = [s for s in spans if (s[0] < 0.0) == (low < -_CLOSE * s[1])] or list(given)[:1]
    if role is Role.U:
        for raw in spans:
            ends = (-100.0, 100.0) if raw[0] < 0.0 else (0.0, 100.0)
            likely = _USUAL_SPAN if raw == spans[0] else 1.0 - _USUAL_SPAN
            prior = 0.0 if len(spans) == 1 else log(likely / max(len(spans) - 1, 1))
            yield Scale(Measure(raw=raw, scaled=ends), prior, f"{unit.symbol} of its range")
        return
    usual = FLOW_METERS if role in {Role.Q, Role.QB} else PRESSURE_SENSORS
    for most in usual if role is not Role.T else (100.0,):
        measure = Measure(None, inside(QUANTITY[role]), spans[0], (0.0, most))
        yield Scale(measure, log(1 / 2), f"{unit.symbol} without a range", stated=False)


def _of_command(candidate: Candidate, values: Floats, *, assume: bool) -> Iterator[Scale]:
    """Return readings of a command without a unit: by its range, else by its values."""
    readings = {
        (0.0, 100.0): None,
        (-100.0, 100.0): None,
        (0.0, 1.0): (0.0, 100.0),
        (-1.0, 1.0): (-100.0, 100.0),
        (0.0, 10.0): (0.0, 100.0),
        (-10.0, 10.0): (-100.0, 100.0),
        (4.0, 20.0): (0.0, 100.0),
        (0.0, 20.0): (0.0, 100.0),
        (-20.0, 20.0): (-100.0, 100.0),
    }
    bounds = candidate.bounds
    if bounds in readings:
        ends = readings[bounds]
        measure = Measure() if ends is None else Measure(raw=bounds, scaled=ends)
        yield Scale(measure, 0.0, f"range {bounds[0]:g} to {bounds[1]:g}")
        return
    if bounds is not None and (bounds[0] == 0.0 or bounds[0] == -bounds[1]):
        ends = (0.0, 100.0) if bounds[0] == 0.0 else (-100.0, 100.0)
        yield Scale(Measure(raw=bounds, scaled=ends), log(0.9), "its range is 0 to 100 %")
        return
    yield Scale(Measure(), log(_ASSUMED if assume else 0.8), "taken as %", stated=False)
    good = values[np.isfinite(values)]
    low, top = (float(good.min()), float(good.max())) if len(good) else (0.0, 0.0)
    for raw, ends, share in (
        ((0.0, 1.0), (0.0, 100.0), 0.05),
        ((0.0, 10.0), (0.0, 100.0), 0.05),
        ((4.0, 20.0), (0.0, 100.0), 0.04),
        ((-10.0, 10.0), (-100.0, 100.0), 0.05),
    ):
        both = low < -_CLOSE * raw[1]
        if (
            (raw[0] < 0.0) == both
            and raw[0] - _CLOSE * raw[1] <= low
            and top <= (1 + _CLOSE) * raw[1]
        ):
            measure = Measure(raw=raw, scaled=ends)
            prior = log(share * (1.0 - _ASSUMED) if assume else share)
            yield Scale(measure, prior, f"{raw[0]:g} to {raw[1]:g}", stated=False)


def _of_unstated(quantity: Quantity, *, assume: bool) -> Iterator[Scale]:
    own = inside(quantity)
    others = len(USUAL[quantity]) - 1
    for symbol in USUAL[quantity]:
        unit = unit_of(symbol)
        assert unit is not None  # noqa: S101 - of our own table
        sure = _ASSUMED if unit == own else (1.0 - _ASSUMED) / others
        reason = f"no unit stated, taken as {symbol}"
        prior = log(sure) if assume else 0.0
        yield Scale(Measure(unit=unit), prior, reason, stated=False, guessed=not assume)
