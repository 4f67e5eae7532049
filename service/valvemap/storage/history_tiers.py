"""Reads the tiers of a history: cells of sealed rows, and of those that are still loose."""

import sqlite3
from collections import OrderedDict
from typing import Any, Final

import numpy as np

from valvemap.pipeline.store_ports import PastCells
from valvemap.storage.history_blocks import CODES, SEALED, T
from valvemap.storage.history_cells import (
    FIELDS,
    ROWS,
    WIDTHS,
    Columns,
    as_past,
    cells_of,
    merged,
    name_of,
    tier_of,
)
from valvemap.storage.history_series import SeriesWriter

MOST_REMEMBERED: Final = 32  # answers, so that minimum, mean and maximum need one search
_BLOCKS = "SELECT id FROM block WHERE series = ? AND first < ? AND last >= ? ORDER BY first"
_EXTENT = "SELECT min(first), max(last) FROM block WHERE series IN (?, ?)"
_EXTENT_OF_TIER = "SELECT min(first), max(last) FROM block WHERE series = ?"
_Key = tuple[Any, ...]


class TierReader:
    """Cells of one open file, within the caller's snapshot.

    Parameters
    ----------
    connection
        The reading connection to the file.
    rows
        Its series.
    """

    def __init__(self, connection: sqlite3.Connection, rows: SeriesWriter) -> None:
        self._reader = connection
        self._rows = rows
        self._remembered: OrderedDict[_Key, PastCells | None] = OrderedDict()

    def cells(
        self, series: str, column: str, span: tuple[int, int], width: int, state: object
    ) -> PastCells | str | None:
        """Return the cells that begin in a span (UTC ns, its end excluded); None if there are none.

        The series' name, if cells are damaged. ``state`` identifies the content of the file.
        """
        key = series, column, span, width, state
        if key not in self._remembered:
            found = self._cells(series, column, span, width)
            if isinstance(found, str):
                return found
            self._remembered[key] = found
            while len(self._remembered) > MOST_REMEMBERED:
                self._remembered.popitem(last=False)
        return self._remembered[key]

    def _cells(
        self, series: str, column: str, span: tuple[int, int], width: int
    ) -> PastCells | str | None:
        names = self._rows.names
        if width not in WIDTHS or not names.keys() >= {T, CODES, column}:
            return None
        found: list[Columns] = []
        tier = tier_of(series, width)
        wanted = T, CODES, ROWS, *(name_of(column, field) for field in FIELDS)
        if names.keys() >= {tier, *wanted}:
            for block in self._blocks(tier, span):
                part = self._rows.examined(self._reader, tier, block, wanted)
                if not len(part.t) or part.damaged:
                    return series
                own = {name: part.columns[name] for name in wanted if name in part.columns}
                found.append(_within(own, span))
        found += self._loose(series, column, span, width)
        extent = self._extent(series, width)
        some = [part for part in found if len(part[T])]
        if extent is None or not some:
            return None
        return as_past(merged(some), column, extent)

    def _blocks(self, series: str, span: tuple[int, int]) -> list[int]:
        low, high = span
        number = self._rows.names.get(series, -1)
        return [id_ for (id_,) in self._reader.execute(_BLOCKS, (number, high, low)).fetchall()]

    def _loose(self, series: str, column: str, span: tuple[int, int], width: int) -> list[Columns]:
        parts = []
        low, high = span[0] - span[0] % width, span[1] + -span[1] % width
        for block in self._blocks(series, (low, high)):
            part = self._rows.examined(self._reader, series, block, (T, CODES, column)).columns
            if column in part:
                parts.append({name: part[name] for name in (T, CODES, column)})
        if not parts:
            return []
        joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        order = np.argsort(joined[T], kind="stable")
        rows = {name: values[order] for name, values in joined.items()}
        return [_within(cells_of(rows, width), span)]

    def _extent(self, series: str, width: int) -> tuple[int, int] | None:
        """Return the first and last time of a series; of rows that are gone, those of cells."""
        names = self._rows.names
        both = names.get(series, -1), names.get(series + SEALED, -1)
        first, last = self._reader.execute(_EXTENT, both).fetchone()
        tier = names.get(tier_of(series, width), -1)
        low, high = self._reader.execute(_EXTENT_OF_TIER, (tier,)).fetchone()
        if first is None:
            return None if low is None else (low, high + width - 1)
        return (first if low is None or low + width > first else low), last


def _within(columns: Columns, span: tuple[int, int]) -> Columns:
    t = columns[T]
    rows = slice(*np.searchsorted(t, span).tolist())
    return {name: values[rows] for name, values in columns.items()}
