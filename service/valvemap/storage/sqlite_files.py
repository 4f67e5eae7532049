"""SQLite files of our own: whose they are, transactions, and what goes wrong in one line."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from valvemap.errors import StorageError


def check_owner(connection: sqlite3.Connection, path: Path, application_id: int, most: int) -> bool:
    """See whose file it is; return whether it is new.

    Raises
    ------
    StorageError
        if it belongs to another program, or is of a version above ``most``.
    """
    found = pragma(connection, "application_id")
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if found != application_id and (found or tables):
        raise StorageError(f"{path} belongs to another program; name another file")
    version = pragma(connection, "user_version")
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
