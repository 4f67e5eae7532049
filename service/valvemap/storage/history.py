"""The history of signals and results in one SQLite file: columns in blocks of successive rows."""

import sqlite3
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Times
from valvemap.pipeline.ports import AlarmChange, Past, Piece
from valvemap.storage import alarm_changes
from valvemap.storage.closing import Closing
from valvemap.storage.history_blocks import CODES, Examined, T, examine, insert, pack, unpack
from valvemap.storage.history_mending import Taken, check_blocks, take_over
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
    SELECT id, rows FROM block WHERE series = :series AND first > ifnull(
        (SELECT max(last) FROM block WHERE series = :series AND rows >= :full), -9223372036854775808
    ) ORDER BY first
"""  # blocks after the last full one

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

    A series is a table of successive rows: a time, a status code and value columns. Rows are saved
    in order of time; a row that is not newer than the last of its series is left out. A save is
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
        Age at which rows are dropped, block by block, s.
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
        self._keep_ns, self._most_bytes = round(keep_s * 1e9), most_bytes
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
        """Store all pieces or none; return how many values were left out as not newer."""
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
                return _nothing()
            found, wanted = [], skip + most
            for block in self._blocks(self._names[series], low, high, backwards=backwards):
                past = self._rows_of(block, series, column)
                inside = slice(*np.searchsorted(past.t, [low, high + 1]).tolist())
                past = past[inside]
                found.append(past[::-1] if backwards else past)
                wanted -= len(found[-1].t)
                if wanted <= 0:
                    break
            return _joined(found)[skip : skip + most]

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

    def forget(self, now: int) -> int:
        """Drop blocks that are too old at ``now`` (UTC ns) or exceed the size; return how many."""

        def drop() -> int:
            alarm_changes.forget(self._writer, now - self._keep_ns)
            dropped = self._drop("last < ?", (now - self._keep_ns,))
            excess = self._bytes() - self._most_bytes
            return dropped + (self._drop_oldest(excess) if excess > 0 else 0)

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
        ordered = np.maximum.accumulate(np.append(series.last, piece.t))
        newer = piece.t > ordered[:-1]
        t = piece.t[newer]
        if len(t):
            columns: dict[str, NDArray[Any]] = {T: t, CODES: piece.codes[newer]}
            columns |= {name: values[newer] for name, values in piece.columns.items()}
            series.small.append(self._insert(piece.series, columns))
            series.last, series.rows = int(t[-1]), series.rows + len(t)
            if series.rows >= BLOCK:
                self._join(piece.series, series)
        return int((len(piece.t) - len(t)) * len(piece.columns))

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
            self._insert(name, columns)

    def _drop(self, condition: str, values: tuple[int, ...]) -> int:
        select = f"SELECT id FROM block WHERE {condition}"  # noqa: S608 - constant
        old = [id_ for (id_,) in self._writer.execute(select, values)]
        self._delete(old)
        return len(old)

    def _drop_oldest(self, excess: int) -> int:
        """Drop the oldest blocks that together hold the given number of bytes."""
        held = self._writer.execute(
            "SELECT block.id, sum(length(data)) FROM block JOIN part ON part.block = block.id "
            "GROUP BY block.id ORDER BY last"
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

    def _blocks(self, series: int, low: int, high: int, *, backwards: bool) -> Iterator[int]:
        order = "DESC" if backwards else "ASC"
        select = (
            "SELECT id FROM block WHERE series = ? AND first <= ? AND last >= ? "  # noqa: S608
            f"ORDER BY first {order}"
        )
        return (block for (block,) in self._reader.execute(select, (series, high, low)))

    def _rows_of(self, block: int, series: str, column: str) -> Past:
        found = self._examined(self._reader, series, block, (T, CODES, column))
        if column not in found.parts:  # the series had no such column then, or it is damaged
            return _nothing()
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


def _nothing() -> Past:
    return Past(np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint32))


def _joined(parts: Sequence[Past]) -> Past:
    if not parts:
        return _nothing()
    columns: list[tuple[Times, Floats, NDArray[np.uint32]]] = [
        (past.t, past.values, past.codes) for past in parts
    ]
    t, values, codes = (np.concatenate(column) for column in zip(*columns, strict=True))
    return Past(t, values, codes)


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
