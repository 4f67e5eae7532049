"""Recordings as Parquet, written as an Arrow stream until they are complete; needs pyarrow."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import NoRecording, RecordingError
from valvemap.model.samples import Codes, Floats, Samples, Times
from valvemap.storage import columns
from valvemap.storage.columns import CellError
from valvemap.storage.headings import Beginning, recognise, time_column
from valvemap.storage.layout import (
    DEFAULT_VALVE,
    Columns,
    Layout,
    MissingColumnError,
    Part,
    find_columns,
    with_p2,
)
from valvemap.storage.long_format import LongColumns, LongReader, LongRows, long_columns
from valvemap.storage.time_units import seconds_per_unit
from valvemap.vocabulary.signals import MEASURED

try:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq
except ImportError as _error:
    raise RecordingError(
        "Parquet recordings need pyarrow: pip install 'valvemap[parquet]'"
    ) from _error

_SCHEMA = pa.schema(
    [
        pa.field("t", pa.timestamp("ns", tz="UTC")),
        *(pa.field(name, pa.float64()) for name in MEASURED),
        pa.field("valve", pa.string()),
        pa.field("quality", pa.uint8()),
    ]
)
_ROW_GROUP = 1 << 19
_RECOGNISED = 3_000  # rows used to recognise foreign headings
_UNREADABLE = (pa.ArrowException, OSError, UnicodeDecodeError)  # of a damaged file


class ArrowReader:
    """Reads record batches; columns may have any suitable Arrow type."""

    def __init__(
        self,
        path: Path,
        schema: pa.Schema,
        batches: Iterable[pa.RecordBatch],
        total: int,
        close: Callable[[], None],
        found: Columns,
    ) -> None:
        self._columns = found
        _check_types(schema, self._columns, path)
        self.ignored = self._columns.ignored
        self._path = path
        self._batches = batches
        self._total = total
        self._done = 0
        self.close = close

    @property
    def fraction(self) -> float:
        """The fraction read, 0 to 1."""
        return min(self._done / self._total, 1.0) if self._total else 1.0

    @property
    def parts(self) -> tuple[Part, ...]:
        """Columns of each valve."""
        return self._columns.parts

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), batch by batch."""
        batches = iter(self._batches)
        while True:
            try:
                batch = next(batches, None)
            except _UNREADABLE as error:
                raise _damaged(self._path, error, self._done) from error
            if batch is None:
                return
            before, self._done = self._done, self._done + batch.num_rows
            if batch.num_rows:
                yield from self._parsed(batch, before)

    def _parsed(self, batch: pa.RecordBatch, before: int) -> Iterator[tuple[str, Samples]]:
        found = self._columns
        try:
            quality = None if found.quality is None else _qualities(batch.column(found.quality))
            whose = None if found.valve is None else batch.column(found.valve)
            valves, index = _valves(whose, batch.num_rows)
            for part in found.parts:
                if part.selects and part.valve not in valves:
                    continue
                samples = _samples(batch, part, quality)
                if part.valve is None:
                    yield from columns.by_valve(samples, valves, index)
                elif not part.selects:
                    yield part.valve, samples
                else:
                    own = samples[index == valves.index(part.valve)]
                    if len(own):
                        yield part.valve, own
        except (UnicodeDecodeError, pa.ArrowException) as error:  # in a cell
            raise _damaged(self._path, error, before) from error
        except CellError as error:
            row = before + error.row + 1
            raise RecordingError(f"{self._path}, row {row}: {error}") from None


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
    except _UNREADABLE as error:
        raise _damaged(path, error, 0) from error
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
            whose = _complete(tag, names[1], "text").to_pylist()
            yield _times(time, seconds), whose, _numbers(value)
            done += batch.num_rows
    except _UNREADABLE as error:
        raise _damaged(path, error, done) from error
    except CellError as error:
        raise RecordingError(f"{path}, row {done + error.row + 1}: {error}") from None


def _find(
    path: Path, file: pq.ParquetFile, headings: Sequence[str], layout: Layout
) -> Columns | LongColumns:
    """Return the columns by our own names, else recognised by headings and first rows."""
    try:
        return find_columns(headings, layout, str(path))
    except MissingColumnError as missing:
        numeric = [_is_number(field.type) for field in file.schema_arrow]
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
                place: _numbers(batch.column(place))
                for place, is_number in enumerate(numeric)
                if place != time and is_number
            }
            times = _times(batch.column(time), seconds_per_unit(headings[time]))
        except _UNREADABLE as error:
            raise _damaged(path, error, 0) from error
        except CellError:
            raise missing from None
        return recognise(Beginning(path, headings, numbers, time, times), layout, missing)


def _cells(batch: pa.RecordBatch) -> list[list[str]]:
    """Return the rows as text; of columns of other types as of missing text."""
    texts = [
        _plain(column).to_pylist() if _is_text(_plain(column).type) else [""] * batch.num_rows
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


def open_stream(path: Path, layout: Layout) -> ArrowReader:
    """Open the Arrow stream of a killed recorder, which may be truncated."""
    try:
        file = pa.OSFile(str(path))
        stream = pa.ipc.open_stream(file)
        stream.schema.names  # noqa: B018 - names that are no text are found here
    except _UNREADABLE as error:
        raise _damaged(path, error, 0) from error
    found = find_columns(stream.schema.names, layout, str(path))
    return ArrowReader(path, stream.schema, stream, 0, file.close, found)


def stream_head() -> bytes:
    """Return the first bytes of an Arrow stream, with its schema."""
    return bytes(_SCHEMA.serialize())


def stream_rows(valve: str, samples: Samples) -> bytes:
    """Return samples as bytes to append to an Arrow stream."""
    batch = pa.record_batch(
        [
            pa.array(samples.t).cast(_SCHEMA.field("t").type),
            *(pa.array(getattr(samples, name)) for name in MEASURED),
            pa.repeat(valve, len(samples)),
            pa.array(samples.quality),
        ],
        schema=_SCHEMA,
    )
    return bytes(batch.serialize())


def parquet_from_stream(stream: Path, path: Path) -> None:
    """Convert a complete Arrow stream to a Parquet file, in constant memory."""
    with (
        pa.OSFile(str(stream)) as source,
        pq.ParquetWriter(path, _SCHEMA, compression="zstd") as writer,
    ):
        held: list[pa.RecordBatch] = []
        rows = 0
        for batch in pa.ipc.open_stream(source):
            held.append(batch)
            rows += batch.num_rows
            if rows >= _ROW_GROUP:
                writer.write_table(pa.Table.from_batches(held, _SCHEMA))
                held, rows = [], 0
        if held:
            writer.write_table(pa.Table.from_batches(held, _SCHEMA))


def _check_types(schema: pa.Schema, found: Columns, path: Path) -> None:
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


def _samples(batch: pa.RecordBatch, part: Part, quality: Codes | None) -> Samples:
    numbers = {
        name: scaling(_numbers(batch.column(place)))
        for name, (place, scaling) in part.numbers.items()
    }
    return with_p2(_times(batch.column(part.t), part.seconds), quality, numbers)


def _is_number(kind: pa.DataType) -> bool:
    t = pa.types
    return any(test(kind) for test in (t.is_integer, t.is_floating, t.is_decimal, t.is_null))


def _is_text(kind: pa.DataType) -> bool:
    return any(test(kind) for test in (pa.types.is_string, pa.types.is_large_string))


def _is_time(kind: pa.DataType) -> bool:
    return any(test(kind) for test in (pa.types.is_timestamp, _is_number, _is_text))


def _is_quality(kind: pa.DataType) -> bool:
    return any(test(kind) for test in (pa.types.is_integer, _is_text))


_ALLOWED: dict[str, tuple[str, Callable[[pa.DataType], bool]]] = {
    "t": ("a timestamp, a number or text", _is_time),
    **dict.fromkeys(MEASURED, ("a number", _is_number)),
    "valve": ("text", _is_text),
    "quality": ("an integer or text", _is_quality),
}


def _plain(column: pa.Array) -> pa.Array:
    return column.dictionary_decode() if pa.types.is_dictionary(column.type) else column


def _complete(column: pa.Array, name: str, allowed: str) -> pa.Array:
    if column.null_count:
        raise CellError(int(np.argmax(_array(column.is_null()))), name, "", allowed)
    return _plain(column)


def _array(column: pa.Array) -> NDArray[Any]:
    # Arrow's arrays are read-only, a separate type for which all kernels would be recompiled
    array: NDArray[Any] = np.require(column.to_numpy(zero_copy_only=False), requirements="W")
    return array


def _numbers(column: pa.Array) -> Floats:
    return _array(pc.cast(_plain(column), pa.float64(), safe=False))


def _times(column: pa.Array, seconds: float = 1.0) -> Times:
    column = _complete(column, "t", columns.ALLOWED_TIME)
    kind = column.type
    if seconds != 1.0 and _is_number(kind):
        return np.rint(_numbers(column) * (seconds * 1e9)).astype(np.int64)
    if pa.types.is_timestamp(kind):
        try:
            return _array(pc.cast(pc.cast(column, pa.timestamp("ns", kind.tz)), pa.int64()))
        except pa.ArrowInvalid:
            raise CellError(0, "t", _as_text(column[0]), columns.ALLOWED_TIME) from None
    if _is_text(kind):
        return columns.times(column.to_pylist())
    if pa.types.is_integer(kind):
        return columns.times_of_integers(_array(pc.cast(column, pa.int64())))
    return columns.times_of_floats(_numbers(column))


def _as_text(time: pa.Scalar) -> str:
    try:
        return str(time)
    except (OverflowError, ValueError):  # a year that Python does not know
        return str(time.value)


def _qualities(column: pa.Array) -> Codes:
    column = _complete(column, "quality", columns.ALLOWED_QUALITY)
    if _is_text(column.type):
        return columns.qualities(column.to_pylist())
    return columns.qualities_of_integers(_array(pc.cast(column, pa.int64())))


def _valves(column: pa.Array | None, rows: int) -> tuple[list[str], NDArray[np.intp]]:
    if column is None:
        return [DEFAULT_VALVE], np.zeros(rows, np.intp)
    column = _complete(column, "valve", columns.ALLOWED_VALVE).dictionary_encode()
    if "" in column.dictionary.to_pylist():
        row = int(np.argmax(_array(pc.equal(_plain(column), ""))))
        raise CellError(row, "valve", "", columns.ALLOWED_VALVE)
    return column.dictionary.to_pylist(), _array(column.indices).astype(np.intp)


def _damaged(path: Path, error: Exception, row: int) -> RecordingError:
    if isinstance(error, FileNotFoundError):
        return NoRecording(f"{path} does not exist")
    sentence = str(error).splitlines()[0] if str(error) else type(error).__name__
    where = f"damaged behind row {row}" if row else "not a recording"
    return RecordingError(f"{path} is {where}: {sentence}")
