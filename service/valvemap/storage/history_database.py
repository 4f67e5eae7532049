"""The connections to the file of a history: damage is repaired while they are used."""

import sqlite3
from collections.abc import Callable, Generator
from pathlib import Path
from threading import Lock
from typing import Final, TypeVar

import numpy as np

from valvemap.storage import history_age
from valvemap.storage.history_blocks import SEALED
from valvemap.storage.history_cells import width_of
from valvemap.storage.history_mending import check_blocks, set_aside_before, take_over
from valvemap.storage.history_reader import RowReader
from valvemap.storage.history_schema import CHECKED_AT_ONCE, check_pages, open_to_write
from valvemap.storage.history_series import SeriesWriter
from valvemap.storage.history_tiers import TierReader
from valvemap.storage.sqlite_files import (
    SALVAGING,
    OurConnection,
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
AGAIN_S: Final = 60.0  # s; shortest time between two files set aside
_PAGES_AT_ONCE = 1_000  # freed in one step
Result = TypeVar("Result")


class HistoryDatabase:
    """One connection that writes and one that reads, for any thread.

    If the file's structure is damaged, it is set aside, and its readable blocks are copied to a new
    one; a damaged column is dropped. Both proceed a little with each transaction.

    Parameters
    ----------
    path, mends, clock
        As of :class:`~valvemap.storage.history.HistoryFile`.

    Attributes
    ----------
    writer, reader : sqlite3.Connection
    writing : Lock
        Held by a thread that writes.
    rows : SeriesWriter
        Appends rows.
    past, tiers
        Read rows and tiers; in `ask` alone.
    tiers_are_whole : bool
        Whether no tier is being computed again.
    state : tuple of int
        Number of files opened, and of transactions: rows read in another state are old.
    size : int
        Bytes in use after the last transaction.

    Raises
    ------
    StorageError
        from every method, in one line that names the file.
    """

    writer: sqlite3.Connection
    reader: sqlite3.Connection
    rows: SeriesWriter
    past: RowReader
    tiers: TierReader

    def __init__(self, path: Path, clock: Callable[[], float], *, mends: bool) -> None:
        self.path = path
        self.writing, self._reading = Lock(), Lock()
        self._mends, self._clock = mends, clock
        self._notes: list[str] = []
        self._opened, self._damaged_at = 0, -np.inf
        self._written, self.tiers_are_whole = 0, False
        self._pages_checked = self._is_open = False
        self._chores: Generator[None] = _no_chores()
        self._lost = self._recounted = 0  # the latter: of unfinished files set aside
        self._finished: list[Path] = []
        with naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._open()
            except sqlite3.DatabaseError as error:
                self.mend(error)
            self._work(AT_START_S if self._pages_checked else IN_TURN_S)
            self.size = self.bytes_in_use()

    def write(self, work: Callable[[], Result]) -> Result:
        """Run ``work`` in a transaction, then a slice of the pending repairs."""
        with self.writing, naming(self.path):
            if not self._is_open:  # a new file could not be created
                with self._reading:
                    self._open()
            try:
                with transaction(self.writer):
                    done = work()
                    self._reset_damaged_tiers()
                self._written += 1
            except BaseException as error:
                if isinstance(error, sqlite3.DatabaseError) and is_damage(error):
                    self.mend(error)
                else:
                    self.rows.reload()
                raise
            self._work(IN_TURN_S)
            self.size = self.bytes_in_use()
            return done

    def ask(self, work: Callable[[], Result]) -> Result:
        """Run a query; set a damaged file aside and run it again."""
        with naming(self.path):
            opened = self._opened
            try:
                with self._reading, snapshot(self.reader):
                    return work()
            except sqlite3.DatabaseError as error:
                with self.writing:
                    if opened == self._opened:
                        self.mend(error)
            with self._reading, snapshot(self.reader):
                return work()

    def give_back(self) -> None:
        """Return freed pages to the disk, some at a time."""
        with self.writing, naming(self.path):
            try:
                if not self._pages_checked:
                    check_pages(self.writer)
                    self._pages_checked = True
                self.writer.execute(f"PRAGMA incremental_vacuum({_PAGES_AT_ONCE})").fetchall()
            except sqlite3.DatabaseError as error:
                self.mend(error)
            self.size = self.bytes_in_use()

    @property
    def state(self) -> tuple[int, int]:
        """Numbers that change with the file and with each transaction."""
        return self._opened, self._written

    @property
    def lost(self) -> int:
        """Rows known to be lost."""
        return self._lost + self.rows.lost

    @property
    def ran_s(self) -> float:
        """For how long the file has been open, in all processes, s."""
        return self._ran_s + self._clock() - self._opened_at

    def take_notes(self) -> list[str]:
        """Return the messages on damage since the last call."""
        notes, self._notes = self._notes, []
        return notes

    def bytes_in_use(self) -> int:
        """Bytes of all pages that are not free."""
        pages, free, page = (
            pragma(self.writer, name) for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * page

    def close(self) -> None:
        """Close both connections; safe to call twice."""
        with self.writing, self._reading, naming(self.path):
            self._close()

    def mend(self, error: sqlite3.Error) -> None:
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

    def _reset_damaged_tiers(self) -> None:
        if not self.rows.damaged_tiers or not self._mends:
            return
        for series in self.rows.damaged_tiers:
            self.rows.reset_tiers(series)
        self.rows.damaged_tiers.clear()
        self._chores.close()
        self.tiers_are_whole, self._chores = False, self._waiting()

    def _open(self) -> None:
        if self._opened:
            self._lost += self.rows.lost
        self.writer = open_to_write(self.path)
        self.rows = SeriesWriter(self.writer)
        self.reader = sqlite3.connect(
            self.path, isolation_level=None, check_same_thread=False, factory=OurConnection
        )
        self.reader.text_factory = text
        self.past = RowReader(self.reader, self.rows)
        self.tiers = TierReader(self.reader, self.rows)
        self._opened += 1
        self._is_open = True
        self._ran_s, self._opened_at = history_age.ran_s(self.writer), self._clock()
        self._pages_checked = self.path.stat().st_size <= CHECKED_AT_ONCE
        self._begin_chores()

    def _begin_chores(self) -> None:
        self._chores.close()
        self._lost, self._recounted = self._lost - self._recounted, 0
        self._finished.clear()
        self.rows.reload()
        self.tiers_are_whole, self._chores = False, self._waiting()

    def _close(self) -> None:
        self._chores.close()
        if self._opened:
            self.writer.close()
            self.reader.close()

    def _work(self, budget_s: float) -> None:
        """Run pending repairs for a limited time."""
        if not self._mends:
            return
        ends = self._clock() + budget_s
        try:
            with transaction(self.writer):
                for _ in self._chores:
                    if self._clock() >= ends:
                        break
        except sqlite3.Error as error:
            if not is_damage(error):  # e.g. a full disk: restart the repairs later
                self._notes.append(f"{self.path} cannot be mended yet: {error}")
                self._begin_chores()
            else:
                self.mend(error)
            return
        for marker in self._finished:
            marker.unlink(missing_ok=True)
            self._recounted = 0
        self._finished.clear()

    def _waiting(self) -> Generator[None]:
        """Check each block, copy the readable blocks of files set aside, seal loose blocks."""
        dropped, hurt = 0, set[str]()
        for checked in check_blocks(self.writer, self.rows.names):
            if checked.lost:
                self._lost, dropped = self._lost + checked.lost, dropped + checked.lost
                self.rows.reload_series()
                hurt.add(checked.series)
            yield
        if dropped:
            self._notes.append(f"{self.path}: columns of {dropped:,} rows are damaged and dropped")
        if "" in hurt:
            self.rows.reset_all_tiers()
        else:
            for series in filter(width_of, hurt):
                self.rows.reset_tiers(series.rpartition(SEALED)[0])
        for marker, damaged in set_aside_before(self.path):
            kept = lost = 0
            for taken in take_over(self.writer, damaged, self.rows.number):
                kept, lost = kept + taken.rows, lost + taken.lost
                self._lost, self._recounted = self._lost + taken.lost, self._recounted + taken.lost
                yield
            self.rows.reset_all_tiers()
            self._notes.append(
                f"{damaged.name}: {kept:,} rows are copied; {lost:,} rows lack columns or all"
            )
            self._finished.append(marker)
        sealed: int | None = -(2**63)
        while sealed is not None:
            sealed = self.rows.seal_pending(sealed)
            yield
        self.tiers_are_whole = True


def _no_chores() -> Generator[None]:
    yield from ()
