"""All that a group remembers, as bytes: what a worker takes over from another.

A head in JSON says the format, the catalogue's version, the block and what columns follow; then the
columns themselves, one after the other, and the baselines.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from service.errors import FleetError
from service.streaming.valve_columns import Columns

MAGIC: Final = b"valvemap memory\n"
FORMAT: Final = 1
_SIZE: Final = struct.Struct("<Q")


@dataclass(frozen=True)
class Memory:
    """A group as it stands after a block.

    Attributes
    ----------
    catalogue
        Version of the catalogue that it was learnt under.
    number
        The last block that was learnt from.
    due
        By name: the source time, UTC ns, at which something is to be done next.
    counts
        By name: what came of the group's blocks.
    columns
        What the valves remember.
    baselines
        By valve: its approved map, packed.
    replies
        To the last commands, packed, the oldest first: one that comes again is not done again.
    """

    catalogue: int
    number: int
    due: Mapping[str, int]
    counts: Mapping[str, int]
    columns: Sequence[Columns]
    baselines: Mapping[str, bytes]
    replies: Sequence[str] = ()


def write_memory(memory: Memory) -> bytes:
    """Pack it.

    Examples
    --------
    >>> one = Columns("k", ("V1",), {"n": np.array([7.0])})
    >>> packed = write_memory(Memory(1, 12, {}, {}, [one], {}))
    >>> read_memory(packed).columns[0].arrays["n"]
    array([7.])
    """
    head = {
        "format": FORMAT,
        "catalogue": memory.catalogue,
        "number": memory.number,
        "due": dict(memory.due),
        "counts": dict(memory.counts),
        "columns": [
            [
                columns.key,
                columns.valves,
                [[name, a.dtype.str, a.shape] for name, a in columns.arrays.items()],
            ]
            for columns in memory.columns
        ],
        "replies": list(memory.replies),
        "baselines": [[valve, len(packed)] for valve, packed in memory.baselines.items()],
    }
    said = json.dumps(head).encode()
    arrays = (array for columns in memory.columns for array in columns.arrays.values())
    body = (array.tobytes() for array in arrays)
    return b"".join((MAGIC, _SIZE.pack(len(said)), said, *body, *memory.baselines.values()))


def read_memory(packed: bytes) -> Memory:
    """Unpack it; the columns are views that cannot be written to.

    Raises
    ------
    FleetError
        if it is none, damaged, or of another format.
    """
    start = len(MAGIC) + _SIZE.size
    if not packed.startswith(MAGIC) or len(packed) < start:
        raise FleetError("not a group's memory")
    (size,) = _SIZE.unpack_from(packed, len(MAGIC))
    try:
        head = json.loads(packed[start : start + size])
        if head["format"] != FORMAT:
            raise FleetError(f"a memory of format {head['format']}, this one knows {FORMAT}")
        return _memory(head, packed, start + size)
    except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise FleetError(f"a group's memory is damaged: {error}") from None


def _memory(head: Mapping[str, Any], packed: bytes, at: int) -> Memory:
    found = []
    for key, valves, arrays in head["columns"]:
        columns = {}
        for name, kind, shape in arrays:
            dtype, n = np.dtype(kind), int(np.prod(shape, dtype=np.int64))
            if dtype.hasobject or n < 0 or len(shape) < 1 or shape[0] != len(valves):
                raise FleetError(f"a group's memory is damaged: {name} of shape {shape}")
            columns[name] = np.frombuffer(packed, dtype, n, at).reshape(shape)
            at += n * dtype.itemsize
        found.append(Columns(str(key), tuple(map(str, valves)), columns))
    baselines = {}
    for valve, size in head["baselines"]:
        baselines[str(valve)] = packed[at : at + size]
        at += size
    if at != len(packed):
        raise FleetError(f"a group's memory is damaged: {len(packed)} bytes, {at} expected")
    return Memory(
        int(head["catalogue"]),
        int(head["number"]),
        {str(name): int(t) for name, t in head["due"].items()},
        {str(name): int(n) for name, n in head["counts"].items()},
        found,
        baselines,
        [str(reply) for reply in head.get("replies", ())],
    )
