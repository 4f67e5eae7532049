"""Recordings of axes: CSV with the columns t, U, x, pA, pB, pS, pT, and optionally T and valve.

``x`` is in mm, U in %, pressures in bar, unless the heading states a unit: ``x [m]``, ``pA [psi]``.
``position`` stands for x, ``pP`` for pS. Without x, ``v`` or ``speed`` is the speed in mm/s. Case
matters for t and T alone; other columns are ignored.
Separators, decimal commas and times are those of :mod:`~valvemap.storage.recordings`.
"""

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from valvemap.errors import NoRecording, RecordingError
from valvemap.model.axis import AxisSamples
from valvemap.model.samples import Floats
from valvemap.pipeline.units import QUANTITY_OF, Quantity, unit_of
from valvemap.storage.columns import CellError
from valvemap.storage.csv_cells import TextCells, TextForm
from valvemap.storage.dates import date_form
from valvemap.storage.packed_text import PACKINGS, text_of

SIGNALS: Final = ("U", "x", "v", "pA", "pB", "pS", "pT", "T")
DEFAULT_AXIS: Final = "Axis"
_WITH_UNIT: Final = re.compile(r"(?P<name>[^\[(]+?)\s*[\[(](?P<unit>[^\])]+)[\])]")
_LENGTHS: Final = {
    "x": {"mm": 1.0, "cm": 10.0, "m": 1000.0, "µm": 1e-3, "in": 25.4},
    "v": {"mm/s": 1.0, "cm/s": 10.0, "m/s": 1000.0, "in/s": 25.4},
}  # mm, mm/s
_ALSO: Final = {"position": "x", "speed": "v", "pp": "pS"}


def read_axes(path: Path) -> Mapping[str, AxisSamples]:
    """Return the samples of each axis of a recording, by name; a missing column is NaN.

    Raises
    ------
    RecordingError
        in one line: file, line, column, value.
    """
    packing = next(
        (
            form
            for form in sorted(PACKINGS, key=len, reverse=True)
            if path.name.casefold().endswith(form)
        ),
        None,
    )
    if packing is None:
        allowed = ", ".join(PACKINGS)
        raise NoRecording(f"{path}: a recording of an axis has a name that ends in {allowed}")
    with text_of(path, packing) as lines:
        header_line = next(lines, "")
        separator = max(",;\t|", key=header_line.count)
        header = [name.strip() for name in next(csv.reader([header_line], delimiter=separator), [])]
        rows = [row for row in csv.reader(lines, delimiter=separator) if row]
    places, units = _places(path, header)
    short = next((k for k, row in enumerate(rows) if len(row) != len(header)), None)
    if short is not None:
        raise RecordingError(
            f"{path}, line {short + 2}: {len(rows[short])} cells, the header has {len(header)}"
        )
    if not rows:
        raise RecordingError(f"{path} holds no samples")
    dates = date_form([row[places["t"]] for row in rows[:64]])
    cells = TextCells(rows, TextForm(separator, dates))
    try:
        t = cells.times(places["t"])
        numbers = {name: cells.numbers(places[name], name) for name in SIGNALS if name in places}
    except CellError as error:
        raise RecordingError(f"{path}, line {error.row + 2}: {error}") from None
    values = {name: inside_of(name, units.get(name, ""), x) for name, x in numbers.items()}
    if "valve" not in places:
        return {DEFAULT_AXIS: AxisSamples.of(t, **values)}
    names, index = cells.names(places["valve"])
    return {
        str(name): AxisSamples.of(
            t[index == k], **{signal: column[index == k] for signal, column in values.items()}
        )
        for k, name in enumerate(names)
    }


def inside_of(signal: str, unit: str, values: Floats) -> Floats:
    """Values of a signal in %, mm, mm/s, bar or °C, of those in a unit that is allowed.

    >>> inside_of("x", "m", np.array([0.5])), inside_of("pA", "MPa", np.array([18.0]))
    (array([500.]), array([180.]))
    """
    if not unit:
        return values
    if signal in _LENGTHS:
        return np.asarray(_LENGTHS[signal][unit] * values)
    known = unit_of(unit)
    assert known is not None  # noqa: S101 - it is allowed
    return np.asarray(float(known.factor) * values + float(known.offset))


def _is_allowed(signal: str, unit: str) -> bool:
    if signal in _LENGTHS:
        return unit in _LENGTHS[signal]
    known = unit_of(unit)
    return known is not None and known.quantity is QUANTITY_OF.get(signal, Quantity.PRESSURE)


def _named(heading: str) -> tuple[str, str]:
    """Split a heading such as ``x [mm]`` into name and unit, empty without one."""
    match = _WITH_UNIT.fullmatch(heading)
    return (heading, "") if match is None else (match["name"], match["unit"].strip())


def _places(path: Path, header: list[str]) -> tuple[dict[str, int], dict[str, str]]:
    """Return the place of each column, and the units that headings state."""
    exact = {name: name for name in ("t", "valve", *SIGNALS)}
    alike = {name.casefold(): name for name in exact if name.casefold() != "t"} | _ALSO
    places: dict[str, int] = {}
    units: dict[str, str] = {}
    for place, heading in enumerate(header):
        bare, unit = _named(heading)
        name = exact.get(bare) or alike.get(bare.casefold())
        if name is None:
            continue
        if name in places:
            raise RecordingError(f"{path}, line 1: two columns are {name}: {heading} is the second")
        if unit and name in {"t", "valve"}:
            continue
        if unit and not _is_allowed(name, unit):
            usual = ", ".join(_LENGTHS[name]) if name in _LENGTHS else "a unit of that quantity"
            raise RecordingError(f"{path}, line 1: {heading!r}: {usual} is allowed")
        places[name] = place
        units[name] = unit
    if "x" in places:
        places.pop("v", None)  # the position is enough, and tells more
    if "t" not in places:
        raise RecordingError(
            f"{path}, line 1: no column t; an axis needs t,U,x,pA,pB,pS,pT and has "
            f"{','.join(header)[:200]}"
        )
    return places, units
