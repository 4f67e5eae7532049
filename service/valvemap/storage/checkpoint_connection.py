"""The connection to a file of checkpoints: its schema is checked, its log folded into the file."""

import sqlite3
from pathlib import Path

from valvemap.storage import checkpoint_rows as rows_of
from valvemap.storage.checkpoint_rows import APPLICATION_ID, SCHEMA_VERSION
from valvemap.storage.sqlite_files import (
    OurConnection,
    check_owner,
    damage,
    pragma,
    text,
    transaction,
)

_LOG_HEADER, _FRAME_HEADER = 32, 24  # bytes, of a write-ahead log


def open_checkpoints(path: Path, timeout: float) -> sqlite3.Connection:
    """Open and check the file; create the tables of a new one."""
    connection = sqlite3.connect(
        path,
        timeout=timeout,
        isolation_level=None,
        check_same_thread=False,
        factory=OurConnection,
    )
    try:
        connection.text_factory = text
        _check(connection, path)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        with transaction(connection):
            if pragma(connection, "application_id") == 0:
                for statement in rows_of.SCHEMA:
                    connection.execute(statement)
            elif pragma(connection, "user_version") < SCHEMA_VERSION:
                rows_of.migrate(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def frames_in_log(path: Path) -> int:
    """Return the number of frames of a write-ahead log, by its size."""
    log = path.with_name(f"{path.name}-wal")
    if not log.exists() or log.stat().st_size < _LOG_HEADER:
        return 0
    with log.open("rb") as file:
        page = int.from_bytes(file.read(12)[8:], "big") or 4096
    return (log.stat().st_size - _LOG_HEADER) // (_FRAME_HEADER + page)


def fold_log(connection: sqlite3.Connection) -> int:
    """Write the log's pages into the file; return their number."""
    _, pages, _ = connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    return max(int(pages), 0)


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Raise if the file belongs to another program, before it is changed."""
    is_new = check_owner(connection, path, APPLICATION_ID, SCHEMA_VERSION, rows_of.TABLES)
    version = pragma(connection, "user_version")
    if not is_new and version < rows_of.OLDEST_VERSION:
        raise damage(f"it is of format {version}, this one writes {SCHEMA_VERSION}")
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise damage(str(verdict))
    if version == SCHEMA_VERSION:
        rows_of.check_columns(connection)
