"""Digits in groups of three: 1.234,5, 1,234.5, 1 234,5 and 1'234.5.

A file has one decimal mark. Where its first cells show which, the other mark groups digits; where
they do not (only ``15.000``), a mark is the decimal one. Spaces and apostrophes only group.
"""

import re
from collections.abc import Iterable, Sequence
from typing import Final

from valvemap.storage.columns import ALLOWED_NUMBER, CellError

_ONLY_GROUP: Final = " \u00a0\u202f\u2009'\u2019"
_MARKS: Final = ".,"
_DECIMAL: Final = re.compile(r"[-+]?(\d+)([.,])(\d+)(?:[eE][-+]?\d+)?")
_BOTH: Final = re.compile(r"[-+]?\d{1,3}(?:([.,])\d{3})+(?!\1)[.,]\d+")
_SEVERAL: Final = re.compile(r"[-+]?\d{1,3}([.,])\d{3}(?:\1\d{3})+")
_GROUPED: Final = {
    mark: re.compile(rf"[-+]?\d{{1,3}}(?:[{mark}]\d{{3}})+(?:[{other}]\d*)?")
    for mark, other in ((".", ","), (",", "."), *((c, ".,") for c in _ONLY_GROUP))
}
_SIZE: Final = 3  # digits of a group


def grouping_of(cells: Iterable[str]) -> str:
    """Return the mark that groups digits in a file with these cells; "" if they do not tell.

    >>> grouping_of(["0,02", "15.000"]), grouping_of(["1,234.5"]), grouping_of(["15.000"])
    ('.', ',', '')
    """
    decimals, groupings = set[str](), set[str]()
    for text in cells:
        cell = text.strip()
        both, several = _BOTH.fullmatch(cell), _SEVERAL.fullmatch(cell)
        decimal = _DECIMAL.fullmatch(cell)
        if both is not None:
            groupings.add(both[1])
        elif several is not None:
            groupings.add(several[1])
        elif decimal is not None and not _may_be_group(decimal[1], decimal[3]):
            decimals.add(decimal[2])
    found = groupings | {mark for mark in _MARKS if decimals == set(_MARKS) - {mark}}
    return found.pop() if len(found) == 1 and not found & decimals else ""


def _may_be_group(before: str, behind: str) -> bool:
    return len(behind) == _SIZE and len(before) <= _SIZE and before != "0"


def is_grouped(cell: str) -> bool:
    """Whether a cell is a number with digits in groups."""
    number = cell.strip()
    return any(form.fullmatch(number) is not None for form in _GROUPED.values())


def ungrouped(cells: Sequence[str], grouping: str, column: str) -> Sequence[str]:
    """Return the cells without marks between groups of digits.

    Raises
    ------
    CellError
        if the mark that groups digits stands elsewhere in a number.
    """
    text = "".join(cells)
    present = [mark for mark in (grouping, *_ONLY_GROUP) if mark and mark in text]
    if not present:
        return cells
    found = list(cells)
    for row, cell in enumerate(cells):
        number = cell.strip()
        for mark in present:
            if mark in number and _GROUPED[mark].fullmatch(number):
                found[row] = number.replace(mark, "")
            elif mark == grouping and mark in number and _DECIMAL.fullmatch(number):
                allowed = f"{ALLOWED_NUMBER}; {mark!r} groups digits in this file"
                raise CellError(row, column, cell, allowed)
    return found
