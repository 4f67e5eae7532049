"""Conditions of a demo's valves, sent from the rig's process to the demo's as JSON lines."""

import json
from collections.abc import Mapping
from typing import Final

from valvemap_rig.condition import Condition

_START: Final = "start"
CONDITION_S: Final = 0.5  # s; interval of two reports; the demo refreshes every second


def condition_line(conditions: Mapping[str, Condition]) -> str:
    """Encode the conditions of valves, by name.

    >>> conditions_in(condition_line({"V1": Condition(0.9)}))
    {'V1': Condition(edge_factor=0.9, gap=0.0, temperature_rise=0.0)}
    """
    return json.dumps(conditions)


def start_line(start_ns: int) -> str:
    """Encode the time of a scenario's first sample, UTC ns.

    >>> start_in(start_line(5)), start_in("ready")
    (5, None)
    """
    return f"{_START} {start_ns}"


def start_in(line: str) -> int | None:
    """Decode a line; any other line has no start."""
    word, _, number = line.partition(" ")
    return int(number) if word == _START and number.isdecimal() else None


def conditions_in(line: str) -> dict[str, Condition]:
    """Decode a line; any other line has no conditions.

    >>> conditions_in("ready")
    {}
    """
    try:
        return {str(name): Condition(*map(float, row)) for name, row in json.loads(line).items()}
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        return {}
