"""Reads a file of checkpoints that a service may be using, and writes one to hand over."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from valvemap.errors import NoSuchFile, StorageError
from valvemap.pipeline.meaning import digest_of
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage import checkpoint_rows as rows_of
from valvemap.storage.checkpoint_rows import Row
from valvemap.storage.sqlite_files import OurConnection, naming, pragma, text, transaction


def read_states(
    path: Path, made_by: str = "valvemap serve"
) -> tuple[list[Checkpoint], list[rows_of.SetAside]]:
    """Return the newest whole state of each name, and the states that are set aside.

    Raises
    ------
    NoSuchFile
        if it is not there.
    StorageError
        naming the file: it cannot be read, or is no state file.
    """
    if not path.is_file():
        raise NoSuchFile(f"{path}: no such file; `{made_by}` makes it")
    with naming(path), closing(rows_of.read_only(path)) as connection:
        connection.text_factory = text
        if pragma(connection, "application_id") != rows_of.APPLICATION_ID:
            raise StorageError(f"{path} is no state file of valvemap")
        version = pragma(connection, "user_version")
        if not rows_of.OLDEST_VERSION <= version <= rows_of.SCHEMA_VERSION:
            raise StorageError(
                f"{path}: its schema is {version}; this valvemap reads {rows_of.OLDEST_VERSION} to "
                f"{rows_of.SCHEMA_VERSION}"
            )
        newest: dict[tuple[str, str], Row] = {}
        for row in rows_of.whole_rows(connection, version):
            if row.name not in newest or newest[row.name].saved < row.saved:
                newest[row.name] = row
        if version < rows_of.SCHEMA_VERSION:
            return [newest[name].checkpoint({"": ""}) for name in sorted(newest)], []
        meanings = rows_of.meanings_in(connection)
        states = [newest[name].checkpoint(meanings) for name in sorted(newest)]
        return states, rows_of.aside_in(connection, meanings)


def write_states(path: Path, checkpoints: Sequence[Checkpoint]) -> None:
    """Write checkpoints to a new file, which `read_states` and the service can read.

    Raises
    ------
    StorageError
        naming the file.
    """
    opened = closing(sqlite3.connect(path, isolation_level=None, factory=OurConnection))
    with naming(path), opened as connection, transaction(connection):
        for statement in rows_of.SCHEMA:
            connection.execute(statement)
        meanings = {digest_of(one.meaning): one.meaning for one in checkpoints}
        connection.executemany(rows_of.INSERT_MEANING, meanings.items())
        connection.executemany(rows_of.INSERT, [Row.of(one, 0, 1) for one in checkpoints])
