"""The history of signals and results in one SQLite file: columns in blocks of successive rows."""

import sqlite3
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from threading import Lock
from typing import Final, TypeVar

import numpy as np

from valvemap.pipeline.ports import AlarmChange, Past, Piece
from valvemap.storage import alarm_changes, history_age
from valvemap.storage.closing import Closing
from valvemap.storage.history_blocks import CODES, T, unpack
from valvemap.storage.history_mending import check_blocks, take_over
from valvemap.storage.history_order import in_order, joined, nothing
from valvemap.storage.history_schema import CHECKED_AT_ONCE, check_pages, prepare
from valvemap.storage.history_series import SeriesWriter
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

AT_START_S: Final = 1.0  # s; time for checks and copies during the start
IN_TURN_S: Final = 0.1  # s; time for the remaining ones after each save, once a second
MEASURED_S: Final = 3_600.0  # s of writing from which the file's rate of growth is known
AGAIN_S: Final = 60.0  # s; shortest time between two files set aside
_PAGES_AT_ONCE = 1_000  # freed in one step
Result = TypeVar("Result")


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
        Rows known to be lost: by damage (a row with one lost column is included), or left out
        because others of their time are stored.

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
        self._lost = 0
        self._rows: SeriesWriter
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
        return self._write(lambda: sum([self._rows.append(piece) for piece in pieces]))

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
            if not self._rows.names.keys() >= {series, column, T, CODES}:
                return nothing()
            found, wanted = [], skip + most
            number = self._rows.names[series]
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
                dropped = self._rows.drop("id <= ?", (old.block,))
            excess = self._bytes() - self._most_bytes
            dropped += self._rows.drop_oldest(excess) if excess > 0 else 0
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

    @property
    def lost(self) -> int:
        """Rows known to be lost, see the class."""
        return self._lost + self._rows.lost

    @property
    def bytes_per_s(self) -> float:
        """The rate at which the file has grown, per s that it was open; 0 if too short to tell."""
        with self._writing, naming(self.path):
            span_s = history_age.ran_s(self._writer) - history_age.since_s(self._writer)
            return self._bytes() / span_s if span_s >= MEASURED_S else 0.0

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
                    self._rows.reload()
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
        if self._opened:
            self._lost += self._rows.lost
        self._writer = _open(self.path)
        self._rows = SeriesWriter(self._writer)
        self._reader = sqlite3.connect(self.path, check_same_thread=False)
        self._reader.text_factory = text
        self._opened += 1
        self._is_open = True
        self._ran_s, self._opened_at = history_age.ran_s(self._writer), self._clock()
        self._pages_checked = self.path.stat().st_size <= CHECKED_AT_ONCE
        self._begin_chores()

    def _begin_chores(self) -> None:
        self._chores.close()
        self._lost, self._recounted = self._lost - self._recounted, 0
        self._finished.clear()
        self._rows.reload()
        self._chores = self._waiting()

    def _close(self) -> None:
        self._chores.close()
        if self._opened:
            self._writer.close()
            self._reader.close()

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
        for lost in check_blocks(self._writer, self._rows.names):
            if lost:
                self._lost, dropped = self._lost + lost, dropped + lost
                self._rows.reload_series()
            yield
        if dropped:
            self._notes.append(f"{self.path}: columns of {dropped:,} rows are damaged and dropped")
        for marker, damaged in _set_aside_before(self.path):
            kept = lost = 0
            for taken in take_over(self._writer, damaged, self._rows.number):
                kept, lost = kept + taken.rows, lost + taken.lost
                self._lost, self._recounted = self._lost + taken.lost, self._recounted + taken.lost
                if taken.rows:
                    self._rows.resume_after(taken)
                yield
            self._notes.append(
                f"{damaged.name}: {kept:,} rows are copied; {lost:,} rows lack columns or all"
            )
            self._finished.append(marker)

    def _bytes(self) -> int:
        pages, free, page = (
            pragma(self._writer, name) for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * page

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
        found = self._rows.examined(self._reader, series, block, (T, CODES, column))
        if column not in found.parts:  # the series had no such column then, or it is damaged
            return nothing()
        codes, values = (unpack(name, found.parts[name]) for name in (CODES, column))
        return Past(found.t, values, codes)


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
