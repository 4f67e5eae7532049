"""How long the history has been written, independent of any clock: rows age while it is open.

A file's time is the sum of the monotonic time during which it was open. Marks relate it to the
order of rows: all blocks and alarm changes up to these numbers were there at that time. A clock
that steps, at the source or here, therefore drops nothing.
"""

import sqlite3
from typing import Final, NamedTuple

_SCHEMA: Final = """
    CREATE TABLE IF NOT EXISTS written (
        ran_s REAL PRIMARY KEY,
        block INTEGER NOT NULL,
        change INTEGER NOT NULL
    )
    """
_NEWEST: Final = (
    "SELECT ifnull((SELECT max(id) FROM block), 0), ifnull((SELECT max(id) FROM alarm_change), 0)"
)


class Mark(NamedTuple):
    """The newest block and alarm change at a time of the file, s."""

    ran_s: float
    block: int
    change: int


def prepare(connection: sqlite3.Connection) -> None:
    """Create the table if it does not exist."""
    connection.execute(_SCHEMA)


def ran_s(connection: sqlite3.Connection) -> float:
    """Return the file's time at the last mark, s; 0 of a new file."""
    (found,) = connection.execute("SELECT max(ran_s) FROM written").fetchone()
    return float(found or 0.0)


def since_s(connection: sqlite3.Connection, block: int) -> float:
    """Return the file's time at the oldest mark that has a block, s; 0 of none."""
    select = "SELECT min(ran_s) FROM written WHERE block >= ?"
    (found,) = connection.execute(select, (block,)).fetchone()
    return float(found or 0.0)


def mark(connection: sqlite3.Connection, now_s: float) -> None:
    """Note that all present rows were there at this time; drop the marks of dropped blocks."""
    newest = connection.execute(_NEWEST).fetchone()
    connection.execute("DELETE FROM written WHERE block < (SELECT min(id) FROM block)")
    connection.execute("INSERT OR REPLACE INTO written VALUES (?, ?, ?)", (now_s, *newest))


def expired(connection: sqlite3.Connection, before_s: float) -> Mark | None:
    """Return the newest mark that is not after a time of the file."""
    select = "SELECT ran_s, block, change FROM written WHERE ran_s <= ? ORDER BY ran_s DESC LIMIT 1"
    found = connection.execute(select, (before_s,)).fetchone()
    return None if found is None else Mark(*found)


def forget_before(connection: sqlite3.Connection, mark: Mark) -> None:
    """Delete the marks before one."""
    connection.execute("DELETE FROM written WHERE ran_s < ?", (mark.ran_s,))
