"""The newest state of every estimator, in one SQLite file."""

import hashlib
import sqlite3
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path
from threading import Lock
from typing import NamedTuple, Self

from valvemap.pipeline.ports import Checkpoint
from valvemap.storage.closing import Closing
from valvemap.storage.sqlite_files import (
    check_owner,
    damage,
    is_damage,
    naming,
    pragma,
    set_aside,
    text,
    transaction,
)

APPLICATION_ID = 0x76_6D_61_70  # "vmap"
SCHEMA_VERSION = 2

LOG = "the log of the last save"

_COLUMNS = "valve, estimator, generation, saved, key, t, state, lam, frozen, digest"
_SELECT = f"SELECT {_COLUMNS} FROM checkpoint"  # noqa: S608 - constant
_ROW = f"{_SELECT} WHERE rowid = ?"
_INSERT = f"INSERT OR REPLACE INTO checkpoint ({_COLUMNS}) VALUES ({', '.join('?' * 10)})"  # noqa: S608
_DIGEST_BYTES = 16
_SMALLEST_BYTES = 512  # of any SQLite file
_LOG_HEADER, _FRAME_HEADER = 32, 24  # bytes, of a write-ahead log
_MOST_ROWS = 1_000_000  # limit on the row ids tried in a damaged file
_SCHEMA = (
    """
    CREATE TABLE checkpoint (
        valve TEXT NOT NULL,
        estimator TEXT NOT NULL,
        generation INTEGER NOT NULL,
        saved INTEGER NOT NULL,
        key TEXT NOT NULL,
        t INTEGER NOT NULL,
        state BLOB NOT NULL,
        lam REAL,
        frozen INTEGER NOT NULL,
        digest BLOB NOT NULL,
        PRIMARY KEY (valve, estimator, generation)
    )
    """,
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {SCHEMA_VERSION}",
)
_TABLES = frozenset({"checkpoint"})


class CheckpointFile(Closing):
    """Stores checkpoints; fulfils :class:`valvemap.pipeline.ports.CheckpointStore`.

    A save is one transaction in a write-ahead log: readers are never blocked, and if the process is
    killed, the file holds the last complete save. Each save checkpoints its log into the file. It
    waits for the disk twice, for the log and for the file: a few ms at an interval of seconds. A
    completed ``save`` also survives a power failure.

    Each state is stored in two generations, each row with a digest of its contents. If the digest
    of the newest one is wrong, the previous generation is loaded. A damaged file is set aside and
    its readable rows are copied to a new one. A file of another format is set aside, too.

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
    damaged : list of str
        ``<Valve>.<Estimator>`` whose newest state was damaged at `load`; LOG if the log had more
        frames than could be read, because of a kill during a save, or of damage.

    Raises
    ------
    StorageError
        from every method, in one line that names the file: it cannot be written, is locked, full,
        or belongs to another program or to a newer version.

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
        self._log_was_torn = False
        self.damaged: list[str] = []
        self._lock = Lock()
        self._generations: dict[tuple[str, str], int] = {}  # the newest generation
        self._saved = 0
        with naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            frames = _frames_in_log(self.path)
            try:
                if self.path.is_file() and self.path.stat().st_size < _SMALLEST_BYTES:
                    raise damage("it is cut short")
                self._connection = _open(self.path, timeout)
                self._log_was_torn = _fold_log(self._connection) < frames
            except sqlite3.DatabaseError as error:
                if not is_damage(error):
                    raise
                self.set_aside = set_aside(self.path)
                self._connection = _open(self.path, timeout)
                with suppress(sqlite3.Error), transaction(self._connection):
                    self._connection.executemany(_INSERT, _salvaged(self.set_aside))
            rows = self._rows()
        self._saved = max((row.saved for row in rows), default=0)
        for row in sorted(rows, key=lambda row: row.saved):
            self._generations[row.valve, row.estimator] = row.generation

    def save(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Store all checkpoints or none; each replaces that of the same valve and estimator."""
        with self._lock, naming(self.path):
            saved = self._saved + 1
            rows = [_Row.of(c, 1 - self._generations.get(_name(c), 1), saved) for c in checkpoints]
            self._connection.execute("PRAGMA synchronous = OFF")  # _fold_log waits for the disk
            try:
                with transaction(self._connection):
                    self._connection.executemany(_INSERT, rows)
            finally:
                self._connection.execute("PRAGMA synchronous = NORMAL")
            _fold_log(self._connection)
            self._saved = saved
            self._generations.update(((r.valve, r.estimator), r.generation) for r in rows)

    def load(self) -> list[Checkpoint]:
        """Return the newest valid checkpoint of each (valve, estimator), in order of the names.

        If one of a valve is damaged, the valve's other checkpoints are from the same earlier save.
        """
        with self._lock, naming(self.path):
            rows = self._rows()
        whole = [row for row in rows if row.is_whole()]
        self.damaged = sorted(
            f"{row.valve}.{row.estimator}"
            for row in rows
            if not row.is_whole()
            and not any(_name(other) == _name(row) and other.saved > row.saved for other in whole)
        )
        if self._log_was_torn:
            self.damaged.append(LOG)
        hurt = {name.partition(".")[0] for name in self.damaged}
        until = {
            valve: min(
                max((r.saved for r in whole if _name(r) == name), default=self._saved)
                for name in {_name(r) for r in whole if r.valve == valve}
            )
            for valve in hurt & {row.valve for row in whole}
        }
        newest: dict[tuple[str, str], _Row] = {}
        for row in sorted(whole, key=lambda row: row.saved):
            if row.saved <= until.get(row.valve, row.saved) or _name(row) not in newest:
                newest[_name(row)] = row
        return [newest[name].checkpoint() for name in sorted(newest)]

    def _rows(self) -> "list[_Row]":
        return [_Row(*row) for row in self._connection.execute(_SELECT).fetchall()]

    @property
    def size(self) -> int:
        """Bytes of the file and its log."""
        parts = (self.path, self.path.with_name(f"{self.path.name}-wal"))
        return sum(part.stat().st_size for part in parts if part.exists())

    def close(self) -> None:
        """Checkpoint the log and close the file; safe to call twice."""
        with self._lock, naming(self.path):
            self._connection.close()


class _Row(NamedTuple):
    """One row; a damaged row may hold any values."""

    valve: str
    estimator: str
    generation: int
    saved: int
    key: str
    t: int
    state: bytes
    lam: float | None
    frozen: int
    digest: bytes

    @classmethod
    def of(cls, c: Checkpoint, generation: int, saved: int) -> Self:
        row = cls(
            c.valve,
            c.estimator,
            generation,
            saved,
            c.key,
            c.t,
            c.state,
            c.lam,
            int(c.frozen),
            b"",
        )
        return row._replace(digest=row._digest())

    def is_whole(self) -> bool:
        return isinstance(self.state, bytes) and self.digest == self._digest()

    def checkpoint(self) -> Checkpoint:
        return Checkpoint(
            self.valve, self.estimator, self.key, self.t, self.state, self.lam, bool(self.frozen)
        )

    def _digest(self) -> bytes:
        said = repr((*self[:6], self.lam, self.frozen)).encode("utf-8", "replace")
        digest = hashlib.blake2b(said, digest_size=_DIGEST_BYTES)
        digest.update(self.state)
        return digest.digest()


def _name(thing: Checkpoint | _Row) -> tuple[str, str]:
    return thing.valve, thing.estimator


def _salvaged(path: Path) -> list[_Row]:
    """Return the rows of a damaged file that are readable and have a valid digest."""
    rows = []
    try:
        with closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as damaged:
            damaged.text_factory = text
            (last,) = damaged.execute("SELECT max(rowid) FROM checkpoint").fetchone()
            for number in range(1, min(last or 0, _MOST_ROWS) + 1):
                with suppress(sqlite3.Error):
                    found = damaged.execute(_ROW, (number,)).fetchone()
                    if found is not None and _Row(*found).is_whole():
                        rows.append(_Row(*found))
    except (sqlite3.Error, TypeError):
        pass
    return rows


def _frames_in_log(path: Path) -> int:
    """Return the number of frames of a write-ahead log, by its size."""
    log = path.with_name(f"{path.name}-wal")
    if not log.exists() or log.stat().st_size < _LOG_HEADER:
        return 0
    with log.open("rb") as file:
        page = int.from_bytes(file.read(12)[8:], "big") or 4096
    return (log.stat().st_size - _LOG_HEADER) // (_FRAME_HEADER + page)


def _fold_log(connection: sqlite3.Connection) -> int:
    """Write the log's pages into the file; return their number."""
    _, pages, _ = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    return max(int(pages), 0)


def _open(path: Path, timeout: float) -> sqlite3.Connection:
    """Open and check the file; create the tables of a new one."""
    connection = sqlite3.connect(
        path, timeout=timeout, isolation_level=None, check_same_thread=False
    )
    try:
        connection.text_factory = text
        _check(connection, path)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        with transaction(connection):
            if pragma(connection, "application_id") == 0:
                for statement in _SCHEMA:
                    connection.execute(statement)
    except BaseException:
        connection.close()
        raise
    return connection


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Raise if the file belongs to another program, before it is changed."""
    is_new = check_owner(connection, path, APPLICATION_ID, SCHEMA_VERSION, _TABLES)
    version = pragma(connection, "user_version")
    if not is_new and version < SCHEMA_VERSION:
        raise damage(f"it is of format {version}, this one writes {SCHEMA_VERSION}")
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise damage(str(verdict))
