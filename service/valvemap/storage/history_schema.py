"""The tables of the history file, and checks that a file has them unchanged."""

import sqlite3
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Final

from valvemap.storage import alarm_changes, history_age
from valvemap.storage.sqlite_files import (
    OurConnection,
    check_owner,
    damage,
    pragma,
    text,
    transaction,
)

APPLICATION_ID = 0x76_6D_61_68  # "vmah"
SCHEMA_VERSION = 3  # 1: checksums without the column's name; 2: nothing packed, no tiers
PAGE: Final = 4_096  # bytes; SQLite's default, used by all our files
HEADER: Final = 100  # bytes
FIXED: Final = (slice(0, 18), slice(20, 24), slice(44, 48), slice(56, 60), slice(68, 72))
"""Of the header: magic string and size of a page, reserved bytes and fractions, format of the
schema, encoding of texts, whose it is. https://www.sqlite.org/fileformat2.html"""
CHECKED_AT_ONCE: Final = 64_000_000  # bytes; a file up to this is checked page by page: 0.1 s
_TABLES: Final = frozenset({"name", "block", "part"})
_SCHEMA: Final = (
    "CREATE TABLE name (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE)",
    """
    CREATE TABLE block (
        id INTEGER PRIMARY KEY,
        series INTEGER NOT NULL,
        first INTEGER NOT NULL,
        last INTEGER NOT NULL,
        rows INTEGER NOT NULL
    )
    """,
    "CREATE INDEX by_time ON block (series, first)",
    "CREATE INDEX by_age ON block (last)",
    """
    CREATE TABLE part (
        block INTEGER NOT NULL,
        name INTEGER NOT NULL,
        digest INTEGER NOT NULL,
        data BLOB NOT NULL,
        PRIMARY KEY (block, name)
    ) WITHOUT ROWID
    """,
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {SCHEMA_VERSION}",
)
_OBJECTS = "SELECT type, name, tbl_name, rootpage, sql FROM sqlite_master"
_Objects = frozenset[tuple[object, ...]]
_ODD = "SELECT 1 FROM block WHERE typeof(rows) <> 'integer' OR typeof(last) <> 'integer' LIMIT 1"
_SAME = (
    (
        "SELECT id, series, first FROM block NOT INDEXED",
        "SELECT id, series, first FROM block INDEXED BY by_time",
    ),
    (
        "SELECT id, last FROM block NOT INDEXED",
        "SELECT id, last FROM block INDEXED BY by_age",
    ),
    (
        "SELECT id, name FROM name NOT INDEXED",
        "SELECT id, name FROM name INDEXED BY sqlite_autoindex_name_1",
    ),
)


def prepare(connection: sqlite3.Connection, path: Path) -> None:
    """Create the tables of a new file, or check those of an existing one.

    Raises
    ------
    StorageError
        if it belongs to another program, or to a newer version.
    DatabaseError
        if it is damaged.
    """
    if _is_ours(path) and not has_header(path):
        raise damage("its header is not as it was made")
    if check_owner(connection, path, APPLICATION_ID, SCHEMA_VERSION, _TABLES):
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        with transaction(connection):
            for statement in _SCHEMA:
                connection.execute(statement)
    elif not has_tables(connection):
        raise damage("its tables are not as they were made")
    alarm_changes.prepare(connection)
    history_age.prepare(connection)
    if pragma(connection, "user_version") != SCHEMA_VERSION:
        connection.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    _check_blocks(connection)
    if path.exists() and path.stat().st_size <= CHECKED_AT_ONCE:
        check_pages(connection)


def _check_blocks(connection: sqlite3.Connection) -> None:
    """Compare tables and their indexes."""
    if connection.execute(_ODD).fetchone():
        raise damage("a block has no number of rows")
    for table, index in _SAME:
        for one, other in ((table, index), (index, table)):
            if connection.execute(f"SELECT 1 FROM ({one} EXCEPT {other}) LIMIT 1").fetchone():  # noqa: S608
                raise damage("a table and its index contradict each other")


def check_pages(connection: sqlite3.Connection) -> None:
    """Check every page, at some 500 MB/s.

    Raises
    ------
    DatabaseError
        if a page is damaged.
    """
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise damage(str(verdict))


def has_tables(connection: sqlite3.Connection) -> bool:
    """Whether tables and indexes, except those of alarms, are at their original pages."""
    try:
        return _objects(connection) == _template()[0]
    except sqlite3.Error:
        return False


def has_header(path: Path) -> bool:
    """Whether a file starts with the header of our files."""
    with path.open("rb") as file:
        header = file.read(HEADER)
    return len(header) == HEADER and all(header[own] == first_page()[own] for own in FIXED)


def _is_ours(path: Path) -> bool:
    """Whether a header has our application id."""
    if not path.exists():
        return False
    with path.open("rb") as file:
        header = file.read(HEADER)
    return header[68:72] == APPLICATION_ID.to_bytes(4, "big")


def first_page() -> bytes:
    """Return the first page, with header and schema, of an empty file."""
    return _template()[1]


def _objects(connection: sqlite3.Connection) -> _Objects:
    found = connection.execute(_OBJECTS)
    return frozenset(
        (kind, name, page, " ".join((sql or "").split()))
        for kind, name, table, page, sql in found
        if table in _TABLES
    )


@cache
def _template() -> tuple[_Objects, bytes]:
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as connection:
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        for statement in _SCHEMA:
            connection.execute(statement)
        alarm_changes.prepare(connection)
        return _objects(connection), connection.serialize()[:PAGE]


def open_to_write(path: Path) -> sqlite3.Connection:
    """Return the writing connection to a history, with its schema."""
    connection = sqlite3.connect(
        path, isolation_level=None, check_same_thread=False, factory=OurConnection
    )
    connection.text_factory = text
    try:
        prepare(connection, path)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
    except BaseException:
        connection.close()
        raise
    return connection
