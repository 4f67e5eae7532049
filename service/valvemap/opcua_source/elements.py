"""Elements of arrays as signals: ``index=3;nsu=urn:plc;s=Commands``, counted from 0.

An array is monitored once: its elements are taken here, from one change for all of them. Of an
array with one signal, the server is asked for that element alone (IndexRange, Part 4, 7.27);
servers that do not know index ranges send the whole array, too.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from struct import Struct
from typing import Final, NamedTuple, Protocol, TypeVar

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


class Element(NamedTuple):
    """A signal's item, and its place in an array."""

    item: int
    place: int


class _Node(Protocol):
    @property
    def item(self) -> int: ...

    @property
    def node(self) -> object: ...

    @property
    def element(self) -> int | None: ...


N = TypeVar("N", bound=_Node)


@dataclass(frozen=True)
class Arrays:
    """The rows of changes whose values are arrays, and where those are: at the encoding byte."""

    data: bytes
    rows: NDArray[np.intp]
    places: NDArray[np.int64]


NO_ARRAYS: Final = Arrays(b"", np.zeros(0, np.intp), np.zeros(0, np.int64))


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
    elements: Mapping[int, Sequence[Element]],
) -> tuple[DataChanges, NDArray[np.uint8]]:
    """Return changes and kinds with a row per element; ``elements`` are by the array's item.

    A change without a value, of a bad status, is one of each element.
    """
    is_array = np.isin(changes.item, np.fromiter(elements, np.int32, len(elements)))
    if not is_array.any():
        return changes, kind
    own = np.flatnonzero(is_array)
    wanted = [elements[item] for item in changes.item[own].tolist()]
    times = np.ones(len(changes), np.intp)
    times[own] = [len(these) for these in wanted]
    rows = np.repeat(np.arange(len(changes)), times)
    found, kinds = changes[rows], kind[rows]
    item, value = found.item.copy(), found.value.copy()
    places = dict(zip(arrays.rows.tolist(), arrays.places.tolist(), strict=True))
    begins = (np.cumsum(times) - times)[own].tolist()
    for row, begin, these in zip(own.tolist(), begins, wanted, strict=True):
        for k, element in enumerate(these, begin):
            item[k] = element.item
            if row in places:
                kinds[k], value[k] = _taken(arrays.data, places[row], element.place)
    return replace(found, item=item, value=value), kinds


def of_one_array(nodes: Iterable[N]) -> list[list[N]]:
    """Return nodes in groups: elements of one array together, any other node alone.

    A group's change comes under the item of its first node.
    """
    groups: dict[object, list[N]] = {}
    for node in nodes:
        key = node.item if node.element is None else ("array", node.node)
        groups.setdefault(key, []).append(node)
    return list(groups.values())


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
