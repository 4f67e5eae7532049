"""The history of signals and results in one SQLite file: columns in blocks of successive rows."""

import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final

from valvemap.pipeline.alarm_results import AlarmChange
from valvemap.pipeline.store_ports import Past, PastCells, Piece
from valvemap.storage import alarm_changes, history_age
from valvemap.storage.closing import Closing
from valvemap.storage.history_cells import WIDTHS
from valvemap.storage.history_database import HistoryDatabase
from valvemap.storage.history_spans import Spans, drop_aged, drop_excess, raw_bytes
from valvemap.storage.sqlite_files import naming

MEASURED_S: Final = 3_600.0  # s of writing from which the file's rate of growth is known


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
    >>> import numpy as np
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
        self._spans = Spans.of(keep_s, results_s, trend_s)
        self._most_bytes = most_bytes
        self._database = HistoryDatabase(self.path, clock, mends=mends)

    def save(self, pieces: Iterable[Piece]) -> int:
        """Store all pieces or none; return how many values were left out as stored already."""
        database = self._database
        return database.write(lambda: sum([database.rows.append(piece) for piece in pieces]))

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
        return self._database.ask(
            lambda: self._database.past.rows(
                series, column, (low, high), backwards=backwards, skip=skip, most=most
            )
        )

    def cells(self, series: str, column: str, low: int, high: int, width: int) -> PastCells | None:
        """Return the cells of a tier that begin from ``low`` to before ``high`` (UTC ns).

        Rows that are not sealed yet are included. None if there is no tier of that width, or while
        the tiers are computed again, after damage or of an older file.
        """
        database = self._database
        if not database.tiers_are_whole:
            return None
        state = database.state
        found = database.ask(
            lambda: database.tiers.cells(series, column, (low, high), width, state)
        )
        if isinstance(found, str):  # damaged
            with database.writing:
                database.rows.damaged_tiers.add(found)
            return None
        return found

    def note(self, changes: Sequence[AlarmChange]) -> None:
        """Store changes of alarms; skip those already stored."""
        database = self._database
        database.write(lambda: alarm_changes.insert(database.writer, changes))

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
        database = self._database
        return database.ask(
            lambda: alarm_changes.select(
                database.reader, owner, (low, high), backwards=backwards, skip=skip, most=most
            )
        )

    def forget(self) -> int:
        """Drop blocks that are too old or exceed the size, in the order in which they were written.

        A block's age is the time that the file was open since it was written: a clock that steps
        drops nothing. Returns their number.
        """
        database = self._database

        def drop() -> int:
            now_s = database.ran_s
            dropped = drop_aged(database.writer, database.rows, self._spans, now_s)
            excess = database.bytes_in_use() - self._most_bytes
            if excess > 0:
                dropped += drop_excess(database.rows, excess, self._most_bytes)
            history_age.mark(database.writer, now_s)
            return dropped

        dropped = database.write(drop)
        database.give_back()
        return dropped

    @property
    def size(self) -> int:
        """Bytes in use, see the class."""
        return self._database.size

    @property
    def lost(self) -> int:
        """Rows known to be lost, see the class."""
        return self._database.lost

    @property
    def bytes_per_s(self) -> float:
        """The bytes of rows written per s that the file was open; 0 if too short to tell."""
        database = self._database
        with database.writing, naming(self.path):
            oldest, held = raw_bytes(database.writer, database.rows)
            ran_s = history_age.ran_s(database.writer)
            span_s = ran_s - history_age.since_s(database.writer, oldest)
            return held / span_s if span_s >= MEASURED_S else 0.0

    def take_notes(self) -> list[str]:
        """Return the messages on damage since the last call."""
        return self._database.take_notes()

    def close(self) -> None:
        """Close the file; safe to call twice."""
        self._database.close()
