"""Blocks: samples and results of many valves as Arrow IPC; `docs/fleet.md` defines the schema.

A block is an Arrow stream with one record batch and LZ4-compressed buffers. The schema's metadata
hold its kind, version, group and number, and further fields of the kind.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from valvemap.errors import BlockError, first_line
from valvemap.kafka.json_messages import loads, text, whole
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.by_valve import ByValve
from valvemap.vocabulary.signals import MEASURED

VERSION: Final = 1

TIME: Final = pa.timestamp("ns", "UTC")
_PREFIX: Final = "valvemap."
_SAMPLES: Final = "samples"
_VALVE: Final = pa.dictionary(pa.int32(), pa.string())
_COLUMNS: Final[Mapping[str, pa.DataType]] = {
    "t": TIME,
    **dict.fromkeys(MEASURED, pa.float64()),
    "quality": pa.uint8(),
}
_WRITING: Final = pa.ipc.IpcWriteOptions(compression="lz4", use_threads=False)  # small blocks
_DAMAGE: Final = (
    pa.ArrowException,
    OSError,
    ValueError,
    MemoryError,
    OverflowError,
    RecursionError,
)
_READING: Final = pa.ipc.IpcReadOptions(use_threads=False)  # small blocks


class Head(NamedTuple):
    """Metadata of every block; ``number`` counts the blocks of its group from 1."""

    kind: str
    group: str
    number: int
    more: Mapping[str, Any]


@dataclass(frozen=True)
class SamplesBlock:
    """Samples of valves of one group, in order of processing.

    Attributes
    ----------
    group, number
        Group, and number of the block in it, from 1.
    valves
        Names; ``samples.segments.members`` are numbers in this list.
    samples
        Sorted by valve.
    catalogue
        Version of the sender's catalogue; a worker with an older one rejects the block.

    Examples
    --------
    >>> samples = Samples.of(t=[0, 1], U=[10, 20], p1=[200, 200], p2=[100, 0], Q=[9, 30])
    >>> one = ByValve(samples, Segments.one(2))
    >>> read_samples(write_samples(SamplesBlock("north.0", 7, ("V1",), one))).samples[0].Q
    array([ 9., 30.])
    """

    group: str
    number: int
    valves: tuple[str, ...]
    samples: ByValve
    catalogue: int = 0


def write_samples(block: SamplesBlock) -> bytes:
    """Encode samples as a message."""
    samples, (members, starts, stops) = block.samples.samples, block.samples.segments
    index = pa.array(np.repeat(members, stops - starts).astype(np.int32))
    columns = {
        "valve": pa.DictionaryArray.from_arrays(index, pa.array(block.valves, pa.string())),
        "t": times(samples.t),
        **{name: pa.array(getattr(samples, name)) for name in _COLUMNS if name != "t"},
    }
    head = Head(_SAMPLES, block.group, block.number, {"catalogue": block.catalogue})
    return write(head, columns)


def read_samples(message: bytes) -> SamplesBlock:
    """Decode samples; a valve's rows need not be contiguous, their order is kept.

    Raises
    ------
    BlockError
        if the message is not a block of samples, is damaged, or has another version.
    """
    head, batch = read(message, _SAMPLES)
    column = batch_column(batch, "valve", _VALVE)
    index = np.array(column.indices.to_numpy(zero_copy_only=False), np.int64)
    valves = tuple(column.dictionary.to_pylist())
    if None in valves or len(set(valves)) < len(valves):
        raise BlockError("column valve: its names must differ")
    columns = {
        name: numpy_of(batch_column(batch, name, kind), kind) for name, kind in _COLUMNS.items()
    }
    if (np.diff(index) < 0).any():
        order = np.argsort(index, kind="stable")
        index, columns = index[order], {name: each[order] for name, each in columns.items()}
    if len(columns["quality"]) and columns["quality"].max() > 2:
        raise BlockError("column quality: 0, 1 and 2 are allowed")
    starts = np.flatnonzero(np.diff(index, prepend=-1)).astype(np.int64)
    stops = np.append(starts[1:], len(index)) if len(starts) else starts
    segments = Segments(index[starts], starts, stops)
    catalogue = whole("metadata valvemap.catalogue", head.more.get("catalogue", 0))
    samples = ByValve(Samples(**columns), segments)
    return SamplesBlock(head.group, head.number, valves, samples, catalogue)


def renumbered(samples: ByValve, numbers: NDArray[np.int64]) -> ByValve:
    """Renumber and sort the valves; valves with a negative number are dropped.

    Examples
    --------
    >>> samples = Samples.of(t=[0, 1], U=[10, 20], p1=[200, 200], p2=[100, 0], Q=[9, 30])
    >>> two = ByValve(samples, Segments(*(np.array(x) for x in ([0, 1], [0, 1], [1, 2]))))
    >>> {valve: one.Q.tolist() for valve, one in renumbered(two, np.array([7, 3])).items()}
    {3: [30.0], 7: [9.0]}
    """
    members, starts, stops = samples.segments
    if (numbers >= 0).all() and (np.diff(numbers) > 0).all():
        return ByValve(samples.samples, Segments(numbers, starts, stops))
    order = np.argsort(numbers)
    order = order[numbers[order] >= 0]
    parts = [samples[int(members[k])] for k in order]
    edges = np.cumsum([0, *map(len, parts)]).astype(np.int64)
    whole = Samples.concatenate(parts)
    return ByValve(whole, Segments(numbers[order], edges[:-1], edges[1:]))


def some(samples: ByValve, rows: NDArray[np.bool_]) -> ByValve:
    """Select rows by a mask (N,); valves without any have no segment.

    Examples
    --------
    >>> samples = Samples.of(t=[0, 1], U=[10, 20], p1=[200, 200], p2=[100, 0], Q=[9, 30])
    >>> two = ByValve(samples, Segments(*(np.array(x) for x in ([0, 1], [0, 1], [1, 2]))))
    >>> {valve: one.Q.tolist() for valve, one in some(two, np.array([False, True])).items()}
    {1: [30.0]}
    """
    members, starts, stops = samples.segments
    before = np.concatenate([[0], np.cumsum(rows)]).astype(np.int64)
    starts, stops = before[starts], before[stops]
    left = stops > starts
    return ByValve(samples.samples[rows], Segments(members[left], starts[left], stops[left]))


def write(head: Head, columns: Mapping[str, pa.Array]) -> bytes:
    """Encode a head and columns of equal length."""
    said = {"block": head.kind, "version": VERSION, "group": head.group, "number": head.number}
    metadata = {_PREFIX + key: json.dumps(value) for key, value in {**said, **head.more}.items()}
    schema = pa.schema(
        [pa.field(name, column.type) for name, column in columns.items()], metadata=metadata
    )
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, schema, options=_WRITING) as stream:
        stream.write_batch(pa.RecordBatch.from_arrays(list(columns.values()), schema=schema))
    packed: bytes = sink.getvalue().to_pybytes()
    return packed


def read(message: bytes, kind: str) -> tuple[Head, pa.RecordBatch]:
    """Decode a block of a kind: its head and its columns.

    Raises
    ------
    BlockError
    """
    try:
        with pa.ipc.open_stream(message, options=_READING) as stream:
            head = _head(stream.schema.metadata or {}, kind)
            batches = list(stream)
        if len(batches) != 1:
            raise BlockError(f"{len(batches)} record batches: a block has one")
        batches[0].validate(full=True)
    except _DAMAGE as error:
        raise BlockError(f"not an Arrow IPC stream: {first_line(error)}") from None
    return head, batches[0]


def batch_column(batch: pa.RecordBatch, name: str, kind: pa.DataType) -> pa.Array:
    """Return a column of the schema's type without nulls.

    Raises
    ------
    BlockError
    """
    where = batch.schema.get_all_field_indices(name)
    if len(where) != 1:
        raise BlockError(f"column {name} is {'missing' if not where else 'there twice'}")
    column = batch.column(where[0])
    if column.type != kind:
        raise BlockError(f"column {name} is of type {column.type}, not {kind}")
    if column.null_count:
        raise BlockError(f"column {name} has {column.null_count} nulls: NaN is no value")
    return column


def times(t: NDArray[np.int64]) -> pa.Array:
    """UTC ns as an Arrow column."""
    return pa.array(np.ascontiguousarray(t), pa.int64()).cast(TIME)


def numpy_of(column: pa.Array, kind: pa.DataType) -> NDArray[Any]:
    """A column as a contiguous NumPy array that owns its data, as the compiled kernels require."""
    if kind == TIME:
        column = column.cast(pa.int64())
    return np.array(column.to_numpy(zero_copy_only=False))


def _head(metadata: Mapping[bytes, bytes], kind: str) -> Head:
    said: dict[str, Any] = {}
    for key, value in metadata.items():
        name = key.decode("utf-8", "replace")
        if name.startswith(_PREFIX):
            said[name.removeprefix(_PREFIX)] = _said(name, value)
    if "block" not in said or "version" not in said:
        raise BlockError("not a block of valvemap: the schema's metadata do not say so")
    if type(said["version"]) is not int or said["version"] != VERSION:
        raise BlockError(f"a block of version {said['version']!r:.40}, this one knows {VERSION}")
    if said["block"] != kind:
        raise BlockError(f"a block of {said['block']!s:.40}, not of {kind}")
    least = 1 if kind == _SAMPLES else 0  # a command may cause results before the first block
    try:
        group = text("group", said.pop("group", None))
        number = whole("number", said.pop("number", None), least)
    except BlockError as error:
        raise BlockError(f"a block says its group, and its number from {least}: {error}") from None
    return Head(kind, group, number, said)


def _said(name: str, value: bytes) -> Any:  # noqa: ANN401 - JSON
    try:
        return loads(value)
    except BlockError:
        raise BlockError(f"metadata {name:.100}: not JSON") from None


def names_of(said: Any, what: str) -> Sequence[str]:  # noqa: ANN401 - JSON
    """Return a list of names in the metadata.

    Raises
    ------
    BlockError
    """
    if not isinstance(said, list) or not all(isinstance(name, str) for name in said):
        raise BlockError(f"metadata {_PREFIX}{what}: a list of names is needed")
    return [text(f"metadata {_PREFIX}{what}", name) for name in said]
