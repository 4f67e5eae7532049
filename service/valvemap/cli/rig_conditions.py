"""Conditions of a demo's valves, a line of JSON from the rig's process to the demo's."""

import json
from collections.abc import Mapping
from typing import Final

from valvemap_rig.condition import Condition

CONDITION_S: Final = 0.5  # s between two reports; the demo shows a line every second


def condition_line(conditions: Mapping[str, Condition]) -> str:
    """Pack the conditions of valves, by name.

    >>> conditions_in(condition_line({"V1": Condition(0.9)}))
    {'V1': Condition(edge_factor=0.9, gap=0.0, temperature_rise=0.0)}
    """
    return json.dumps(conditions)


def conditions_in(line: str) -> dict[str, Condition]:
    """Unpack them; a line that says something else has none.

    >>> conditions_in("ready")
    {}
    """
    try:
        return {str(name): Condition(*map(float, row)) for name, row in json.loads(line).items()}
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        return {}
