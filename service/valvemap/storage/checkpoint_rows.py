"""Rows of the file of checkpoints: their schema, digests and migration."""

import hashlib
import sqlite3
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Final, NamedTuple, Self

from valvemap.pipeline.meaning import UNREADABLE, digest_of
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage.sqlite_files import OurConnection, text

APPLICATION_ID: Final = 0x76_6D_61_70  # "vmap"
SCHEMA_VERSION: Final = 3
OLDEST_VERSION: Final = 2  # that can be migrated

_DIGEST_BYTES = 16
_MOST_ROWS = 1_000_000  # limit on the row ids tried in a damaged file
_BEFORE_3 = "valve, estimator, generation, saved, key, t, state, lam, frozen, digest"
_COLUMNS = "valve, estimator, generation, saved, key, t, state, lam, frozen, meaning, digest"
_ASIDE = "valve, estimator, generation, saved, key, t, state, lam, frozen, meaning, digest, reason"

SELECT: Final = f"SELECT {_COLUMNS} FROM checkpoint"  # noqa: S608 - constant, as all below
SELECT_ASIDE: Final = f"SELECT id, {_ASIDE} FROM aside ORDER BY id"  # noqa: S608
INSERT: Final = f"INSERT OR REPLACE INTO checkpoint ({_COLUMNS}) VALUES ({', '.join('?' * 11)})"  # noqa: S608
INSERT_ASIDE: Final = f"INSERT INTO aside ({_ASIDE}) VALUES ({', '.join('?' * 12)})"  # noqa: S608
INSERT_MEANING: Final = "INSERT OR REPLACE INTO meaning (id, said) VALUES (?, ?)"
DELETE: Final = "DELETE FROM checkpoint WHERE valve = ? AND estimator = ?"
DELETE_ASIDE: Final = "DELETE FROM aside WHERE id = ?"
FORGET_MEANINGS: Final = (
    "DELETE FROM meaning WHERE id NOT IN (SELECT meaning FROM checkpoint UNION SELECT meaning "
    "FROM aside)"
)

_CHECKPOINT = """
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
        meaning TEXT NOT NULL DEFAULT '',
        PRIMARY KEY (valve, estimator, generation)
    )
    """
_SINCE_3 = (
    "CREATE TABLE meaning (id TEXT PRIMARY KEY, said TEXT NOT NULL) WITHOUT ROWID",
    "CREATE TABLE identity (id TEXT NOT NULL)",
    "INSERT INTO identity VALUES (lower(hex(randomblob(16))))",
    """
    CREATE TABLE aside (
        id INTEGER PRIMARY KEY,
        valve TEXT NOT NULL,
        estimator TEXT NOT NULL,
        generation INTEGER NOT NULL,
        saved INTEGER NOT NULL,
        key TEXT NOT NULL,
        t INTEGER NOT NULL,
        state BLOB NOT NULL,
        lam REAL,
        frozen INTEGER NOT NULL,
        meaning TEXT NOT NULL,
        digest BLOB NOT NULL,
        reason TEXT NOT NULL
    )
    """,
    f"PRAGMA user_version = {SCHEMA_VERSION}",
)
SCHEMA: Final = (_CHECKPOINT, *_SINCE_3, f"PRAGMA application_id = {APPLICATION_ID}")
TABLES: Final = frozenset({"checkpoint", "meaning", "identity", "aside"})


class Row(NamedTuple):
    """One row; a damaged row may hold any values. ``meaning`` is the digest of its text."""

    valve: str
    estimator: str
    generation: int
    saved: int
    key: str
    t: int
    state: bytes
    lam: float | None
    frozen: int
    meaning: str
    digest: bytes

    @classmethod
    def of(cls, c: Checkpoint, generation: int, saved: int) -> Self:
        """Return the row of a checkpoint."""
        lam, frozen, meaning = c.lam, int(c.frozen), digest_of(c.meaning)
        row = cls(
            *(c.valve, c.estimator, generation, saved, c.key, c.t, c.state, lam, frozen, meaning),
            digest=b"",
        )
        return row.signed()

    @property
    def name(self) -> tuple[str, str]:
        """Valve and estimator."""
        return self.valve, self.estimator

    def signed(self) -> Self:
        """Return the row with its digest."""
        return self._replace(digest=self._digest(self.meaning))

    def is_whole(self) -> bool:
        """Whether the digest is right."""
        return isinstance(self.state, bytes) and self.digest == self._digest(self.meaning)

    def was_whole(self) -> bool:
        """As `is_whole`, by the digest of schema 2."""
        return isinstance(self.state, bytes) and self.digest == self._digest()

    def checkpoint(self, meanings: Mapping[str, str]) -> Checkpoint:
        """Return the checkpoint; ``meanings`` are the readable ones by digest."""
        return Checkpoint(
            valve=self.valve,
            estimator=self.estimator,
            key=self.key,
            t=self.t,
            state=self.state,
            lam=self.lam,
            frozen=bool(self.frozen),
            meaning=meanings.get(self.meaning, f"{UNREADABLE}{self.meaning}"),
        )

    def _digest(self, *of: str) -> bytes:
        said = repr((*self[:6], self.lam, self.frozen, *of)).encode("utf-8", "replace")
        digest = hashlib.blake2b(said, digest_size=_DIGEST_BYTES)
        digest.update(self.state)
        return digest.digest()


class SetAside(NamedTuple):
    """A state that is set aside: its number in the file, and why."""

    number: int
    checkpoint: Checkpoint
    reason: str


def check_columns(connection: sqlite3.Connection) -> None:
    """Raise sqlite3.OperationalError if a table or a column has another name."""
    for select in (SELECT, f"SELECT {_ASIDE} FROM aside", "SELECT id, said FROM meaning"):  # noqa: S608
        connection.execute(f"{select} LIMIT 0")
    connection.execute("SELECT id FROM identity LIMIT 0")


def meanings_in(connection: sqlite3.Connection) -> dict[str, str]:
    """Return the texts of the meanings by their digests, without damaged ones."""
    rows = connection.execute("SELECT id, said FROM meaning").fetchall()
    return {"": "", **{id_: said for id_, said in rows if id_ == digest_of(str(said))}}


def identity_in(connection: sqlite3.Connection) -> str:
    """Return the random name that the file got when it was made."""
    found = connection.execute("SELECT id FROM identity").fetchone()
    return "" if found is None else str(found[0])


def identity_of(path: Path) -> str:
    """As `identity_in`, of the file at a path; empty if it is none of ours."""
    try:
        with closing(read_only(path)) as connection:
            return identity_in(connection)
    except sqlite3.Error:
        return ""


def migrate(connection: sqlite3.Connection) -> None:
    """Bring a file of schema 2 to the present one, in the transaction of the caller.

    Rows keep their states; their meaning is unknown.
    """
    connection.execute("ALTER TABLE checkpoint ADD COLUMN meaning TEXT NOT NULL DEFAULT ''")
    rows = [Row(*row) for row in connection.execute(SELECT).fetchall()]
    connection.executemany(INSERT, [row.signed() for row in rows if row.was_whole()])
    for statement in _SINCE_3:
        connection.execute(statement)


def salvaged(path: Path) -> tuple[list[Row], dict[str, str]]:
    """Return the rows of a damaged file that are readable and whole, and their meanings."""
    rows, meanings = [], {"": ""}
    with suppress(sqlite3.Error, TypeError), closing(read_only(path)) as damaged:
        with suppress(sqlite3.Error):
            meanings = meanings_in(damaged)
        (last,) = damaged.execute("SELECT max(rowid) FROM checkpoint").fetchone()
        for number in range(1, min(last or 0, _MOST_ROWS) + 1):
            with suppress(sqlite3.Error):
                found = _row_of_any_version(damaged, number)
                if found is not None:
                    rows.append(found)
    return rows, meanings


def _row_of_any_version(connection: sqlite3.Connection, number: int) -> Row | None:
    """Return a whole row in the present form; None if it is not whole."""
    try:
        found = connection.execute(f"{SELECT} WHERE rowid = ?", (number,)).fetchone()
        row = None if found is None else Row(*found)
        return row if row is not None and row.is_whole() else None
    except sqlite3.OperationalError:  # there is no such column before schema 3
        select = f"SELECT {_BEFORE_3} FROM checkpoint WHERE rowid = ?"  # noqa: S608
        found = connection.execute(select, (number,)).fetchone()
        row = None if found is None else Row(*(*found[:9], "", found[9]))
        return row.signed() if row is not None and row.was_whole() else None


def whole_rows(connection: sqlite3.Connection, version: int) -> list[Row]:
    """Return the whole rows of a file of any version, in the present form."""
    if version < SCHEMA_VERSION:
        found = connection.execute(f"SELECT {_BEFORE_3} FROM checkpoint").fetchall()  # noqa: S608
        before = [Row(*(*row[:9], "", row[9])) for row in found]
        return [row.signed() for row in before if row.was_whole()]
    rows = [Row(*row) for row in connection.execute(SELECT).fetchall()]
    return [row for row in rows if row.is_whole()]


def aside_in(connection: sqlite3.Connection, meanings: Mapping[str, str]) -> list[SetAside]:
    """Return the states that are set aside, the oldest first."""
    found = connection.execute(SELECT_ASIDE).fetchall()
    rows = [(number, Row(*row[:-1]), str(row[-1])) for number, *row in found]
    return [
        SetAside(number, row.checkpoint(meanings), reason)
        for number, row, reason in rows
        if row.is_whole()
    ]


def read_only(path: Path) -> sqlite3.Connection:
    """Open a file without changing it."""
    name = f"{path.absolute().as_uri()}?mode=ro"  # any character may be in it
    connection = sqlite3.connect(name, uri=True, factory=OurConnection)
    connection.text_factory = text
    return connection
