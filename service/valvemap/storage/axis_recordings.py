"""Recordings of axes: CSV with the columns t, U, x, pA, pB, pS, pT, and optionally T and valve.

``x`` is in mm, U in %, pressures in bar; ``position`` stands for x, ``pP`` for pS. Without x, ``v``
or ``speed`` is the speed in mm/s. Case matters for t and T alone; other columns are ignored.
Separators, decimal commas and times are those of :mod:`~valvemap.storage.recordings`.
"""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from valvemap.errors import NoRecording, RecordingError
from valvemap.model.axis import AxisSamples
from valvemap.storage.columns import CellError
from valvemap.storage.csv_cells import TextCells, TextForm
from valvemap.storage.dates import date_form
from valvemap.storage.packed_text import PACKINGS, text_of

SIGNALS: Final = ("U", "x", "v", "pA", "pB", "pS", "pT", "T")
DEFAULT_AXIS: Final = "Axis"
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
    places = _places(path, header)
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
        values = {name: cells.numbers(places[name], name) for name in SIGNALS if name in places}
    except CellError as error:
        raise RecordingError(f"{path}, line {error.row + 2}: {error}") from None
    if "valve" not in places:
        return {DEFAULT_AXIS: AxisSamples.of(t, **values)}
    names, index = cells.names(places["valve"])
    return {
        str(name): AxisSamples.of(
            t[index == k], **{signal: column[index == k] for signal, column in values.items()}
        )
        for k, name in enumerate(names)
    }


def _places(path: Path, header: list[str]) -> dict[str, int]:
    exact = {name: name for name in ("t", "valve", *SIGNALS)}
    alike = {name.casefold(): name for name in exact if name.casefold() != "t"} | _ALSO
    places: dict[str, int] = {}
    for place, heading in enumerate(header):
        name = exact.get(heading) or alike.get(heading.casefold())
        if name is None:
            continue
        if name in places:
            raise RecordingError(f"{path}, line 1: two columns are {name}: {heading} is the second")
        places[name] = place
    if "x" in places:
        places.pop("v", None)  # the position is enough, and tells more
    if "t" not in places:
        raise RecordingError(
            f"{path}, line 1: no column t; an axis needs t,U,x,pA,pB,pS,pT and has "
            f"{','.join(header)[:200]}"
        )
    return places
