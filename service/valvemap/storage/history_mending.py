"""Repair of a history: checks blocks in place, or copies them from a damaged file."""

import sqlite3
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from valvemap.storage import alarm_changes
from valvemap.storage.history_blocks import (
    SEALED,
    Parts,
    T,
    chosen,
    examine,
    insert,
    rows_in,
    unpack,
)
from valvemap.storage.history_cells import width_of
from valvemap.storage.salvage import Block, salvage_blocks, salvage_changes
from valvemap.storage.sqlite_files import SALVAGING

CHANGES_AT_ONCE: Final = 100  # alarm changes per step, some 10 us each

_NEXT = (
    "SELECT id, series, first, last, rows FROM block WHERE id > ? AND id <= ? ORDER BY id LIMIT 1"
)
_PARTS = "SELECT name, digest, data FROM part WHERE block = ?"
_BETWEEN = "SELECT block, data FROM part WHERE block > ? AND block < ?"
_DROP = "DELETE FROM part WHERE block = ? AND name = ?"
_UPDATE = "UPDATE block SET first = ?, last = ?, rows = ? WHERE id = ?"
_OVERLAP = (
    "SELECT data FROM block JOIN part ON part.block = block.id "
    "WHERE series IN (?, ?) AND first <= ? AND last >= ? AND name = ?"
)
_CHANGE = (
    "INSERT OR IGNORE INTO alarm_change (t, owner, digest, report, checksum) VALUES (?, ?, ?, ?, ?)"
)


@dataclass(frozen=True)
class Checked:
    """The lost rows of a block, and its series; empty if unknown."""

    lost: int = 0
    series: str = ""


@dataclass(frozen=True)
class Taken:
    """The copied and the lost rows of a block."""

    rows: int = 0
    lost: int = 0


def check_blocks(
    connection: sqlite3.Connection, names: Mapping[str, int]
) -> Generator[Checked, None, None]:
    """Check each block; yield how many of its rows are lost.

    Damaged columns are dropped, and blocks without times entirely. The block table is corrected if
    it contradicts the rows of a block.
    """
    numbers = {number: name for name, number in names.items()}
    (newest,) = connection.execute("SELECT max(id) FROM block").fetchone()
    block = -(2**63)
    while row := connection.execute(_NEXT, (block, newest)).fetchone():
        strays = dict[int, int]()
        for stray, data in connection.execute(_BETWEEN, (block, row[0])):
            strays[stray] = max(strays.get(stray, 0), rows_in(data))
        for stray, rows in strays.items():
            _delete_parts(connection, stray)
            yield Checked(rows)
        block, owner, first, last, rows = row
        stored = connection.execute(_PARTS, (block,)).fetchall()
        known = {n: numbers[n] for n, *_ in stored if n in numbers}
        parts: Parts = {known[n]: (digest, data) for n, digest, data in stored if n in known}
        found = examine(numbers.get(owner, ""), parts)
        n = len(found.t)
        dropped = [p for p, *_ in stored if p not in known or known[p] in found.damaged]
        connection.executemany(_DROP, [(block, p) for p in dropped])
        if not n:
            connection.execute("DELETE FROM block WHERE id = ?", (block,))
            _delete_parts(connection, block)
        elif (first, last, rows) != (true := (int(found.t[0]), int(found.t[-1]), n)):
            connection.execute(_UPDATE, (*true, block))
        lost = 0 if n and not dropped else n or max(rows, 1)
        yield Checked(lost, numbers.get(owner, ""))


def take_over(
    connection: sqlite3.Connection, damaged: Path, number: Callable[[str], int]
) -> Generator[Taken, None, None]:
    """Copy the readable blocks of a damaged file, one per step.

    Rows that exist in the new file are kept: they were saved since, or copied before a kill.

    Parameters
    ----------
    connection
        Connection to the new file, within a transaction.
    number
        Returns the number of a name in the new file.
    """
    for block in salvage_blocks(damaged):
        yield _take_over(connection, block, number)
    changes = []
    for change in salvage_changes(damaged):
        changes.append(change)
        if len(changes) == CHANGES_AT_ONCE:
            yield _note(connection, changes)
            changes = []
    yield _note(connection, changes)


def _delete_parts(connection: sqlite3.Connection, block: int) -> None:
    """Delete all columns of a block: a damaged key hides those behind it from the first search."""
    while connection.execute("DELETE FROM part WHERE block = ?", (block,)).rowcount:
        pass


def _take_over(connection: sqlite3.Connection, block: Block, number: Callable[[str], int]) -> Taken:
    if not block.series:
        return Taken(lost=block.lost)
    found = block.found
    both = number(block.series), number(block.series + SEALED)
    span = *both, int(found.t[-1]), int(found.t[0])
    known = [unpack(T, data) for (data,) in connection.execute(_OVERLAP, (*span, number(T)))]
    if known:
        found = chosen(found, ~np.isin(found.t, np.concatenate(known)))
    if not len(found.t):
        return Taken(lost=block.lost)
    (lowest,) = connection.execute("SELECT min(id) FROM block").fetchone()
    before_all = 0 if lowest is None else lowest - 1  # blocks come newest first
    insert(connection, block.series, found.t, found.parts, number, before_all)
    return Taken(0 if width_of(block.series) else len(found.t), block.lost)


def _note(connection: sqlite3.Connection, changes: list[tuple[object, ...]]) -> Taken:
    """Store changes of alarms; skip damaged ones."""
    whole = [change for change in changes if alarm_changes.is_whole(change)]
    connection.executemany(_CHANGE, whole)
    return Taken(lost=len(changes) - len(whole))


def set_aside_before(path: Path) -> list[tuple[Path, Path]]:
    """Return files set aside that are not fully copied, each with its marker; newest first."""
    markers = [
        marker
        for marker in path.parent.iterdir()
        if marker.name.startswith(f"{path.name}.damaged-") and marker.name.endswith(SALVAGING)
    ]
    found = [(marker, marker.with_name(marker.name.removesuffix(SALVAGING))) for marker in markers]
    return sorted((pair for pair in found if pair[1].exists()), reverse=True)
