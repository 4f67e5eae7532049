"""The newest state of every estimator, in one SQLite file."""

import os
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Lock

from valvemap.errors import StateFileLost
from valvemap.pipeline.meaning import digest_of
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage import checkpoint_rows as rows_of
from valvemap.storage.checkpoint_connection import fold_log, frames_in_log, open_checkpoints
from valvemap.storage.checkpoint_generations import restorable
from valvemap.storage.checkpoint_rows import Row, SetAside
from valvemap.storage.closing import Closing
from valvemap.storage.sqlite_files import (
    damage,
    is_damage,
    naming,
    set_aside,
    transaction,
)
from valvemap.storage.state_lock import FileLock, is_at

LOG = "the log of the last save"
MOST_ASIDE = 8  # states set aside of one valve and estimator; the oldest are deleted

_SMALLEST_BYTES = 512  # of any SQLite file


class CheckpointFile(Closing):
    """Stores checkpoints; fulfils :class:`valvemap.pipeline.store_ports.CheckpointStore`.

    A save is one transaction in a write-ahead log: readers are never blocked, and if the process is
    killed, the file holds the last complete save. Each save checkpoints its log into the file. It
    waits for the disk twice, for the log and for the file: a few ms at an interval of seconds. A
    completed ``save`` also survives a power failure.

    Each state is stored in two generations, each row with a digest of its contents. If the digest
    of the newest one is wrong, the previous generation is loaded. A damaged file is set aside and
    its readable rows are copied to a new one. A file of another format is set aside, too.

    The file is used by one process at a time: a second one is rejected. Each save checks that the
    file is still the one that was opened. If it was removed, replaced, or its volume unmounted, a
    new file is opened at the path and the save raises StateFileLost: the caller then saves all.

    Each row carries the meaning of its state: nodes, units and accuracy of the valve's signals.
    States that no longer fit the configuration are set aside in the same file.

    May be used from any thread, by one at a time.

    Parameters
    ----------
    path
        The file; it and its folder are created if missing.
    timeout
        Timeout for another process's lock, s.

    Attributes
    ----------
    set_aside : Path or None
        Where a damaged file, or one of another format, was moved on opening; the caller reports it.
    renewed : int
        How often the file was found lost, and opened again.
    damaged : list of str
        ``<Valve>.<Estimator>`` whose newest state was damaged at `load`; LOG if the log had more
        frames than could be read, because of a kill during a save, or of damage.

    Raises
    ------
    StorageError
        from every method, in one line that names the file: it cannot be written, is locked, full,
        belongs to another program or to a newer version, or is in use by another process.
    StateFileLost
        from `save` and `put_aside`: nothing was saved, and a new file is in place.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "checkpoints.sqlite"
    >>> with CheckpointFile(path) as store:
    ...     store.save([Checkpoint("V1", "RLS", "key", 1, b"state", lam=0.99, frozen=False)])
    >>> with CheckpointFile(path) as store:
    ...     store.load()[0].state
    b'state'
    """

    def __init__(self, path: str | Path, timeout: float = 5.0) -> None:
        self.path = Path(path)
        self.set_aside: Path | None = None
        self.renewed = 0
        self.damaged: list[str] = []
        self._timeout = timeout
        self._log_was_torn = False
        self._saved = 0
        self._generations: dict[tuple[str, str], int] = {}  # the newest generation
        self._meanings: dict[str, str] = {}  # texts in the file, by digest
        self._identity = ""
        self._place: os.stat_result | None = None
        self._lock = Lock()
        with naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._in_use = FileLock(self.path)
            try:
                self._open()
            except BaseException:
                self._in_use.close()
                raise

    def save(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Store all checkpoints or none; each replaces that of the same valve and estimator."""
        with self._lock, naming(self.path):
            self._check_place()
            saved = self._saved + 1
            rows = [Row.of(c, 1 - self._generations.get(_name(c), 1), saved) for c in checkpoints]
            meanings = self._new_meanings(checkpoints)
            self._connection.execute("PRAGMA synchronous = OFF")  # fold_log waits for the disk
            try:
                with transaction(self._connection):
                    self._connection.executemany(rows_of.INSERT_MEANING, meanings.items())
                    self._connection.executemany(rows_of.INSERT, rows)
            finally:
                self._connection.execute("PRAGMA synchronous = NORMAL")
            fold_log(self._connection)
            self._saved = saved
            self._meanings.update(meanings)
            self._generations.update((r.name, r.generation) for r in rows)

    def put_aside(
        self,
        aside: Sequence[tuple[Checkpoint, str]],
        moved: Mapping[tuple[str, str], tuple[str, str]],
    ) -> None:
        """Keep checkpoints that are not restored, with their reasons; and rename others.

        ``moved`` maps (valve, estimator) to its new name. The newest MOST_ASIDE states of a name
        are kept aside.
        """
        if not aside and not moved:
            return
        with self._lock, naming(self.path):
            self._check_place()
            meanings = self._new_meanings([one for one, _ in aside])
            rows = self._rows()
            gone = {_name(one) for one, _ in aside} | moved.keys()
            put = [
                row._replace(valve=moved[row.name][0], estimator=moved[row.name][1]).signed()
                for row in rows
                if row.name in moved and row.is_whole()
            ]
            with transaction(self._connection):
                self._connection.executemany(rows_of.INSERT_MEANING, meanings.items())
                for one, reason in aside:
                    row = Row.of(one, 0, self._saved)
                    self._connection.execute(rows_of.INSERT_ASIDE, (*row, reason))
                self._connection.executemany(rows_of.DELETE, sorted(gone))
                self._connection.executemany(rows_of.INSERT, put)
                self._forget_oldest()
                self._connection.execute(rows_of.FORGET_MEANINGS)
            fold_log(self._connection)
            self._read()

    def aside(self) -> list[SetAside]:
        """Return the states that are set aside, the oldest first."""
        with self._lock, naming(self.path):
            return rows_of.aside_in(self._connection, self._meanings)

    def forget_aside(self, numbers: Sequence[int]) -> None:
        """Delete states that are set aside, by their numbers."""
        with self._lock, naming(self.path), transaction(self._connection):
            self._connection.executemany(rows_of.DELETE_ASIDE, [(n,) for n in numbers])

    def load(self, together: Sequence[Sequence[str]] = ()) -> list[Checkpoint]:
        """Return the newest valid checkpoint of each (valve, estimator), in order of the names.

        If one of a valve is damaged, the valve's other checkpoints are from the same earlier save,
        and so are those of the valves that are named ``together`` with it.
        """
        with self._lock, naming(self.path):
            rows = self._rows()
        chosen, self.damaged = restorable(rows, together)
        if self._log_was_torn:
            self.damaged.append(LOG)
        return [row.checkpoint(self._meanings) for row in chosen]

    def _open(self) -> None:
        """Open the file at the path; set a damaged one aside and copy its readable rows."""
        frames = frames_in_log(self.path)
        try:
            if self.path.is_file() and self.path.stat().st_size < _SMALLEST_BYTES:
                raise damage("it is cut short")
            self._connection = open_checkpoints(self.path, self._timeout)
            self._log_was_torn = fold_log(self._connection) < frames
        except sqlite3.DatabaseError as error:
            if not is_damage(error):
                raise
            self.set_aside = set_aside(self.path)
            self._connection = open_checkpoints(self.path, self._timeout)
            rows, meanings = rows_of.salvaged(self.set_aside)
            with suppress(sqlite3.Error), transaction(self._connection):
                self._connection.executemany(rows_of.INSERT_MEANING, meanings.items())
                self._connection.executemany(rows_of.INSERT, rows)
        self._place, self._identity = self.path.stat(), rows_of.identity_in(self._connection)
        self._read()

    def _read(self) -> None:
        """Read which rows and meanings there are."""
        rows = self._rows()
        self._saved = max((row.saved for row in rows), default=0)
        self._generations = {
            row.name: row.generation for row in sorted(rows, key=lambda row: row.saved)
        }
        self._meanings = rows_of.meanings_in(self._connection)

    def _check_place(self) -> None:
        """Open a new file if the one at the path is not the one that was opened.

        Raises
        ------
        StateFileLost
            if so.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._in_use.check()
        if self._place is not None and is_at(self.path, self._place):
            return
        self._place = None  # until another file is open
        with suppress(sqlite3.Error):
            self._connection.close()  # before another file has the name of its log
        if self.path.exists() and not self._is_own():
            self.set_aside = set_aside(self.path)
        self._open()
        self.renewed += 1
        raise StateFileLost(
            f"{self.path} was removed or replaced while in use: a new file was made, and all "
            "states are saved again"
        )

    def _is_own(self) -> bool:
        """Whether the file at the path once was this one: a copy, or its volume mounted again."""
        return rows_of.identity_of(self.path) == self._identity

    def _new_meanings(self, checkpoints: Sequence[Checkpoint]) -> dict[str, str]:
        """Return the meanings that are not in the file yet, by digest."""
        texts = {one.meaning for one in checkpoints}
        by_digest = {digest_of(said): said for said in texts}
        return {key: said for key, said in by_digest.items() if key not in self._meanings}

    def _forget_oldest(self) -> None:
        """Delete the oldest states aside, beyond MOST_ASIDE of a name."""
        names: dict[tuple[str, str], list[int]] = {}
        for number, *row in self._connection.execute(rows_of.SELECT_ASIDE).fetchall():
            names.setdefault((row[0], row[1]), []).append(number)
        old = [(number,) for numbers in names.values() for number in numbers[:-MOST_ASIDE]]
        self._connection.executemany(rows_of.DELETE_ASIDE, old)

    def _rows(self) -> list[Row]:
        return [Row(*row) for row in self._connection.execute(rows_of.SELECT).fetchall()]

    @property
    def size(self) -> int:
        """Bytes of the file and its log."""
        parts = (self.path, self.path.with_name(f"{self.path.name}-wal"))
        return sum(part.stat().st_size for part in parts if part.exists())

    def close(self) -> None:
        """Checkpoint the log, close the file and release it; safe to call twice."""
        with self._lock, naming(self.path):
            self._connection.close()
            self._in_use.close()


def _name(one: Checkpoint) -> tuple[str, str]:
    return one.valve, one.estimator
