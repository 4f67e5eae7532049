"""Units inside the cells of a recording: ``12.3 bar``, in a column or in a file's long format."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from valvemap.storage.columns import is_missing
from valvemap.storage.csv_headings import is_number, is_unit

_CELL: Final = re.compile(r"(?P<number>[-+]?[\d.,']+(?:[eE][-+]?\d+)?)\s*(?P<unit>[^\d\s.,].*)")


def number_and_unit(cell: str) -> tuple[str, str]:
    """Return the number and the unit of a cell; the cell and ``""`` if it has no unit.

    >>> [number_and_unit(cell) for cell in ("12.3 bar", "-1,5e3 l/min", "7.1", "3 pieces", "NA")]
    [('12.3', 'bar'), ('-1,5e3', 'l/min'), ('7.1', ''), ('3 pieces', ''), ('NA', '')]
    """
    match = _CELL.fullmatch(cell.strip())
    if match is None or not is_unit(match["unit"]) or not is_number(match["number"]):
        return cell, ""
    return match["number"], match["unit"].strip()


def units_of(rows: Sequence[Sequence[str]]) -> Mapping[int, str]:
    """Return the unit inside the cells by column, where all that hold a number have the same.

    >>> units_of([["0.1", "12 bar"], ["0.2", "13 bar"], ["0.3", "NA"]])
    {1: 'bar'}
    """
    found: dict[int, str] = {}
    for place, cells in enumerate(zip(*rows, strict=True)):
        units = {number_and_unit(cell)[1] for cell in cells if not is_missing(cell)}
        if len(units) == 1 and (unit := units.pop()):
            found[place] = unit
    return found


def without_unit(cells: Iterable[str], unit: str) -> list[str]:
    """Return the cells without a unit; those that have another one stay as they are."""
    return [
        number if own == unit else cell
        for cell, (number, own) in ((cell, number_and_unit(cell)) for cell in cells)
    ]
