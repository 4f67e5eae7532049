"""Checkpoint of a group as bytes, which another worker can restore.

A JSON head states the format, the catalogue's version, the block number and the columns. The
columns and the baselines follow it. Columns of unsigned integers are compressed to half or less;
columns of equal type and shape are stored as differences, because a valve's estimators process
nearly the same samples. Other columns hardly compress, and compression takes longer.

A checksum before the head seals all of it, so that damage is not taken for another configuration.
States of older versions have no seal.
"""

import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from valvemap.errors import DamagedState, FleetError
from valvemap.kafka.group_clock import Ahead
from valvemap.pipeline.valve_columns import Columns

MAGIC: Final = b"valvemap memory"
FORMAT: Final = 3
READABLE: Final = (1, 2, 3)  # format 1 is uncompressed; 1 and 2 are not sealed
_SEALED: Final = b" sealed\n"
_UNSEALED: Final = b"\n"
_SEAL: Final = struct.Struct("<I")  # CRC-32 of all behind it
_SIZE: Final = struct.Struct("<Q")
_CODEC: Final = pa.Codec("lz4_raw")
_DENSEST: Final = 255  # bytes that one byte of LZ4 can encode
_ROOM: Final = 64_000_000  # bytes; for checkpoints that are mostly zeros
_DENSE: Final = 32  # maximum ratio of unpacked to packed bytes; trained estimators have 2 to 4
_COUNTS: Final = "u"

_Alike = dict[tuple[str, tuple[int, ...]], NDArray[Any]]  # last column by type and shape


@dataclass(frozen=True)
class Memory:
    """Checkpoint of a group after a block.

    Attributes
    ----------
    catalogue
        Version of the catalogue.
    number
        Number of the last block processed.
    due
        Next due time by name, source time, UTC ns.
    counts
        Counters of the group's blocks by name.
    columns
        State of the estimators.
    baselines
        Encoded approved map by valve.
    replies
        Encoded replies to the last commands, oldest first; a repeated command is not executed
        again.
    ahead
        Consecutive last blocks dated far ahead: number and median of their times.
    """

    catalogue: int
    number: int
    due: Mapping[str, int]
    counts: Mapping[str, int]
    columns: Sequence[Columns]
    baselines: Mapping[str, bytes]
    replies: Sequence[str] = ()
    ahead: Ahead = ()


def write_memory(memory: Memory) -> bytes:
    """Encode a checkpoint.

    Examples
    --------
    >>> one = Columns("k", ("V1",), {"n": np.array([7.0])})
    >>> packed = write_memory(Memory(1, 12, {}, {}, [one], {}))
    >>> read_memory(packed).columns[0].arrays["n"]
    array([7.])
    """
    alike: _Alike = {}
    body, said_of = [], []
    for columns in memory.columns:
        packed = [_packed(array, alike) for array in columns.arrays.values()]
        body += [array for array, _ in packed]
        arrays = zip(columns.arrays.items(), packed, strict=True)
        of_each = [[name, a.dtype.str, a.shape, *size] for (name, a), (_, size) in arrays]
        said_of.append([columns.key, columns.valves, of_each])
    head = {
        "format": FORMAT,
        "catalogue": memory.catalogue,
        "number": memory.number,
        "due": dict(memory.due),
        "counts": dict(memory.counts),
        "columns": said_of,
        "replies": list(memory.replies),
        **({"ahead": memory.ahead} if memory.ahead else {}),
        "baselines": [[valve, len(packed)] for valve, packed in memory.baselines.items()],
    }
    said = json.dumps(head).encode()
    return sealed(_SIZE.pack(len(said)), said, *body, *memory.baselines.values())


def sealed(*parts: bytes | memoryview) -> bytes:
    """Return the parts of a checkpoint behind their checksum."""
    seal = 0
    for part in parts:
        seal = zlib.crc32(part, seal)
    return b"".join((MAGIC, _SEALED, _SEAL.pack(seal), *parts))


def read_memory(packed: bytes) -> Memory:
    """Decode a checkpoint; the columns are read-only views.

    Raises
    ------
    DamagedState
        if it is invalid or damaged.
    FleetError
        if it is of a newer format.
    """
    at = _without_seal(packed)
    start = at + _SIZE.size
    if len(packed) < start:
        raise DamagedState("not a group's memory")
    (size,) = _SIZE.unpack_from(packed, at)
    try:
        head = json.loads(packed[start : start + size])
        if head["format"] not in READABLE:
            raise FleetError(f"a memory of format {head['format']}, this one knows up to {FORMAT}")
        return _memory(head, packed, start + size)
    except _DAMAGE as error:
        raise DamagedState(f"a group's memory is damaged: {error}") from None


def _without_seal(packed: bytes) -> int:
    """Check the seal; return the position behind it."""
    at = len(MAGIC)
    if packed.startswith(MAGIC + _UNSEALED):
        return at + len(_UNSEALED)
    if not packed.startswith(MAGIC + _SEALED) or len(packed) < at + len(_SEALED) + _SEAL.size:
        raise DamagedState("not a group's memory")
    at += len(_SEALED)
    (seal,) = _SEAL.unpack_from(packed, at)
    at += _SEAL.size
    if zlib.crc32(memoryview(packed)[at:]) != seal:
        raise DamagedState("a group's memory is damaged: its checksum differs")
    return at


_DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RecursionError,
    SyntaxError,  # invalid dtype of a column
    TypeError,
    ValueError,
)


def _memory(head: Mapping[str, Any], packed: bytes, at: int) -> Memory:
    found, alike, room = [], _Alike(), _ROOM + _DENSE * len(packed)
    for key, valves, arrays in head["columns"]:
        columns = {}
        for name, kind, shape, *compressed in arrays:
            dtype, n = np.dtype(kind), int(np.prod(shape, dtype=np.int64))
            if dtype.hasobject or n < 0 or len(shape) < 1 or shape[0] != len(valves):
                raise DamagedState(f"a group's memory is damaged: {name} of shape {shape}")
            room -= n * dtype.itemsize
            if room < 0:
                raise DamagedState("a group's memory is damaged: too large once it is decompressed")
            if compressed:
                (size,) = compressed
                columns[name] = _unpacked(packed[at : at + size], dtype, tuple(shape), alike)
                at += size
            else:
                columns[name] = np.frombuffer(packed, dtype, n, at).reshape(shape)
                at += n * dtype.itemsize
        found.append(Columns(str(key), tuple(map(str, valves)), columns))
    baselines = {}
    for valve, size in head["baselines"]:
        baselines[str(valve)] = packed[at : at + size]
        at += size
    if at != len(packed):
        raise DamagedState(f"a group's memory is damaged: {len(packed)} bytes, {at} expected")
    return Memory(
        int(head["catalogue"]),
        int(head["number"]),
        {str(name): int(t) for name, t in head["due"].items()},
        {str(name): int(n) for name, n in head["counts"].items()},
        found,
        baselines,
        [str(reply) for reply in head.get("replies", ())],
        tuple((int(number), int(t)) for number, t in head.get("ahead", ())),
    )


def _packed(array: NDArray[Any], alike: _Alike) -> tuple[bytes | memoryview, list[int]]:
    """Return an array as bytes, and their number if they are compressed."""
    whole = np.ascontiguousarray(array)
    if array.dtype.kind != _COUNTS or not array.size:
        return whole.reshape(-1).view(np.uint8).data, []
    kind = array.dtype.str, array.shape
    before = alike.get(kind)
    alike[kind] = whole
    packed = bytes(_CODEC.compress(whole if before is None else whole ^ before, asbytes=True))
    return packed, [len(packed)]


def _unpacked(
    packed: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], alike: _Alike
) -> NDArray[Any]:
    n = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    if n > _DENSEST * len(packed):
        raise DamagedState(f"a group's memory is damaged: {n} bytes of {len(packed)} compressed")
    differs = np.frombuffer(_CODEC.decompress(packed, n, asbytes=True), dtype).reshape(shape)
    kind = dtype.str, shape
    before = alike.get(kind)
    alike[kind] = differs if before is None else differs ^ before
    return alike[kind]
