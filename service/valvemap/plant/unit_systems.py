"""What units a plant has where it states none: those of one system, and one for its pressures.

The unit of a signal is drawn from the plant's system of units (metric, United States, SI), which
the stated units disclose: who measures flow in gpm hardly has gauges in bar. Two pressures come
from one kind of gauge.
"""

from collections.abc import Iterator, Mapping
from math import log
from typing import Final

from valvemap.pipeline.units import Quantity, Unit, relative
from valvemap.plant.priors import ODD
from valvemap.plant.roles import QUANTITY, Role

_P, _F, _T = Quantity.PRESSURE, Quantity.FLOW, Quantity.TEMPERATURE
_SHARES: Final[Mapping[str, tuple[float, Mapping[Quantity, Mapping[str, float]]]]] = {
    "metric": (
        0.7,
        {
            _P: {"bar": 0.92, "MPa": 0.03, "kPa": 0.02, "psi": 0.01, "Pa": 0.01},
            _F: {"l/min": 0.8, "m³/h": 0.1, "l/s": 0.05, "cm³/s": 0.03, "gpm": 0.01},
            _T: {"°C": 0.98, "K": 0.015, "°F": 0.005},
        },
    ),
    "United States": (
        0.12,
        {
            _P: {"psi": 0.93, "bar": 0.04, "kPa": 0.01, "MPa": 0.01, "Pa": 0.001},
            _F: {"gpm": 0.9, "l/min": 0.06, "cm³/s": 0.02, "m³/h": 0.01, "l/s": 0.005},
            _T: {"°F": 0.85, "°C": 0.14, "K": 0.01},
        },
    ),
    "SI": (
        0.18,
        {
            _P: {"MPa": 0.55, "kPa": 0.2, "bar": 0.15, "Pa": 0.08, "psi": 0.005},
            _F: {"l/min": 0.55, "m³/h": 0.25, "l/s": 0.12, "cm³/s": 0.05, "gpm": 0.005},
            _T: {"°C": 0.95, "K": 0.045, "°F": 0.005},
        },
    ),
}
"""Systems by prior probability, and the shares of their units."""
_RARE: Final = 1e-3  # of a unit that is not in the table
_WRONG_FLOW: Final = 0.05  # of the units stated for flows; no value shows a wrong one at once

USUAL: Final[Mapping[Quantity, tuple[str, ...]]] = {
    Quantity.OPENING: ("%", "1"),
    **{quantity: tuple(shares) for quantity, shares in _SHARES["metric"][1].items()},
}
"""The units that a number without a unit may have, the likeliest first."""


def of_mistaken_flow(stated: Mapping[Role, Unit], true: Unit, times: int) -> float:
    """Return the log odds that the unit stated ``times`` times for Q is wrong, and ``true`` right.

    A wrong statement is as probable as its unit is usual, which cancels what makes it likely:
    only how usual the true unit is beside the other stated ones is left.

    >>> from valvemap.pipeline.units import unit_of
    >>> bar, m3_h, l_min = (unit_of(symbol) for symbol in ("bar", "m³/h", "l/min"))
    >>> stated = {Role.P1: bar, Role.Q: m3_h}
    >>> [round(of_mistaken_flow(stated, l_min, times), 1) for times in (1, 2)]
    [-3.2, -6.2]
    """
    others = dict(stated)
    others.pop(Role.Q, None)
    usual = _log_probability(others | {Role.Q: true}) - _log_probability(others)
    return times * log(_WRONG_FLOW) - log(1.0 - _WRONG_FLOW) + usual


def of_guesses(stated: Mapping[Role, Unit], guessed: Mapping[Role, Unit]) -> float:
    """Return the log probability of the guessed units, given the stated ones; both by role.

    >>> from valvemap.pipeline.units import unit_of
    >>> bar, psi, gpm = (unit_of(symbol) for symbol in ("bar", "psi", "gpm"))
    >>> of_guesses({}, {Role.P1: bar}) > of_guesses({}, {Role.P1: psi})
    True
    >>> of_guesses({Role.Q: gpm}, {Role.P1: bar}) > of_guesses({Role.Q: gpm}, {Role.P1: psi})
    False
    """
    if not guessed:
        return 0.0
    return _log_probability({**stated, **guessed}) - _log_probability(stated)


def _log_probability(units: Mapping[Role, Unit]) -> float:
    total = 0.0
    for prior, shares in _SHARES.values():
        probability = prior
        for one in _factors(units, shares):
            probability *= one
        total += probability
    return log(total)


def _factors(
    units: Mapping[Role, Unit], shares: Mapping[Quantity, Mapping[str, float]]
) -> Iterator[float]:
    gauges: list[Unit] = []
    for role, own in units.items():
        quantity, unit = QUANTITY[role], relative(own)
        share = shares.get(quantity, {}).get(unit.symbol, _RARE)
        if quantity is not _P or not gauges:
            yield share if quantity in shares else 1.0
        else:
            yield ODD * share + (1.0 - ODD) * (unit in gauges)
        if quantity is _P:
            gauges.append(unit)
