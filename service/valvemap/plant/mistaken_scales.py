"""Readings of a variable whose stated unit, span or direction is wrong."""

from typing import Final

from valvemap.pipeline.units import Measure, Quantity, inside, scaling_of, unit_of
from valvemap.plant.roles import QUANTITY, Role
from valvemap.plant.scales import Floats, Scale
from valvemap.plant.unit_systems import USUAL

_SPANS_OFF: Final = (0.5, 2.0, 0.1, 10.0)  # times; of a sensor taken for one of another span
_VOLTS: Final = (0.0, 10.0)  # of a command


def reversed_command(scale: Scale, values: Floats) -> Scale:
    """Return the reading in which the valve is shut at the other end of U; values in %.

    >>> import numpy as np
    >>> reversed_command(Scale(Measure(), 0.0, ""), np.array([20.0, 90.0])).text
    '0..100:100..0'
    """
    both = bool((values < 0.0).any())
    ends = (-100.0, 100.0) if both else (0.0, 100.0)
    unit = scale.measure.unit or inside(Quantity.OPENING)
    own = scaling_of(unit, scale.measure.raw, scale.measure.scaled)
    raw = scale.measure.raw or (own.back(ends[0]), own.back(ends[1]))
    least, most = scale.measure.scaled or ends
    wrong_way = (0.0 - least, 0.0 - most) if both else (most, least)
    measure = Measure(raw=raw, scaled=wrong_way)
    return Scale(measure, 0.0, f"shut at {raw[1]:g}", stated=False)


def mistaken(scale: Scale, role: Role) -> list[Scale]:
    """Return the readings in which the stated unit is a mistake for another of its quantity."""
    quantity = QUANTITY[role]
    own = scale.measure.unit or inside(quantity)
    if scale.measure.raw is not None or quantity not in USUAL:
        return []
    others = [unit_of(symbol) for symbol in USUAL[quantity]]
    found = [
        Scale(Measure(unit=unit), 0.0, f"in {unit.symbol} instead of {own.symbol}", stated=False)
        for unit in others
        if unit is not None and unit != own
    ]
    if role in {Role.P1, Role.P2}:
        for times in _SPANS_OFF:
            measure = Measure(None, own, (0.0, 100.0), (0.0, 100.0 * times))
            reason = f"{times:g} times as large: its sensor has another span"
            found.append(Scale(measure, 0.0, reason, stated=False))
    if role is Role.U:
        volts = Measure(raw=_VOLTS, scaled=(0.0, 100.0))
        found.append(Scale(volts, 0.0, f"in V instead of {own.symbol}", stated=False))
    return found
