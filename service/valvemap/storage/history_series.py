"""Writes the series of a history: loose blocks, sealed blocks and their tiers; drops the oldest."""

import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Flags, Times
from valvemap.pipeline.store_ports import Piece
from valvemap.storage.history_blocks import (
    CODES,
    SEALED,
    Examined,
    T,
    base_of,
    chosen,
    examine,
    insert,
    missing_in,
    pack,
    pack_sealed,
)
from valvemap.storage.history_cells import WIDTHS, cells_of, merged, overlapping, tier_of
from valvemap.storage.history_rows import Rows, by_time
from valvemap.storage.history_write_states import BLOCK, CELLS, WriteState, series_of_file

MOST_LOOSE: Final = 64  # blocks of a series; beyond it they are joined
MOST_SMALL: Final = 16  # blocks of a tier; beyond it they are joined
_OVERLAPPING = "SELECT id FROM block WHERE series IN (?, ?) AND first <= ? AND last >= ?"
_NEWEST = (
    "SELECT ifnull((SELECT max(id) FROM block), 0), ifnull((SELECT max(block) FROM written), 0)"
)
_PENDING = "SELECT id, series FROM block WHERE id > ? AND rows >= ? AND series IN ({}) ORDER BY id"


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
    damaged_tiers : set
        Series whose tiers lost cells, to be computed again.
    """

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._writer = connection
        self.lost = 0
        self.damaged_tiers = set[str]()
        self.names: dict[str, int] = {}
        self._series: dict[str, WriteState] = {}
        self._newest = 0
        self.reload()

    def reload(self) -> None:
        """Load names and series from the file."""
        self.names = dict(self._writer.execute("SELECT name, id FROM name").fetchall())
        self.reload_series()

    def reload_series(self) -> None:
        """Load the series from the file."""
        self._newest = max(self._newest, *self._writer.execute(_NEWEST).fetchone())
        self._series = series_of_file(self._writer, self.names)

    def append(self, piece: Piece) -> int:
        """Write a piece as a loose block; seal the loose blocks when they fill a large one."""
        series = self._series.setdefault(piece.series, WriteState())
        own = by_time(piece)
        late = own.t <= series.last
        if late.any():
            own = own[~self._is_known(series, own, late)]
        t = own.t
        if len(t):
            columns: dict[str, NDArray[Any]] = {T: t, CODES: own.codes, **own.columns}
            series.small[self._insert(piece.series, columns)] = len(t)
            series.last = max(series.last, int(t[-1]))
            if series.rows >= BLOCK:
                self._seal(piece.series, self._taken(piece.series, series))
            elif len(series.small) > MOST_LOOSE:
                joined = self._taken(piece.series, series)
                if joined:
                    series.small[self._insert(piece.series, joined)] = len(joined[T])
        return int((len(piece.t) - len(t)) * len(piece.columns))

    def seal_pending(self, after: int) -> int | None:
        """Seal the next full block that is still loose; return its number, None if there is none.

        Such blocks are those of older files, and those whose tiers are computed again.
        """
        loose = [self.names[name] for name in self._owners() if SEALED not in name]
        select = _PENDING.format(", ".join("?" * len(loose)))
        found = self._writer.execute(f"{select} LIMIT 1", (after, BLOCK, *loose)).fetchone()
        if found is None:
            return None
        block, number = found
        series = next(name for name, own in self.names.items() if own == number)
        examined = self.examined(self._writer, series, block)
        self._delete([block])
        self.lost += len(examined.t) if examined.damaged else 0
        if len(examined.t):
            self._seal(series, examined.columns, id_=block)
        return int(block)

    def reset_tiers(self, series: str) -> None:
        """Have the tiers of a series computed again from the values that remain."""
        sealed, loose = self.number(base_of(series) + SEALED), self.number(base_of(series))
        self._writer.execute("UPDATE block SET series = ? WHERE series = ?", (loose, sealed))
        select = "SELECT first, last FROM block WHERE series = ? ORDER BY first"
        spans = np.array(self._writer.execute(select, (loose,)).fetchall(), np.int64).reshape(-1, 2)
        for width in WIDTHS:
            tier = tier_of(series, width)
            number = self.number(tier)
            blocks = self._writer.execute("SELECT id FROM block WHERE series = ?", (number,))
            for (block,) in blocks.fetchall():
                found = self.examined(self._writer, tier, block)
                kept = chosen(found, ~overlapping(found.t, width, spans))
                if len(kept.t) == len(found.t) and len(kept.t):
                    continue
                self._delete([block])
                if len(kept.t):
                    self._add(tier, kept.t, kept.parts, block)
        self.reload_series()

    def reset_all_tiers(self) -> None:
        """Have the tiers of all series computed again, see `reset_tiers`."""
        for series in {name.partition(SEALED)[0] for name in self._owners()}:
            self.reset_tiers(series)

    def _owners(self) -> list[str]:
        """Return the names of all series that have a block."""
        names = {number: name for name, number in self.names.items()}
        found = self._writer.execute("SELECT DISTINCT series FROM block").fetchall()
        return [names[number] for (number,) in found if number in names]

    def _seal(
        self, series: str, columns: Mapping[str, NDArray[Any]], id_: int | None = None
    ) -> None:
        """Write rows as a sealed block, and add their cells to the tiers."""
        if not columns:
            return
        parts = pack_sealed(columns)
        self._add(base_of(series) + SEALED, columns[T], parts, id_)
        for width in WIDTHS:
            self._add_cells(tier_of(series, width), cells_of(columns, width))

    def _add_cells(self, tier: str, cells: Mapping[str, NDArray[Any]]) -> None:
        own = self._series.setdefault(tier, WriteState())
        block = self._add(tier, cells[T], pack_sealed(cells))
        own.small[block] = len(cells[T])
        if own.rows < CELLS and len(own.small) <= MOST_SMALL:
            return
        examined = [self.examined(self._writer, tier, block) for block in own.small]
        whole = [found.columns for found in examined if len(found.t) and not found.damaged]
        self._delete(list(own.start_anew()))
        if len(whole) < len(examined):
            self.damaged_tiers.add(base_of(tier.rpartition(SEALED)[0]))
        if not whole:
            return
        joined = merged(whole)
        block = self._add(tier, joined[T], pack_sealed(joined))
        if len(joined[T]) < CELLS:
            own.small[block] = len(joined[T])

    def _is_known(self, series: WriteState, own: Rows, late: Flags) -> Flags:
        """Return which rows are stored already (n,); count those of whose time others are stored.

        A row at the last time of its series is a repetition, whatever its values.
        """
        known, others = np.zeros((2, len(own.t)), np.bool_)
        span = int(own.t[late][-1]), int(own.t[late][0])
        both = self.number(own.series), self.number(own.series + SEALED)
        for (block,) in self._writer.execute(_OVERLAPPING, (*both, *span)).fetchall():
            stored = self.examined(self._writer, own.series, block)
            if len(stored.t):
                place = np.minimum(np.searchsorted(stored.t, own.t), len(stored.t) - 1)
                there = late & (stored.t[place] == own.t)
                known |= there
                others |= there & own.differs(stored.columns, place)
        self.lost += int((others & (own.t < series.last)).sum())
        return known

    def _insert(self, series: str, columns: Mapping[str, NDArray[Any]]) -> int:
        parts = {name: pack(name, column) for name, column in columns.items()}
        return self._add(series, columns[T], parts)

    def _add(
        self, series: str, t: Times, parts: Mapping[str, bytes], id_: int | None = None
    ) -> int:
        """Write a block; numbers are not used again, since age goes by them."""
        if id_ is None:
            self._newest += 1
            id_ = self._newest
        return insert(self._writer, series, t, parts, self.number, id_)

    def _taken(self, name: str, series: WriteState) -> dict[str, NDArray[Any]]:
        """Delete a series' loose blocks; return their rows, with NaN for columns they lack."""
        examined = [self.examined(self._writer, name, block) for block in series.small]
        blocks = [found for found in examined if len(found.t)]
        columns = {
            column: np.concatenate(
                [
                    found.columns[column]
                    if column in found.columns
                    else np.full(len(found.t), np.nan)
                    for found in blocks
                ]
            )
            for column in dict.fromkeys(column for found in blocks for column in found.columns)
        }
        self.lost += sum(len(found.t) for found in blocks if found.damaged)
        self.lost += series.rows - sum(len(found.t) for found in blocks)
        self._delete(list(series.start_anew()))
        if not columns:
            return {}
        order = np.argsort(columns[T], kind="stable")
        return {column: rows[order] for column, rows in columns.items()}

    def drop(self, up_to: int, series: Iterable[int]) -> int:
        """Drop the blocks of some series up to a number; return their number."""
        numbers = list(series)
        select = (
            f"SELECT id FROM block WHERE id <= ? AND series IN ({', '.join('?' * len(numbers))})"  # noqa: S608
        )
        old = [id_ for (id_,) in self._writer.execute(select, (up_to, *numbers))]
        self._delete(old)
        return len(old)

    def drop_oldest(self, excess: int, shares: Sequence[tuple[Iterable[int], int]]) -> int:
        """Drop blocks that together hold the given number of bytes; return their number.

        ``shares``: of each group of series, in this order, the oldest blocks are dropped until the
        group holds that number of bytes.
        """
        held = self._writer.execute(
            "SELECT block.id, series, sum(length(data)) FROM block "
            "JOIN part ON part.block = block.id GROUP BY block.id ORDER BY block.id"
        ).fetchall()
        oldest = dict[int, None]()
        for group, least in shares:
            numbers = frozenset(group)
            own = [(id_, size) for id_, series, size in held if series in numbers]
            left = sum(size for id_, size in own if id_ not in oldest)
            for id_, size in own:
                if excess <= 0 or left <= least:
                    break
                if id_ not in oldest:
                    oldest[id_] = None
                    excess, left = excess - size, left - size
        self._delete(list(oldest))
        return len(oldest)

    def _delete(self, blocks: Sequence[int]) -> None:
        gone = set(blocks)
        for series in self._series.values():
            for block in gone & series.small.keys():
                del series.small[block]
        rows = [(block,) for block in blocks]
        self._writer.executemany("DELETE FROM part WHERE block = ?", rows)
        self._writer.executemany("DELETE FROM block WHERE id = ?", rows)

    def number(self, name: str) -> int:
        """Return the number of a name, a new one if it has none."""
        if name not in self.names:
            insert = self._writer.execute("INSERT INTO name (name) VALUES (?)", (name,))
            self.names[name] = int(insert.lastrowid or 0)
        return int(self.names[name])

    def examined(
        self, connection: sqlite3.Connection, series: str, block: int, columns: Sequence[str] = ()
    ) -> Examined:
        """Return the columns of a block with valid checksums; all, or the given ones.

        Columns from which a given one follows are returned, too.
        """
        parts = self._parts(connection, block, columns)
        if columns and (needed := missing_in(parts)):
            parts |= self._parts(connection, block, needed)
        return examine(series, parts)

    def _parts(
        self, connection: sqlite3.Connection, block: int, columns: Sequence[str]
    ) -> dict[str, tuple[int, bytes]]:
        chosen = [name for name in columns or self.names if name in self.names]
        numbers = {self.names[name]: name for name in chosen}
        which = f"AND name IN ({', '.join('?' * len(numbers))})" if columns else ""
        select = f"SELECT name, digest, data FROM part WHERE block = ? {which}"  # noqa: S608
        rows = connection.execute(select, (block, *(numbers if columns else ()))).fetchall()
        return {numbers[n]: (digest, data) for n, digest, data in rows if n in numbers}
