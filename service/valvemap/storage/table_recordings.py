"""Recordings in memory: data frames (pandas, polars, pyarrow) and mappings of arrays."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import RecordingError
from valvemap.model.samples import Codes, Floats, Samples, Times
from valvemap.storage import columns
from valvemap.storage.column_finding import find_columns
from valvemap.storage.columns import CellError
from valvemap.storage.csv_cells import scaled_times, times_of_cells
from valvemap.storage.headings import Beginning, recognise, time_column
from valvemap.storage.layout import (
    DEFAULT_VALVE,
    Columns,
    Layout,
    MissingColumnError,
    Part,
    with_p2,
)
from valvemap.storage.tables import columns_of, narwhals, series_in, size_of, without_mask
from valvemap.storage.time_units import seconds_per_unit

_RECOGNISED: Final = 3_000  # rows used to recognise foreign headings

Column = NDArray[Any] | list[str]


class TableReader:
    """Reads a table chunk by chunk; its columns are those of a recording.

    Numbers may be of any numeric type, times also datetimes (UTC unless they have a zone). Missing
    numbers are NaN. Valves may be integers. What an index gives: see `tables.columns_of`.

    Raises
    ------
    RecordingError
        if it is no table, or a column is of no suitable type; names them and the allowed ones.
    """

    def __init__(self, table: object, chunk_rows: int, layout: Layout) -> None:
        self.name = type(table).__name__
        self._table = columns_of(table, self.name)
        self._chunk_rows = chunk_rows
        self._columns = self._find(layout)
        self._rows = size_of(next(iter(self._table.values())), self.name)
        self._done = 0
        self.ignored = self._columns.ignored

    @property
    def fraction(self) -> float:
        """The fraction read, 0 to 1."""
        return self._done / self._rows if self._rows else 1.0

    @property
    def parts(self) -> tuple[Part, ...]:
        """Columns of each valve."""
        return self._columns.parts

    def close(self) -> None:
        """Nothing is open."""

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), chunk by chunk."""
        try:
            whole = list(self._converted())
        except CellError as error:
            raise RecordingError(f"{self.name}, row {error.row + 1}: {error}") from None
        for start in range(0, self._rows, self._chunk_rows):
            rows = slice(start, start + self._chunk_rows)
            self._done = min(rows.stop, self._rows)
            for samples, valves, index in whole:
                if start < len(samples):
                    here = Samples(**{name: x[rows].copy() for name, x in vars(samples).items()})
                    yield from columns.by_valve(here, valves, index[rows])

    def _find(self, layout: Layout) -> Columns:
        """Return the columns by our own names, else recognised by headings and first rows."""
        headings = list(self._table)
        try:
            return find_columns(headings, layout, self.name)
        except MissingColumnError as missing:
            plain = [self._named(place)[1] for place in range(len(headings))]
            numeric = [isinstance(x, np.ndarray) and x.dtype.kind in "if" for x in plain]
            time = time_column(headings, numeric)
            if not layout.recognises or time is None:
                raise
            numbers = {
                place: np.asarray(column[:_RECOGNISED], np.float64)
                for place, column in enumerate(plain)
                if numeric[place] and place != time
            }
            begin = plain[time][:_RECOGNISED]
            try:
                times = _times(begin, seconds_per_unit(headings[time], 1.0))
            except CellError:
                raise missing from None
            begins = Beginning(Path(self.name), headings, numbers, time, times)
            return recognise(begins, layout, missing)

    def _converted(self) -> Iterator[tuple[Samples, list[str], NDArray[np.intp]]]:
        """Yield samples, valves and each row's valve of every part of the table."""
        found = self._columns
        quality = None if found.quality is None else _qualities(*self._named(found.quality))
        valves, index = [DEFAULT_VALVE], np.zeros(self._rows, np.intp)
        if found.valve is not None:
            valves, index = columns.names(_texts(*self._named(found.valve)))
        for part in found.parts:
            samples = self._samples(part, quality)
            if part.valve is None:
                yield samples, valves, index
            elif not part.selects:
                yield samples, [part.valve], np.zeros(self._rows, np.intp)
            elif part.valve in valves:
                own = index == valves.index(part.valve)
                yield samples[own], [part.valve], np.zeros(int(own.sum()), np.intp)

    def _samples(self, part: Part, quality: Codes | None) -> Samples:
        numbers = {
            signal: scaling(_numbers(*self._named(place), signal))
            for signal, (place, scaling) in part.numbers.items()
        }
        return with_p2(_times(self._named(part.t)[1], part.seconds), quality, numbers)

    def _named(self, place: int) -> tuple[str, Column]:
        name = list(self._table)[place]
        try:
            return f"{self.name}: column {name}", _plain(self._table[name])
        except TypeError as error:
            raise RecordingError(f"{self.name}: column {name} is of type {error}") from None


def _plain(values: object) -> Column:
    """Return float64, int64, datetime64[ns], or texts.

    Raises
    ------
    TypeError
        if it is something else; says what.
    CellError
        if a time is out of range.
    """
    series = series_in(values)
    if series is not None:
        return _of_series(series)
    array = np.asarray(without_mask(values))
    if array.ndim != 1:
        raise TypeError(f"{array.dtype} and shape {array.shape}; (N,) is allowed")
    if array.dtype.kind == "M":
        return _in_ns(array)
    if array.dtype.kind == "m":  # since the recording's start
        return _in_ns(array.astype(array.dtype.str.replace("m8", "M8")))
    if array.dtype.kind in "iu":
        return array.astype(np.int64)
    if array.dtype.kind == "f":
        return array.astype(np.float64)
    if array.dtype.kind in "OUT":
        return [_text(x) for x in array.tolist()]
    raise TypeError(f"{array.dtype}; numbers, datetimes, durations and text are allowed")


def _of_series(series: Any) -> Column:  # noqa: ANN401 - narwhals' series of any library
    nw, kind = narwhals(), series.dtype
    assert nw is not None  # noqa: S101 - there is a series
    if kind == nw.Date:
        series = series.cast(nw.Datetime("us"))
        kind = series.dtype
    if kind == nw.Datetime:
        if series.null_count():
            row = int(np.argmax(series.is_null().to_numpy()))
            raise CellError(row, "t", "", columns.ALLOWED_TIME)
        unit = kind.time_unit if kind.time_unit in ("ns", "us", "ms") else "us"
        return _in_ns(np.asarray(series.dt.timestamp(unit).to_numpy()).view(f"M8[{unit}]"))
    if kind == nw.Duration:
        return _plain(series.to_numpy())
    if kind.is_integer() and not series.null_count():
        return np.asarray(series.cast(nw.Int64).to_numpy())
    if kind.is_numeric():
        return np.asarray(series.cast(nw.Float64).to_numpy(), np.float64)
    if kind in (nw.String, nw.Categorical, nw.Enum, nw.Object):
        return [_text(x) for x in series.to_list()]
    if series.null_count() == len(series):
        return np.full(len(series), np.nan)
    raise TypeError(f"{kind}; numbers, datetimes, durations and text are allowed")


def _in_ns(times: NDArray[np.datetime64]) -> Column:
    ns = times.astype("M8[ns]")
    bad = np.isnat(times) | (ns.astype(times.dtype) != times)
    if bad.any():
        row = int(np.argmax(bad))
        raise CellError(row, "t", times[row], columns.ALLOWED_TIME)
    return ns


def _text(value: object) -> str:
    if value is None or value != value:  # noqa: PLR0124 - NaN and NaT are not themselves
        return ""
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def _numbers(where: str, column: Column, signal: str) -> Floats:
    if isinstance(column, list):
        return columns.numbers(column, signal)
    if column.dtype.kind == "M":
        raise RecordingError(f"{where} is of type {column.dtype}, not a number")
    return column.astype(np.float64)


def _times(column: Column, seconds: float) -> Times:
    if isinstance(column, list):
        return times_of_cells(column, seconds)
    if column.dtype.kind in "if" and seconds != 1.0:
        return scaled_times(column.astype(np.float64), column, seconds)
    if column.dtype.kind == "M":
        return column.astype(np.int64)
    if column.dtype.kind == "i":
        return columns.times_of_integers(column)
    return columns.times_of_floats(column)


def _qualities(where: str, column: Column) -> Codes:
    if isinstance(column, list):
        return columns.qualities(column)
    if column.dtype.kind != "i":
        raise RecordingError(f"{where} is of type {column.dtype}, not an integer or text")
    return columns.qualities_of_integers(column)


def _texts(where: str, column: Column) -> Sequence[str]:
    if isinstance(column, list):
        return column
    if column.dtype.kind == "i":
        return [str(number) for number in column.tolist()]
    raise RecordingError(f"{where} is of type {column.dtype}, not text or integers")
