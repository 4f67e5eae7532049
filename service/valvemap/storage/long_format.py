"""Recordings in long format: a row per value, with its time and the name of its signal."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import RecordingError
from valvemap.model.samples import Floats, Samples, Times
from valvemap.plant.names import tokens
from valvemap.plant.unit_texts import split_unit
from valvemap.storage import columns
from valvemap.storage.cell_units import number_and_unit
from valvemap.storage.column_finding import find_columns
from valvemap.storage.csv_headings import is_number, is_unit
from valvemap.storage.headings import Beginning, recognise, time_column
from valvemap.storage.layout import (
    DEFAULT_VALVE,
    Columns,
    Layout,
    MissingColumnError,
    Part,
    with_p2,
)

MOST_ROWS: Final = 20_000_000  # values of a file; they are sorted in memory
_VALUE_WORDS: Final = frozenset(
    {"value", "wert", "messwert", "valeur", "valor", "valore", "值", "数值"}
)
_RECOGNISED: Final = 3_000  # rows used to recognise the names of signals
_MOST_TAGS: Final = 200
_LEAST_REPEATS: Final = 2  # rows per tag at the beginning of a file, on average


@dataclass(frozen=True)
class LongColumns:
    """The columns of times, names, values and their units; -1: the file has none of these."""

    time: int
    tag: int
    value: int
    unit: int = -1

    def is_a_row(self, header: Sequence[str]) -> bool:
        """Whether the cells that were taken for headings are a row: the file has no headings."""
        return is_number(number_and_unit(header[self.value])[0])

    def tagged(self, rows: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
        """Return the names of N rows with their units, and the cells of their values alone."""
        cells = [number_and_unit(row[self.value]) for row in rows]
        units = [
            of_cell or (row[self.unit].strip() if self.unit >= 0 else "")
            for row, (_, of_cell) in zip(rows, cells, strict=True)
        ]
        names = [row[self.tag] for row in rows]
        shown = [
            f"{name} [{unit}]" if unit and not split_unit(name)[2] else name
            for name, unit in zip(names, units, strict=True)
        ]
        return shown, [[number] for number, _ in cells]


def long_columns(
    headings: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[bool]
) -> LongColumns | None:
    """Return the columns of a file in long format, None if it is in none.

    >>> rows = [["0", "p1", "180"], ["0", "Q", "30"], ["1", "p1", "181"], ["1", "Q", "31"]]
    >>> long_columns(["time", "tag", "value"], rows, [True, False, True])
    LongColumns(time=0, tag=1, value=2, unit=-1)
    """
    time = time_column(headings, numeric)
    if any(is_number(number_and_unit(heading)[0]) for heading in headings):
        time = _rising(rows)  # they are a row: the file has no headings
    if time is None:
        return None
    texts = [n for n, is_number in enumerate(numeric) if not is_number and n != time]
    values = [n for n, is_number in enumerate(numeric) if is_number and n != time]
    named = [n for n in values if _VALUE_WORDS & set(tokens(headings[n]))]
    chosen = named or values
    units = [n for n in texts if all(is_unit(row[n].strip()) for row in rows)]
    tags = [n for n in texts if n not in units and _are_tags([row[n] for row in rows])]
    if not tags or len(chosen) != 1:
        return None
    return LongColumns(time, tags[0], chosen[0], units[0] if units else -1)


class LongRows:
    """The values of a recording in long format, collected before they are sorted by time.

    ``ignored`` are the signals that belong to no valve, ``parts`` the columns of each valve, once
    the samples have been taken.
    """

    def __init__(self, path: Path, layout: Layout) -> None:
        self._path, self._layout = path, layout
        self._known: dict[str, int] = {}
        self._parts: list[tuple[Times, NDArray[np.intp], Floats]] = []
        self._rows = 0
        self.ignored: tuple[str, ...] = ()
        self.parts: tuple[Part, ...] = ()

    def add(self, times: Times, names: Sequence[str], values: Floats) -> None:
        """Add N values with their times and the names of their signals.

        Raises
        ------
        RecordingError
            if there are more than can be sorted in memory.
        """
        tags = np.array([self._known.setdefault(n, len(self._known)) for n in names], np.intp)
        self._rows += len(tags)
        if self._rows > MOST_ROWS:
            raise RecordingError(f"{self._path}: more than {MOST_ROWS:,} rows in long format")
        self._parts.append((times, tags, values))

    def samples(self, chunk_rows: int) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), chunk by chunk, sorted by time.

        Raises
        ------
        RecordingError
            if the names are those of no whole valve, or ambiguous.
        """
        if not self._parts:
            return
        times, tags, values = (np.concatenate(x) for x in zip(*self._parts, strict=True))
        t, table = pivot(times, tags, values, len(self._known))
        found = self._columns(t, table)
        self.ignored, self.parts = found.ignored, found.parts
        for part in found.parts:
            own = {
                name: scaling(table[:, column - 1])
                for name, (column, scaling) in part.numbers.items()
            }
            there = np.asarray(np.isfinite(np.stack(list(own.values()))).any(axis=0))
            for start in range(0, len(t), chunk_rows):
                rows = np.flatnonzero(there[start : start + chunk_rows]) + start
                some = {name: values_[rows] for name, values_ in own.items()}
                yield str(part.valve or DEFAULT_VALVE), with_p2(t[rows], None, some)

    def _columns(self, t: Times, table: Floats) -> Columns:
        """Return the columns of the table: by our own names, else recognised."""
        headings = ["t", *self._known]
        numbers = {number + 1: column[:_RECOGNISED] for number, column in enumerate(table.T)}
        try:
            return find_columns(headings, self._layout, str(self._path))
        except MissingColumnError as missing:
            begins = Beginning(self._path, headings, numbers, 0, t[:_RECOGNISED])
            return recognise(begins, self._layout, missing)


class LongReader:
    """Reads blocks of times, names and values (N,) as a recording of ``total`` rows.

    ``ignored`` are the signals that belong to no valve, once the first samples are there.
    """

    def __init__(
        self,
        rows: LongRows,
        blocks: Iterable[tuple[Times, Sequence[str], Floats]],
        total: int,
        chunk_rows: int,
        close: Callable[[], None],
    ) -> None:
        self._long, self._blocks, self._chunk_rows = rows, blocks, chunk_rows
        self._done, self._total = 0, total
        self.close = close
        self.ignored: tuple[str, ...] = ()

    @property
    def fraction(self) -> float:
        """The fraction read, 0 to 1."""
        return min(self._done / self._total, 1.0) if self._total else 1.0

    @property
    def parts(self) -> tuple[Part, ...]:
        """Columns of each valve."""
        return self._long.parts

    def chunks(self) -> Iterator[tuple[str, Samples]]:
        """Yield (valve, samples), chunk by chunk."""
        for times, names, values in self._blocks:
            self._long.add(times, names, values)
            self._done += len(times)
        for valve, samples in self._long.samples(self._chunk_rows):
            self.ignored = self._long.ignored
            yield valve, samples


def pivot(times: Times, tag: NDArray[np.intp], values: Floats, tags: int) -> tuple[Times, Floats]:
    """Return distinct times (M,), and the values of each tag (M, tags), held from its last one.

    Rows before the first value of a tag hold NaN in its column.

    >>> t, table = pivot(np.array([0, 0, 5]), np.array([0, 1, 0]), np.array([1.0, 2.0, 3.0]), 2)
    >>> t.tolist(), table.tolist()
    ([0, 5], [[1.0, 2.0], [3.0, 2.0]])
    """
    distinct, row = np.unique(times, return_inverse=True)
    table = np.full((len(distinct), tags), np.nan)
    there = np.zeros((len(distinct), tags), np.bool_)
    table[row, tag] = values
    there[row, tag] = True
    newest = np.maximum.accumulate(np.where(there, np.arange(len(distinct))[:, None], -1), axis=0)
    held = np.take_along_axis(table, np.maximum(newest, 0), axis=0)
    return distinct, np.where(newest >= 0, held, np.nan)


def _rising(rows: Sequence[Sequence[str]]) -> int | None:
    """Return the first column of times that never fall, and do rise; None if there is none."""
    for place, cells in enumerate(zip(*rows, strict=True)):
        with suppress(columns.CellError):
            steps = np.diff(columns.times(cells))
            if (steps >= 0).all() and (steps > 0).any():
                return place
    return None


def _are_tags(cells: Sequence[str]) -> bool:
    distinct = len(set(cells))
    return 1 < distinct <= _MOST_TAGS and len(cells) >= _LEAST_REPEATS * distinct
