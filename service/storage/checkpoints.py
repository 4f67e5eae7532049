"""The newest state of every estimator, in one SQLite file."""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Self

from service.errors import StorageError
from service.streaming.ports import Checkpoint

APPLICATION_ID = 0x76_6D_61_70  # "vmap"
SCHEMA_VERSION = 1

_COLUMNS = "valve, estimator, key, t, state, lam, frozen"
_SELECT = f"SELECT {_COLUMNS} FROM checkpoint ORDER BY valve, estimator"  # noqa: S608 - constant
_INSERT = f"INSERT OR REPLACE INTO checkpoint ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)"  # noqa: S608
_SCHEMA = (
    """
    CREATE TABLE checkpoint (
        valve TEXT NOT NULL,
        estimator TEXT NOT NULL,
        key TEXT NOT NULL,
        t INTEGER NOT NULL,
        state BLOB NOT NULL,
        lam REAL,
        frozen INTEGER NOT NULL,
        PRIMARY KEY (valve, estimator)
    )
    """,
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {SCHEMA_VERSION}",
)
_DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


class CheckpointFile:
    """Keeps checkpoints; fulfils :class:`service.streaming.ports.CheckpointStore`.

    A save is one transaction in a write-ahead log: readers are never held up, and whatever kills
    the process, the file holds the last complete save. ``synchronous = FULL`` waits for the disk
    once per save, a few ms at an interval of seconds; what ``save`` returned from survives a power
    cut, too (with NORMAL everything since the last turn-over of the log could be gone).

    May be used from any thread, by one at a time.

    Parameters
    ----------
    path
        The file; it and its folder are made if missing.
    timeout
        How long to wait for another process's lock, s.

    Attributes
    ----------
    set_aside : Path or None
        Where a damaged file was moved when this one was opened: to be said once, and looked at.

    Raises
    ------
    StorageError
        from every method, one line naming the file: it cannot be written, is locked, full, belongs
        to another program or to a newer version.

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
        self._lock = Lock()
        with _naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._connection = _open(self.path, timeout)
            except sqlite3.DatabaseError as error:
                if not _is_damage(error):
                    raise
                self.set_aside = _set_aside(self.path)
                self._connection = _open(self.path, timeout)

    def save(self, checkpoints: Sequence[Checkpoint]) -> None:
        """Keep all of them or none; each replaces the one of the same valve and estimator."""
        rows = [(c.valve, c.estimator, c.key, c.t, c.state, c.lam, c.frozen) for c in checkpoints]
        with self._lock, _naming(self.path), _transaction(self._connection):
            self._connection.executemany(_INSERT, rows)

    def load(self) -> list[Checkpoint]:
        """Return the newest checkpoint of each (valve, estimator), in the order of these names."""
        with self._lock, _naming(self.path):
            rows = self._connection.execute(_SELECT).fetchall()
        return [
            Checkpoint(valve, estimator, key, t, state, lam, bool(frozen))
            for valve, estimator, key, t, state, lam, frozen in rows
        ]

    @property
    def size(self) -> int:
        """Bytes of the file and its log."""
        parts = (self.path, self.path.with_name(f"{self.path.name}-wal"))
        return sum(part.stat().st_size for part in parts if part.exists())

    def close(self) -> None:
        """Close the file and fold its log into it; safe to call twice."""
        with self._lock, _naming(self.path):
            self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _open(path: Path, timeout: float) -> sqlite3.Connection:
    """Open and check the file, furnish it if it is new."""
    connection = sqlite3.connect(path, timeout, isolation_level=None, check_same_thread=False)
    try:
        _check(connection, path)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        with _transaction(connection):
            if _pragma(connection, "application_id") == 0:
                for statement in _SCHEMA:
                    connection.execute(statement)
    except BaseException:
        connection.close()
        raise
    return connection


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Raise if this is not our file, before anything in it is touched."""
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    application = _pragma(connection, "application_id")
    if application != APPLICATION_ID and (application or tables):
        raise StorageError(f"{path} belongs to another program; name another checkpoint file")
    version = _pragma(connection, "user_version")
    if version > SCHEMA_VERSION:
        raise StorageError(
            f"{path} was written by a newer valvemap: its schema is {version}, "
            f"this one knows up to {SCHEMA_VERSION}"
        )
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        error = sqlite3.DatabaseError(verdict)
        error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
        raise error


def _pragma(connection: sqlite3.Connection, name: str) -> int:
    (value,) = connection.execute(f"PRAGMA {name}").fetchone()
    return int(value)


@contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # a full disk has rolled back already
            connection.execute("ROLLBACK")
        raise


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn what SQLite and the file system raise into one sentence that names the file."""
    try:
        yield
    except sqlite3.Error as error:
        raise StorageError(f"{path} cannot be used: {error}") from error
    except OSError as error:
        raise StorageError(f"{path} cannot be used: {error.strerror}") from error


def _is_damage(error: sqlite3.Error) -> bool:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in _DAMAGE


def _set_aside(path: Path) -> Path:
    """Move a damaged file and its log out of the way, under a name that is free."""
    n = 1
    while (kept := path.with_name(f"{path.name}.damaged-{n}")).exists():
        n += 1
    for companion in ("-wal", "-shm", ""):
        part = path.with_name(path.name + companion)
        if part.exists():
            part.rename(kept.with_name(kept.name + companion))
    return kept
