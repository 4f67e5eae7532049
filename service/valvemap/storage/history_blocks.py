"""Blocks of the history: successive rows of a series, one column per part.

A loose block has the rows of one or some saves. Once a series has enough, they become a sealed
block, whose columns are packed (`packing`), and count in the tiers (`history_cells`).
"""

import sqlite3
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.storage.packing import (
    MOST_ROWS,
    is_packed,
    others_of,
    pack_doubles,
    pack_integers,
    rows_of,
    unpack_doubles,
    unpack_integers,
)

T: Final = "t"
CODES: Final = "codes"
BYTES_OF_VALUE: Final = 8  # of columns that are not packed, except times and codes
MOST_RELATED: Final = 12  # columns; all pairs of more are not tried, the time grows with the cube
SEALED: Final = "#"  # ends the name of a series of sealed blocks

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
        Valid columns as stored; empty without times and codes.
    columns
        The same as arrays (n,).
    damaged
        Names of damaged columns.
    """

    t: Times
    parts: Mapping[str, bytes]
    columns: Mapping[str, NDArray[Any]]
    damaged: tuple[str, ...]

    @classmethod
    def none(cls, parts: Parts | None = None) -> Self:
        """Return the result for a block without any valid part."""
        return cls(np.empty(0, np.int64), {}, {}, tuple(parts or ()))


def base_of(series: str) -> str:
    """Return the name of a series without the mark of sealed blocks."""
    return series.removesuffix(SEALED)


def examine(series: str, parts: Parts) -> Examined:
    """Check the checksum of every column of a series' block, and that all have as many rows."""
    series = base_of(series)
    t: Times = _unpacked(parts[T], series, T) if T in parts else np.empty(0, np.int64)
    if not len(t) or (np.diff(t) <= 0).any():
        return Examined.none(parts)
    first, columns = int(t[0]), dict[str, NDArray[Any]]()
    alone = {name: part for name, part in parts.items() if not _follows_from(part[1])}
    for some in (alone, {name: part for name, part in parts.items() if name not in alone}):
        known = dict(columns)  # a column follows from columns that stand alone
        for name, part in some.items():
            found = _unpacked(part, series, name, first, known)
            if len(found) == len(t):
                columns[name] = found
    if CODES not in columns:
        return Examined.none(parts)
    whole = {name: data for name, (_, data) in parts.items() if name in columns}
    return Examined(t, whole, columns, tuple(name for name in parts if name not in columns))


def _follows_from(data: object) -> tuple[str, ...]:
    """Return the columns from which one follows; none if it is damaged."""
    try:
        return others_of(data) if isinstance(data, bytes) and is_packed(data) else ()
    except ValueError:
        return ()


def missing_in(parts: Parts) -> tuple[str, ...]:
    """Return the columns that are needed to unpack the given ones, and are not among them."""
    needed = {other for _, data in parts.values() for other in _follows_from(data)}
    return tuple(sorted(needed - parts.keys()))


def checksum(data: bytes, series: str, name: str, first: int) -> int:
    """Return the checksum of a packed column.

    It covers series, column and ``first``, the first time of the block (not for the times).
    """
    whose = f"{series}\n{name}\n{0 if name == T else first}"
    return zlib.crc32(data, zlib.crc32(whose.encode("utf-8", "replace")))


def _unpacked(
    part: tuple[object, object],
    series: str,
    name: str,
    first: int = 0,
    others: Mapping[str, NDArray[Any]] | None = None,
) -> NDArray[Any]:
    """Unpack a column; no rows if it is damaged. Checksums of version 1 do not include the name."""
    digest, data = part
    if not isinstance(data, bytes) or digest not in (
        checksum(data, series, name, first),
        zlib.crc32(data),
    ):
        return np.empty(0)
    try:
        return unpack(name, data, others)
    except (zlib.error, ValueError):  # zeros have checksum 0
        return np.empty(0)


def pack(name: str, column: NDArray[Any]) -> bytes:
    """Return a column of a loose block: times (as differences) and codes are compressed."""
    if name == T:
        return zlib.compress(np.diff(column, prepend=np.int64(0)).astype("<i8").tobytes(), 1)
    if name == CODES:
        return zlib.compress(column.astype("<u4").tobytes(), 1)
    return column.astype("<f8").tobytes()


def pack_sealed(columns: Mapping[str, NDArray[Any]]) -> dict[str, bytes]:
    """Return the columns of a sealed block; among few columns some may follow from others."""
    packed, alone = dict[str, bytes](), dict[str, NDArray[Any]]()
    few = len(columns) <= MOST_RELATED
    for name, column in columns.items():
        if name in {T, CODES}:
            packed[name] = pack_integers(column.astype(np.int64))
            continue
        packed[name] = pack_doubles(column, alone)
        if few and not others_of(packed[name]):
            alone[name] = column
    return packed


def unpack(
    name: str, data: bytes | None, others: Mapping[str, NDArray[Any]] | None = None
) -> NDArray[Any]:
    """Return a column; no rows from empty bytes. ``others`` are columns it may follow from.

    Raises
    ------
    ValueError, zlib.error
        if it is damaged.
    """
    if data is None:
        return np.empty(0)
    if is_packed(data):
        if name in {T, CODES}:
            return unpack_integers(data).astype(np.int64 if name == T else np.uint32)
        known = others or {}
        return unpack_doubles(data, lambda other: known.get(other, np.empty(0)))
    if name == T:
        return np.cumsum(np.frombuffer(_inflated(data), "<i8"))
    if name == CODES:
        return np.frombuffer(_inflated(data), "<u4")
    return np.frombuffer(data, "<f8")


def rows_in(data: object) -> int:
    """Return how many rows a column of values seems to have, also if it is damaged."""
    if not isinstance(data, bytes):
        return 0
    try:
        return rows_of(data) if is_packed(data) else len(data) // BYTES_OF_VALUE
    except ValueError:
        return len(data) // BYTES_OF_VALUE


def _inflated(data: bytes) -> bytes:
    """Decompress a column; raise ValueError if it has more rows than a block may."""
    inflating = zlib.decompressobj()
    found = inflating.decompress(data, BYTES_OF_VALUE * MOST_ROWS)
    if not inflating.eof:
        raise ValueError("cut short, or longer than any block")
    return found


def chosen(found: Examined, rows: NDArray[np.bool_]) -> Examined:
    """Return the chosen rows of a block, in the form of the block."""
    if rows.all():
        return found
    columns = {name: column[rows] for name, column in found.columns.items()}
    sealed = is_packed(found.parts.get(T, b""))
    parts = pack_sealed(columns) if sealed else {n: pack(n, c) for n, c in columns.items()}
    return Examined(found.t[rows], parts, columns, found.damaged)


def insert(
    connection: sqlite3.Connection,
    series: str,
    t: Times,
    parts: Mapping[str, bytes],
    number: Callable[[str], int],
    id_: int,
) -> int:
    """Write a block under a number; return it. ``number`` returns the number of a name."""
    first, base = int(t[0]), base_of(series)
    row = id_, number(series), first, int(t[-1]), len(t)
    connection.execute(_BLOCK, row)
    packed = [
        (id_, number(name), checksum(data, base, name, first), data) for name, data in parts.items()
    ]
    connection.executemany(_PART, packed)
    return id_
