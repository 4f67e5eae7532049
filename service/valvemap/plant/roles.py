"""The roles of signals at a valve, and the evidence that a name gives for each.

The evidence is a log likelihood ratio (in nats) against *a signal of something else*: the sum over
the concepts in the name. One table has the weight of each concept for each role.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

from valvemap.pipeline.units import Quantity
from valvemap.plant.concepts import QUANTITIES, Concept


class Role(StrEnum):
    """What a signal is at a valve. The first seven are named as in the configuration."""

    U = "U"
    P1 = "p1"
    P2 = "p2"
    Q = "Q"
    T = "T"
    DP = "dp"
    PA = "pA"
    PB = "pB"
    QB = "QB"
    SPOOL = "spool position"
    PILOT = "pilot pressure"
    POSITION = "position"
    SPEED = "speed"
    SETPOINT = "setpoint"
    OTHER = "other"


NAMES: Final[frozenset[str]] = frozenset(Role)  # a signal without a role is not recognised

C = Concept
_WRONG: Final = -6.0  # a word for another quantity
_STATUS: Final = -5.0
WORTH: Final[Mapping[Role, Mapping[Concept, float]]] = {
    Role.U: {
        C.COMMAND: 5.0, C.OPENING: 4.0, C.SETPOINT: 3.5, C.VALVE: 0.5, C.ACTUAL: -2.0,
        C.SPOOL: -2.5, C.POSITION: -0.5, C.PILOT: -5.0, C.MACHINE: -5.0, C.SUPPLY: -5.0,
        C.TANK: -4.0, C.DIFFERENCE: -5.0, C.ESTIMATED: -4.5,
    },
    Role.P1: {
        C.PRESSURE: 4.0, C.BEFORE: 4.0, C.SUPPLY: 3.5, C.BEHIND: -4.5, C.TANK: -4.5,
        C.CONSUMER: -3.0,
        C.PORT_A: -0.5, C.PORT_B: -2.0, C.PILOT: -8.0, C.SETPOINT: -6.0, C.DIFFERENCE: -7.0,
        C.MACHINE: -3.0, C.ESTIMATED: -4.5, C.VALVE: 2.5,
    },
    Role.P2: {
        C.PRESSURE: 4.0, C.BEHIND: 4.0, C.TANK: 3.5, C.CONSUMER: 3.0, C.BEFORE: -4.5,
        C.SUPPLY: -4.5, C.PORT_B: -1.0, C.PORT_A: -1.0, C.PILOT: -8.0, C.SETPOINT: -6.0,
        C.DIFFERENCE: -7.0, C.MACHINE: -3.0, C.ESTIMATED: -4.5, C.VALVE: 2.5,
    },
    Role.PA: {C.PRESSURE: 3.0, C.PORT_A: 5.0, C.PILOT: -8.0, C.SETPOINT: -6.0, C.DIFFERENCE: -7.0,
              C.ESTIMATED: -4.5},
    Role.PB: {C.PRESSURE: 3.0, C.PORT_B: 5.0, C.PILOT: -8.0, C.SETPOINT: -6.0, C.DIFFERENCE: -7.0,
              C.ESTIMATED: -4.5},
    Role.DP: {C.PRESSURE: 2.0, C.DIFFERENCE: 5.0, C.PILOT: -6.0, C.SETPOINT: -6.0,
              C.MACHINE: -5.0, C.LEVEL: -3.0, C.ESTIMATED: -4.5},
    Role.Q: {C.FLOW: 6.0, C.VALVE: 0.5, C.SETPOINT: -6.0, C.PORT_B: -3.0, C.MACHINE: -3.0,
             C.SUPPLY: -2.0, C.ESTIMATED: -4.5},
    Role.QB: {C.FLOW: 4.0, C.PORT_B: 5.0, C.SETPOINT: -6.0},
    Role.T: {C.TEMPERATURE: 6.0, C.SETPOINT: -6.0, C.MACHINE: -4.0},
    Role.SPOOL: {C.SPOOL: 6.0, C.POSITION: 1.0, C.ACTUAL: 1.5, C.VALVE: 0.5, C.OPENING: 1.0,
                 C.SETPOINT: -2.0},
    Role.PILOT: {C.PILOT: 7.0, C.PRESSURE: 1.0},
    Role.POSITION: {C.POSITION: 4.0},
    Role.SPEED: {C.SPEED: 5.0, C.ROTATION: 5.0},
    Role.SETPOINT: {C.SETPOINT: 2.5, C.PRESSURE: 2.0, C.FLOW: 2.0, C.POSITION: 2.0, C.SPEED: 2.0,
                    C.TEMPERATURE: 2.0, C.ROTATION: 2.0},
    Role.OTHER: {C.LEVEL: 4.0, C.LOAD: 4.0, C.STATUS: 4.0, C.LIMIT: 4.0, C.MACHINE: 3.0,
                 C.ESTIMATED: 2.0},
}  # fmt: skip
"""Nats by role and concept."""

QUANTITY: Final[Mapping[Role, Quantity]] = {
    Role.U: Quantity.OPENING,
    Role.P1: Quantity.PRESSURE,
    Role.P2: Quantity.PRESSURE,
    Role.PA: Quantity.PRESSURE,
    Role.PB: Quantity.PRESSURE,
    Role.DP: Quantity.PRESSURE,
    Role.Q: Quantity.FLOW,
    Role.QB: Quantity.FLOW,
    Role.T: Quantity.TEMPERATURE,
    Role.SPOOL: Quantity.OPENING,
    Role.PILOT: Quantity.PRESSURE,
}
"""Quantity of a role's signal; the others have none of ours."""

LEARNT: Final = (Role.U, Role.P1, Role.P2, Role.Q, Role.T, Role.DP, Role.PA, Role.PB, Role.QB)
"""Roles of which a configuration can consist."""


def evidence_of_name(found: Mapping[Concept, float], role: Role) -> float:
    """Return the log likelihood ratio of a role, given the concepts in a name."""
    worth = WORTH[role]
    if role is Role.SETPOINT and C.SETPOINT not in found:
        return _WRONG
    total = 0.0
    for concept, certainty in found.items():
        if concept in worth:
            total += certainty * worth[concept]
        elif concept in QUANTITIES:
            total += certainty * _WRONG
        elif concept in {C.STATUS, C.LIMIT}:
            total += certainty * _STATUS
    return total
