"""Changes of alarms in the history file, one row each, limited in age and number."""

import json
import sqlite3
import zlib
from collections.abc import Sequence
from dataclasses import asdict, fields
from itertools import islice
from typing import Any, Final

from valvemap.pipeline.ports import AlarmChange, AlarmReport

MOST_CHANGES: Final = 100_000  # rows; some 50 MB; the oldest are dropped first
_SCHEMA = (
    """
    CREATE TABLE IF NOT EXISTS alarm_change (
        id INTEGER PRIMARY KEY,
        t INTEGER NOT NULL,
        owner TEXT NOT NULL,
        digest TEXT NOT NULL,
        report TEXT NOT NULL,
        checksum INTEGER NOT NULL,
        UNIQUE (t, owner, digest)
    )
    """,
    "CREATE INDEX IF NOT EXISTS alarm_change_of ON alarm_change (owner, t)",
)
KINDS: Final = (int, str, str, str, int)  # of t, owner, digest, report, checksum
_KNOWN = frozenset(field.name for field in fields(AlarmReport))


def prepare(connection: sqlite3.Connection) -> None:
    """Create the table if it does not exist."""
    for statement in _SCHEMA:
        connection.execute(statement)


def insert(connection: sqlite3.Connection, changes: Sequence[AlarmChange]) -> None:
    """Insert changes; skip those already stored."""
    rows = []
    for change in changes:
        report = json.dumps(asdict(change.report))
        row = change.t, change.owner, _digest(change.report), report, _checksum(report)
        rows.append(row)
    connection.executemany(
        "INSERT OR IGNORE INTO alarm_change (t, owner, digest, report, checksum) "
        "VALUES (?, ?, ?, ?, ?)",
        rows,
    )


def select(
    connection: sqlite3.Connection,
    owner: str | None,
    span: tuple[int, int],
    *,
    backwards: bool,
    skip: int,
    most: int,
) -> list[AlarmChange]:
    """Return the changes within a span (UTC ns, both ends included); damaged rows are skipped."""
    whose, values = ("", ()) if owner is None else ("owner = ? AND ", (owner,))
    order = "DESC" if backwards else "ASC"
    rows = connection.execute(
        f"SELECT t, owner, digest, report, checksum FROM alarm_change "  # noqa: S608
        f"WHERE {whose}t BETWEEN ? AND ? ORDER BY t {order}, id",
        (*values, *span),
    )
    whole = (AlarmChange(row[1], row[0], _report(row[3])) for row in rows if is_whole(row))
    return list(islice(whole, skip, skip + most))


def is_whole(row: Sequence[Any]) -> bool:
    """Whether the checksum of a row (t, owner, digest, report, checksum) is correct."""
    *_, report, checksum = row
    return all(map(isinstance, row, KINDS)) and _checksum(report) == checksum


def forget(connection: sqlite3.Connection, until: int) -> None:
    """Drop rows up to a number, and the first ones above the limit."""
    connection.execute("DELETE FROM alarm_change WHERE id <= ?", (until,))
    excess = "SELECT id FROM alarm_change ORDER BY id DESC LIMIT -1 OFFSET ?"
    connection.execute(f"DELETE FROM alarm_change WHERE id IN ({excess})", (MOST_CHANGES,))  # noqa: S608


def _digest(report: AlarmReport) -> str:
    """Return a digest that distinguishes two changes of the same time."""
    stands = (report.active, report.acked, report.confirmed)
    return f"{report.name} {report.count} {stands} {report.commented}"


def _checksum(text: str) -> int:
    return zlib.crc32(text.encode("utf-8", "replace"))


def _report(text: str) -> AlarmReport:
    said = json.loads(text)
    return AlarmReport(**{name: value for name, value in said.items() if name in _KNOWN})
