"""Concepts: what the words of a signal's name mean.

A name is split into concepts: its quantity (pressure, flow, command, …) and qualifiers (before the
valve, pilot, setpoint, …). Their words by language are in :mod:`quantity_words` and
:mod:`qualifier_words`; tags of instruments (ISA 5.1) and the letters of ports are in rows of their
own.
"""

from collections.abc import Mapping
from enum import Enum, auto
from typing import Final


class Concept(Enum):
    """The meaning of a word in a signal's name."""

    PRESSURE = auto()
    FLOW = auto()
    TEMPERATURE = auto()
    COMMAND = auto()
    OPENING = auto()
    SPOOL = auto()
    POSITION = auto()
    SPEED = auto()
    ROTATION = auto()
    LEVEL = auto()
    LOAD = auto()
    VALVE = auto()
    BEFORE = auto()
    BEHIND = auto()
    SUPPLY = auto()
    TANK = auto()
    CONSUMER = auto()
    PORT_A = auto()
    PORT_B = auto()
    PILOT = auto()
    DIFFERENCE = auto()
    SETPOINT = auto()
    ACTUAL = auto()
    ESTIMATED = auto()
    LIMIT = auto()
    MACHINE = auto()
    STATUS = auto()


QUANTITIES: Final = frozenset(
    {
        Concept.PRESSURE,
        Concept.FLOW,
        Concept.TEMPERATURE,
        Concept.COMMAND,
        Concept.OPENING,
        Concept.SPOOL,
        Concept.POSITION,
        Concept.SPEED,
        Concept.ROTATION,
        Concept.LEVEL,
        Concept.LOAD,
    }
)
"""Concepts that name a quantity; the others qualify one."""

SIDES: Final = frozenset(
    {Concept.BEFORE, Concept.BEHIND, Concept.SUPPLY, Concept.TANK, Concept.CONSUMER}
)
"""Qualifiers that say on which side of a valve a pressure is."""

PORT_LETTERS: Final[Mapping[str, tuple[Concept, ...]]] = {
    "p": (Concept.SUPPLY,),
    "s": (Concept.SUPPLY,),
    "t": (Concept.TANK,),
    "r": (Concept.TANK,),
    "a": (Concept.PORT_A,),
    "b": (Concept.PORT_B,),
    "x": (Concept.PILOT,),
    "1": (Concept.BEFORE,),
    "2": (Concept.BEHIND,),
}
"""The letter or number of a port behind a word for a pressure or a flow: pA, Druck 2, Q_B."""

COMPACT: Final[Mapping[str, tuple[Concept, ...]]] = {
    "pa": (Concept.PRESSURE, Concept.PORT_A),
    "pb": (Concept.PRESSURE, Concept.PORT_B),
    "qa": (Concept.FLOW, Concept.PORT_A),
    "qb": (Concept.FLOW, Concept.PORT_B),
    "dp": (Concept.PRESSURE, Concept.DIFFERENCE),
    "pdt": (Concept.PRESSURE, Concept.DIFFERENCE),
    "pdi": (Concept.PRESSURE, Concept.DIFFERENCE),
    "pdit": (Concept.PRESSURE, Concept.DIFFERENCE),
}
"""Words that hold two concepts."""

CARRIERS: Final = frozenset(
    {
        "value", "val", "wert", "valeur", "valor", "valore", "wartosc", "waarde", "hodnota",
        "varde", "deger", "значение", "值", "数值", "値", "값", "eng", "data", "raw",
    }
)  # fmt: skip
"""Words of a structure's member that holds the number: what it is, the structure's name says."""
