"""Changes of alarms in the history file, one row each, limited in age and number."""

import json
import sqlite3
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from itertools import islice
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from valvemap.pipeline.alarm_results import AlarmChange, AlarmReport

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
_REPORTS: Final = TypeAdapter(AlarmReport)
_LARGEST: Final = 1 << 63
MOST_SEVERE: Final = 1_000  # Part 5, 6.4.2


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
    reports = ((row, _report(row[3])) for row in rows if is_whole(row))
    whole = (AlarmChange(row[1], row[0], report) for row, report in reports if report is not None)
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


def _report(text: str) -> AlarmReport | None:
    """Return the stored report; None if it is none, although its checksum is correct."""
    try:
        found = _REPORTS.validate_json(text, strict=True)
    except ValidationError:
        return None
    numbers = found.since, found.at, found.commented, found.count, found.ended
    known = all(0 <= number < _LARGEST for number in numbers)
    return found if known and 1 <= found.severity <= MOST_SEVERE else None
