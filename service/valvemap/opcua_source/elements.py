"""Elements of arrays as signals: ``index=3;nsu=urn:plc;s=Commands``, counted from 0.

The server is asked for the element alone (IndexRange, Part 4, 7.27). Servers that do not know
index ranges send the whole array; the element is then taken here.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import nan
from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.opcua_source.wire import NUMERIC_FORMATS
from valvemap.pipeline.data_changes import DataChanges

ARRAY: Final = 254
"""The kind of a change whose value is an array; see ``Message.kind``."""
NO_NUMBER: Final = 255
"""The kind of a change whose value is neither a number nor an array of numbers."""

_PREFIX = re.compile(r"index=(?P<element>\d{1,9});(?P<node>.+)", re.DOTALL)
_KIND: Final = 0x3F  # bits of a Variant's encoding byte
_LENGTH = Struct("<i")


@dataclass(frozen=True)
class Arrays:
    """The rows of changes whose values are arrays, and where those are: at the encoding byte."""

    data: bytes
    rows: NDArray[np.intp]
    places: NDArray[np.int64]


def parted(text: str) -> tuple[int | None, str]:
    """Split the text of a node into the element (None: its value is no array) and the NodeId.

    >>> parted("index=3;ns=2;s=Commands"), parted("ns=2;s=index=3;")
    ((3, 'ns=2;s=Commands'), (None, 'ns=2;s=index=3;'))
    """
    match = _PREFIX.fullmatch(text)
    return (None, text) if match is None else (int(match["element"]), match["node"])


def with_elements(
    changes: DataChanges,
    kind: NDArray[np.uint8],
    arrays: Arrays,
    elements: Mapping[int, int],
) -> tuple[DataChanges, NDArray[np.uint8]]:
    """Return changes and kinds with the elements of arrays; ``elements`` are by item."""
    value, kinds = changes.value.copy(), kind.copy()
    for row, place in zip(arrays.rows.tolist(), arrays.places.tolist(), strict=True):
        element = elements.get(int(changes.item[row]))
        if element is not None:
            kinds[row], value[row] = _taken(arrays.data, place, element)
    return replace(changes, value=value), kinds


def _taken(data: bytes, place: int, element: int) -> tuple[int, float]:
    """Return kind and number of an element; an array of one is the element itself."""
    kind = data[place] & _KIND
    form = NUMERIC_FORMATS.get(kind)
    (length,) = _LENGTH.unpack_from(data, place + 1)
    index = 0 if length == 1 else element
    if form is None or not 0 <= index < length:
        return NO_NUMBER, nan
    begins = place + 1 + _LENGTH.size
    return kind, float(form.unpack_from(data, begins + index * form.size)[0])
