"""Dates as spreadsheets write them: 31.12.2026 13:45, 12/31/2026 1:45 PM, or days since 1900."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from enum import Enum
from itertools import pairwise
from typing import Final

from valvemap.clock import utc_ns

_DATE = re.compile(
    r"(\d{1,2})([./-])(\d{1,2})\2(\d{4})"
    r"(?:[ ,T]\s*(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?\s*([AaPp]\.?[Mm]\.?)?)?"
)
_SERIAL_EPOCH_DAYS: Final = 25_569  # 1970-01-01 as an Excel day number
_SERIALS: Final = (20_000, 80_000)  # days: 1954 to 2119
_SHORTEST_STEP_S: Final = 5e-4  # s; smaller steps are days: no source has 2 kHz
_DAY_NS: Final = 86_400 * 10**9


class Order(Enum):
    """Which of a date's first two numbers is the day."""

    DAY_FIRST = "day first"
    MONTH_FIRST = "month first"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class DateForm:
    """The date format of one file, in addition to ISO 8601, ns and seconds.

    ``serial``: numbers are days since 1899-12-30; ``order``: order of day and month in numeric
    dates.
    """

    serial: bool = False
    order: Order = Order.UNKNOWN


def date_form(cells: Sequence[str]) -> DateForm:
    """Detect the date format of a file from its first times.

    >>> date_form(["13/02/2026 08:00:00"]).order, date_form(["46000.25", "46000.2500001"]).serial
    (<Order.DAY_FIRST: 'day first'>, True)
    """
    order = Order.UNKNOWN
    for cell in cells:
        match = _DATE.fullmatch(cell.strip())
        if match is None:
            continue
        first, second = int(match[1]), int(match[3])
        if match[9] or second > 12:
            return DateForm(order=Order.MONTH_FIRST)
        if first > 12:
            order = Order.DAY_FIRST
    return DateForm(serial=_are_serial(cells), order=order)


def _are_serial(cells: Sequence[str]) -> bool:
    try:
        days = [float(cell.replace(",", ".")) for cell in cells]
    except ValueError:
        return False
    low, high = _SERIALS
    if len(days) < 2 or not all(low <= day <= high for day in days):
        return False
    steps = sorted(abs(b - a) for a, b in pairwise(days) if a != b)
    return bool(steps) and steps[len(steps) // 2] < _SHORTEST_STEP_S


def date_nanoseconds(cell: str, form: DateForm) -> int | None:
    """Return UTC ns of one cell; None if it is no such date, or day and month are ambiguous."""
    text = cell.strip()
    if form.serial:
        try:
            days = Decimal(text.replace(",", "."))
        except InvalidOperation:
            return None
        return int(((days - _SERIAL_EPOCH_DAYS) * _DAY_NS).to_integral_value())
    match = _DATE.fullmatch(text)
    if match is None or is_ambiguous(cell, form):
        return None
    first, second = int(match[1]), int(match[3])
    day_first = match[2] == "." or form.order is Order.DAY_FIRST
    day, month = (first, second) if day_first else (second, first)
    hour = int(match[5] or 0)
    if match[9]:
        hour = hour % 12 + (12 if match[9][0] in "Pp" else 0)
    try:
        moment = datetime(
            int(match[4]), month, day, hour, int(match[6] or 0), int(match[7] or 0), tzinfo=UTC
        )
    except ValueError:
        return None
    return utc_ns(moment) + int((match[8] or "").ljust(9, "0"))


def is_ambiguous(cell: str, form: DateForm) -> bool:
    """Whether it is a date whose day and month are ambiguous."""
    match = _DATE.fullmatch(cell.strip())
    return match is not None and match[2] != "." and form.order is Order.UNKNOWN
