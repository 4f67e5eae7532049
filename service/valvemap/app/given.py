"""Arguments of scripts: recordings, units and columns in the form in which people type them."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from valvemap.errors import ConfigurationError, RecordingError
from valvemap.pipeline.units import QUANTITY_OF, UNITS, Measure, Unit, unit_of
from valvemap.plant.answers import parse_answers
from valvemap.plant.roles import Role
from valvemap.storage.layout import Layout
from valvemap.storage.table_recordings import ALLOWED, is_table
from valvemap.storage.time_units import TIME_UNITS
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
    units = _checked(units, "units", ("t", *MEASURED), "p1")
    columns = _checked(columns, "columns", (*MEASURED, *OTHERS), "U")
    signals = {
        name: Measure(
            column=columns.get(name),
            unit=None if name not in units else _unit(name, units[name]),
        )
        if ".." not in units.get(name, "")
        else replace(_span(name, units[name]), column=columns.get(name))
        for name in MEASURED
    }
    time, valve, quality = (columns.get(name) for name in OTHERS)
    seconds = _seconds(units["t"]) if "t" in units else None
    return Layout(signals=signals, time=time, valve=valve, quality=quality, seconds=seconds)


def _checked(given: object, what: str, allowed: tuple[str, ...], example: str) -> dict[str, str]:
    """Return a copy of texts by signal."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ConfigurationError(
            f"{what} is {given!r}; texts by signal are allowed: {what}={{{example!r}: '…'}}"
        )
    for name, text in given.items():
        if name in allowed:
            continue
        known = ", ".join(allowed)
        turned = f"; is {what}={{{text!r}: {name!r}}} meant?" if text in allowed else ""
        raise ConfigurationError(f"{what}[{name!r}]: {known} are allowed, not {name!r}{turned}")
    return dict(given)


def _seconds(text: str) -> float:
    if text not in TIME_UNITS or not text:
        known = ", ".join(filter(None, TIME_UNITS))
        raise ConfigurationError(f"units['t'] is {text!r}; {known} are allowed")
    return TIME_UNITS[text]


def _span(signal: str, text: str) -> Measure:
    """Return raw numbers and their values, ``0..10:0..100%``, as ``--scale`` has them."""
    given = parse_answers((), (f"{signal}={text}",))
    return given[""].scales[Role(signal)].measure


def _unit(signal: str, text: str) -> Unit:
    unit = unit_of(str(text))
    quantity = QUANTITY_OF[signal]
    if unit is None or unit.quantity is not quantity:
        known = ", ".join(unit.symbol for unit in UNITS if unit.quantity is quantity)
        raise ConfigurationError(f"units[{signal!r}] is {text!r}; {known} are allowed")
    return unit
