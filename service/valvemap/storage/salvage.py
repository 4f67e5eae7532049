"""Reads the intact part of a damaged history, block by block, the newest first.

Three B-trees of the file list each block: its table and the indexes by time and by age. Its columns
are in a fourth. All are read, from both ends, because a row lost in one may exist in another.
Columns are accepted only by their checksums, which include series and column. Times and number of
rows of a block are taken from its time column. If the first page, with header and schema, is
damaged, it is replaced by that of a new file: all our files have the same tables at the same pages.
"""

import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from valvemap.storage import alarm_changes
from valvemap.storage.history_blocks import Examined, base_of, examine, rows_in
from valvemap.storage.history_schema import FIXED, PAGE, first_page, has_header, has_tables
from valvemap.storage.sqlite_files import FIRST_PAGE, OurConnection, text

CHANGE: Final = slice(24, 28)  # in the header: change counter
SIZE: Final = slice(28, 32)  # pages of the file
FREE_PAGES: Final = slice(32, 40)  # first free page, and number of free pages
SIZE_HOLDS_FOR: Final = slice(92, 96)  # change counter for which SIZE is valid
MOST_ROWS_OF_BLOCK: Final = 10_000_000  # upper bound; a larger number is damaged
_TABLE = "SELECT id, series, rows FROM block NOT INDEXED ORDER BY id"
_BY_TIME = "SELECT id, series, first FROM block INDEXED BY by_time ORDER BY series {}, first {}"
_BY_AGE = "SELECT id, last FROM block INDEXED BY by_age ORDER BY last"
_NAMES = (
    "SELECT id, name FROM name NOT INDEXED ORDER BY id",
    "SELECT id, name FROM name INDEXED BY sqlite_autoindex_name_1 ORDER BY name",
)
_OWNERLESS = "SELECT DISTINCT block FROM part ORDER BY block"
_PARTS = "SELECT name, digest, data FROM part WHERE block = ?"
_PART = f"{_PARTS} AND name = ?"
_CHANGES = "SELECT t, owner, digest, report, checksum FROM alarm_change NOT INDEXED ORDER BY id"


@dataclass(frozen=True)
class Block:
    """A block found: its series, its valid parts, and the number of its lost rows.

    ``series`` is empty if no part is usable.
    """

    series: str
    found: Examined
    lost: int


def salvage_blocks(damaged: Path) -> Iterator[Block]:
    """Yield the blocks of a damaged file, the newest first; no process may write the file."""
    with closing(_opened(damaged)) as connection:
        names = _names(connection)
        for block, owners, said in _blocks(connection):
            rows, cut = _parts(connection, block, names)
            parts = {
                name: (digest, data)
                for number, digest, data in rows
                for name in names.get(number, ())
            }
            series = {base_of(name) for owner in owners for name in names.get(owner, ())}
            found = {name: examine(name, parts) for name in series}
            usable = [name for name in series if len(found[name].t)]
            if len(usable) != 1:  # none, or the series is ambiguous
                yield Block("", Examined.none(), _agreed([rows_in(d) for *_, d in rows], said))
                continue
            (whose,) = usable
            lacks = cut or bool(found[whose].damaged) or len(parts) < len(rows)
            yield Block(whose, found[whose], len(found[whose].t) if lacks else 0)


def _agreed(lengths: Sequence[int], said: int) -> int:
    """Return the number of rows that most columns of a block have; ``said`` if none is readable.

    >>> _agreed([200, 65_736, 200, 0], 200), _agreed([], 300), _agreed([0], 0)
    (200, 300, 1)
    """
    counted = Counter(filter(None, lengths)).most_common(1)
    return counted[0][0] if counted else said or 1


def salvage_changes(damaged: Path) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of alarm_change: t, owner, digest, report, checksum."""
    with closing(_opened(damaged)) as connection:
        yield from _both_ways(connection, _CHANGES, *alarm_changes.KINDS)


def _opened(damaged: Path) -> sqlite3.Connection:
    if not has_header(damaged) or not _knows_its_size(damaged):
        _mend_header(damaged)
    connection = _connected(damaged)
    if not has_tables(connection):
        connection.close()
        _replace_first_page(damaged)
        connection = _connected(damaged)
    return connection


def _connected(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, check_same_thread=False, factory=OurConnection)
    connection.text_factory = text
    return connection


def _mend_header(damaged: Path) -> None:
    """Restore the header fields that all our files share; a copy of the first page is kept."""
    with damaged.open("rb") as file:
        page = bytearray(file.read(PAGE))
    for own in FIXED:
        page[own] = first_page()[own]
    page[SIZE] = (damaged.stat().st_size // PAGE).to_bytes(4, "big")
    page[SIZE_HOLDS_FOR] = page[CHANGE]
    _write_first_page(damaged, page)


def _knows_its_size(path: Path) -> bool:
    with path.open("rb") as file:
        header = file.read(PAGE)
    return int.from_bytes(header[SIZE], "big") == path.stat().st_size // PAGE


def _replace_first_page(damaged: Path) -> None:
    """Write the first page of an empty file; delete the log, whose pages belong to the old one."""
    size, page = damaged.stat().st_size, bytearray(first_page())
    page[SIZE] = (size // PAGE).to_bytes(4, "big")
    page[FREE_PAGES] = bytes(8)  # none: free pages are not read
    page[SIZE_HOLDS_FOR] = page[CHANGE]
    _write_first_page(damaged, page)
    for companion in ("-wal", "-shm"):
        damaged.with_name(damaged.name + companion).unlink(missing_ok=True)


def _write_first_page(damaged: Path, page: bytearray) -> None:
    beside = damaged.with_name(f"{damaged.name}{FIRST_PAGE}")
    with damaged.open("r+b") as file:
        if not beside.exists():
            beside.write_bytes(file.read(PAGE))
            file.seek(0)
        file.write(page)


def _names(connection: sqlite3.Connection) -> dict[int, set[str]]:
    """Return the names by number; both if table and index differ."""
    names: dict[int, set[str]] = {}
    for select in _NAMES:
        for number, name in _both_ways(connection, select, int, str):
            names.setdefault(number, set()).add(name)
    return names


def _blocks(connection: sqlite3.Connection) -> Iterator[tuple[int, set[int], int]]:
    """Yield number, series and row count (0 if unknown) of each block; the newest first."""
    owners: dict[int, set[int]] = {}
    rows: dict[int, int] = {}
    for block, series, n in _both_ways(connection, _TABLE, int, int, int):
        owners.setdefault(block, set()).add(series)
        rows[block] = n if 0 < n < MOST_ROWS_OF_BLOCK else 0
    orders = (_BY_TIME.format(order, order) for order in ("ASC", "DESC"))
    for block, series, _ in _either(connection, orders, (int, int, int)):
        owners.setdefault(block, set()).add(series)
    ages = dict(_both_ways(connection, _BY_AGE, int, int))
    known = owners.keys() | ages.keys() | {n for (n,) in _both_ways(connection, _OWNERLESS, int)}
    for block in sorted(known, key=_newest(ages), reverse=True):
        yield block, owners.get(block, set()), rows.get(block, 0)


def _newest(ages: Mapping[int, int]) -> Any:  # noqa: ANN401 - a key
    return lambda block: (ages.get(block, 0), block)


def _parts(
    connection: sqlite3.Connection, block: int, names: Iterable[int]
) -> tuple[list[tuple[int, Any, Any]], bool]:
    """Return the packed columns of a block, and whether any could not be read."""
    try:
        return connection.execute(_PARTS, (block,)).fetchall(), False
    except sqlite3.Error:
        rows = []
    for number in names:
        with suppress(sqlite3.Error):
            rows += connection.execute(_PART, (block, number)).fetchall()
    return rows, True


def _both_ways(
    connection: sqlite3.Connection, select: str, *kinds: type
) -> Iterable[tuple[Any, ...]]:
    """Yield the rows of a B-tree from its start, and from its end if that is interrupted."""
    return _either(connection, (select, f"{select} DESC"), kinds)


def _either(
    connection: sqlite3.Connection, selects: Iterable[str], kinds: Sequence[type]
) -> Iterable[tuple[Any, ...]]:
    """Yield the rows whose values have the expected types."""
    found: dict[tuple[Any, ...], None] = {}
    for select in selects:
        try:
            for row in connection.execute(select):
                if all(map(isinstance, row, kinds)):
                    found[tuple(row)] = None
        except sqlite3.Error:
            continue
        break
    return list(found)
