"""Converts the columns of a recording from text to arrays, exactly.

A cell that cannot be parsed raises :class:`CellError`; the reader adds file and line to it.
"""

import re
from collections.abc import Iterator, Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation

import numpy as np
from numpy.typing import NDArray

from valvemap.clock import utc_ns
from valvemap.model.samples import Codes, Floats, Samples, Times
from valvemap.storage.dates import DateForm, date_nanoseconds, is_ambiguous
from valvemap.vocabulary.statuses import Quality

NANOSECONDS_FROM = 10**15
ALLOWED_TIME = (
    "an ISO 8601 time, an integer >= 1e15 (UTC ns) or seconds, between the years 1678 and 2261"
)
_IN_MS_HINT = "; for milliseconds since 1970, name the column t [ms] (units={'t': 'ms'} in Python)"
ALLOWED_DATE = "a date in which day and month can be told apart: write 2026-12-31T08:00:00"
ALLOWED_NUMBER = "a number, nan or an empty cell"
_MISSING = frozenset(  # as other programs write it, historians and spreadsheets among them
    {
        "",
        "na",
        "n/a",
        "n.a.",
        "#n/a",
        "null",
        "none",
        "nil",
        "-",
        "--",
        "---",
        "?",
        "bad",
        "invalid",
    }
    | {"bad input", "bad quality", "no data", "no value", "nodata", "not available", "i/o timeout"}
    | {"comm fail", "comm error", "shutdown", "out of service", "error", "#div/0!", "underflow"}
    | {"#nv", "#n/d", "(null)", "<null>", "err", "over range", "under range", "overflow"}
)
_ERROR_VALUE = re.compile(r"#[^\d!?]+[!?]|-?1\.#(?:qnan|ind|snan)")  # of spreadsheets, of C
ALLOWED_QUALITY = "0, 1, 2, Good, Uncertain, Bad or an OPC UA status code"
ALLOWED_VALVE = "a name"

_ZONE_WORD = re.compile(r"\s*(?:UTC|GMT)$")
_FRACTION = re.compile(r"[.,](\d+)")
_EXACT_SECONDS = 1e6  # below, doubles still resolve 1 ns
_EXACT_INTEGERS = 2.0**53  # below, doubles are exact integers
_NANO = 9  # decimals of a second in ns
_SMALLEST, _LARGEST = -(2**63) + 1, 2**63 - 1  # -2**63 is NaT elsewhere
LATEST_S = _LARGEST // 10**9  # since 1970
_IN_MS = (1e11, 1e14)  # since 1970: of the years 1973 to 5138


class CellError(Exception):
    """One cell of a column cannot be read; rows count from 0 within the batch."""

    def __init__(self, row: int, column: str, value: object, allowed: str) -> None:
        hint = _IN_MS_HINT if column == "t" and _may_be_ms(value) else ""
        super().__init__(f"{column} is {_shortened(value)}, allowed is {allowed}{hint}")
        self.row = row


def numbers(cells: Sequence[str], column: str) -> Floats:
    """Read numbers as Python does (correctly rounded); an empty cell is NaN.

    >>> numbers(["1.5", "", "nan", "-2e3"], "U")
    array([ 1.5e+00,      nan,      nan, -2.0e+03])
    """
    try:
        read = np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return np.array([_number(row, column, cell) for row, cell in enumerate(cells)])
    _refuse_underscores(cells, column, ALLOWED_NUMBER)
    return read


def is_missing(cell: str) -> bool:
    """Whether a cell says that there is no number: it is empty, or NA, null, none or a dash."""
    text = cell.strip().casefold()
    return text in _MISSING or _ERROR_VALUE.fullmatch(text) is not None


def times(cells: Sequence[str], form: DateForm | None = None) -> Times:
    """Read times as UTC ns, each cell by its own form and exact to the ns.

    An integer of at least 1e15 is UTC ns, any other number is seconds since 1970 (or since the
    recording's own origin), anything else is ISO 8601, in UTC if it has no offset. Digits beyond
    the ns are truncated. ``form`` is the date format of a spreadsheet, if any.

    >>> times(["1700000000123456789", "0.01", "1970-01-01T01:00:00.000000001+01:00"])
    array([1700000000123456789,            10000000,                   1])
    """
    form = form or DateForm()
    if form.serial:
        return np.array([_instant(row, cell, form) for row, cell in enumerate(cells)], np.int64)
    try:
        whole = np.fromiter(map(int, cells), np.int64, len(cells))
        if whole.size and whole.min() >= NANOSECONDS_FROM:
            _refuse_underscores(cells, "t", ALLOWED_TIME)
            return whole
    except (ValueError, OverflowError):
        pass
    try:
        seconds = np.fromiter(map(float, cells), np.float64, len(cells))
        if np.all(np.abs(seconds) < _EXACT_SECONDS):
            _refuse_underscores(cells, "t", ALLOWED_TIME)
            return np.rint(seconds * 1e9).astype(np.int64)
    except ValueError:
        pass
    return np.array([_instant(row, cell, form) for row, cell in enumerate(cells)], np.int64)


def times_of_integers(values: NDArray[np.int64]) -> Times:
    """Return UTC ns from integers: those of at least 1e15 are ns, the others seconds."""
    is_ns = values >= NANOSECONDS_FROM
    seconds = np.where(is_ns, 0, values)
    limit = _LARGEST // 10**9
    _refuse_times((seconds > limit) | (seconds < -limit), values)
    return np.where(is_ns, values, seconds * 10**9)


def times_of_floats(values: Floats) -> Times:
    """Return UTC ns from doubles: those of at least 1e15 are ns, the others seconds.

    Seconds count as their shortest decimal, so that they are those of :func:`times`.

    >>> times_of_floats(np.array([0.01, 1_700_000_000.123])).tolist()
    [10000000, 1700000000123000000]
    """
    is_ns = values >= NANOSECONDS_FROM
    limit = np.where(is_ns, 2.0**63, _LARGEST // 10**9)
    _refuse_times(~(np.abs(values) < limit), values)
    ns = np.where(is_ns, values, 0.0).astype(np.int64)
    seconds = np.where(is_ns, 0.0, values)
    ns[~is_ns] = np.rint(np.where(np.abs(seconds) < _EXACT_SECONDS, seconds, 0.0) * 1e9)[~is_ns]
    left = np.flatnonzero(np.abs(seconds) >= _EXACT_SECONDS)
    for decimals in range(_NANO + 1):
        if not len(left):
            break
        scaled = np.rint(values[left] * 10.0**decimals)
        exact = (np.abs(scaled) < _EXACT_INTEGERS) & (scaled / 10.0**decimals == values[left])
        ns[left[exact]] = scaled[exact].astype(np.int64) * 10 ** (_NANO - decimals)
        left = left[~exact]
    for row in left.tolist():
        ns[row] = int((Decimal(repr(float(values[row]))) * 10**9).to_integral_value())
    return ns


def qualities(cells: Sequence[str]) -> Codes:
    """Parse qualities: words by their prefix, status codes by their severity.

    >>> qualities(["0", "Bad", "UncertainLastUsableValue", "2147483648", "0x40000000"])
    array([0, 2, 1, 2, 1], dtype=uint8)
    """
    known = {cell: _quality(cell) for cell in set(cells)}
    for row, cell in enumerate(cells if None in known.values() else ()):
        if known[cell] is None:
            raise CellError(row, "quality", cell, ALLOWED_QUALITY)
    return np.array([known[cell] for cell in cells], np.uint8)


def qualities_of_integers(values: NDArray[np.int64]) -> Codes:
    """Return qualities from 0, 1, 2 and OPC UA status codes."""
    if values.size and values.min() >= Quality.GOOD and values.max() <= Quality.BAD:
        return values.astype(np.uint8)
    distinct, where = np.unique(values, return_inverse=True)
    known = [_quality_of_code(int(value)) for value in distinct]
    for row in np.flatnonzero(np.array([code is None for code in known])[where])[:1]:
        raise CellError(int(row), "quality", values[row], ALLOWED_QUALITY)
    return np.array(known, np.uint8)[where]


def names(cells: Sequence[str]) -> tuple[list[str], NDArray[np.intp]]:
    """Return distinct names in order of appearance, and the index of each row's name."""
    distinct = list(dict.fromkeys(cells))
    if "" in distinct:
        raise CellError(list(cells).index(""), "valve", "", ALLOWED_VALVE)
    index = {name: i for i, name in enumerate(distinct)}
    return distinct, np.fromiter(map(index.__getitem__, cells), np.intp, len(cells))


def by_valve(
    samples: Samples, valves: Sequence[str], index: NDArray[np.intp]
) -> Iterator[tuple[str, Samples]]:
    """Split a batch by valve, preserving the order of rows."""
    present = np.flatnonzero(np.bincount(index)).tolist()
    for i in present:
        yield valves[i], samples if len(present) == 1 else samples[index == i]


def time_text(t: int) -> str:
    """Format a time so that :func:`times` returns the same ns: as ns where unambiguous.

    >>> time_text(1_700_000_000_123_456_789), time_text(-10_000_001)
    ('1700000000123456789', '-0.010000001')
    """
    if t >= NANOSECONDS_FROM:
        return str(t)
    seconds, ns = divmod(abs(t), 10**9)
    return f"{'-' if t < 0 else ''}{seconds}.{ns:09d}"


def _number(row: int, column: str, cell: str) -> float:
    if is_missing(cell):
        return float("nan")
    try:
        number = float(cell)
    except ValueError:
        number = None
    if number is None or "_" in cell:
        raise CellError(row, column, cell, ALLOWED_NUMBER)
    return number


def _instant(row: int, cell: str, form: DateForm) -> int:
    t = date_nanoseconds(cell, form)
    if t is None and is_ambiguous(cell, form):
        raise CellError(row, "t", cell, ALLOWED_DATE)
    try:
        t = _nanoseconds(cell.strip()) if t is None else t
    except (ValueError, InvalidOperation):
        t = None
    if t is None or not _SMALLEST <= t <= _LARGEST:
        raise CellError(row, "t", cell, ALLOWED_TIME)
    return t


def _nanoseconds(cell: str) -> int | None:
    try:
        number = Decimal(cell)
    except InvalidOperation:
        return _iso_nanoseconds(cell)
    if "_" in cell or not number.is_finite():
        return None
    if number >= NANOSECONDS_FROM:
        return int(number) if number == number.to_integral_value() else None
    if abs(number) > _LARGEST:
        return None
    return int((number * 10**9).to_integral_value())


def _iso_nanoseconds(cell: str) -> int:
    moment = datetime.fromisoformat(_ZONE_WORD.sub("+00:00", cell))  # cuts digits behind the sixth
    fraction = _FRACTION.search(cell)
    rest = int(fraction[1][6:9].ljust(3, "0")) if fraction else 0
    return utc_ns(moment) + rest


def _quality(cell: str) -> Quality | None:
    word = cell.strip().casefold()
    for quality in Quality:
        if word.startswith(quality.name.casefold()):
            return quality
    try:
        return _quality_of_code(int(word, 0))
    except ValueError:
        return None


def _quality_of_code(code: int) -> Quality | None:
    if code in (0, 1, 2):
        return Quality(code)
    if 1024 <= code < 2**32:  # smaller codes are OPC Classic qualities, where 192 is good
        return Quality(min(code >> 30, 2))
    return None


def _refuse_underscores(cells: Sequence[str], column: str, allowed: str) -> None:
    if "_" in "".join(cells):
        row = next(i for i, cell in enumerate(cells) if "_" in cell)
        raise CellError(row, column, cells[row], allowed)


def _refuse_times(bad: NDArray[np.bool_], values: Floats | NDArray[np.int64]) -> None:
    if bad.any():
        row = int(np.argmax(bad))
        raise CellError(row, "t", values[row], ALLOWED_TIME)


def _may_be_ms(value: object) -> bool:
    try:
        return _IN_MS[0] <= abs(float(str(value))) < _IN_MS[1]
    except ValueError:
        return False


def _shortened(value: object) -> str:
    text = repr(str(value))
    return text if len(text) <= 60 else text[:57] + "...'"
