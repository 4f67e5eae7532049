"""Recordings as they are written: a stream of Arrow, converted to Parquet when it is complete."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from valvemap.model.samples import Samples
from valvemap.storage.arrow_reader import UNREADABLE, ArrowReader, damaged
from valvemap.storage.column_finding import find_columns
from valvemap.storage.layout import Layout
from valvemap.vocabulary.signals import MEASURED

_SCHEMA = pa.schema(
    [
        pa.field("t", pa.timestamp("ns", tz="UTC")),
        *(pa.field(name, pa.float64()) for name in MEASURED),
        pa.field("valve", pa.string()),
        pa.field("quality", pa.uint8()),
    ]
)
_ROW_GROUP = 1 << 19


def open_stream(path: Path, layout: Layout) -> ArrowReader:
    """Open the Arrow stream of a killed recorder, which may be truncated."""
    try:
        file = pa.OSFile(str(path))
        stream = pa.ipc.open_stream(file)
        stream.schema.names  # noqa: B018 - names that are no text are found here
    except UNREADABLE as error:
        raise damaged(path, error, 0) from error
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
