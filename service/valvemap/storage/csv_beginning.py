"""The beginning of a CSV recording: separator, headings, columns, and how it writes its numbers."""

import csv
import io
import re
from collections.abc import Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

from valvemap.errors import RecordingError
from valvemap.plant.unit_texts import split_unit
from valvemap.storage import columns
from valvemap.storage.cell_units import number_and_unit, units_of
from valvemap.storage.clock_times import Clock, day_and_clock, is_clock
from valvemap.storage.column_finding import find_columns
from valvemap.storage.columns import CellError
from valvemap.storage.csv_cells import TextCells, TextForm
from valvemap.storage.csv_headings import SEPARATORS, cells_of, headings_of, is_number
from valvemap.storage.dates import date_form
from valvemap.storage.digit_groups import grouping_of
from valvemap.storage.headings import Beginning, recognise, time_column
from valvemap.storage.layout import COLUMNS, Columns, Layout, MissingColumnError
from valvemap.storage.long_format import LongColumns, long_columns
from valvemap.storage.packed_text import HEADER_LIMIT, Faults
from valvemap.storage.time_units import seconds_per_unit

_TEXTS = ("valve", "quality")  # columns in which a unit behind a number is none
_SAID_FIRST = re.compile(r"sep=(.)\s*", re.IGNORECASE)  # Excel's own first line
_PEEKED = 64  # lines used to detect the date format
_RECOGNISED = 3_000  # lines used to recognise foreign headings

Rows = list[list[str]]


class CsvBeginning:
    """What the first lines of a text say of all.

    Attributes
    ----------
    separator, header
        of the columns, and their names with the units of their cells.
    skipped
        Number of lines before the first row.
    columns, long
        What the columns are; ``long`` only in long format.
    form
        How times and numbers are written.
    units
        The units that stand behind numbers, by column.
    peeked
        The lines that were read and are rows.
    """

    def __init__(self, path: Path, text: io.TextIOWrapper, layout: Layout) -> None:
        self._path, self._text, self._layout = path, text, layout
        self.separator, self.header, skipped, first = self._read_header(layout)
        found = units_of(self._rows_of(first))
        self.units = {n: unit for n, unit in found.items() if self.header[n] not in _TEXTS}
        for place, unit in self.units.items():
            if split_unit(self.header[place])[1] is None:
                self.header[place] += f" [{unit}]"
        self.long: LongColumns | None = None
        self.columns, self.peeked = self._find(f"{path}, line {skipped}", first)
        with Faults(path, lambda: 0):
            self.peeked += islice(text, max(_PEEKED - len(self.peeked), 0))
        is_headless = self.long is not None and self.long.is_a_row(self.header)
        self.skipped = skipped - is_headless
        place = self.columns.parts[0].t if self.long is None else self.long.time
        self.form = self._form_of(self._rows_of(self.first_lines), place)

    @property
    def first_lines(self) -> list[str]:
        """The lines by which formats are detected."""
        return self.peeked[:_PEEKED]

    def _find(self, where: str, first: list[str]) -> tuple[Columns, list[str]]:
        """Return the columns, and the lines that were read to recognise foreign headings."""
        try:
            return find_columns(self.header, self._layout, where), first
        except MissingColumnError as missing:
            if not self._layout.recognises:
                raise
            refusal = missing
        if all(is_number(name) for name in self.header):
            names = ",".join(COLUMNS[: len(self.header)])
            said = str(refusal).partition("; for other names")[0]
            raise MissingColumnError(
                f"{said}; where it has no headings, --columns={names} or similar names them"
            )
        with Faults(self._path, lambda: 0):
            peeked = [*first, *islice(self._text, _RECOGNISED)]
        rows = self._rows_of(peeked)
        numeric = [
            all(
                is_number(number_and_unit(row[place])[0]) or columns.is_missing(row[place])
                for row in rows
            )
            for place in range(len(self.header))
        ]
        self.long = long_columns(self.header, rows, numeric)
        if self.long is not None:
            if self.long.is_a_row(self.header):
                peeked = [self._first_line, *peeked]
            return Columns((), None, None, ()), peeked
        return self._recognised(rows, numeric, refusal), peeked

    def _rows_of(self, lines: Sequence[str]) -> Rows:
        rows = csv.reader(lines, delimiter=self.separator, skipinitialspace=True)
        with suppress(csv.Error):
            return [row for row in rows if len(row) == len(self.header)]
        return []

    def _recognised(self, rows: Rows, numeric: Sequence[bool], refusal: RecordingError) -> Columns:
        """Return the columns recognised by headings and first rows; else raise ``refusal``."""
        time = time_column(self.header, numeric)
        if time is None or not rows:
            raise refusal
        texts = TextCells(rows, self._form_of(rows[:_PEEKED], time))
        try:
            times = texts.times(time, seconds_per_unit(self.header[time], 1.0))
        except CellError:
            raise refusal from None
        numbers = {
            place: texts.numbers(place, self.header[place])
            for place, is_number in enumerate(numeric)
            if is_number and place != time
        }
        begins = Beginning(self._path, self.header, numbers, time, times)
        return recognise(begins, self._layout, refusal)

    def _read_header(self, layout: Layout) -> tuple[str, list[str], int, list[str]]:
        """Return separator, headings, the number of header lines, and lines that are data."""
        said, number = None, 0
        with Faults(self._path, lambda: 0):
            line = self._text.readline(HEADER_LIMIT)
            match = _SAID_FIRST.fullmatch(line)
            if match is not None:
                said, number = match[1] if match[1] in SEPARATORS else None, 1
                line = self._text.readline(HEADER_LIMIT)
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
        return TextForm(self.separator, date_form(cells), grouping, days, clock, self.units)
