"""The cells of some lines of a CSV file, by column: as text, or parsed by Arrow."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Floats, Times
from valvemap.storage import columns
from valvemap.storage.cell_units import without_unit
from valvemap.storage.clock_times import Clock
from valvemap.storage.columns import CellError
from valvemap.storage.csv_headings import is_number
from valvemap.storage.dates import DateForm
from valvemap.storage.digit_groups import ungrouped
from valvemap.storage.time_units import SYMBOLS

_ALLOWED_UNITS = (
    f"a number of {', '.join(SYMBOLS)}, and the heading states another unit: name it in brackets, "
    "such as t [ms] (units={'t': 'ms'} in Python)"
)


class Cells(Protocol):
    """Lines of a file; each method converts the column at ``place``, and may raise a CellError."""

    def numbers(self, place: int, name: str) -> Floats: ...  # noqa: D102

    def times(self, place: int, seconds: float = 1.0) -> Times: ...  # noqa: D102

    def qualities(self, place: int) -> Codes: ...  # noqa: D102

    def names(self, place: int) -> tuple[list[str], NDArray[np.intp]]: ...  # noqa: D102


class TextForm(NamedTuple):
    """How a file writes times and numbers.

    ``grouping`` is the mark between groups of digits; ``days`` are the places of dates and of times
    of day, where these are two columns; ``clock`` reads times of day where there are no dates;
    ``units`` are those inside the cells, by column.
    """

    separator: str = ","
    dates: DateForm = DateForm()
    grouping: str = ""
    days: tuple[int, int] | None = None
    clock: Clock | None = None
    units: Mapping[int, str] = {}


class TextCells:
    """Cells as text; a decimal comma is accepted unless the comma separates columns."""

    def __init__(self, rows: Sequence[Sequence[str]], form: TextForm) -> None:
        self._columns: list[Sequence[str]] = list(zip(*rows, strict=True))
        if form.days is not None:
            day, clock = form.days
            pairs = zip(self._columns[day], self._columns[clock], strict=True)
            joined = [f"{x.strip()} {y.strip()}" for x, y in pairs]
            self._columns[day] = self._columns[clock] = joined
        for place, unit in form.units.items():
            self._columns[place] = without_unit(self._columns[place], unit)
        self._form = form
        self._separator = form.separator

    def numbers(self, place: int, name: str) -> Floats:
        """Numbers; an empty cell is NaN."""
        cells = ungrouped(self._columns[place], self._form.grouping, name)
        if self._separator != ",":
            return columns.numbers(with_points(cells), name)
        try:
            return columns.numbers(cells, name)
        except CellError:  # a quoted decimal comma
            if not any("," in cell for cell in cells):
                raise
            return columns.numbers(with_points(cells), name)

    def times(self, place: int, seconds: float = 1.0) -> Times:
        """UTC ns; ``seconds`` is the unit of numbers."""
        if seconds != 1.0 and is_number(self._columns[place][0]):
            return scaled_times(self.numbers(place, "t"), self._columns[place], seconds)
        if self._form.clock is not None:
            return self._form.clock.times(self._columns[place])
        cells = ungrouped(self._columns[place], self._form.grouping, "t")
        return times_of_text(cells, self._separator, self._form.dates)

    def qualities(self, place: int) -> Codes:
        """Qualities."""
        return columns.qualities(self._columns[place])

    def names(self, place: int) -> tuple[list[str], NDArray[np.intp]]:
        """Distinct names, and the index of each row's name."""
        return columns.names(self._columns[place])


def scaled_times(values: Floats, cells: Any, seconds: float) -> Times:  # noqa: ANN401 - by row
    """Return ns of numbers in a unit, given in seconds; `UNKNOWN` is refused."""
    if math.isnan(seconds):
        raise CellError(0, "t", cells[0], _ALLOWED_UNITS)
    if not np.isfinite(values).all():
        row = int(np.argmax(~np.isfinite(values)))
        raise CellError(row, "t", cells[row], columns.ALLOWED_TIME)
    beyond = np.abs(values) * seconds >= columns.LATEST_S
    if beyond.any():
        row = int(np.argmax(beyond))
        raise CellError(row, "t", cells[row], columns.ALLOWED_TIME)
    whole, unit = np.trunc(values), round(seconds * 1e9)
    return np.asarray(
        whole.astype(np.int64) * unit + np.rint((values - whole) * unit).astype(np.int64)
    )


def times_of_cells(cells: Sequence[str], seconds: float) -> Times:
    """Return UTC ns of cells with points; ``seconds`` is the unit of numbers."""
    if seconds != 1.0 and len(cells) and is_number(cells[0]):
        return scaled_times(columns.numbers(cells, "t"), cells, seconds)
    return columns.times(cells)


def times_of_text(cells: Sequence[str], separator: str, dates: DateForm) -> Times:
    """Return UTC ns; a decimal comma is accepted."""
    if separator == "," and not any("," in cell for cell in cells):
        return columns.times(cells, dates)
    return columns.times(with_points(cells), dates)


def with_points(cells: Sequence[str]) -> list[str]:
    """Return the cells with points for commas."""
    return [cell.replace(",", ".") for cell in cells]
