"""Recordings as text: CSV, plain or compressed with gzip or xz."""

import csv
import gzip
import io
import lzma
import os
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from itertools import chain, islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import NoRecording, RecordingError, ValvemapError
from valvemap.model.samples import Codes, Samples
from valvemap.plant.unit_texts import split_unit
from valvemap.storage import columns
from valvemap.storage.cell_units import number_and_unit, units_of
from valvemap.storage.clock_times import Clock, day_and_clock, is_clock
from valvemap.storage.columns import CellError
from valvemap.storage.csv_cells import Cells, TextCells, TextForm
from valvemap.storage.csv_headings import SEPARATORS, cells_of, headings_of, is_number
from valvemap.storage.dates import date_form
from valvemap.storage.digit_groups import grouping_of
from valvemap.storage.headings import Beginning, recognise, time_column
from valvemap.storage.layout import (
    COLUMNS,
    Columns,
    Layout,
    MissingColumnError,
    Part,
    find_columns,
    with_p2,
)
from valvemap.storage.long_format import LongColumns, LongRows, long_columns
from valvemap.storage.time_units import seconds_per_unit
from valvemap.vocabulary.signals import MEASURED

if TYPE_CHECKING:
    from valvemap.storage.arrow_csv import ArrowParser

PACKINGS = (".csv", ".csv.gz", ".csv.xz")

_HEADER_LIMIT = 65_536
_TEXTS = ("valve", "quality")  # columns in which a unit behind a number is none
_SAID_FIRST = re.compile(r"sep=(.)\s*", re.IGNORECASE)  # Excel's own first line
_PEEKED = 64  # lines used to detect the date format
_RECOGNISED = 3_000  # lines used to recognise foreign headings
_PEEK = 65_536  # bytes
_NO_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1f\x81\x8d\x8f\x90\x9d]")
_MAGICS = {b"\x1f\x8b": ".csv.gz", b"\xfd7zXZ\x00": ".csv.xz"}
_MAGIC = 6  # bytes of the longest
_WIDE = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}  # by the byte order mark
_DAMAGE = (EOFError, zlib.error, lzma.LZMAError, gzip.BadGzipFile, csv.Error)

_BLOCK = 2_048  # lines; their cells fit in the CPU cache, nearly twice as fast

Rows = list[list[str]]
Block = tuple[Samples, NDArray[np.intp]]
Chunk = tuple[list[Block], RecordingError | None]  # parsed, and the error behind it
T = TypeVar("T")


class CsvReader:
    """Reads a recording of one of :data:`PACKINGS` chunk by chunk.

    The separator is that of the header: comma, semicolon, tab or bar. A decimal comma is accepted
    unless the comma separates columns. The encoding is UTF-8 or UTF-16, with or without a byte
    order mark, else cp1252. Any line endings are accepted.
    """

    def __init__(self, path: Path, packing: str, chunk_rows: int, layout: Layout) -> None:
        self._path = path
        self._rows = chunk_rows
        with _Faults(path, lambda: 0):
            self._raw = path.open("rb")
            self._size = os.fstat(self._raw.fileno()).st_size
        try:
            packing = _packing(path, self._raw.peek(_MAGIC)[:_MAGIC], packing)
            unpacked = io.BufferedReader(cast("io.RawIOBase", _unpacked(self._raw, packing)), _PEEK)
            with _Faults(path, lambda: 0):
                encoding = _encoding(unpacked.peek(_PEEK))
            self._text = io.TextIOWrapper(unpacked, encoding=encoding, newline="")
            self._separator, self._header, skipped, first = self._read_header(layout)
            found = units_of(self._rows_of(first))
            self._units = {n: unit for n, unit in found.items() if self._header[n] not in _TEXTS}
            for place, unit in self._units.items():
                if split_unit(self._header[place])[1] is None:
                    self._header[place] += f" [{unit}]"
            self._long: LongColumns | None = None
            self._layout = layout
            self._columns, peeked = self._find(f"{path}, line {skipped}", first)
        except ValvemapError:
            self._raw.close()
            raise
        self.ignored = self._columns.ignored
        self._valves: dict[str, int] = {}
        with _Faults(path, lambda: 0):
            peeked += islice(self._text, max(_PEEKED - len(peeked), 0))
        is_headless = self._long is not None and self._long.is_a_row(self._header)
        self._skipped = skipped - is_headless
        self._lines = chain(peeked, self._text)
        place = self._columns.parts[0].t if self._long is None else self._long.time
        self._form = self._form_of(self._rows_of(peeked[:_PEEKED]), place)
        self._arrow = self._parser(peeked[:_PEEKED])

    @property
    def fraction(self) -> float:
        """The fraction of the file's bytes read, 0 to 1."""
        with suppress(OSError, ValueError):  # a thread that reads ahead may close it meanwhile
            return min(self._raw.tell() / self._size, 1.0)
        return 1.0

    @property
    def parts(self) -> tuple[Part, ...]:
        """Columns of each valve."""
        return self._columns.parts

    def close(self) -> None:
        """Close the file."""
        with suppress(*_DAMAGE, OSError):  # nothing was written
            self._text.close()
        self._raw.close()

    def _find(self, where: str, first: list[str]) -> tuple[Columns, list[str]]:
        """Return the columns, and the lines that were read to recognise foreign headings."""
        try:
            return find_columns(self._header, self._layout, where), first
        except MissingColumnError as missing:
            if not self._layout.recognises:
                raise
            refusal = missing
        if all(is_number(name) for name in self._header):
            names = ",".join(COLUMNS[: len(self._header)])
            said = str(refusal).partition("; for other names")[0]
            raise MissingColumnError(
                f"{said}; where it has no headings, --columns={names} or similar names them"
            )
        with _Faults(self._path, lambda: 0):
            peeked = [*first, *islice(self._text, _RECOGNISED)]
        rows = self._rows_of(peeked)
        numeric = [
            all(
                is_number(number_and_unit(row[place])[0]) or columns.is_missing(row[place])
                for row in rows
            )
            for place in range(len(self._header))
        ]
        self._long = long_columns(self._header, rows, numeric)
        if self._long is not None:
            if self._long.is_a_row(self._header):
                peeked = [self._first_line, *peeked]
            return Columns((), None, None, ()), peeked
        return self._recognised(rows, numeric, refusal), peeked

    def _rows_of(self, lines: Sequence[str]) -> Rows:
        rows = csv.reader(lines, delimiter=self._separator, skipinitialspace=True)
        with suppress(csv.Error):
            return [row for row in rows if len(row) == len(self._header)]
        return []

    def _recognised(self, rows: Rows, numeric: Sequence[bool], refusal: RecordingError) -> Columns:
        """Return the columns recognised by headings and first rows; else raise ``refusal``."""
        time = time_column(self._header, numeric)
        if time is None or not rows:
            raise refusal
        texts = TextCells(rows, self._form_of(rows[:_PEEKED], time))
        try:
            times = texts.times(time, seconds_per_unit(self._header[time]))
        except CellError:
            raise refusal from None
        numbers = {
            place: texts.numbers(place, self._header[place])
            for place, is_number in enumerate(numeric)
            if is_number and place != time
        }
        begins = Beginning(self._path, self._header, numbers, time, times)
        return recognise(begins, self._layout, refusal)

    def _read_header(self, layout: Layout) -> tuple[str, list[str], int, list[str]]:
        """Return separator, headings, the number of header lines, and lines that are data."""
        said, number = None, 0
        with _Faults(self._path, lambda: 0):
            line = self._text.readline(_HEADER_LIMIT)
            match = _SAID_FIRST.fullmatch(line)
            if match is not None:
                said, number = match[1] if match[1] in SEPARATORS else None, 1
                line = self._text.readline(_HEADER_LIMIT)
            lines = [line, *islice(self._text, _PEEKED if line.endswith(("\r", "\n")) else 0)]
        if not line:
            raise RecordingError(f"{self._path} is empty: a recording begins with t,U,p1,p2,Q")
        if layout.header is None:
            found = headings_of(lines, said)
            self._first_line = lines[found.lines - 1]
            return found.separator, found.names, number + found.lines, lines[found.lines :]
        self._first_line = line
        separator = said or max(SEPARATORS, key=line.count)
        width = len(cells_of(line, separator))
        if len(layout.header) != width:
            raise RecordingError(
                f"{self._path}, line {number + 1}: {width} cells separated by "
                f"{SEPARATORS[separator]}, --columns names {len(layout.header)}"
            )
        return separator, list(layout.header), number, lines

    def _form_of(self, rows: Rows, time: int) -> TextForm:
        """Return how the file writes times and numbers, detected from its first rows."""
        grouping = grouping_of(cell for row in rows for cell in row)
        days = day_and_clock(rows, time)
        cells = [row[time] for row in rows]
        if days is not None:
            cells = [f"{row[days[0]]} {row[days[1]]}" for row in rows]
        has_clock = days is None and bool(cells) and all(map(is_clock, cells))
        clock = Clock() if has_clock else None
        return TextForm(self._separator, date_form(cells), grouping, days, clock, self._units)

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), chunk by chunk.

        Samples before damage are yielded before the error is raised.
        """
        if self._long is not None:
            yield from self._pivoted(self._long)
            return
        for blocks, problem in self._parsed_lines():
            if blocks:
                samples, index = zip(*blocks, strict=True)
                whole = Samples.concatenate(samples)
                yield from columns.by_valve(whole, list(self._valves), np.concatenate(index))
            if problem is not None:
                raise problem

    def _parsed_lines(self) -> Iterator[Chunk]:
        """Yield chunks of lines, parsed by Arrow as long as no cell is quoted."""
        while self._arrow is not None:
            lines: list[str] = []
            problem = self._taken(self._lines, lines, self._rows, self._at(lines))
            text = "".join(lines)
            if '"' in text:  # a quoted cell may go over several lines, and chunks
                self._lines = chain(lines, self._lines if problem is None else _raising(problem))
                break
            before, self._skipped = self._skipped, self._skipped + len(lines)
            blocks = self._parsed_by_arrow(self._arrow, lines, text)
            if blocks is None:
                yield from self._parsed_text(lines, before)
            yield blocks or [], problem
            if len(lines) < self._rows:
                return
        yield from self._parsed_text(self._lines, self._skipped)

    def _parsed_by_arrow(
        self, arrow: "ArrowParser", lines: Sequence[str], text: str
    ) -> list[Block] | None:
        """Return the blocks of lines; None if they must be parsed as text."""
        if max(map(len, lines), default=0) > csv.field_size_limit():
            return None
        cells = arrow.parsed(text)
        try:
            return None if cells is None else list(self._blocks(cells))
        except CellError:
            return None

    def _parsed_text(self, lines: Iterable[str], skipped: int) -> Iterator[Chunk]:
        """Yield chunks of lines as text; ``skipped`` is the number of lines before them."""
        reader = self._reader(lines)
        more, problem = True, None
        while more:
            blocks: list[Block] = []
            left = self._rows
            while more and left:
                limit, before = min(left, _BLOCK), reader.line_num + skipped
                rows: Rows = []
                problem = self._taken(reader, rows, limit, lambda: reader.line_num + skipped)
                blocks += self._parsed(rows, before)
                left -= len(rows)
                more = len(rows) == limit and problem is None
            yield blocks, problem

    def _pivoted(self, place: LongColumns) -> Iterator[tuple[str, Samples]]:
        """Yield the samples of a file in long format, sorted by time."""
        long = LongRows(self._path, self._layout)
        unit = seconds_per_unit(self._header[place.time])
        reader = self._reader(self._lines)
        problem, more = None, True
        while more:
            before, rows = reader.line_num + self._skipped, list[list[str]]()
            problem = self._taken(reader, rows, _BLOCK, lambda: reader.line_num + self._skipped)
            more = len(rows) == _BLOCK and problem is None
            lines: Sequence[int] = range(before + 1, before + 1 + len(rows))
            lines, rows = self._without_blank_lines(lines, rows)
            if not rows:
                continue
            cells = TextCells(rows, self._form)
            try:
                t = cells.times(place.time, unit)
                tags, bare = place.tagged(rows)
                plain = self._form._replace(days=None, units={})
                values = TextCells(bare, plain).numbers(0, self._header[place.value])
            except CellError as error:
                raise RecordingError(f"{self._path}, line {lines[error.row]}: {error}") from None
            long.add(t, tags, values)
        if problem is not None:
            raise problem
        for valve, samples in long.samples(self._rows):
            self.ignored, self._columns = long.ignored, Columns(long.parts, None, None, ())
            yield valve, samples

    def _reader(self, lines: Iterable[str]) -> Any:  # noqa: ANN401 - the class has no public name
        return csv.reader(lines, delimiter=self._separator, skipinitialspace=True)

    def _at(self, lines: Sequence[str]) -> Callable[[], int]:
        """Return the number of the last line that was read."""
        before = self._skipped
        return lambda: before + len(lines)

    def _taken(
        self, items: Iterator[T], taken: list[T], limit: int, line: Callable[[], int]
    ) -> RecordingError | None:
        """Append up to ``limit`` items, and return the error that stopped reading, if any."""
        try:
            with _Faults(self._path, line):
                taken.extend(islice(items, limit))  # keeps those before an error
        except RecordingError as error:
            return error
        return None

    def _parsed(self, rows: Rows, before: int) -> list[Block]:
        """Return samples and their valves' numbers; none if all lines are blank."""
        lines: Sequence[int] = range(before + 1, before + 1 + len(rows))
        if set(map(len, rows)) != {len(self._header)}:
            lines, rows = self._without_blank_lines(lines, rows)
        if not rows:
            return []
        try:
            return list(self._blocks(TextCells(rows, self._form)))
        except CellError as error:
            raise RecordingError(f"{self._path}, line {lines[error.row]}: {error}") from None

    def _blocks(self, cells: Cells) -> Iterator[Block]:
        """Yield the samples of every part of the file, and their valves' numbers."""
        found = self._columns
        quality = None if found.quality is None else cells.qualities(found.quality)
        names, index = None, None
        if found.valve is not None:
            names, index = cells.names(found.valve)
        for part in found.parts:
            samples = self._samples(part, cells, quality)
            if part.valve is None and names is not None and index is not None:
                numbers = [self._valves.setdefault(name, len(self._valves)) for name in names]
                yield samples, np.array(numbers)[index]
                continue
            valve = str(part.valve)
            if part.selects and names is not None and index is not None:
                if valve not in names:
                    continue
                samples = samples[index == names.index(valve)]
            number = self._valves.setdefault(valve, len(self._valves))
            yield samples, np.full(len(samples), number, np.intp)

    def _samples(self, part: Part, cells: Cells, quality: Codes | None) -> Samples:
        numbers = {
            name: scaling(cells.numbers(place, name))
            for name, (place, scaling) in part.numbers.items()
        }
        return with_p2(cells.times(part.t, part.seconds), quality, numbers)

    def _parser(self, peeked: Sequence[str]) -> "ArrowParser | None":
        """Return Arrow's parser for the file, if it reads its first lines."""
        found = self._columns
        if self._units:
            return None
        two_columns = self._form.days is not None or self._form.clock is not None
        if self._long is not None or two_columns or find_spec("pyarrow") is None:
            return None
        from valvemap.storage.arrow_csv import ArrowParser  # noqa: PLC0415 - an extra, and large

        scaled = {part.t for part in found.parts if part.seconds != 1.0}
        places = {place for part in found.parts for place, _ in part.numbers.values()}
        return ArrowParser.of(
            peeked,
            len(self._header),
            self._separator,
            self._form.dates,
            numbers=places | scaled,
            texts={place for place in (found.valve, found.quality) if place is not None},
            times={part.t for part in found.parts} - scaled,
        )

    def _without_blank_lines(
        self, numbers: Sequence[int], rows: Rows
    ) -> tuple[Sequence[int], Rows]:
        kept = [(number, row) for number, row in zip(numbers, rows, strict=True) if row]
        for number, row in kept:
            if len(row) != len(self._header):
                raise RecordingError(
                    f"{self._path}, line {number}: {len(row)} cells separated by "
                    f"{SEPARATORS[self._separator]} where the header has {len(self._header)}"
                )
        return [number for number, _ in kept], [row for _, row in kept]


class _Faults:
    """Converts exceptions of reading text to a RecordingError."""

    def __init__(self, path: Path, line: Callable[[], int]) -> None:
        self._path = path
        self._line = line

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, UnicodeDecodeError):
            raise RecordingError(
                f"{self._path} is not a recording: no UTF-8 text behind line {self._line()}; save "
                "it as CSV UTF-8"
            ) from None
        if isinstance(error, _DAMAGE):
            raise RecordingError(
                f"{self._path} is cut off or damaged behind line {self._line()}: {error}"
            ) from None
        if isinstance(error, FileNotFoundError):
            raise NoRecording(f"{self._path} does not exist") from None
        if isinstance(error, OSError):
            raise RecordingError(
                f"{self._path} cannot be read: {error.strerror or error}"
            ) from error


def csv_rows(valve: str, samples: Samples) -> bytes:
    r"""Return samples as CSV lines that read back bit-identically.

    >>> csv_rows("V1", Samples.of(t=[10**15], U=[0.1], p1=[200], p2=[1e-9], Q=[30]))
    b'1000000000000000,0.1,200.0,1e-09,30.0,nan,V1,0\n'
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(
        zip(
            map(columns.time_text, samples.t.tolist()),
            *(getattr(samples, name).tolist() for name in MEASURED),
            (valve,) * len(samples),
            samples.quality.tolist(),
            strict=True,
        )
    )
    return text.getvalue().encode()


def csv_header() -> bytes:
    """Return the header line for :func:`csv_rows`."""
    return (",".join(COLUMNS) + "\n").encode()


def packed(packing: str, text: bytes) -> bytes:
    """Compress text for appending, as a separate gzip member or xz stream."""
    match packing:
        case ".csv.gz":
            return gzip.compress(text, compresslevel=6, mtime=0)
        case ".csv.xz":
            return lzma.compress(text, preset=3)
        case _:
            return text


@contextmanager
def text_of(path: Path, packing: str) -> Iterator[Iterator[str]]:
    """Yield the lines of a file; damage is a `RecordingError`."""
    number = 0
    with _Faults(path, lambda: number), path.open("rb") as raw:
        unpacked = io.BufferedReader(cast("io.RawIOBase", _unpacked(raw, packing)), _PEEK)
        encoding = _encoding(unpacked.peek(_PEEK))
        yield iter(io.TextIOWrapper(unpacked, encoding=encoding, newline=""))


def _unpacked(raw: BinaryIO, packing: str) -> IO[bytes]:
    match packing:
        case ".csv.gz":
            return cast("IO[bytes]", gzip.GzipFile(fileobj=raw))
        case ".csv.xz":
            return lzma.LZMAFile(raw)
        case _:
            return raw


def _packing(path: Path, beginning: bytes, named: str) -> str:
    """Return how a file is packed: as its name says, else by its first bytes."""
    if beginning.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise NoRecording(f"{path} is a workbook or an archive: save the sheet as CSV")
    if named != ".csv":
        return named
    return next((form for magic, form in _MAGICS.items() if beginning.startswith(magic)), named)


def _raising(problem: RecordingError) -> Iterator[str]:
    """Raise when the first line is asked for."""
    raise problem
    yield ""


def _encoding(beginning: bytes) -> str:
    """Return the encoding, detected from the first bytes."""
    if beginning[:2] in _WIDE:
        return _WIDE[beginning[:2]]
    if beginning[1:2] == b"\0" and beginning[3:4] == b"\0":
        return "utf-16-le"
    if beginning[:1] == b"\0" and beginning[2:3] == b"\0":
        return "utf-16-be"
    try:
        beginning[:_HEADER_LIMIT].decode("utf-8")
    except UnicodeDecodeError as error:
        cut_off = error.start >= len(beginning) - 4
        if not cut_off and not _NO_TEXT.search(beginning):
            return "cp1252"  # e.g. the ° of °C from a spreadsheet
    return "utf-8-sig"
