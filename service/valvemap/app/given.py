"""Arguments of scripts: recordings, units and columns in the form in which people type them."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from valvemap.errors import ConfigurationError, RecordingError
from valvemap.pipeline.units import QUANTITY_OF, UNITS, Measure, Unit, unit_of
from valvemap.storage.layout import Layout
from valvemap.storage.table_recordings import ALLOWED, is_table
from valvemap.vocabulary.signals import MEASURED

OTHERS: Final = ("t", "valve", "quality")  # columns that are no signals


def recordings_in(given: object) -> list[Any]:
    """Return recordings: one, or those of a list.

    >>> recordings_in("plant.csv"), len(recordings_in([{"U": []}, "plant.parquet"]))
    ([PosixPath('plant.csv')], 2)

    Raises
    ------
    RecordingError
        if it is neither; names its type and the allowed ones.
    """
    if isinstance(given, str | os.PathLike):
        return [Path(given)]
    if is_table(given):
        return [given]
    try:
        parts = list(given)  # type: ignore[call-overload]
    except TypeError:
        parts = []
    if not parts or not all(isinstance(x, str | os.PathLike) or is_table(x) for x in parts):
        shown = repr(given)
        shown = shown if len(shown) <= 60 and "\n" not in shown else f"a {type(given).__name__}"
        raise RecordingError(f"{shown} is no recording; {ALLOWED} is allowed")
    return [Path(x) if isinstance(x, str | os.PathLike) else x for x in parts]


def layout_of(units: Mapping[str, str] | None, columns: Mapping[str, str] | None) -> Layout:
    """Return the layout of recordings with these units and column names.

    Raises
    ------
    ConfigurationError
        if a signal or unit is unknown, or the unit is not one of the signal; names the allowed
        ones.
    """
    units, columns = dict(units or {}), dict(columns or {})
    _check(units, "units", MEASURED)
    _check(columns, "columns", (*MEASURED, *OTHERS))
    signals = {
        name: Measure(
            column=columns.get(name),
            unit=None if name not in units else _unit(name, units[name]),
        )
        for name in MEASURED
    }
    time, valve, quality = (columns.get(name) for name in OTHERS)
    return Layout(signals=signals, time=time, valve=valve, quality=quality)


def _check(given: Mapping[str, str], what: str, allowed: tuple[str, ...]) -> None:
    for name in given:
        if name not in allowed:
            known = ", ".join(allowed)
            raise ConfigurationError(f"{what}[{name!r}]: {known} are allowed, not {name!r}")


def _unit(signal: str, text: str) -> Unit:
    unit = unit_of(str(text))
    quantity = QUANTITY_OF[signal]
    if unit is None or unit.quantity is not quantity:
        known = ", ".join(unit.symbol for unit in UNITS if unit.quantity is quantity)
        raise ConfigurationError(f"units[{signal!r}] is {text!r}; {known} are allowed")
    return unit
