"""Checks the metadata of an Arrow IPC stream before decompression.

The metadata state the rows, codec and buffers of each record batch in flatbuffers; each compressed
buffer begins with its uncompressed size (8 bytes, little endian; -1: not compressed). `check`
compares them with limits. A message of a few kB that would decompress to GB is therefore rejected
within microseconds.

Source: https://arrow.apache.org/docs/format/Columnar.html, `Message.fbs`.
"""

import struct
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

from valvemap.errors import BlockError, first_line

_BATCH, _DICTIONARY, _SCHEMA = "record batch", "dictionary", "schema"
_LZ4_FRAME: Final = 0  # `CompressionType` that `blocks.write` uses
_SIZE_BYTES: Final = 8  # size field before a compressed buffer
_MOST_MESSAGES: Final = (
    8  # messages in a stream: schema, dictionary, batch, and a reserve for other writers
)
_MOST_NODES: Final = 4_096  # arrays of a batch, children included: 60 for each estimator of a block


@dataclass(frozen=True)
class Limits:
    """Limits of a block.

    Attributes
    ----------
    packed
        Bytes of the message; brokers reject larger ones (`topics.message_mb`).
    rows
        Rows of the batch.
    unpacked
        Bytes of all its buffers after decompression.
    names
        Rows of a dictionary: the valves of a group.
    """

    packed: int
    rows: int
    unpacked: int
    names: int


def check(message: bytes, limits: Limits) -> None:
    """Check that a stream is within its limits, without decompression.

    Raises
    ------
    BlockError
    """
    if len(message) > limits.packed:
        raise BlockError(f"{len(message)} bytes: at most {limits.packed} are allowed")
    try:
        _check_messages(message, limits)
    except (pa.ArrowException, OSError, ValueError, struct.error) as error:
        said = first_line(error)
        raise BlockError(f"not an Arrow IPC stream: {said}") from None


def _check_messages(message: bytes, limits: Limits) -> None:
    room = limits.unpacked
    reader = pa.ipc.MessageReader.open_stream(pa.py_buffer(message))
    for _ in range(_MOST_MESSAGES):
        try:
            part = reader.read_next_message()
        except StopIteration:
            return
        if part.type == _SCHEMA:
            continue
        header = _Table.root(part.metadata.to_pybytes()).table(_HEADER)
        if header is None or part.type not in (_BATCH, _DICTIONARY):
            raise BlockError(f"a {part.type} has no place in a block")
        if part.type == _DICTIONARY:
            header = header.table(_DATA)
        if header is None:
            raise BlockError("a dictionary without values")
        room -= _unpacked(
            header, part.body, limits.names if part.type == _DICTIONARY else limits.rows, room
        )
    raise BlockError(f"more than {_MOST_MESSAGES - 1} messages in a stream: a block has one batch")


def _unpacked(batch: "_Table", body: pa.Buffer | None, rows: int, room: int) -> int:
    """Bytes of a batch's buffers after decompression."""
    if not 0 <= batch.int64(_LENGTH) <= rows:
        raise BlockError(f"{batch.int64(_LENGTH)} rows: at most {rows} are allowed")
    nodes, buffers = batch.vector(_NODES, 2), batch.vector(_BUFFERS, 2)
    if len(nodes) > _MOST_NODES or len(buffers) > 4 * _MOST_NODES:
        raise BlockError(f"{len(nodes)} arrays in a batch: at most {_MOST_NODES} are allowed")
    # An element takes at least one bit.
    if any(not 0 <= length <= max(rows, 8 * room) for length, _ in nodes):
        raise BlockError("an array is longer than a block can be")
    packing = batch.table(_COMPRESSION)
    if packing is not None and packing.int8(_CODEC) != _LZ4_FRAME:
        raise BlockError("compressed by another codec than LZ4 frames")
    body_size = 0 if body is None else body.size
    total = 0
    for at, length in buffers:
        if at < 0 or length < 0 or at + length > body_size:
            raise BlockError("a buffer lies outside of its message")
        total += _size(body, at, length, is_packed=packing is not None)
        if total > room:
            raise BlockError(f"more than {room} bytes once it is decompressed")
    return total


def _size(body: pa.Buffer | None, at: int, length: int, *, is_packed: bool) -> int:
    if not is_packed or length == 0 or body is None:
        return length
    if length < _SIZE_BYTES:
        raise BlockError("a compressed buffer without its size")
    size = int.from_bytes(body.slice(at, _SIZE_BYTES).to_pybytes(), "little", signed=True)
    if size < -1:
        raise BlockError("a compressed buffer of negative size")
    return length - _SIZE_BYTES if size == -1 else size


# Field numbers of the tables in `Message.fbs`.
_HEADER: Final = 2  # of Message; the union's type is the field before it
_DATA: Final = 1  # of DictionaryBatch
_LENGTH, _NODES, _BUFFERS, _COMPRESSION = 0, 1, 2, 3  # of RecordBatch
_CODEC: Final = 0  # of BodyCompression


class _Table:
    """A flatbuffer table: it begins with an offset to its vtable, which holds the field offsets."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data, self._at = data, at
        self._fields = at - _read("<i", data, at)
        self._size = _read("<H", data, self._fields)

    @staticmethod
    def root(data: bytes) -> "_Table":
        return _Table(data, _read("<I", data, 0))

    def int64(self, field: int) -> int:
        at = self._place(field)
        return 0 if at is None else _read("<q", self._data, at)

    def int8(self, field: int) -> int:
        at = self._place(field)
        return 0 if at is None else _read("<b", self._data, at)

    def table(self, field: int) -> "_Table | None":
        at = self._place(field)
        return None if at is None else _Table(self._data, at + _read("<I", self._data, at))

    def vector(self, field: int, width: int) -> list[tuple[int, ...]]:
        """Return a vector of structs with ``width`` int64 each."""
        at = self._place(field)
        if at is None:
            return []
        start = at + _read("<I", self._data, at)
        size, one = _read("<I", self._data, start), struct.Struct(f"<{width}q")
        end = start + 4 + size * one.size
        if end > len(self._data):
            raise struct.error("a list ends behind its message")
        return list(one.iter_unpack(self._data[start + 4 : end]))

    def _place(self, field: int) -> int | None:
        entry = 4 + 2 * field
        if entry + 2 > self._size:
            return None
        offset = _read("<H", self._data, self._fields + entry)
        return self._at + offset if offset else None


def _read(kind: str, data: bytes, at: int) -> int:
    if at < 0:
        raise struct.error("a place before the message")
    (found,) = struct.unpack_from(kind, data, at)
    return int(found)
