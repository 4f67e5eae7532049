"""Recordings as text: CSV, plain or compressed with gzip or xz."""

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from importlib.util import find_spec
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import RecordingError, ValvemapError
from valvemap.model.samples import Codes, Samples
from valvemap.storage import columns
from valvemap.storage.columns import CellError
from valvemap.storage.csv_beginning import CsvBeginning, Rows
from valvemap.storage.csv_cells import Cells, TextCells
from valvemap.storage.csv_headings import SEPARATORS
from valvemap.storage.layout import Columns, Layout, Part, with_p2
from valvemap.storage.long_format import LongColumns, LongRows
from valvemap.storage.packed_text import DAMAGE, Faults, opened_text
from valvemap.storage.time_units import seconds_per_unit

if TYPE_CHECKING:
    from valvemap.storage.arrow_csv import ArrowParser

_BLOCK = 2_048  # lines; their cells fit in the CPU cache, nearly twice as fast

Block = tuple[Samples, NDArray[np.intp]]
Chunk = tuple[list[Block], RecordingError | None]  # parsed, and the error behind it
T = TypeVar("T")


class CsvReader:
    """Reads a recording of one of :data:`~valvemap.storage.packed_text.PACKINGS` chunk by chunk.

    The separator is that of the header: comma, semicolon, tab or bar. A decimal comma is accepted
    unless the comma separates columns. The encoding is UTF-8 or UTF-16, with or without a byte
    order mark, else cp1252. Any line endings are accepted.
    """

    def __init__(self, path: Path, packing: str, chunk_rows: int, layout: Layout) -> None:
        self._path, self._rows, self._layout = path, chunk_rows, layout
        with Faults(path, lambda: 0):
            self._raw = path.open("rb")
            self._size = os.fstat(self._raw.fileno()).st_size
        try:
            self._text = opened_text(path, self._raw, packing)
            self._begins = CsvBeginning(path, self._text, layout)
        except ValvemapError:
            self._raw.close()
            raise
        self._columns, self._skipped = self._begins.columns, self._begins.skipped
        self.ignored = self._columns.ignored
        self._valves: dict[str, int] = {}
        self._lines = chain(self._begins.peeked, self._text)
        self._arrow = self._parser(self._begins.first_lines)

    @property
    def fraction(self) -> float:
        """The fraction of the file's bytes read, 0 to 1."""
        with suppress(OSError, ValueError):  # a thread that reads ahead may close it
            return min(self._raw.tell() / self._size, 1.0)
        return 1.0

    @property
    def parts(self) -> tuple[Part, ...]:
        """Columns of each valve."""
        return self._columns.parts

    def close(self) -> None:
        """Close the file."""
        with suppress(*DAMAGE, OSError):  # nothing was written
            self._text.close()
        self._raw.close()

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), chunk by chunk.

        Samples before damage are yielded before the error is raised.
        """
        if self._begins.long is not None:
            yield from self._pivoted(self._begins.long)
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
        unit = seconds_per_unit(self._begins.header[place.time])
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
            cells = TextCells(rows, self._begins.form)
            try:
                t = cells.times(place.time, unit)
                tags, bare = place.tagged(rows)
                plain = self._begins.form._replace(days=None, units={})
                values = TextCells(bare, plain).numbers(0, self._begins.header[place.value])
            except CellError as error:
                raise RecordingError(f"{self._path}, line {lines[error.row]}: {error}") from None
            long.add(t, tags, values)
        if problem is not None:
            raise problem
        for valve, samples in long.samples(self._rows):
            self.ignored, self._columns = long.ignored, Columns(long.parts, None, None, ())
            yield valve, samples

    def _reader(self, lines: Iterable[str]) -> Any:  # noqa: ANN401 - the class has no public name
        return csv.reader(lines, delimiter=self._begins.separator, skipinitialspace=True)

    def _at(self, lines: Sequence[str]) -> Callable[[], int]:
        """Return the number of the last line that was read."""
        before = self._skipped
        return lambda: before + len(lines)

    def _taken(
        self, items: Iterator[T], taken: list[T], limit: int, line: Callable[[], int]
    ) -> RecordingError | None:
        """Append up to ``limit`` items, and return the error that stopped reading, if any."""
        try:
            with Faults(self._path, line):
                taken.extend(islice(items, limit))  # keeps those before an error
        except RecordingError as error:
            return error
        return None

    def _parsed(self, rows: Rows, before: int) -> list[Block]:
        """Return samples and their valves' numbers; none if all lines are blank."""
        lines: Sequence[int] = range(before + 1, before + 1 + len(rows))
        if set(map(len, rows)) != {len(self._begins.header)}:
            lines, rows = self._without_blank_lines(lines, rows)
        if not rows:
            return []
        try:
            return list(self._blocks(TextCells(rows, self._begins.form)))
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
        if self._begins.units:
            return None
        two_columns = self._begins.form.days is not None or self._begins.form.clock is not None
        if self._begins.long is not None or two_columns or find_spec("pyarrow") is None:
            return None
        from valvemap.storage.arrow_csv import ArrowParser  # noqa: PLC0415 - an extra, and large

        scaled = {part.t for part in found.parts if part.seconds != 1.0}
        places = {place for part in found.parts for place, _ in part.numbers.values()}
        return ArrowParser.of(
            peeked,
            len(self._begins.header),
            self._begins.separator,
            self._begins.form.dates,
            numbers=places | scaled,
            texts={place for place in (found.valve, found.quality) if place is not None},
            times={part.t for part in found.parts} - scaled,
        )

    def _without_blank_lines(
        self, numbers: Sequence[int], rows: Rows
    ) -> tuple[Sequence[int], Rows]:
        kept = [(number, row) for number, row in zip(numbers, rows, strict=True) if row]
        width, separator = len(self._begins.header), SEPARATORS[self._begins.separator]
        for number, row in kept:
            if len(row) != width:
                raise RecordingError(
                    f"{self._path}, line {number}: {len(row)} cells separated by {separator} "
                    f"where the header has {width}"
                )
        return [number for number, _ in kept], [row for _, row in kept]


def _raising(problem: RecordingError) -> Iterator[str]:
    """Raise when the first line is asked for."""
    raise problem
    yield ""
