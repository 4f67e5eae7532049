"""Persistent queue of blocks not acknowledged by the broker yet, with the source position.

Blocks and position are written in one transaction. After a crash, each sample is in exactly one
block, and each block is sent at least once; consumers detect duplicates by the block number.
"""

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Final, NamedTuple

from valvemap.storage.closing import Closing
from valvemap.storage.sqlite_files import OurConnection, check_owner, naming, transaction

APPLICATION_ID: Final = 0x76_6D_73_70  # "vmsp"
SCHEMA_VERSION: Final = 1
_SCHEMA: Final = (
    """
    CREATE TABLE block (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        name TEXT NOT NULL,
        number INTEGER NOT NULL,
        samples INTEGER NOT NULL,
        bytes INTEGER NOT NULL,
        data BLOB NOT NULL
    )
    """,
    "CREATE TABLE kept (name TEXT PRIMARY KEY, data BLOB NOT NULL) WITHOUT ROWID",
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {SCHEMA_VERSION}",
)
_AT_ONCE: Final = 100  # blocks of one read


@dataclass(frozen=True)
class Packed:
    """An encoded block of a group, its number, and its number of samples."""

    group: str
    number: int
    samples: int
    data: bytes


class Waiting(NamedTuple):
    """A block in the queue."""

    id: int
    group: str
    data: bytes


class GivenUp(NamedTuple):
    """Blocks and samples dropped by a save."""

    blocks: int = 0
    samples: int = 0


class Spool(Closing):
    """Blocks in order of creation; thread-safe.

    Parameters
    ----------
    path
        The file; it and its folder are created if missing. Only one process can open it.
    most_bytes
        Capacity. On overflow, the oldest blocks are dropped, except those in flight.

    Raises
    ------
    StorageError
        from every method, one line naming the file.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "north.sqlite"
    >>> with Spool(path, 1_000) as spool:
    ...     _ = spool.save([Packed("north.0", 1, 20, b"block")], {"position": b"p"})
    >>> with Spool(path, 1_000) as spool:
    ...     [(one.group, one.data) for one in spool.take(10)], spool.kept()
    ([('north.0', b'block')], {'position': b'p'})
    """

    def __init__(self, path: Path, most_bytes: int) -> None:
        self.path = path
        self.most_bytes = most_bytes
        self._lock = Lock()
        self._taken = 0  # id of the last block in flight
        with naming(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._connection = _open(path)
            found = self._connection.execute("SELECT count(*), coalesce(sum(bytes), 0) FROM block")
            self.blocks, self.bytes = found.fetchone()

    def save(self, blocks: Sequence[Packed], kept: Mapping[str, bytes]) -> GivenUp:
        """Add blocks and the source state in one durable transaction.

        Returns the blocks dropped on overflow.
        """
        with self._lock, naming(self.path):
            before = self.blocks, self.bytes
            try:
                self._connection.execute("PRAGMA synchronous = FULL")  # durable before it is sent
                with transaction(self._connection):
                    self._insert(blocks)
                    self._connection.executemany(
                        "INSERT OR REPLACE INTO kept VALUES (?, ?)", list(kept.items())
                    )
                    given_up = self._make_room()
            except BaseException:
                self.blocks, self.bytes = before
                raise
            return given_up

    def kept(self) -> dict[str, bytes]:
        """Return the source state of the last save."""
        with self._lock, naming(self.path):
            return dict(self._connection.execute("SELECT name, data FROM kept").fetchall())

    def take(self, most_bytes: int) -> list[Waiting]:
        """Take the next blocks to send, about ``most_bytes`` in total."""
        found, left = [], most_bytes
        with self._lock, naming(self.path):
            rows = self._connection.execute(
                "SELECT id, name, data FROM block WHERE id > ? ORDER BY id LIMIT ?",
                (self._taken, _AT_ONCE),
            )
            for row in rows:
                if left <= 0:
                    break
                found.append(Waiting(*row))
                left -= len(found[-1].data)
            rows.close()
            if found:
                self._taken = found[-1].id
        return found

    def take_again(self) -> None:
        """Restart at the oldest block in the queue."""
        with self._lock:
            self._taken = 0

    def note_sent(self, ids: Sequence[int]) -> None:
        """Delete acknowledged blocks, without waiting for the disk."""
        with self._lock, naming(self.path):
            self._connection.execute("PRAGMA synchronous = NORMAL")
            with transaction(self._connection):
                for id_ in ids:
                    found = self._connection.execute("SELECT bytes FROM block WHERE id = ?", (id_,))
                    for (size,) in found.fetchall():
                        self._connection.execute("DELETE FROM block WHERE id = ?", (id_,))
                        self.blocks, self.bytes = self.blocks - 1, self.bytes - size

    def close(self) -> None:
        """Close the file; idempotent."""
        with self._lock, naming(self.path):
            self._connection.close()

    def _insert(self, blocks: Sequence[Packed]) -> None:
        self._connection.executemany(
            "INSERT INTO block (name, number, samples, bytes, data) VALUES (?, ?, ?, ?, ?)",
            [(one.group, one.number, one.samples, len(one.data), one.data) for one in blocks],
        )
        self.blocks += len(blocks)
        self.bytes += sum(len(one.data) for one in blocks)

    def _make_room(self) -> GivenUp:
        blocks = samples = last = 0
        rows = self._connection.execute(
            "SELECT id, bytes, samples FROM block WHERE id > ? ORDER BY id", (self._taken,)
        )
        for id_, size, n in rows:
            if self.bytes <= self.most_bytes:
                break
            last, blocks, samples = id_, blocks + 1, samples + n
            self.blocks, self.bytes = self.blocks - 1, self.bytes - size
        rows.close()
        if blocks:
            self._connection.execute(
                "DELETE FROM block WHERE id > ? AND id <= ?", (self._taken, last)
            )
        return GivenUp(blocks, samples)


def _open(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(
        path, timeout=0.0, isolation_level=None, check_same_thread=False, factory=OurConnection
    )
    try:
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")  # no second collector
        connection.execute("PRAGMA journal_mode = WAL")
        new = check_owner(connection, path, APPLICATION_ID, SCHEMA_VERSION)
        with transaction(connection):  # locks the file
            for statement in _SCHEMA if new else ():
                connection.execute(statement)
    except BaseException:
        connection.close()
        raise
    return connection
