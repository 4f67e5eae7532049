"""What signals and results have been, in one SQLite file: columns in blocks of successive rows."""

import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Times
from valvemap.pipeline.ports import AlarmChange, Past, Piece
from valvemap.storage import alarm_changes
from valvemap.storage.closing import Closing
from valvemap.storage.sqlite_files import check_owner, naming, pragma, transaction

APPLICATION_ID = 0x76_6D_61_68  # "vmah"
SCHEMA_VERSION = 1
BLOCK: Final = 4_096  # rows of a block that is full: 41 s of 100 Hz, 32 kB of each column
_PAGES_AT_ONCE = 1_000  # given back to the disk in one go
_SCHEMA = (
    "PRAGMA auto_vacuum = INCREMENTAL",
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
_T, _CODES = "t", "codes"


@dataclass
class _Series:
    """What is known of a series while it is written: its number, its last row, its small blocks."""

    number: int
    last: int
    small: list[int] = field(default_factory=list)
    rows: int = 0


class _Block(NamedTuple):
    id: int
    first: int
    last: int
    rows: int


class HistoryFile(Closing):
    """Keeps pieces of series, and gives back what they were.

    A series is a table of successive rows: a time, a status code and some columns. Rows come in the
    order of their times; one that is not newer than the last of its series is left out. A save is
    one transaction; what kills the process loses what was not saved, nothing else. Small blocks are
    joined as they come, so that a day of 100 Hz is 211 blocks.

    May be used from any thread, by one at a time; readers do not wait for who writes.

    Parameters
    ----------
    path
        The file; it and its folder are made if missing.
    keep_s
        Rows older than this are forgotten, block by block.
    most_bytes
        So large may the file become; the oldest blocks go first.

    Attributes
    ----------
    size : int
        Bytes in use after the last save: who asks waits for no disk.

    Raises
    ------
    StorageError
        from every method, one line naming the file.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "history.sqlite"
    >>> good = np.zeros(2, np.uint32)
    >>> with HistoryFile(path) as store:
    ...     piece = Piece("V1.Signals", np.array([1, 2]), good, {"Q": np.array([5.0, 6.0])})
    ...     _ = store.save([piece])
    ...     store.read("V1.Signals", "Q", 0, 9, most=9).values
    array([5., 6.])
    """

    def __init__(
        self, path: str | Path, keep_s: float = 7 * 86_400.0, most_bytes: int = 2_000_000_000
    ) -> None:
        self.path = Path(path)
        self._keep_ns, self._most_bytes = round(keep_s * 1e9), most_bytes
        self._writing, self._reading = Lock(), Lock()
        with naming(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = _open(self.path)
            self._reader = sqlite3.connect(self.path, check_same_thread=False)
            self._names = dict(self._writer.execute("SELECT name, id FROM name").fetchall())
            self._series = self._known_series()
            self.size = self._bytes()

    def save(self, pieces: Iterable[Piece]) -> int:
        """Keep all pieces or none; return how many values were left out as not newer."""
        with self._writing, naming(self.path):
            with transaction(self._writer):
                left_out = sum([self._append(piece) for piece in pieces])
            self.size = self._bytes()
            return left_out

    def read(
        self,
        series: str,
        column: str,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> Past:
        """Rows from ``low`` to ``high`` (UTC ns, both belong to it), but for the first ``skip``."""
        with self._reading, naming(self.path):
            names = {name: self._known(name) for name in (series, column, _T, _CODES)}
            if None in names.values():
                return _nothing()
            found, wanted = [], skip + most
            for block in self._blocks(int(names[series] or 0), low, high, backwards=backwards):
                past = self._rows_of(block, names, column)
                inside = slice(*np.searchsorted(past.t, [low, high + 1]).tolist())
                past = past[inside]
                found.append(past[::-1] if backwards else past)
                wanted -= len(found[-1].t)
                if wanted <= 0:
                    break
        return _joined(found)[skip : skip + most]

    def note(self, changes: Sequence[AlarmChange]) -> None:
        """Keep changes of alarms; those that are kept already are not kept twice."""
        with self._writing, naming(self.path), transaction(self._writer):
            alarm_changes.insert(self._writer, changes)

    def changes(
        self,
        owner: str | None,
        low: int,
        high: int,
        *,
        backwards: bool = False,
        skip: int = 0,
        most: int,
    ) -> list[AlarmChange]:
        """Changes of an owner's alarms (None: of all) from ``low`` to ``high``, as :meth:`read`."""
        with self._reading, naming(self.path):
            span = low, high
            return alarm_changes.select(
                self._reader, owner, span, backwards=backwards, skip=skip, most=most
            )

    def forget(self, now: int) -> int:
        """Drop what is too old at ``now`` (UTC ns), or too much; return how many blocks."""
        with self._writing, naming(self.path):
            with transaction(self._writer):
                alarm_changes.forget(self._writer, now - self._keep_ns)
                dropped = self._drop("last < ?", (now - self._keep_ns,))
                excess = self._bytes() - self._most_bytes
                if excess > 0:
                    dropped += self._drop_oldest(excess)
            self._writer.execute(f"PRAGMA incremental_vacuum({_PAGES_AT_ONCE})").fetchall()
            self.size = self._bytes()
            return dropped

    def _bytes(self) -> int:
        pages, free, page = (
            pragma(self._writer, name) for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * page

    def close(self) -> None:
        """Close the file; safe to call twice."""
        with self._writing, self._reading, naming(self.path):
            self._writer.close()
            self._reader.close()

    def _append(self, piece: Piece) -> int:
        """Write a piece as a block, and join small blocks once they make a large one."""
        series = self._series.get(piece.series)
        if series is None:
            series = self._series[piece.series] = _Series(self._number(piece.series), -(2**63))
        ordered = np.maximum.accumulate(np.append(series.last, piece.t))
        newer = piece.t > ordered[:-1]
        t = piece.t[newer]
        if len(t):
            columns: dict[str, NDArray[Any]] = {_T: t, _CODES: piece.codes[newer]}
            columns |= {name: values[newer] for name, values in piece.columns.items()}
            series.small.append(self._insert(series.number, columns))
            series.last, series.rows = int(t[-1]), series.rows + len(t)
            if series.rows >= BLOCK:
                self._join(series)
        return int((len(piece.t) - len(t)) * len(piece.columns))

    def _insert(self, series: int, columns: Mapping[str, NDArray[Any]]) -> int:
        t = columns[_T]
        insert = "INSERT INTO block (series, first, last, rows) VALUES (?, ?, ?, ?)"
        block = self._writer.execute(insert, (series, int(t[0]), int(t[-1]), len(t))).lastrowid
        assert block is not None  # noqa: S101 - a row was inserted
        packed = [(self._number(name), _pack(name, column)) for name, column in columns.items()]
        self._writer.executemany(
            "INSERT INTO part (block, name, digest, data) VALUES (?, ?, ?, ?)",
            [(block, name, zlib.crc32(data), data) for name, data in packed],
        )
        return block

    def _join(self, series: _Series) -> None:
        """Make one block of a series' small ones; a column that some lack is NaN there."""
        numbers = {number: name for name, number in self._names.items()}
        blocks = [self._parts(self._writer, block) for block in series.small]
        names = [numbers[number] for parts in blocks for number in parts]
        rows = [len(_unpack(_T, parts[self._names[_T]])) for parts in blocks]
        columns = {
            name: np.concatenate(
                [
                    _unpack(name, parts[self._names[name]])
                    if self._names[name] in parts
                    else np.full(n, np.nan)
                    for parts, n in zip(blocks, rows, strict=True)
                ]
            )
            for name in dict.fromkeys(names)
        }
        self._delete(series.small)
        self._insert(series.number, columns)
        series.small, series.rows = [], 0

    def _drop(self, condition: str, values: tuple[int, ...]) -> int:
        select = f"SELECT id FROM block WHERE {condition}"  # noqa: S608 - constant
        old = [id_ for (id_,) in self._writer.execute(select, values)]
        self._delete(old)
        return len(old)

    def _drop_oldest(self, excess: int) -> int:
        """The oldest blocks that hold so many bytes in all."""
        held = self._writer.execute(
            "SELECT block.id, sum(length(data)) FROM block JOIN part ON part.block = block.id "
            "GROUP BY block.id ORDER BY last"
        )
        oldest = []
        for id_, size in held:
            if excess <= 0:
                break
            oldest.append(id_)
            excess -= size
        self._delete(oldest)
        return len(oldest)

    def _delete(self, blocks: Sequence[int]) -> None:
        gone = set(blocks)
        for series in self._series.values():
            if gone & set(series.small):
                series.small = [block for block in series.small if block not in gone]
        rows = [(block,) for block in blocks]
        self._writer.executemany("DELETE FROM part WHERE block = ?", rows)
        self._writer.executemany("DELETE FROM block WHERE id = ?", rows)

    def _known_series(self) -> dict[str, _Series]:
        """Every series as it was left."""
        names = {number: name for name, number in self._names.items()}
        found = {}
        last = "SELECT series, max(last) FROM block GROUP BY series"
        for number, newest in self._writer.execute(last).fetchall():
            series = found[names[number]] = _Series(number, newest)
            small = "SELECT id, rows FROM block WHERE series = ? AND rows < ? ORDER BY first"
            for block, rows in self._writer.execute(small, (number, BLOCK)):
                series.small.append(block)
                series.rows += rows
        return found

    def _number(self, name: str) -> int:
        if name not in self._names:
            insert = self._writer.execute("INSERT INTO name (name) VALUES (?)", (name,))
            self._names[name] = int(insert.lastrowid or 0)
        return int(self._names[name])

    def _known(self, name: str) -> int | None:
        row = self._reader.execute("SELECT id FROM name WHERE name = ?", (name,)).fetchone()
        return None if row is None else int(row[0])

    def _blocks(self, series: int, low: int, high: int, *, backwards: bool) -> Iterator[_Block]:
        order = "DESC" if backwards else "ASC"
        select = (
            "SELECT id, first, last, rows FROM block WHERE series = ? AND first <= ? AND last >= ? "  # noqa: S608
            f"ORDER BY first {order}"
        )
        return map(_Block._make, self._reader.execute(select, (series, high, low)))

    def _rows_of(self, block: _Block, names: Mapping[str, int | None], column: str) -> Past:
        parts = self._parts(self._reader, block.id, [names[_T], names[_CODES], names[column]])
        t, codes = (_unpack(name, parts.get(names[name])) for name in (_T, _CODES))
        if len(t) != block.rows or len(codes) != block.rows:
            return _nothing()
        values = _unpack(column, parts.get(names[column]))
        if len(values) != block.rows:  # the series had no such column then, or it is damaged
            return _nothing()
        return Past(t, values, codes)

    @staticmethod
    def _parts(
        connection: sqlite3.Connection, block: int, names: Sequence[int | None] = ()
    ) -> dict[int | None, bytes]:
        """Columns of a block, packed; those that are damaged are left out."""
        chosen = f"AND name IN ({', '.join('?' * len(names))})" if names else ""
        select = f"SELECT name, digest, data FROM part WHERE block = ? {chosen}"  # noqa: S608
        rows = connection.execute(select, (block, *names)).fetchall()
        return {name: data for name, digest, data in rows if zlib.crc32(data) == digest}


def _pack(name: str, column: NDArray[Any]) -> bytes:
    """Times as differences and codes are packed; values hardly can be."""
    if name == _T:
        return zlib.compress(np.diff(column, prepend=np.int64(0)).astype("<i8").tobytes(), 1)
    if name == _CODES:
        return zlib.compress(column.astype("<u4").tobytes(), 1)
    return column.astype("<f8").tobytes()


def _unpack(name: str, data: bytes | None) -> NDArray[Any]:
    if data is None:
        return np.empty(0)
    if name == _T:
        return np.cumsum(np.frombuffer(zlib.decompress(data), "<i8"))
    if name == _CODES:
        return np.frombuffer(zlib.decompress(data), "<u4")
    return np.frombuffer(data, "<f8")


def _nothing() -> Past:
    return Past(np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint32))


def _joined(parts: Sequence[Past]) -> Past:
    if not parts:
        return _nothing()
    columns: list[tuple[Times, Floats, NDArray[np.uint32]]] = [
        (past.t, past.values, past.codes) for past in parts
    ]
    t, values, codes = (np.concatenate(column) for column in zip(*columns, strict=True))
    return Past(t, values, codes)


def _open(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    try:
        if check_owner(connection, path, APPLICATION_ID, SCHEMA_VERSION):
            for statement in _SCHEMA:
                connection.execute(statement)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        alarm_changes.prepare(connection)
    except BaseException:
        connection.close()
        raise
    return connection
