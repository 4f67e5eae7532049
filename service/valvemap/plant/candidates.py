"""Variables of a plant, and what their labels say: role, unit, range."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from valvemap.pipeline.units import Quantity, Unit, absolute
from valvemap.plant.concepts import CARRIERS, QUANTITIES, Concept
from valvemap.plant.names import concepts, tokens
from valvemap.plant.roles import LEARNT, QUANTITY, Role, evidence_of_name
from valvemap.plant.span_texts import raw_and_scaled
from valvemap.plant.unit_texts import (
    is_of_gauge,
    is_of_others,
    is_of_vacuum,
    known_unit,
    split_unit,
)

_OF_DESCRIPTION: Final = 0.5  # weight of a description's words against the name's
_WHOLE_NAME: Final = 1.5  # a name of one word that is known exactly
_UNIT_FITS, _UNIT_CONTRADICTS = 8.0, -10.0  # nats
_ELECTRICAL_COMMAND: Final = 1.5
_WRITABLE: Final = -0.5
_SPARE: Final = 3.0  # nats by which a second signal of a kind is less likely to be the one
_QUALIFIERS: Final = frozenset(
    {
        Concept.BEFORE, Concept.BEHIND, Concept.SUPPLY, Concept.TANK, Concept.CONSUMER,
        Concept.PORT_A, Concept.PORT_B, Concept.PILOT, Concept.DIFFERENCE, Concept.ACTUAL,
        Concept.VALVE,
    }
)  # fmt: skip
_PORTS: Final = frozenset({"p", "t", "a", "b"})
_LENGTHS: Final = frozenset({"mm", "cm", "m", "um", "µm", "inch"})
_SPEEDS: Final = frozenset(
    {"mm/s", "m/s", "m/min", "cm/s", "rpm", "1/min", "u/min", "min-1", "r/min"}
)


@dataclass(frozen=True)
class Candidate:
    """One variable: node (or heading), names from the root down, unit and range as stated.

    ``symbol`` is the unit's text where it is none of ours; ``largest`` the largest value of an
    integer data type, None of a floating one; ``companion`` the node beside it that holds its
    factor. ``text`` is what it sends if that is a text with a number, such as ``12,3 bar``.
    """

    node: str
    path: tuple[str, ...]
    unit: Unit | None = None
    bounds: tuple[float, float] | None = None
    writable: bool = False
    description: str = ""
    symbol: str = ""
    largest: float | None = None
    companion: "Candidate | None" = None
    text: str = ""

    @cached_property
    def label(self) -> "Label":
        """The meaning of name, description and unit."""
        return _label(self)


@dataclass(frozen=True)
class Label:
    """What name, description and unit of a variable say.

    ``units`` are the stated units, one if name and property agree; ``evidence`` is the log
    likelihood ratio of each role. ``statements`` counts the places that state the unit;
    ``gauge`` if one says that a pressure is one against the atmosphere.
    """

    name: str
    concepts: Mapping[Concept, float]
    units: tuple[Unit, ...]
    evidence: Mapping[Role, float]
    statements: int = 1
    gauge: bool = False

    @cached_property
    def role(self) -> Role:
        """The most likely role."""
        return max(self.evidence, key=lambda role: self.evidence[role])

    def gain(self, role: Role) -> float:
        """Return by how much a role is likelier than that the variable is left unused, nats."""
        best = max(self.evidence[other] for other in LEARNT if other is not role)
        return self.evidence[role] - max(0.0, best - _SPARE, self._of_others)

    @cached_property
    def _of_others(self) -> float:
        return max(value for other, value in self.evidence.items() if other not in LEARNT)

    @cached_property
    def is_relevant(self) -> bool:
        """Whether it looks like a signal of a valve."""
        return self.role in LEARNT and self.evidence[self.role] > 0.0


def _label(candidate: Candidate) -> Label:
    name, in_name, symbol_in_name = split_unit(_last_part(candidate.path[-1]))
    if len(candidate.path) > 1:
        above, unit_above, _ = split_unit(_last_part(candidate.path[-2]))
        if _is_of_a_signal(above):
            in_name = in_name or unit_above
            name = f"{above} {name}" if _only_qualifies(name) else name
    _, in_text, _ = split_unit(candidate.description)
    stated = candidate.unit or known_unit(candidate.symbol)
    units = tuple(dict.fromkeys(unit for unit in (stated, in_name) if unit is not None))
    if not units and in_text is not None:
        units = (in_text,)
    statements = sum(unit in units for unit in (stated, in_name, in_text) if unit is not None)
    if is_of_vacuum(candidate.symbol, name, candidate.description):
        units = tuple(absolute(unit) for unit in units)
    found = concepts(name)
    said = concepts(candidate.description) if candidate.description else {}
    symbols = [s for s in (candidate.symbol, symbol_in_name) if is_of_others(s)]
    whole = _WHOLE_NAME if len(tokens(name)) == 1 and 1.0 in found.values() else 1.0
    described = units
    gauge = is_of_gauge(candidate.symbol, candidate.path[-1], candidate.description)
    spans = raw_and_scaled(candidate.description, None) if candidate.description else None
    if spans is not None and spans[1].unit is not None and _is_raw(units, spans[0].unit):
        described = (*(u for u in units if u.quantity is Quantity.ELECTRICAL), spans[1].unit)
    elif in_text is not None and all(unit.quantity is Quantity.ELECTRICAL for unit in units):
        described = (*units, in_text)  # what the current stands for
    evidence = {}
    for role in Role:
        named = evidence_of_name(found, role)
        score = whole * named if named > 0.0 else named
        score += _OF_DESCRIPTION * evidence_of_name(said, role)
        if role in LEARNT or score > 0.0 or symbols:
            score += _of_units(role, tuple(dict.fromkeys(described)), symbols)
        evidence[role] = score + _WRITABLE * candidate.writable
    return Label(name, found, units, evidence, max(statements, 1), gauge)


def _is_raw(stated: Iterable[Unit], raw: Unit | None) -> bool:
    """Whether the stated units are that of the raw numbers: mA, V, or % of a span."""
    return all(
        unit.quantity is Quantity.ELECTRICAL or (raw is not None and unit.quantity is raw.quantity)
        for unit in stated
    )


def _only_qualifies(name: str) -> bool:
    """Whether a name only distinguishes, and names no quantity: ``Inlet``, ``Value``.

    >>> [_only_qualifies(name) for name in ("Inlet", "Value", "Count", "Setpoint", "Flow in", "T")]
    [True, True, False, False, False, True]
    """
    words = tokens(name)
    return all(w in CARRIERS or w in _PORTS for w in words) or (
        bool(found := concepts(name)) and _QUALIFIERS.issuperset(found)
    )


def _is_of_a_signal(name: str) -> bool:
    """Whether the name of a folder or a structure is that of a signal, and not of a device."""
    found = concepts(name)
    return bool(QUANTITIES.intersection(found)) and Concept.VALVE not in found


def _last_part(text: str) -> str:
    """Return a tag's last name: ``"DB7"."V"."p1"`` is p1; a unit's stroke does not part it."""
    if '"."' in text:
        return text.rsplit('"."', maxsplit=1)[-1].strip('"')
    return text


def _of_units(role: Role, units: Iterable[Unit], others: Iterable[str]) -> float:
    total, wanted = 0.0, QUANTITY.get(role)
    for unit in units:
        if unit.quantity is Quantity.ELECTRICAL:
            total += _ELECTRICAL_COMMAND if role is Role.U else 0.0
        elif wanted is not None:
            total += _UNIT_FITS if unit.quantity is wanted else _UNIT_CONTRADICTS
        elif role is Role.POSITION and unit.quantity is Quantity.OPENING:
            total += 0.6 * _UNIT_FITS  # % of a stroke
        elif role is Role.SETPOINT and unit.quantity is not Quantity.OPENING:
            total += 0.8 * _UNIT_FITS
    for symbol in others:
        plain = symbol.casefold()
        fits = (role is Role.POSITION and plain in _LENGTHS) or (
            role is Role.SPEED and plain in _SPEEDS
        )
        total += _UNIT_FITS if fits else _UNIT_CONTRADICTS if role in LEARNT else 0.0
    return total
