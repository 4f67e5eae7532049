"""The history of signals and results in one SQLite file: columns in blocks of successive rows."""

import sqlite3
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Flags
from valvemap.pipeline.ports import AlarmChange, Past, Piece
from valvemap.storage import alarm_changes, history_age
from valvemap.storage.closing import Closing
from valvemap.storage.history_blocks import CODES, Examined, T, examine, insert, pack, unpack
from valvemap.storage.history_mending import Taken, check_blocks, take_over
from valvemap.storage.history_order import in_order, joined, nothing
from valvemap.storage.history_rows import Rows, by_time
from valvemap.storage.history_schema import CHECKED_AT_ONCE, check_pages, prepare
from valvemap.storage.sqlite_files import (
    SALVAGING,
    is_damage,
    move_aside,
    name_aside,
    naming,
    pragma,
    text,
    transaction,
)

BLOCK: Final = 4_096  # rows of a full block: 41 s at 100 Hz, 32 kB per column
AT_START_S: Final = 1.0  # s; time for checks and copies during the start
IN_TURN_S: Final = 0.1  # s; time for the remaining ones after each save, once a second
AGAIN_S: Final = 60.0  # s; shortest time between two files set aside
_PAGES_AT_ONCE = 1_000  # freed in one step
_SMALL = """
    SELECT id, rows FROM block WHERE series = :series AND id > ifnull(
        (SELECT max(id) FROM block WHERE series = :series AND rows >= :full), -9223372036854775808
    ) ORDER BY id
"""  # blocks written after the last full one

_OVERLAPPING = "SELECT id FROM block WHERE series = ? AND first <= ? AND last >= ?"

Result = TypeVar("Result")


@dataclass
class _Series:
    """The write state of a series: its number, its last row and its small blocks."""

    number: int
    last: int
    small: list[int] = field(default_factory=list)
    rows: int = 0


class HistoryFile(Closing):
    """Stores pieces of series and reads them back.

    A series is a table of rows: a time, a status code and value columns. Rows may come late: they
    are read in order of time. A row that is stored already is left out; one that differs from the
    stored row of its time is left out and counted as lost. A save is
    one transaction, so a kill loses only unsaved rows. Small blocks are joined, so that a day at
    100 Hz is 211 blocks.

    A damaged file never stops the service. If its structure is damaged, the file is set aside under
    a name with its time, and its readable blocks are copied to a new file. If a column is damaged,
    the column is dropped. Lost rows are counted. Both repairs proceed a little with each save, so
    that a large file delays neither start nor saves.

    May be used from any thread, by one at a time; readers do not wait for the writer.

    Parameters
    ----------
    path
        The file; it and its folder are created if missing.
    keep_s
        Age at which rows are dropped, block by block, s; rows age while the file is open.
    most_bytes
        Maximum size of the file; the oldest blocks are dropped first.
    mends
        Whether to repair damage, which only the owner of the file may do; else it raises
        StorageError.
    clock
        Returns seconds; limits the time spent on repairs.

    Attributes
    ----------
    size : int
        Bytes in use after the last save; reading it needs no disk access.
    lost : int
        Rows known to be lost by damage; a row with one lost column is included.

    Raises
    ------
    StorageError
        from every method, in one line that names the file.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "history.sqlite"
    >>> good = np.zeros(2, np.uint32)
    >>> with HistoryFile(path) as store:
    ...     piece = Piece("V1.Signals", np.array([1, 2]), good, {"Q": np.array([5.0, 6.0])})
    ...     _ = store.save([piece])
    ...     store.read("V1.Signals", "Q", 0, 9, most=9).values
    array([5., 6.])
    """

    def __init__(
        self,
        path: str | Path,
        keep_s: float = 7 * 86_400.0,
        most_bytes: int = 2_000_000_000,
        *,
        mends: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = Path(path)
        self.lost = 0
        self._keep_s, self._most_bytes = keep_s, most_bytes
        self._writing, self._reading = Lock(), Lock()
        self._mends, self._clock = mends, clock
        self._notes: list[str] = []
        self._opened, self._damaged_at = 0, -np.inf
        self._pages_checked = self._is_open = False
        self._chores: Generator[None] = _no_chores()
        self._recounted = 0  # rows of unfinished files set aside that `lost` holds
        self._finished: list[Path] = []
        with naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._open()
            except sqlite3.DatabaseError as error:
                self._mend(error)
            self._work(AT_START_S if self._pages_checked else IN_TURN_S)
            self.size = self._bytes()

    def save(self, pieces: Iterable[Piece]) -> int:
        """Store all pieces or none; return how many values were left out as stored already."""
        return self._write(lambda: sum([self._append(piece) for piece in pieces]))

    def read(
        self,
        series: str,
        column: str,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> Past:
        """Return rows from ``low`` to ``high`` (UTC ns, both included) after ``skip`` others."""

        def find() -> Past:
            if not self._names.keys() >= {series, column, T, CODES}:
                return nothing()
            found, wanted = [], skip + most
            number = self._names[series]
            blocks = (
                (first, last, self._rows_between(block, series, column, low, high))
                for block, first, last in self._blocks(number, low, high, backwards=backwards)
            )
            for rows in in_order(blocks, backwards=backwards):
                found.append(rows)
                wanted -= len(rows.t)
                if wanted <= 0:
                    break
            return joined(found)[skip : skip + most]

        return self._ask(find)

    def note(self, changes: Sequence[AlarmChange]) -> None:
        """Store changes of alarms; skip those already stored."""
        self._write(lambda: alarm_changes.insert(self._writer, changes))

    def changes(
        self,
        owner: str | None,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> list[AlarmChange]:
        """Return changes of an owner's alarms (None: of all), from ``low`` to ``high``."""
        return self._ask(
            lambda: alarm_changes.select(
                self._reader, owner, (low, high), backwards=backwards, skip=skip, most=most
            )
        )

    def forget(self) -> int:
        """Drop blocks that are too old or exceed the size, in the order in which they were written.

        A block's age is the time that the file was open since it was written: a clock that steps
        drops nothing. Returns their number.
        """

        def drop() -> int:
            now_s = self._ran_s + self._clock() - self._opened_at
            old, dropped = history_age.expired(self._writer, now_s - self._keep_s), 0
            if old is not None:
                alarm_changes.forget(self._writer, old.change)
                dropped = self._drop("id <= ?", (old.block,))
            excess = self._bytes() - self._most_bytes
            dropped += self._drop_oldest(excess) if excess > 0 else 0
            history_age.mark(self._writer, now_s)
            return dropped

        def give_back() -> None:
            if not self._pages_checked:
                check_pages(self._writer)
                self._pages_checked = True
            self._writer.execute(f"PRAGMA incremental_vacuum({_PAGES_AT_ONCE})").fetchall()

        dropped = self._write(drop)
        with self._writing, naming(self.path):
            try:
                give_back()
            except sqlite3.DatabaseError as error:
                self._mend(error)
            self.size = self._bytes()
        return dropped

    def take_notes(self) -> list[str]:
        """Return the messages on damage since the last call."""
        notes, self._notes = self._notes, []
        return notes

    def close(self) -> None:
        """Close the file; safe to call twice."""
        with self._writing, self._reading, naming(self.path):
            self._close()

    def _write(self, work: Callable[[], Result]) -> Result:
        """Run ``work`` in a transaction, then a slice of the pending repairs."""
        with self._writing, naming(self.path):
            if not self._is_open:  # a new file could not be created
                with self._reading:
                    self._open()
            try:
                with transaction(self._writer):
                    done = work()
            except BaseException as error:
                if isinstance(error, sqlite3.DatabaseError) and is_damage(error):
                    self._mend(error)
                else:
                    self._remember()
                raise
            self._work(IN_TURN_S)
            self.size = self._bytes()
            return done

    def _ask(self, work: Callable[[], Result]) -> Result:
        """Run a query; set a damaged file aside and run it again."""
        with naming(self.path):
            opened = self._opened
            try:
                with self._reading:
                    return work()
            except sqlite3.DatabaseError as error:
                with self._writing:
                    if opened == self._opened:
                        self._mend(error)
            with self._reading:
                return work()

    def _open(self) -> None:
        self._writer = _open(self.path)
        self._reader = sqlite3.connect(self.path, check_same_thread=False)
        self._reader.text_factory = text
        self._opened += 1
        self._is_open = True
        self._ran_s, self._opened_at = history_age.ran_s(self._writer), self._clock()
        self._pages_checked = self.path.stat().st_size <= CHECKED_AT_ONCE
        self._begin_chores()

    def _begin_chores(self) -> None:
        self._chores.close()
        self.lost, self._recounted = self.lost - self._recounted, 0
        self._finished.clear()
        self._remember()
        self._chores = self._waiting()

    def _close(self) -> None:
        self._chores.close()
        if self._opened:
            self._writer.close()
            self._reader.close()

    def _remember(self) -> None:
        """Load names and series from the file."""
        self._names = dict(self._writer.execute("SELECT name, id FROM name").fetchall())
        self._series = self._known_series()

    def _mend(self, error: sqlite3.Error) -> None:
        """Set a damaged file aside and create a new one.

        Raises
        ------
        sqlite3.Error
            the given error, if the file is not damaged, belongs to another process, or the last one
            was set aside less than ``AGAIN_S`` ago.
        """
        too_soon = self._clock() < self._damaged_at + AGAIN_S
        if not is_damage(error) or not self._mends or too_soon:
            raise error
        self._damaged_at = self._clock()
        with self._reading:
            self._close()
            self._is_open = False
            kept = name_aside(self.path)
            kept.with_name(kept.name + SALVAGING).touch()
            move_aside(self.path, kept)
            self._notes.append(f"{self.path} is damaged ({error}); it is set aside as {kept.name}")
            self._open()

    def _work(self, budget_s: float) -> None:
        """Run pending repairs for a limited time."""
        if not self._mends:
            return
        ends = self._clock() + budget_s
        try:
            with transaction(self._writer):
                for _ in self._chores:
                    if self._clock() >= ends:
                        break
        except sqlite3.Error as error:
            if not is_damage(error):  # e.g. a full disk: restart the repairs later
                self._notes.append(f"{self.path} cannot be mended yet: {error}")
                self._begin_chores()
            else:
                self._mend(error)
            return
        for marker in self._finished:
            marker.unlink(missing_ok=True)
            self._recounted = 0
        self._finished.clear()

    def _waiting(self) -> Generator[None]:
        """Check each block, then copy the readable blocks of files set aside."""
        dropped = 0
        for lost in check_blocks(self._writer, self._names):
            if lost:
                self.lost, dropped = self.lost + lost, dropped + lost
                self._series = self._known_series()
            yield
        if dropped:
            self._notes.append(f"{self.path}: columns of {dropped:,} rows are damaged and dropped")
        for marker, damaged in _set_aside_before(self.path):
            kept = lost = 0
            for taken in take_over(self._writer, damaged, self._number):
                kept, lost = kept + taken.rows, lost + taken.lost
                self.lost, self._recounted = self.lost + taken.lost, self._recounted + taken.lost
                if taken.rows:
                    self._continue(taken)
                yield
            self._notes.append(
                f"{damaged.name}: {kept:,} rows are copied; {lost:,} rows lack columns or all"
            )
            self._finished.append(marker)

    def _continue(self, taken: Taken) -> None:
        """Continue a series after a block copied from a damaged file."""
        series = self._series.setdefault(
            taken.series, _Series(self._number(taken.series), taken.last)
        )
        series.last = max(series.last, taken.last)

    def _bytes(self) -> int:
        pages, free, page = (
            pragma(self._writer, name) for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * page

    def _append(self, piece: Piece) -> int:
        """Write a piece as a block, and join small blocks when they fill a large one."""
        series = self._series.get(piece.series)
        if series is None:
            series = self._series[piece.series] = _Series(self._number(piece.series), -(2**63))
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
            stored = self._examined(self._writer, own.series, block)
            if len(stored.t):
                place = np.minimum(np.searchsorted(stored.t, own.t), len(stored.t) - 1)
                there = late & (stored.t[place] == own.t)
                known |= there
                others |= there & own.differs(stored.parts, place)
        self.lost += int((others & (own.t < series.last)).sum())
        return known

    def _insert(self, series: str, columns: Mapping[str, NDArray[Any]]) -> int:
        parts = {name: pack(name, column) for name, column in columns.items()}
        return insert(self._writer, series, columns[T], parts, self._number)

    def _join(self, name: str, series: _Series) -> None:
        """Join a series' small blocks to one; rows without a column have NaN in it."""
        examined = [self._examined(self._writer, name, block) for block in series.small]
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

    def _drop(self, condition: str, values: tuple[int, ...]) -> int:
        select = f"SELECT id FROM block WHERE {condition}"  # noqa: S608 - constant
        old = [id_ for (id_,) in self._writer.execute(select, values)]
        self._delete(old)
        return len(old)

    def _drop_oldest(self, excess: int) -> int:
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
        names = {number: name for name, number in self._names.items()}
        found = {}
        last = "SELECT series, max(last) FROM block GROUP BY series"
        for number, newest in self._writer.execute(last).fetchall():
            series = found[names[number]] = _Series(number, newest)
            for block, rows in self._writer.execute(_SMALL, {"series": number, "full": BLOCK}):
                series.small.append(block)
                series.rows += rows
        return found

    def _number(self, name: str) -> int:
        if name not in self._names:
            insert = self._writer.execute("INSERT INTO name (name) VALUES (?)", (name,))
            self._names[name] = int(insert.lastrowid or 0)
        return int(self._names[name])

    def _blocks(
        self, series: int, low: int, high: int, *, backwards: bool
    ) -> list[tuple[int, int, int]]:
        """Return number, first and last time of blocks in a span, see `in_order`."""
        order = "last DESC" if backwards else "first"
        select = (
            "SELECT id, first, last FROM block WHERE series = ? AND first <= ? AND last >= ? "  # noqa: S608
            f"ORDER BY {order}"
        )
        return self._reader.execute(select, (series, high, low)).fetchall()

    def _rows_between(self, block: int, series: str, column: str, low: int, high: int) -> Past:
        past = self._rows_of(block, series, column)
        return past[slice(*np.searchsorted(past.t, [low, high + 1]).tolist())]

    def _rows_of(self, block: int, series: str, column: str) -> Past:
        found = self._examined(self._reader, series, block, (T, CODES, column))
        if column not in found.parts:  # the series had no such column then, or it is damaged
            return nothing()
        codes, values = (unpack(name, found.parts[name]) for name in (CODES, column))
        return Past(found.t, values, codes)

    def _examined(
        self, connection: sqlite3.Connection, series: str, block: int, columns: Sequence[str] = ()
    ) -> Examined:
        """Return the columns of a block with valid checksums; all, or the given ones."""
        numbers = {self._names[name]: name for name in columns or self._names}
        chosen = f"AND name IN ({', '.join('?' * len(columns))})" if columns else ""
        select = f"SELECT name, digest, data FROM part WHERE block = ? {chosen}"  # noqa: S608
        rows = connection.execute(select, (block, *(numbers if columns else ()))).fetchall()
        parts = {numbers[n]: (digest, data) for n, digest, data in rows if n in numbers}
        return examine(series, parts)


def _no_chores() -> Generator[None]:
    yield from ()


def _set_aside_before(path: Path) -> list[tuple[Path, Path]]:
    """Return files set aside that are not fully copied, each with its marker; newest first."""
    markers = [
        marker
        for marker in path.parent.iterdir()
        if marker.name.startswith(f"{path.name}.damaged-") and marker.name.endswith(SALVAGING)
    ]
    found = [(marker, marker.with_name(marker.name.removesuffix(SALVAGING))) for marker in markers]
    return sorted((pair for pair in found if pair[1].exists()), reverse=True)


def _open(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    connection.text_factory = text
    try:
        prepare(connection, path)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
    except BaseException:
        connection.close()
        raise
    return connection
