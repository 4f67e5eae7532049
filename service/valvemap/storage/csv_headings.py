"""Headings of a CSV file: behind a logger's notes, with a line of units below, behind a ``#``."""

import csv
from collections.abc import Sequence
from contextlib import suppress
from typing import Final, NamedTuple

from valvemap.plant.unit_texts import is_of_others, known_unit
from valvemap.storage.digit_groups import is_grouped
from valvemap.storage.time_units import TIME_UNITS

SEPARATORS: Final = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar"}
_BRACKETS: Final = "[]() "
_NONE: Final = ("", "-")  # cells of a line of units where there is none


class Headings(NamedTuple):
    """Separator, names with their units, and the number of lines up to the first row."""

    separator: str
    names: list[str]
    lines: int


def headings_of(lines: Sequence[str], separator: str | None = None) -> Headings:
    """Return the headings: the first line with as many cells as most lines below have.

    A line of units below the headings is joined to them. Where no line is so, the first counts.

    Parameters
    ----------
    lines
        The first lines of a file, at least one.
    separator
        Separator of the cells; None: the most frequent one of the headings.

    Examples
    --------
    >>> headings_of(["Rig 4", "", "# t;U;p1;p2;Q", "s;%;kPa;kPa;l/min", "0;1;2;3;4", "1;1;2;3;4"])
    Headings(separator=';', names=['t [s]', 'U [%]', 'p1 [kPa]', 'p2 [kPa]', 'Q [l/min]'], lines=4)
    """
    number = next((k for k in range(len(lines)) if _is_above_rows(lines, k, separator)), 0)
    found = separator or _separator_of(lines[number])
    names = [name.strip().strip("\ufeff") for name in cells_of(lines[number], found)]
    if names:
        names[0] = names[0].removeprefix("#").lstrip()
    units = cells_of(lines[number + 1], found) if number + 1 < len(lines) else []
    if len(units) != len(names) or not _are_units(units):
        return Headings(found, names, number + 1)
    joined = [
        name if unit.strip(_BRACKETS) in _NONE else f"{name} [{unit.strip(_BRACKETS)}]"
        for name, unit in zip(names, units, strict=True)
    ]
    return Headings(found, joined, number + 2)


def cells_of(line: str, separator: str) -> list[str]:
    """Return the cells of one line; none if it is damaged."""
    with suppress(csv.Error):
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    return []


def is_number(cell: str) -> bool:
    """Whether a cell is a number, with a point or a comma, and digits in groups or not."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return is_grouped(cell)
    return "_" not in cell  # which `float` takes, and `columns.numbers` refuses


def _is_above_rows(lines: Sequence[str], number: int, separator: str | None) -> bool:
    """Whether it has two cells or more, not most of them numbers, and most lines below as many."""
    line = lines[number]
    separator = separator or _separator_of(line)
    cells = cells_of(line, separator)
    width, numbers = len(cells), sum(map(is_number, cells))
    below = [len(cells_of(other, separator)) for other in lines[number + 1 :] if other.strip()]
    return width > 1 and 2 * numbers <= width and 2 * below.count(width) > len(below)


def _separator_of(line: str) -> str:
    return max(SEPARATORS, key=line.count)


def _are_units(cells: Sequence[str]) -> bool:
    """Whether each cell is a unit, or says that there is none; and one is a unit."""
    texts = [cell.strip(_BRACKETS) for cell in cells]
    said = [text for text in texts if text not in _NONE]
    return bool(said) and all(map(is_unit, said))


def is_unit(text: str) -> bool:
    """Whether a text is a unit that recordings have."""
    return (
        text.casefold() in {"", *TIME_UNITS} or known_unit(text) is not None or is_of_others(text)
    )
