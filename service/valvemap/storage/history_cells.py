"""Cells of the tiers: minimum, maximum, sum and counts of a column over 10 s or 5 min.

A tier is a series of its own in the same tables: a row is a cell, its time the cell's start (a
multiple of its width since 1970), its code the worst status. It has the column ``n``, the number of
rows, and six columns for each column of the values. Cells of one time are merged when read or
joined, so rows that come late add a second cell.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Flags, Floats, Times
from valvemap.pipeline.store_ports import PastCells
from valvemap.storage.history_blocks import CODES, SEALED, T, base_of
from valvemap.vocabulary.history_columns import OWN_WORDS

WIDTHS: Final = (10 * 10**9, 300 * 10**9)  # ns; for spans of hours, and of weeks
ROWS: Final = "n"
MINIMUM, MAXIMUM, SUM, GOOD, UNCERTAIN, MARKS = "min", "max", "sum", "good", "uncertain", "marks"
FIELDS: Final = (MINIMUM, MAXIMUM, SUM, GOOD, UNCERTAIN, MARKS)
LOW_AGAIN, HIGH_AGAIN, LOW_FIRST, HIGH_FIRST = 1, 2, 4, 8
"""Marks: minimum, maximum occur more than once; are the first good value, at the cell's start."""
_UNCERTAIN, _BAD = 0x4000_0000, 0x8000_0000
_LOW: Final = (MINIMUM, np.minimum, LOW_AGAIN, LOW_FIRST)
_HIGH: Final = (MAXIMUM, np.maximum, HIGH_AGAIN, HIGH_FIRST)
Columns = Mapping[str, NDArray[Any]]


def tier_of(series: str, width: int) -> str:
    """Return the name of the tier of a series of values.

    >>> tier_of("V1.Signals", WIDTHS[0])
    'V1.Signals#10s'
    """
    return f"{base_of(series)}{SEALED}{width // 10**9}s"


def width_of(series: str) -> int:
    """Return the width of the cells of a tier, ns; 0 of a series of values."""
    _, _, tier = series.rpartition(SEALED)
    return next((width for width in WIDTHS if tier == f"{width // 10**9}s"), 0)


def name_of(column: str, field: str) -> str:
    """Return the name of a column of a tier."""
    return f"{column}.{field}"


def codes_of(column: str, codes: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return the StatusCodes of one column, from those of the rows."""
    return np.zeros_like(codes) if column in OWN_WORDS else codes


def cells_of(columns: Columns, width: int) -> dict[str, NDArray[Any]]:
    """Return the cells of rows by time: the columns of a tier."""
    t, codes = columns[T], columns[CODES]
    start = t - t % width
    places = np.flatnonzero(np.diff(start, prepend=start[0] - 1))
    found: dict[str, NDArray[Any]] = {
        T: start[places],
        CODES: np.maximum.reduceat(codes, places),
        ROWS: np.diff(places, append=len(t)).astype(np.float64),
    }
    number = np.repeat(np.arange(len(places)), np.diff(places, append=len(t)))
    for name, values in columns.items():
        if name not in {T, CODES}:
            found |= _column(name, t, codes_of(name, codes), values, number, found[T])
    return found


def _column(
    name: str, t: Times, codes: NDArray[np.uint32], values: Floats, number: Times, starts: Times
) -> dict[str, NDArray[Any]]:
    """Return the six columns of one; ``number`` (n,) is each row's cell."""
    n, known = len(starts), ~np.isnan(values)
    good = known & (codes < _UNCERTAIN)
    doubtful = known & (codes >= _UNCERTAIN) & (codes < _BAD)
    found = _nothing(name, n)
    found[name_of(name, GOOD)] = np.bincount(number[good], minlength=n).astype(np.float64)
    found[name_of(name, UNCERTAIN)] = np.bincount(number[doubtful], minlength=n).astype(np.float64)
    if not good.any():
        return found
    t, values, number = t[good], values[good], number[good]
    places = np.flatnonzero(np.diff(number, prepend=-1))
    cells = number[places]
    with np.errstate(all="ignore"):
        found[name_of(name, SUM)][cells] = np.add.reduceat(values, places)
    for field, extreme, again, first in (_LOW, _HIGH):
        best = extreme.reduceat(values, places)
        found[name_of(name, field)][cells] = best
        count = np.add.reduceat((values == np.repeat(best, _sizes(places, t))).astype(int), places)
        at_start = (t[places] == starts[cells]) & (values[places] == best)
        marks = np.where(count > 1, again, 0) + np.where(at_start, first, 0)
        found[name_of(name, MARKS)][cells] += marks
    return found


def _sizes(places: Times, of: NDArray[Any]) -> Times:
    return np.diff(places, append=len(of))


def _nothing(name: str, n: int) -> dict[str, NDArray[Any]]:
    """Return the six columns of cells without a value."""
    found: dict[str, NDArray[Any]] = {name_of(name, field): np.zeros(n) for field in FIELDS}
    found[name_of(name, MINIMUM)] += np.inf
    found[name_of(name, MAXIMUM)] -= np.inf
    return found


def merged(parts: Sequence[Columns]) -> dict[str, NDArray[Any]]:
    """Return the cells of several blocks of a tier by time, those of one time as one."""
    names = dict.fromkeys(name for part in parts for name in part)
    values = {name.rpartition(".")[0] for name in names if "." in name}
    absent = {key: array for name in values for key, array in _nothing(name, 1).items()}
    joined = {
        name: np.concatenate(
            [
                part[name] if name in part else np.repeat(absent[name], len(part[T]))
                for part in parts
            ]
        )
        for name in names
    }
    order = np.argsort(joined[T], kind="stable")
    joined = {name: column[order] for name, column in joined.items()}
    t = joined[T]
    places = np.flatnonzero(np.diff(t, prepend=t[0] - 1))
    if len(places) == len(t):
        return joined
    found: dict[str, NDArray[Any]] = {
        T: t[places],
        CODES: np.maximum.reduceat(joined[CODES], places),
        ROWS: np.add.reduceat(joined[ROWS], places),
    }
    for name in values:
        for field in (SUM, GOOD, UNCERTAIN):
            key = name_of(name, field)
            with np.errstate(all="ignore"):
                found[key] = np.add.reduceat(joined[key], places)
        marks, has = joined[name_of(name, MARKS)].astype(int), joined[name_of(name, GOOD)] > 0
        found[name_of(name, MARKS)] = np.zeros(len(places))
        for field, extreme, again, first in (_LOW, _HIGH):
            column = joined[name_of(name, field)]
            best = extreme.reduceat(column, places)
            is_best = has & (column == np.repeat(best, _sizes(places, t)))
            count = np.add.reduceat(np.where(is_best, 1 + ((marks & again) > 0), 0), places)
            at_start = np.logical_or.reduceat(is_best & ((marks & first) > 0), places)
            found[name_of(name, field)] = best
            found[name_of(name, MARKS)] += np.where(count > 1, again, 0) + np.where(
                at_start, first, 0
            )
    return {name: found[name] for name in names}


def as_past(cells: Columns, column: str, extent: tuple[int, int]) -> PastCells:
    """Return the cells of one column of a tier."""
    fields = {field: cells[name_of(column, field)] for field in FIELDS}
    return PastCells(
        cells[T],
        cells[ROWS].astype(np.int64),
        fields[GOOD].astype(np.int64),
        fields[UNCERTAIN].astype(np.int64),
        fields[MINIMUM],
        fields[MAXIMUM],
        fields[SUM],
        fields[MARKS].astype(np.uint8),
        extent,
    )


def overlapping(t: NDArray[np.int64], width: int, spans: NDArray[np.int64]) -> Flags:
    """Return which cells that begin at t (n,) overlap any of the spans (m, 2)."""
    if not len(spans):
        return np.zeros(len(t), np.bool_)
    reached = np.maximum.accumulate(spans[:, 1])
    before = np.searchsorted(spans[:, 0], t + width) - 1  # the last span that begins in time
    return (before >= 0) & (reached[np.maximum(before, 0)] >= t)
