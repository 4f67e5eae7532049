"""SQLite files of our own: whose they are, transactions, damage, and errors in one line."""

import sqlite3
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Final

from valvemap.errors import StorageError

MOST_SET_ASIDE: Final = 3  # damaged files of one name; the oldest goes first
MOST_VERSION: Final = 1_000  # versions are counted one by one: beyond, it is a flipped bit
_DAMAGE: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_NO_FORMAT: Final = "unsupported file format"  # a flipped bit: there is none but ours
_COMPANIONS: Final = ("-wal", "-shm", "")
FIRST_PAGE: Final = ".first-page"  # of a damaged file, where another took its place
SALVAGING: Final = ".salvaging"  # beside a damaged file of which not all is taken over yet


def check_owner(
    connection: sqlite3.Connection,
    path: Path,
    application_id: int,
    most: int,
    ours: AbstractSet[str] = frozenset(),
) -> bool:
    """See whose file it is; return whether it is new. ``ours`` are tables that only we make.

    Raises
    ------
    StorageError
        if it belongs to another program, or is of a version above ``most``.
    DatabaseError
        if tables and header contradict each other: it is damaged.
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
    """Value of a setting that is a number."""
    (value,) = connection.execute(f"PRAGMA {name}").fetchone()
    return int(value)


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """All or nothing."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # a full disk has rolled back already
            connection.execute("ROLLBACK")
        raise


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what SQLite and the file system raise into one sentence that names the file."""
    try:
        yield
    except sqlite3.Error as error:
        raise StorageError(f"{path} cannot be used: {error}") from error
    except OSError as error:
        raise StorageError(f"{path} cannot be used: {error.strerror}") from error


def damage(text: str) -> sqlite3.DatabaseError:
    """Return the error that SQLite raises for a damaged file."""
    error = sqlite3.DatabaseError(text)
    error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    return error


def is_damage(error: sqlite3.Error) -> bool:
    """Whether the file itself is damaged, rather than locked, full or out of reach."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return code in _DAMAGE or str(error) == _NO_FORMAT


def text(data: bytes) -> str:
    """Return a text as the file has it; of a damaged one what can be read."""
    return data.decode("utf-8", "replace")


def set_aside(path: Path) -> Path:
    """Move a damaged file and its log out of the way; return where it is now."""
    kept = name_aside(path)
    move_aside(path, kept)
    return kept


def name_aside(path: Path) -> Path:
    """Return a free name for a damaged file, which says when it was last written."""
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    name = f"{path.name}.damaged-{written:%Y%m%dT%H%M%SZ}"
    names = (path.with_name(name if n == 1 else f"{name}-{n}") for n in count(1))
    return next(free for free in names if not free.exists())


def move_aside(path: Path, kept: Path) -> None:
    """Rename a damaged file and its log; of many the newest MOST_SET_ASIDE are kept."""
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
    """A name in which no letter is a wildcard."""
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)
