"""Recordings in Parquet, in our own columns, recognised ones, or in long format."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from valvemap.errors import RecordingError
from valvemap.model.samples import Floats, Times
from valvemap.storage.arrow_columns import (
    complete,
    is_number,
    is_text,
    numbers_of,
    plain,
    times_of,
)
from valvemap.storage.arrow_reader import UNREADABLE, ArrowReader, damaged
from valvemap.storage.column_finding import find_columns
from valvemap.storage.columns import CellError
from valvemap.storage.headings import Beginning, recognise, time_column
from valvemap.storage.layout import Columns, Layout, MissingColumnError
from valvemap.storage.long_format import LongColumns, LongReader, LongRows, long_columns
from valvemap.storage.time_units import seconds_per_unit

_RECOGNISED = 3_000  # rows used to recognise foreign headings


def open_parquet(path: Path, chunk_rows: int, layout: Layout) -> ArrowReader | LongReader:
    """Open a Parquet file; memory is bounded by the chunk, regardless of the row group size."""
    try:
        metadata = pq.read_metadata(path)
        wanted = (layout.valve or "valve").casefold()
        names = [name for name in metadata.schema.names if name.casefold() == wanted]
        file = pq.ParquetFile(
            path,
            metadata=metadata,
            read_dictionary=names,
            buffer_size=1 << 20,
            pre_buffer=False,  # would buffer the whole file
        )
        headings = list(file.schema_arrow.names)
    except UNREADABLE as error:
        raise damaged(path, error, 0) from error
    found = _find(path, file, headings, layout)
    if isinstance(found, LongColumns):
        rows = LongRows(path, layout)
        blocks = _long_blocks(path, file, found, chunk_rows)
        return LongReader(rows, blocks, file.metadata.num_rows, chunk_rows, file.close)
    useless = set(found.ignored)
    kept = [name for name in headings if name not in useless]
    found = _moved(found, headings, kept)
    batches = file.iter_batches(batch_size=chunk_rows, columns=kept)
    schema = pa.schema([file.schema_arrow.field(name) for name in kept])
    reader = ArrowReader(path, schema, batches, file.metadata.num_rows, file.close, found)
    reader.ignored = tuple(name for name in headings if name in useless)
    return reader


def _long_blocks(
    path: Path, file: pq.ParquetFile, place: LongColumns, rows: int
) -> Iterator[tuple[Times, Sequence[str], Floats]]:
    """Yield times, names of signals and values of a file in long format."""
    names = [file.schema_arrow.names[n] for n in (place.time, place.tag, place.value)]
    seconds, done = seconds_per_unit(names[0]), 0
    try:
        for batch in file.iter_batches(batch_size=rows, columns=names):
            time, tag, value = (batch.column(batch.schema.get_field_index(n)) for n in names)
            whose = complete(tag, names[1], "text").to_pylist()
            yield times_of(time, seconds), whose, numbers_of(value)
            done += batch.num_rows
    except UNREADABLE as error:
        raise damaged(path, error, done) from error
    except CellError as error:
        raise RecordingError(f"{path}, row {done + error.row + 1}: {error}") from None


def _find(
    path: Path, file: pq.ParquetFile, headings: Sequence[str], layout: Layout
) -> Columns | LongColumns:
    """Return the columns by our own names, else recognised by headings and first rows."""
    try:
        return find_columns(headings, layout, str(path))
    except MissingColumnError as missing:
        numeric = [is_number(field.type) for field in file.schema_arrow]
        time = time_column(headings, numeric)
        if not layout.recognises or time is None:
            raise
        try:
            batch = next(file.iter_batches(batch_size=_RECOGNISED), None)
            if batch is None:
                raise missing from None
            long = long_columns(headings, _cells(batch), numeric)
            if long is not None:
                return long
            numbers = {
                place: numbers_of(batch.column(place))
                for place, usable in enumerate(numeric)
                if place != time and usable
            }
            times = times_of(batch.column(time), seconds_per_unit(headings[time], 1.0))
        except UNREADABLE as error:
            raise damaged(path, error, 0) from error
        except CellError:
            raise missing from None
        return recognise(Beginning(path, headings, numbers, time, times), layout, missing)


def _cells(batch: pa.RecordBatch) -> list[list[str]]:
    """Return the rows as text; of columns of other types as of missing text."""
    texts = [
        plain(column).to_pylist() if is_text(plain(column).type) else [""] * batch.num_rows
        for column in batch.columns
    ]
    return [["" if cell is None else cell for cell in row] for row in zip(*texts, strict=True)]


def _moved(found: Columns, headings: Sequence[str], kept: Sequence[str]) -> Columns:
    """Return the columns by their numbers among those that are kept."""

    def place(number: int) -> int:
        return kept.index(headings[number])

    parts = tuple(
        replace(
            part,
            t=place(part.t),
            numbers={name: (place(n), scaling) for name, (n, scaling) in part.numbers.items()},
        )
        for part in found.parts
    )
    valve, quality = (None if n is None else place(n) for n in (found.valve, found.quality))
    return Columns(parts, valve, quality, ())
