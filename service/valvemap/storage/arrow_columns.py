"""Columns of Arrow as arrays of samples, whatever their type."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from valvemap.errors import RecordingError
from valvemap.model.samples import Codes, Floats, Times
from valvemap.storage import columns
from valvemap.storage.columns import CellError
from valvemap.storage.csv_cells import scaled_times, times_of_cells
from valvemap.storage.layout import DEFAULT_VALVE, Columns
from valvemap.vocabulary.signals import MEASURED


def check_types(schema: pa.Schema, found: Columns, path: Path) -> None:
    """Raise RecordingError if a column is of a type that its quantity cannot have."""
    places = [("t", part.t) for part in found.parts]
    places += [(name, n) for part in found.parts for name, (n, _) in part.numbers.items()]
    places += [
        (name, n)
        for name, n in (("valve", found.valve), ("quality", found.quality))
        if n is not None
    ]
    for name, place in places:
        kind = schema.field(place).type
        allowed, test = _ALLOWED[name]
        if not test(kind.value_type if pa.types.is_dictionary(kind) else kind):
            raise RecordingError(
                f"{path}: column {schema.field(place).name} is of type {kind}, not {allowed}"
            )


def writable(column: pa.Array) -> NDArray[Any]:
    """Return the values of a column as an array that can be written to.

    Arrow's own arrays are read-only: a separate type, for which all kernels would be recompiled.
    """
    array: NDArray[Any] = np.require(column.to_numpy(zero_copy_only=False), requirements="W")
    return array


def numbers_of(column: pa.Array) -> Floats:
    """Return numbers of any type as float64; NaN where there is none."""
    return writable(pc.cast(plain(column), pa.float64(), safe=False))


def times_of(column: pa.Array, seconds: float = 1.0) -> Times:
    """Return times as UTC ns; ``seconds`` are those of one unit of a number."""
    column = complete(column, "t", columns.ALLOWED_TIME)
    kind = column.type
    if seconds != 1.0 and is_number(kind):
        return scaled_times(numbers_of(column), column, seconds)
    if pa.types.is_duration(kind):  # since the recording's start
        kind = pa.timestamp(kind.unit)
        column = pc.cast(pc.cast(column, pa.int64()), kind)
    if pa.types.is_timestamp(kind):
        try:
            return writable(pc.cast(pc.cast(column, pa.timestamp("ns", kind.tz)), pa.int64()))
        except pa.ArrowInvalid:
            raise CellError(0, "t", _as_text(column[0]), columns.ALLOWED_TIME) from None
    if is_text(kind):
        return times_of_cells(column.to_pylist(), seconds)
    if pa.types.is_integer(kind):
        return columns.times_of_integers(writable(pc.cast(column, pa.int64())))
    return columns.times_of_floats(numbers_of(column))


def qualities_of(column: pa.Array) -> Codes:
    """Return the qualities of numbers or labels."""
    column = complete(column, "quality", columns.ALLOWED_QUALITY)
    if is_text(column.type):
        return columns.qualities(column.to_pylist())
    return columns.qualities_of_integers(writable(pc.cast(column, pa.int64())))


def valves_of(column: pa.Array | None, rows: int) -> tuple[list[str], NDArray[np.intp]]:
    """Return the names of valves, and the number of each row's valve among them."""
    if column is None:
        return [DEFAULT_VALVE], np.zeros(rows, np.intp)
    column = complete(column, "valve", columns.ALLOWED_VALVE).dictionary_encode()
    if "" in column.dictionary.to_pylist():
        row = int(np.argmax(writable(pc.equal(plain(column), ""))))
        raise CellError(row, "valve", "", columns.ALLOWED_VALVE)
    return column.dictionary.to_pylist(), writable(column.indices).astype(np.intp)


def complete(column: pa.Array, name: str, allowed: str) -> pa.Array:
    """Return a column without a dictionary; raise CellError if a cell is empty."""
    if column.null_count:
        raise CellError(int(np.argmax(writable(column.is_null()))), name, "", allowed)
    return plain(column)


def plain(column: pa.Array) -> pa.Array:
    """Return a column without a dictionary."""
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def is_number(kind: pa.DataType) -> bool:
    """Whether values of a type can be read as numbers."""
    t = pa.types
    return any(test(kind) for test in (t.is_integer, t.is_floating, t.is_decimal, t.is_null))


def is_text(kind: pa.DataType) -> bool:
    """Whether values of a type are text."""
    return any(test(kind) for test in (pa.types.is_string, pa.types.is_large_string))


def _is_time(kind: pa.DataType) -> bool:
    known = pa.types.is_timestamp, pa.types.is_duration, is_number, is_text
    return any(test(kind) for test in known)


def _is_quality(kind: pa.DataType) -> bool:
    return any(test(kind) for test in (pa.types.is_integer, is_text))


_ALLOWED: dict[str, tuple[str, Callable[[pa.DataType], bool]]] = {
    "t": ("a timestamp, a duration, a number or text", _is_time),
    **dict.fromkeys(MEASURED, ("a number", is_number)),
    "valve": ("text", is_text),
    "quality": ("an integer or text", _is_quality),
}


def _as_text(time: pa.Scalar) -> str:
    try:
        return str(time)
    except (OverflowError, ValueError):  # a year that Python does not know
        return str(time.value)
