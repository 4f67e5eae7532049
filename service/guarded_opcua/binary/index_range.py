"""Parts of arrays: OPC UA's NumericRange (Part 4, 7.27)."""

import re
from typing import Any

from asyncua import ua

_DIMENSION = re.compile(r"(\d{1,9})(?::(\d{1,9}))?")
_MAX_DIMENSIONS = 8

Ranges = tuple[slice, ...]


class IndexRangeError(ValueError):
    """The text is not a NumericRange."""


def parse_index_range(text: str) -> Ranges:
    """Parse ``"3"``, ``"1:4"`` or ``"0:1,2"``; bounds count and include both ends.

    >>> parse_index_range("1:4")
    (slice(1, 5, None),)
    """
    parts = text.split(",")
    if len(parts) > _MAX_DIMENSIONS:
        raise IndexRangeError(text)
    found = []
    for part in parts:
        match = _DIMENSION.fullmatch(part)
        if match is None:
            raise IndexRangeError(text)
        low = int(match[1])
        high = low if match[2] is None else int(match[2])
        if match[2] is not None and high <= low:
            raise IndexRangeError(text)
        found.append(slice(low, high + 1))
    return tuple(found)


def select(variant: ua.Variant, ranges: Ranges) -> ua.Variant | None:
    """Return the range of an array, string or byte string; None if it is out of bounds."""
    if not variant.is_array:
        if len(ranges) != 1 or not isinstance(variant.Value, str | bytes):
            return None
        piece = variant.Value[ranges[0]]
        return ua.Variant(piece, variant.VariantType) if piece else None
    value = _cut(variant.Value, ranges)
    return None if value is None else ua.Variant(value, variant.VariantType, is_array=True)


def _cut(value: Any, ranges: Ranges) -> list[Any] | None:  # noqa: ANN401 - nested lists
    if not isinstance(value, list | tuple):
        return None
    piece = list(value[ranges[0]])
    if not piece or len(ranges) == 1:
        return piece or None
    cut = [_cut(row, ranges[1:]) for row in piece]
    return None if any(row is None for row in cut) else cut
