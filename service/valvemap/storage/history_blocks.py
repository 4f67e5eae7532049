"""Blocks of the history: successive rows of a series, one packed column per part."""

import sqlite3
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times

T: Final = "t"
CODES: Final = "codes"
BYTES_OF_VALUE: Final = 8  # of all columns except times and codes, which are packed
MOST_ROWS: Final = 1 << 21  # of a block; a save has at most a million, joined to small blocks

_BLOCK = "INSERT INTO block (id, series, first, last, rows) VALUES (?, ?, ?, ?, ?)"
_PART = "INSERT INTO part (block, name, digest, data) VALUES (?, ?, ?, ?)"

Parts = Mapping[str, tuple[int, bytes]]
"""Packed columns by name, each with its checksum."""


@dataclass(frozen=True)
class Examined:
    """The parts of a block with valid checksums.

    Attributes
    ----------
    t : (n,)
        Times of the rows, UTC ns; empty if times or codes are damaged.
    parts
        Valid packed columns; empty without times and codes.
    damaged
        Names of damaged columns.
    """

    t: Times
    parts: Mapping[str, bytes]
    damaged: tuple[str, ...]

    @classmethod
    def none(cls, parts: Parts | None = None) -> Self:
        """Return the result for a block without any valid part."""
        return cls(np.empty(0, np.int64), {}, tuple(parts or ()))


def examine(series: str, parts: Parts) -> Examined:
    """Check the checksum of every column of a series' block, and that all have as many rows."""
    t: Times = _unpacked(parts[T], series, T) if T in parts else np.empty(0, np.int64)
    if not len(t) or (np.diff(t) <= 0).any():
        return Examined.none(parts)
    first = int(t[0])
    whole = {
        name: data
        for name, (digest, data) in parts.items()
        if len(_unpacked((digest, data), series, name, first)) == len(t)
    }
    if CODES not in whole:
        return Examined.none(parts)
    return Examined(t, whole, tuple(name for name in parts if name not in whole))


def checksum(data: bytes, series: str, name: str, first: int) -> int:
    """Return the checksum of a packed column.

    It covers series, column and ``first``, the first time of the block (not for the times).
    """
    whose = f"{series}\n{name}\n{0 if name == T else first}"
    return zlib.crc32(data, zlib.crc32(whose.encode("utf-8", "replace")))


def _unpacked(part: tuple[object, object], series: str, name: str, first: int = 0) -> NDArray[Any]:
    """Unpack a column; no rows if it is damaged. Checksums of version 1 do not include the name."""
    digest, data = part
    if not isinstance(data, bytes) or digest not in (
        checksum(data, series, name, first),
        zlib.crc32(data),
    ):
        return np.empty(0)
    try:
        return unpack(name, data)
    except (zlib.error, ValueError):  # zeros have checksum 0
        return np.empty(0)


def pack(name: str, column: NDArray[Any]) -> bytes:
    """Pack a column: times (as differences) and codes are compressed, values are not."""
    if name == T:
        return zlib.compress(np.diff(column, prepend=np.int64(0)).astype("<i8").tobytes(), 1)
    if name == CODES:
        return zlib.compress(column.astype("<u4").tobytes(), 1)
    return column.astype("<f8").tobytes()


def unpack(name: str, data: bytes | None) -> NDArray[Any]:
    """Return a column from its packed form; no rows from empty bytes."""
    if data is None:
        return np.empty(0)
    if name == T:
        return np.cumsum(np.frombuffer(_inflated(data), "<i8"))
    if name == CODES:
        return np.frombuffer(_inflated(data), "<u4")
    return np.frombuffer(data, "<f8")


def _inflated(data: bytes) -> bytes:
    """Decompress a column; raise ValueError if it has more rows than a block may."""
    inflating = zlib.decompressobj()
    found = inflating.decompress(data, BYTES_OF_VALUE * MOST_ROWS)
    if not inflating.eof:
        raise ValueError("cut short, or longer than any block")
    return found


def without(t: Times, found: Examined) -> Examined:
    """Return the rows at other times than these, UTC ns."""
    other = ~np.isin(found.t, t)
    if other.all():
        return found
    parts = {name: pack(name, unpack(name, data)[other]) for name, data in found.parts.items()}
    return Examined(found.t[other], parts, found.damaged)


def insert(
    connection: sqlite3.Connection,
    series: str,
    t: Times,
    parts: Mapping[str, bytes],
    number: Callable[[str], int],
    *,
    id_: int | None = None,
) -> int:
    """Write a block; return its number, by default the next one.

    ``number`` returns the number of a name.
    """
    first = int(t[0])
    row = id_, number(series), first, int(t[-1]), len(t)
    block = connection.execute(_BLOCK, row).lastrowid
    assert block is not None  # noqa: S101 - a row was inserted
    packed = [
        (block, number(name), checksum(data, series, name, first), data)
        for name, data in parts.items()
    ]
    connection.executemany(_PART, packed)
    return block
