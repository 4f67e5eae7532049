"""Arguments of scripts: recordings, units and columns in the form in which people type them."""

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from valvemap.errors import ConfigurationError, RecordingError
from valvemap.pipeline.units import QUANTITY_OF, UNITS, Measure, Unit, unit_of
from valvemap.plant.evidence import Rating
from valvemap.plant.roles import Role
from valvemap.storage.layout import Layout
from valvemap.storage.tables import ALLOWED, is_table, of_rows
from valvemap.storage.time_units import SYMBOLS, TIME_UNITS
from valvemap.vocabulary.signals import MEASURED

if TYPE_CHECKING:
    from valvemap.config.models import Config

MOST_SHOWN: Final = 60  # characters of a value in a message
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
        return [_file(given)]
    if is_table(given):
        return [given]
    parts = list(given) if isinstance(given, Iterable) and not hasattr(given, "read") else []
    rows = of_rows(parts)
    if rows is not None:
        return [rows]
    if not parts or not all(isinstance(x, str | os.PathLike) or is_table(x) for x in parts):
        raise RecordingError(f"{shown(given)} is no recording; {ALLOWED} is allowed")
    return [_file(x) if isinstance(x, str | os.PathLike) else x for x in parts]


def config_in(given: object) -> "Config | None":
    """Return a configuration, that of a file, or None.

    Raises
    ------
    ConfigurationError
        if it is neither, or the file is invalid.
    """
    from valvemap.config.loading import load_config  # noqa: PLC0415 - a saved map needs neither
    from valvemap.config.models import Config  # noqa: PLC0415

    if isinstance(given, str | os.PathLike):
        return load_config(given)
    if given is None or isinstance(given, Config):
        return given
    raise ConfigurationError(
        f"config is {shown(given)}; a configuration (valvemap.load_config) or its path is allowed"
    )


def rating_of(rated_flow: float, rated_drop: float) -> Rating:
    """Return what a name plate states.

    Raises
    ------
    ConfigurationError
        if a value is no number that a name plate can state.
    """
    for what, value, is_allowed, allowed in (
        ("rated_flow", rated_flow, lambda x: x >= 0.0, "of at least 0 (l/min; 0: unknown)"),
        ("rated_drop", rated_drop, lambda x: x > 0.0, "above 0 (bar)"),
    ):
        if not isinstance(value, Real) or not math.isfinite(value) or not is_allowed(value):
            raise ConfigurationError(f"{what} is {shown(value)}; a number {allowed} is allowed")
    return Rating(flow_l_min=float(rated_flow), drop_bar=float(rated_drop))


def name_in(what: str, given: object) -> list[str] | None:
    """Return the name of a valve or estimator as a list of names; None if none is given.

    Raises
    ------
    ConfigurationError
        if it is no text.
    """
    if given is not None and not isinstance(given, str):
        raise ConfigurationError(f"{what} is {shown(given)}; one name is allowed")
    return None if given is None else [given]


def shown(given: object) -> str:
    """Return a typed value for a message: itself if it is short, else its type."""
    text = repr(given)
    return text if len(text) <= MOST_SHOWN and "\n" not in text else f"a {type(given).__name__}"


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
    """Return a copy of texts by signal, without those that are None."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise ConfigurationError(
            f"{what} is {given!r}; texts by signal are allowed: {what}={{{example!r}: '…'}}"
        )
    for name, text in given.items():
        if name in allowed and (text is None or isinstance(text, str)):
            continue
        if name in allowed:
            raise ConfigurationError(f"{what}[{name!r}] is {shown(text)}; a text is allowed")
        known = ", ".join(allowed)
        turned = f"; is {what}={{{text!r}: {name!r}}} meant?" if str(text) in allowed else ""
        raise ConfigurationError(f"{what}[{name!r}]: {known} are allowed, not {name!r}{turned}")
    return {name: text for name, text in given.items() if text is not None}


def _file(given: str | os.PathLike[str]) -> Path:
    text = os.fspath(given)
    if not text.strip():
        raise RecordingError(f"{text!r} is no recording; {ALLOWED} is allowed")
    if "://" in text:
        raise RecordingError(
            f"{text!r} is an address, and files are read: fetch it, or give a data frame, such as "
            "pandas.read_csv(…)"
        )
    return Path(text).expanduser()


def _seconds(text: str) -> float:
    if text not in TIME_UNITS:
        raise ConfigurationError(f"units['t'] is {text!r}; {', '.join(SYMBOLS)} are allowed")
    return TIME_UNITS[text]


def _span(signal: str, text: str) -> Measure:
    """Return raw numbers and their values, ``0..10:0..100%``, as ``--scale`` has them."""
    from valvemap.plant.answers import parse_answers  # noqa: PLC0415 - a saved map needs none of it

    given = parse_answers((), (f"{signal}={text}",))
    return given[""].scales[Role(signal)].measure


def _unit(signal: str, text: str) -> Unit:
    unit = unit_of(str(text))
    quantity = QUANTITY_OF[signal]
    if unit is None or unit.quantity is not quantity:
        known = ", ".join(unit.symbol for unit in UNITS if unit.quantity is quantity)
        raise ConfigurationError(f"units[{signal!r}] is {text!r}; {known} are allowed")
    return unit
