"""Reads the rows of a history in order of time, from blocks that may overlap."""

import sqlite3
from collections import OrderedDict
from typing import Final

import numpy as np

from valvemap.pipeline.store_ports import Past
from valvemap.storage.history_blocks import CODES, SEALED, T
from valvemap.storage.history_cells import codes_of
from valvemap.storage.history_order import in_order, joined, nothing
from valvemap.storage.history_series import SeriesWriter

MOST_REMEMBERED: Final = 80  # columns of blocks: the loose ones of a series, and some sealed ones


class RowReader:
    """Rows of one open file, within the caller's snapshot.

    Blocks that were read last are remembered, as a block's number is not used for other rows: an
    aggregate reads the same ones for what is before, inside and behind its intervals, and three
    aggregates of a variable do so in turn.

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
        self._remembered: OrderedDict[tuple[int, str], Past] = OrderedDict()

    def rows(
        self,
        series: str,
        column: str,
        span: tuple[int, int],
        *,
        backwards: bool,
        skip: int,
        most: int,
    ) -> Past:
        """Return rows in a span (UTC ns, both ends included) after ``skip`` others."""
        if not self._rows.names.keys() >= {column, T, CODES}:
            return nothing()
        low, high = span
        found, wanted = [], skip + most
        blocks = (
            (first, last, self._rows_between(block, series, column, low, high))
            for block, first, last in self._blocks(series, low, high, backwards=backwards)
        )
        for rows in in_order(blocks, backwards=backwards):
            found.append(rows)
            wanted -= len(rows.t)
            if wanted <= 0:
                break
        return joined(found)[skip : skip + most]

    def _blocks(
        self, series: str, low: int, high: int, *, backwards: bool
    ) -> list[tuple[int, int, int]]:
        """Return number, first and last time of blocks in a span, see `in_order`."""
        numbers = [self._rows.names.get(name, -1) for name in (series, series + SEALED)]
        order = "last DESC" if backwards else "first"
        select = (
            "SELECT id, first, last FROM block WHERE series IN (?, ?) AND first <= ? "  # noqa: S608
            f"AND last >= ? ORDER BY {order}"
        )
        return self._reader.execute(select, (*numbers, high, low)).fetchall()

    def _rows_between(self, block: int, series: str, column: str, low: int, high: int) -> Past:
        past = self._whole(block, series, column)
        first, behind = np.searchsorted(past.t, low), np.searchsorted(past.t, high, side="right")
        return past[slice(int(first), int(behind))]  # high + 1 may be beyond int64

    def _whole(self, block: int, series: str, column: str) -> Past:
        key = block, column
        if key not in self._remembered:
            found = self._rows.examined(self._reader, series, block, (T, CODES, column))
            if column not in found.parts:  # the series had no such column then, or it is damaged
                return nothing()
            codes = codes_of(column, found.columns[CODES])
            self._remembered[key] = Past(found.t, found.columns[column], codes)
            while len(self._remembered) > MOST_REMEMBERED:
                self._remembered.popitem(last=False)
        self._remembered.move_to_end(key)
        return self._remembered[key]
