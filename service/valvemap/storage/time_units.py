"""Units of a column of times, as its heading states them."""

from typing import Final

from valvemap.plant.unit_texts import split_unit

TIME_UNITS: Final = {
    "": 1.0,
    "s": 1.0,
    "sec": 1.0,
    "ms": 1e-3,
    "min": 60.0,
    "h": 3600.0,
    "us": 1e-6,
    "\u00b5s": 1e-6,  # micro sign
    "\u03bcs": 1e-6,  # Greek letter
}
"""Seconds of one unit, by its symbol."""


def seconds_per_unit(heading: str) -> float:
    """Return the seconds of one unit of a time column: 0.001 for ``Zeit [ms]``."""
    _, _, unit = split_unit(heading)
    return TIME_UNITS.get(unit.casefold(), 1.0)
