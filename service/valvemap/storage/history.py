"""The history of signals and results in one SQLite file: columns in blocks of successive rows."""

import sqlite3
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from threading import Lock
from typing import Final, TypeVar

import numpy as np

from valvemap.pipeline.results import AlarmChange
from valvemap.pipeline.store_ports import Past, PastCells, Piece
from valvemap.storage import alarm_changes, history_age
from valvemap.storage.closing import Closing
from valvemap.storage.history_blocks import SEALED
from valvemap.storage.history_cells import WIDTHS, width_of
from valvemap.storage.history_mending import check_blocks, set_aside_before, take_over
from valvemap.storage.history_reader import RowReader
from valvemap.storage.history_schema import CHECKED_AT_ONCE, check_pages, open_to_write
from valvemap.storage.history_series import SeriesWriter
from valvemap.storage.history_spans import Spans, drop_aged, drop_excess, raw_bytes
from valvemap.storage.history_tiers import TierReader
from valvemap.storage.sqlite_files import (
    SALVAGING,
    is_damage,
    move_aside,
    name_aside,
    naming,
    pragma,
    snapshot,
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
    stored row of its time is left out and counted as lost. A save is one transaction, so a kill
    loses only unsaved rows. Every 4,096 rows of a series are sealed: packed without loss, and added
    to the tiers (minimum, mean, maximum and counts over 10 s and 5 min) in the same transaction.

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
        Maximum size of the file; the oldest blocks are dropped first, see `history_spans`.
    results_s, trend_s
        Age at which rows of results, and the tier of 5 min, are dropped; by default ``keep_s``.
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
        results_s: float | None = None,
        trend_s: float | None = None,
        mends: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = Path(path)
        self.widths: Sequence[int] = WIDTHS
        self._lost = 0
        self._rows: SeriesWriter
        self._spans = Spans.of(keep_s, results_s, trend_s)
        self._most_bytes = most_bytes
        self._writing, self._reading = Lock(), Lock()
        self._mends, self._clock = mends, clock
        self._notes: list[str] = []
        self._opened, self._damaged_at = 0, -np.inf
        self._written, self._tiers_are_whole = 0, False
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
        return self._ask(
            lambda: self._past.rows(
                series, column, (low, high), backwards=backwards, skip=skip, most=most
            )
        )

    def cells(self, series: str, column: str, low: int, high: int, width: int) -> PastCells | None:
        """Return the cells of a tier that begin from ``low`` to before ``high`` (UTC ns).

        Rows that are not sealed yet are included. None if there is no tier of that width, or while
        the tiers are computed again, after damage or of an older file.
        """
        if not self._tiers_are_whole:
            return None
        state = self._opened, self._written
        found = self._ask(lambda: self._tiers.cells(series, column, (low, high), width, state))
        if isinstance(found, str):  # damaged
            with self._writing:
                self._rows.damaged_tiers.add(found)
            return None
        return found

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
            dropped = drop_aged(self._writer, self._rows, self._spans, now_s)
            excess = self._bytes() - self._most_bytes
            if excess > 0:
                dropped += drop_excess(self._rows, excess, self._most_bytes)
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
        """The bytes of rows written per s that the file was open; 0 if too short to tell."""
        with self._writing, naming(self.path):
            oldest, held = raw_bytes(self._writer, self._rows)
            span_s = history_age.ran_s(self._writer) - history_age.since_s(self._writer, oldest)
            return held / span_s if span_s >= MEASURED_S else 0.0

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
                    self._reset_damaged_tiers()
                self._written += 1
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
                with self._reading, snapshot(self._reader):
                    return work()
            except sqlite3.DatabaseError as error:
                with self._writing:
                    if opened == self._opened:
                        self._mend(error)
            with self._reading, snapshot(self._reader):
                return work()

    def _reset_damaged_tiers(self) -> None:
        if not self._rows.damaged_tiers or not self._mends:
            return
        for series in self._rows.damaged_tiers:
            self._rows.reset_tiers(series)
        self._rows.damaged_tiers.clear()
        self._chores.close()
        self._tiers_are_whole, self._chores = False, self._waiting()

    def _open(self) -> None:
        if self._opened:
            self._lost += self._rows.lost
        self._writer = open_to_write(self.path)
        self._rows = SeriesWriter(self._writer)
        self._reader = sqlite3.connect(self.path, isolation_level=None, check_same_thread=False)
        self._reader.text_factory = text
        self._past = RowReader(self._reader, self._rows)
        self._tiers = TierReader(self._reader, self._rows)
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
        self._tiers_are_whole, self._chores = False, self._waiting()

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
        """Check each block, copy the readable blocks of files set aside, seal loose blocks."""
        dropped, hurt = 0, set[str]()
        for checked in check_blocks(self._writer, self._rows.names):
            if checked.lost:
                self._lost, dropped = self._lost + checked.lost, dropped + checked.lost
                self._rows.reload_series()
                hurt.add(checked.series)
            yield
        if dropped:
            self._notes.append(f"{self.path}: columns of {dropped:,} rows are damaged and dropped")
        if "" in hurt:
            self._rows.reset_all_tiers()
        else:
            for series in filter(width_of, hurt):
                self._rows.reset_tiers(series.rpartition(SEALED)[0])
        for marker, damaged in set_aside_before(self.path):
            kept = lost = 0
            for taken in take_over(self._writer, damaged, self._rows.number):
                kept, lost = kept + taken.rows, lost + taken.lost
                self._lost, self._recounted = self._lost + taken.lost, self._recounted + taken.lost
                yield
            self._rows.reset_all_tiers()
            self._notes.append(
                f"{damaged.name}: {kept:,} rows are copied; {lost:,} rows lack columns or all"
            )
            self._finished.append(marker)
        sealed: int | None = -(2**63)
        while sealed is not None:
            sealed = self._rows.seal_pending(sealed)
            yield
        self._tiers_are_whole = True

    def _bytes(self) -> int:
        pages, free, page = (
            pragma(self._writer, name) for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * page


def _no_chores() -> Generator[None]:
    yield from ()
