"""Writes the series of a history as blocks, joins small blocks, and drops the oldest."""

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Flags
from valvemap.pipeline.ports import Piece
from valvemap.storage.history_blocks import CODES, Examined, T, examine, insert, pack, unpack
from valvemap.storage.history_mending import Taken
from valvemap.storage.history_rows import Rows, by_time

BLOCK: Final = 4_096  # rows of a full block: 41 s at 100 Hz, 32 kB per column
_SMALL = """
    SELECT id, rows FROM block WHERE series = :series AND id > ifnull(
        (SELECT max(id) FROM block WHERE series = :series AND rows >= :full), -9223372036854775808
    ) ORDER BY id
"""  # blocks written after the last full one

_OVERLAPPING = "SELECT id FROM block WHERE series = ? AND first <= ? AND last >= ?"


@dataclass
class _Series:
    """The write state of a series: its number, its last row and its small blocks."""

    number: int
    last: int
    small: list[int] = field(default_factory=list)
    rows: int = 0


class SeriesWriter:
    """The series of one open file, written within the caller's transactions.

    Parameters
    ----------
    connection
        The writing connection to the file.

    Attributes
    ----------
    names : dict
        Numbers of series and columns.
    lost : int
        Rows left out because others of their time are stored, or found damaged when joined.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._writer = connection
        self.lost = 0
        self.names: dict[str, int] = {}
        self._series: dict[str, _Series] = {}
        self.reload()

    def reload(self) -> None:
        """Load names and series from the file."""
        self.names = dict(self._writer.execute("SELECT name, id FROM name").fetchall())
        self.reload_series()

    def reload_series(self) -> None:
        """Load the series from the file."""
        self._series = self._known_series()

    def append(self, piece: Piece) -> int:
        """Write a piece as a block, and join small blocks when they fill a large one."""
        series = self._series.get(piece.series)
        if series is None:
            series = self._series[piece.series] = _Series(self.number(piece.series), -(2**63))
        own = by_time(piece)
        late = own.t <= series.last
        if late.any():
            own = own[~self._is_known(series, own, late)]
        t = own.t
        if len(t):
            columns: dict[str, NDArray[Any]] = {T: t, CODES: own.codes, **own.columns}
            series.small.append(self._insert(piece.series, columns))
            series.last, series.rows = max(series.last, int(t[-1])), series.rows + len(t)
            if series.rows >= BLOCK:
                self._join(piece.series, series)
        return int((len(piece.t) - len(t)) * len(piece.columns))

    def _is_known(self, series: _Series, own: Rows, late: Flags) -> Flags:
        """Return which rows are stored already (n,); count those of whose time others are stored.

        A row at the last time of its series is a repetition, whatever its values.
        """
        known, others = np.zeros((2, len(own.t)), np.bool_)
        span = int(own.t[late][-1]), int(own.t[late][0])
        for (block,) in self._writer.execute(_OVERLAPPING, (series.number, *span)).fetchall():
            stored = self.examined(self._writer, own.series, block)
            if len(stored.t):
                place = np.minimum(np.searchsorted(stored.t, own.t), len(stored.t) - 1)
                there = late & (stored.t[place] == own.t)
                known |= there
                others |= there & own.differs(stored.parts, place)
        self.lost += int((others & (own.t < series.last)).sum())
        return known

    def _insert(self, series: str, columns: Mapping[str, NDArray[Any]]) -> int:
        parts = {name: pack(name, column) for name, column in columns.items()}
        return insert(self._writer, series, columns[T], parts, self.number)

    def _join(self, name: str, series: _Series) -> None:
        """Join a series' small blocks to one; rows without a column have NaN in it."""
        examined = [self.examined(self._writer, name, block) for block in series.small]
        blocks = [found for found in examined if len(found.t)]
        columns = {
            column: np.concatenate(
                [
                    unpack(column, found.parts[column])
                    if column in found.parts
                    else np.full(len(found.t), np.nan)
                    for found in blocks
                ]
            )
            for column in dict.fromkeys(column for found in blocks for column in found.parts)
        }
        self.lost += sum(len(found.t) for found in blocks if found.damaged)
        self.lost += series.rows - sum(len(found.t) for found in blocks)
        self._delete(series.small)
        series.small, series.rows = [], 0
        if columns:
            order = np.argsort(columns[T], kind="stable")
            self._insert(name, {column: rows[order] for column, rows in columns.items()})

    def drop(self, condition: str, values: tuple[int, ...]) -> int:
        """Drop the blocks of a condition in SQL; return their number."""
        select = f"SELECT id FROM block WHERE {condition}"  # noqa: S608 - constant
        old = [id_ for (id_,) in self._writer.execute(select, values)]
        self._delete(old)
        return len(old)

    def drop_oldest(self, excess: int) -> int:
        """Drop the oldest blocks that together hold the given number of bytes."""
        held = self._writer.execute(
            "SELECT block.id, sum(length(data)) FROM block JOIN part ON part.block = block.id "
            "GROUP BY block.id ORDER BY block.id"
        )
        oldest = []
        for id_, size in held:
            if excess <= 0:
                break
            oldest.append(id_)
            excess -= size
        self._delete(oldest)
        return len(oldest)

    def _delete(self, blocks: Sequence[int]) -> None:
        gone = set(blocks)
        for series in self._series.values():
            if gone & set(series.small):
                series.small = [block for block in series.small if block not in gone]
        rows = [(block,) for block in blocks]
        self._writer.executemany("DELETE FROM part WHERE block = ?", rows)
        self._writer.executemany("DELETE FROM block WHERE id = ?", rows)

    def _known_series(self) -> dict[str, _Series]:
        """Return the write state of every series in the file."""
        names = {number: name for name, number in self.names.items()}
        found = {}
        last = "SELECT series, max(last) FROM block GROUP BY series"
        for number, newest in self._writer.execute(last).fetchall():
            series = found[names[number]] = _Series(number, newest)
            for block, rows in self._writer.execute(_SMALL, {"series": number, "full": BLOCK}):
                series.small.append(block)
                series.rows += rows
        return found

    def number(self, name: str) -> int:
        """Return the number of a name, a new one if it has none."""
        if name not in self.names:
            insert = self._writer.execute("INSERT INTO name (name) VALUES (?)", (name,))
            self.names[name] = int(insert.lastrowid or 0)
        return int(self.names[name])

    def resume_after(self, taken: Taken) -> None:
        """Continue a series after a block copied from a damaged file."""
        series = self._series.setdefault(
            taken.series, _Series(self.number(taken.series), taken.last)
        )
        series.last = max(series.last, taken.last)

    def examined(
        self, connection: sqlite3.Connection, series: str, block: int, columns: Sequence[str] = ()
    ) -> Examined:
        """Return the columns of a block with valid checksums; all, or the given ones."""
        numbers = {self.names[name]: name for name in columns or self.names}
        chosen = f"AND name IN ({', '.join('?' * len(columns))})" if columns else ""
        select = f"SELECT name, digest, data FROM part WHERE block = ? {chosen}"  # noqa: S608
        rows = connection.execute(select, (block, *(numbers if columns else ()))).fetchall()
        parts = {numbers[n]: (digest, data) for n, digest, data in rows if n in numbers}
        return examine(series, parts)
