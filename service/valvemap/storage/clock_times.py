"""Times of day: 13:45:10,5 or 1:45:10 PM, beside a column of dates or alone."""

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from valvemap.model.samples import Times
from valvemap.storage.columns import ALLOWED_TIME, CellError

_CLOCK: Final = re.compile(
    r"(\d{1,2}):([0-5]\d)(?::([0-5]\d)(?:[.,:](\d{1,9}))?)?\s*([AaPp]\.?[Mm]\.?)?"
)
_DAY: Final = re.compile(r"\d{4}[-./]\d{1,2}[-./]\d{1,2}|\d{1,2}([-./])\d{1,2}\1\d{4}")
_HOURS, _NOON = 24, 12
_DAY_NS: Final = 86_400 * 10**9
_MIDNIGHT_NS: Final = -_DAY_NS // 2  # a step back by more passes midnight


def is_clock(cell: str) -> bool:
    """Whether a cell is a time of day.

    >>> is_clock("13:45:10,25"), is_clock("1:45 PM"), is_clock("2026-01-01 13:45")
    (True, True, False)
    """
    match = _CLOCK.fullmatch(cell.strip())
    return match is not None and int(match[1]) < _HOURS


def is_day(cell: str) -> bool:
    """Whether a cell is a date alone."""
    return _DAY.fullmatch(cell.strip()) is not None


def day_and_clock(rows: Sequence[Sequence[str]], time: int) -> tuple[int, int] | None:
    """Return the places of dates and times of day, if one of them is the column ``time``.

    >>> day_and_clock([["31.12.2026", "13:45:10", "5,2"]], 0)
    (0, 1)
    """
    if not rows or time >= len(rows[0]):
        return None
    places = range(len(rows[0]))
    of_column, others = (is_day, is_clock) if is_day(rows[0][time]) else (is_clock, is_day)
    if not all(of_column(row[time]) for row in rows):
        return None
    for place in places:
        if place != time and all(others(row[place]) for row in rows):
            return (time, place) if of_column is is_day else (place, time)
    return None


class Clock:
    """Converts times of day to ns since the first midnight, block after block of one file."""

    def __init__(self) -> None:
        self._days = 0
        self._last: int | None = None

    def times(self, cells: Sequence[str]) -> Times:
        """Return ns; a day begins where a time is earlier by more than half a day."""
        t = np.array([_nanoseconds(row, cell) for row, cell in enumerate(cells)], np.int64)
        before = np.concatenate(([t[0] if self._last is None else self._last], t[:-1]))
        steps = t - before
        days = self._days + np.cumsum(steps < _MIDNIGHT_NS) - np.cumsum(steps > -_MIDNIGHT_NS)
        self._days, self._last = int(days[-1]), int(t[-1])
        return np.asarray(t + days * _DAY_NS, np.int64)


def _nanoseconds(row: int, cell: str) -> int:
    match = _CLOCK.fullmatch(cell.strip())
    if match is None or int(match[1]) >= _HOURS:
        raise CellError(row, "t", cell, ALLOWED_TIME)
    hour = int(match[1])
    if match[5]:
        hour = hour % _NOON + (_NOON if match[5][0] in "Pp" else 0)
    seconds = 3_600 * hour + 60 * int(match[2]) + int(match[3] or 0)
    return seconds * 10**9 + int((match[4] or "").ljust(9, "0"))
