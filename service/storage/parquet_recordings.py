"""Recordings as Parquet, by way of an Arrow stream while they grow; needs pyarrow."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.errors import RecordingError
from service.identification.samples import Codes, Floats, Samples, Times
from service.storage import columns
from service.storage.columns import CellError

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
        *(pa.field(name, pa.float64()) for name in columns.NUMBERS),
        pa.field("valve", pa.string()),
        pa.field("quality", pa.uint8()),
    ]
)
_ROW_GROUP = 1 << 19


class ArrowReader:
    """Reads record batches whose columns may be of any Arrow type that can hold them."""

    def __init__(
        self,
        path: Path,
        schema: pa.Schema,
        batches: Iterable[pa.RecordBatch],
        total: int,
        close: Callable[[], None],
    ) -> None:
        _check(schema, path)
        self.ignored = tuple(name for name in schema.names if name not in columns.COLUMNS)
        self._path = path
        self._batches = batches
        self._total = total
        self._done = 0
        self.close = close

    @property
    def fraction(self) -> float:
        """How much has been read, 0 to 1."""
        return min(self._done / self._total, 1.0) if self._total else 1.0

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), batch by batch."""
        batches = iter(self._batches)
        while True:
            try:
                batch = next(batches, None)
            except (pa.ArrowException, OSError) as error:
                raise _damaged(self._path, error, self._done) from error
            if batch is None:
                return
            before, self._done = self._done, self._done + batch.num_rows
            if batch.num_rows:
                yield from self._parsed(batch, before)

    def _parsed(self, batch: pa.RecordBatch, before: int) -> Iterator[tuple[str, Samples]]:
        found = {name: batch.column(name) for name in columns.COLUMNS if name in batch.schema.names}
        try:
            samples = Samples.of(
                t=_times(found["t"]),
                U=_numbers(found["U"]),
                p1=_numbers(found["p1"]),
                p2=_numbers(found["p2"]),
                Q=_numbers(found["Q"]),
                T=_numbers(found["T"]) if "T" in found else None,
                quality=_qualities(found["quality"]) if "quality" in found else None,
            )
            valves = _valves(found.get("valve"), batch.num_rows)
        except CellError as error:
            row = before + error.row + 1
            raise RecordingError(f"{self._path}, row {row}: {error}") from None
        yield from columns.by_valve(samples, *valves)


def open_parquet(path: Path, chunk_rows: int) -> ArrowReader:
    """Open a Parquet file; memory is bounded by the chunk, however large its row groups are."""
    try:
        metadata = pq.read_metadata(path)
        names = [name for name in metadata.schema.names if name == "valve"]
        file = pq.ParquetFile(
            path,
            metadata=metadata,
            read_dictionary=names,
            buffer_size=1 << 20,
            pre_buffer=False,  # would hold the whole file in the end
        )
    except (pa.ArrowException, OSError) as error:
        raise _damaged(path, error, 0) from error
    wanted = [name for name in file.schema_arrow.names if name in columns.COLUMNS]
    batches = file.iter_batches(batch_size=chunk_rows, columns=wanted)
    return ArrowReader(path, file.schema_arrow, batches, file.metadata.num_rows, file.close)


def open_stream(path: Path) -> ArrowReader:
    """Open what a killed recorder has left behind: a stream which may end anywhere."""
    try:
        file = pa.OSFile(str(path))
        stream = pa.ipc.open_stream(file)
    except (pa.ArrowException, OSError) as error:
        raise _damaged(path, error, 0) from error
    return ArrowReader(path, stream.schema, stream, 0, file.close)


def stream_head() -> bytes:
    """Begin an Arrow stream: the bytes that name its columns."""
    return bytes(_SCHEMA.serialize())


def stream_rows(valve: str, samples: Samples) -> bytes:
    """Samples as bytes that continue an Arrow stream."""
    batch = pa.record_batch(
        [
            pa.array(samples.t).cast(_SCHEMA.field("t").type),
            *(pa.array(getattr(samples, name)) for name in columns.NUMBERS),
            pa.repeat(valve, len(samples)),
            pa.array(samples.quality),
        ],
        schema=_SCHEMA,
    )
    return bytes(batch.serialize())


def parquet_from_stream(stream: Path, path: Path) -> None:
    """Turn a finished Arrow stream into a Parquet file, in constant memory."""
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


def _check(schema: pa.Schema, path: Path) -> None:
    missing = [name for name in columns.REQUIRED if name not in schema.names]
    if missing:
        raise RecordingError(
            f"{path}: column {', '.join(missing)} is missing; there must be t, U, p1, p2, Q "
            f"(and may be T, valve, quality), found {', '.join(schema.names)[:60]!r}"
        )
    twice = [name for name in columns.COLUMNS if schema.names.count(name) > 1]
    if twice:
        raise RecordingError(f"{path}: column {twice[0]} stands there twice")
    for name in columns.COLUMNS:
        if name in schema.names:
            kind = schema.field(name).type
            allowed, test = _ALLOWED[name]
            if not test(kind.value_type if pa.types.is_dictionary(kind) else kind):
                raise RecordingError(f"{path}: column {name} is of type {kind}, not {allowed}")


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
    **dict.fromkeys(columns.NUMBERS, ("a number", _is_number)),
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
    array: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    return array


def _numbers(column: pa.Array) -> Floats:
    return _array(pc.cast(_plain(column), pa.float64(), safe=False))


def _times(column: pa.Array) -> Times:
    column = _complete(column, "t", columns.ALLOWED_TIME)
    kind = column.type
    if pa.types.is_timestamp(kind):
        try:
            return _array(pc.cast(pc.cast(column, pa.timestamp("ns", kind.tz)), pa.int64()))
        except pa.ArrowInvalid:
            raise CellError(0, "t", column[0], columns.ALLOWED_TIME) from None
    if _is_text(kind):
        return columns.times(column.to_pylist())
    if pa.types.is_integer(kind):
        return columns.times_of_integers(_array(pc.cast(column, pa.int64())))
    return columns.times_of_floats(_numbers(column))


def _qualities(column: pa.Array) -> Codes:
    column = _complete(column, "quality", columns.ALLOWED_QUALITY)
    if _is_text(column.type):
        return columns.qualities(column.to_pylist())
    return columns.qualities_of_integers(_array(pc.cast(column, pa.int64())))


def _valves(column: pa.Array | None, rows: int) -> tuple[list[str], NDArray[np.intp]]:
    if column is None:
        return [columns.DEFAULT_VALVE], np.zeros(rows, np.intp)
    column = _complete(column, "valve", columns.ALLOWED_VALVE).dictionary_encode()
    if "" in column.dictionary.to_pylist():
        row = int(np.argmax(_array(pc.equal(_plain(column), ""))))
        raise CellError(row, "valve", "", columns.ALLOWED_VALVE)
    return column.dictionary.to_pylist(), _array(column.indices).astype(np.intp)


def _damaged(path: Path, error: Exception, row: int) -> RecordingError:
    if isinstance(error, FileNotFoundError):
        return RecordingError(f"{path} does not exist")
    sentence = str(error).splitlines()[0] if str(error) else type(error).__name__
    where = f"damaged behind row {row}" if row else "not a recording"
    return RecordingError(f"{path} is {where}: {sentence}")
