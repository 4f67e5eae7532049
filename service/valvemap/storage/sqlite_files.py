"""Our SQLite files: ownership, transactions, damage, and one-line errors."""

import sqlite3
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any, Final

from valvemap import owned_files
from valvemap.errors import StorageError

MOST_SET_ASIDE: Final = 3  # damaged files of one name; the oldest is deleted first
MOST_VERSION: Final = 1_000  # versions are small integers; a larger one is damage
_DAMAGE: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_NO_FORMAT: Final = "unsupported file format"  # damage: all our files have one format
_NO_NAME: Final = ("no such column", "no such table")  # of our own statements: a name is damaged
_COMPANIONS: Final = ("-wal", "-shm", "")
FIRST_PAGE: Final = ".first-page"  # copy of a damaged file's first page, if it was replaced
SALVAGING: Final = ".salvaging"  # marker of a damaged file that is not fully copied yet


class OurConnection(sqlite3.Connection):
    """A connection that reports every damage as SQLite's own errors do.

    Where a damaged schema is no UTF-8, Python cannot decode SQLite's message, and raises that.
    """

    def execute(self, *arguments: Any) -> sqlite3.Cursor:  # noqa: ANN401 - as of sqlite3
        """As of `sqlite3.Connection`."""
        try:
            return super().execute(*arguments)
        except UnicodeDecodeError as error:
            raise damage("malformed database schema") from error

    def executemany(self, *arguments: Any) -> sqlite3.Cursor:  # noqa: ANN401 - as of sqlite3
        """As of `sqlite3.Connection`."""
        try:
            return super().executemany(*arguments)
        except UnicodeDecodeError as error:
            raise damage("malformed database schema") from error


def check_owner(
    connection: sqlite3.Connection,
    path: Path,
    application_id: int,
    most: int,
    ours: AbstractSet[str] = frozenset(),
) -> bool:
    """Check the owner of a file; return whether it is new. ``ours`` are names of our tables.

    Raises
    ------
    StorageError
        if it belongs to another program, or is of a version above ``most``.
    DatabaseError
        if tables and header are inconsistent: the file is damaged.
    """
    found = pragma(connection, "application_id")
    select = "SELECT name FROM sqlite_master WHERE type = 'table'"
    tables = {name for (name,) in connection.execute(select)}
    if found != application_id and (found or tables):
        if tables & ours:
            raise damage(f"its application id is {found:#x}")
        raise StorageError(f"{path} belongs to another program; name another file")
    version = pragma(connection, "user_version")
    if not 0 <= version <= max(most, MOST_VERSION):
        raise damage(f"its version is {version}")
    if version > most:
        raise StorageError(
            f"{path} was written by a newer valvemap: its schema is {version}, "
            f"this one knows up to {most}"
        )
    return not found


def pragma(connection: sqlite3.Connection, name: str) -> int:
    """Return the value of a numeric PRAGMA."""
    (value,) = connection.execute(f"PRAGMA {name}").fetchone()
    return int(value)


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Run the block in one transaction; roll back on an exception."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # after a full disk SQLite has already rolled back
            connection.execute("ROLLBACK")
        raise


@contextmanager
def snapshot(connection: sqlite3.Connection) -> Iterator[None]:
    """Run the queries of the block on one state of the file."""
    connection.execute("BEGIN")
    try:
        yield
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Convert errors of SQLite and the file system to a one-line StorageError naming the file."""
    try:
        with owned_files.naming(path, "cannot be used"):
            yield
    except sqlite3.Error as error:
        raise StorageError(f"{path} cannot be used: {error}") from error


def damage(text: str) -> sqlite3.DatabaseError:
    """Return the error that SQLite raises for a damaged file."""
    error = sqlite3.DatabaseError(text)
    error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    return error


def is_damage(error: sqlite3.Error) -> bool:
    """Whether an error means a damaged file, not a locked, full or inaccessible one."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return code in _DAMAGE or str(error) == _NO_FORMAT or str(error).startswith(_NO_NAME)


def text(data: bytes) -> str:
    """Decode a text of the file; invalid bytes are replaced."""
    return data.decode("utf-8", "replace")


def set_aside(path: Path) -> Path:
    """Rename a damaged file and its log; return the new path."""
    kept = name_aside(path)
    move_aside(path, kept)
    return kept


def name_aside(path: Path) -> Path:
    """Return a free name for a damaged file, with its modification time."""
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    name = f"{path.name}.damaged-{written:%Y%m%dT%H%M%SZ}"
    names = (path.with_name(name if n == 1 else f"{name}-{n}") for n in count(1))
    return next(free for free in names if not free.exists())


def move_aside(path: Path, kept: Path) -> None:
    """Rename a damaged file and its log; keep only the newest MOST_SET_ASIDE of such files."""
    for companion in _COMPANIONS:
        part = path.with_name(path.name + companion)
        if part.exists():
            part.rename(kept.with_name(kept.name + companion))
    beside = (*_COMPANIONS[:-1], FIRST_PAGE, SALVAGING)
    before = [
        other
        for other in path.parent.glob(f"{_literally(path.name)}.damaged-*")
        if other != kept and not other.name.endswith(beside)
    ]
    before.sort(key=lambda other: other.stat().st_mtime, reverse=True)
    for old in before[MOST_SET_ASIDE - 1 :]:
        for companion in ("", *beside):
            old.with_name(old.name + companion).unlink(missing_ok=True)


def _literally(name: str) -> str:
    """Return a name with its wildcards escaped."""
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)
