"""Parts of values as signals: ``index=3;nsu=urn:plc;s=Commands``, counted from 0.

Or members of structures (:mod:`valvemap.opcua_source.members`). A variable is monitored once: its
parts are taken here, from one change for all of them. Of an array with one signal, the server is
asked for that element alone (IndexRange, Part 4, 7.27); servers that do not know index ranges send
the whole array, too.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from struct import Struct
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.opcua_source.members import Member, taken
from valvemap.opcua_source.structures import PATH, Path, parse_path
from valvemap.opcua_source.wire import NUMERIC_FORMATS
from valvemap.pipeline.data_changes import DataChanges

COMPOUND: Final = 254
"""The kind of a change whose value is an array or a structure; see ``Message.kind``."""
NO_NUMBER: Final = 255
"""The kind of a change whose value is nothing of which a signal could be taken."""

_PREFIX = re.compile(
    rf"(?:index=(?P<element>\d{{1,9}})|member=(?P<path>{PATH}));(?P<node>.+)", re.DOTALL
)
_KIND: Final = 0x3F  # bits of a Variant's encoding byte
_IS_ARRAY: Final = 0x80
_LENGTH = Struct("<i")


class Element(NamedTuple):
    """A signal's item, and its place in an array or a structure."""

    item: int
    place: int | Member


class _Node(Protocol):
    @property
    def item(self) -> int: ...

    @property
    def node(self) -> object: ...

    @property
    def place(self) -> int | Member | None: ...


N = TypeVar("N", bound=_Node)


@dataclass(frozen=True)
class Compounds:
    """The rows of changes whose values have parts, and where those are: at the encoding byte."""

    data: bytes
    rows: NDArray[np.intp]
    places: NDArray[np.int64]


NO_COMPOUNDS: Final = Compounds(b"", np.zeros(0, np.intp), np.zeros(0, np.int64))


def parted(text: str) -> tuple[int | Path | None, str]:
    """Split the text of a node into the part (None: the value itself is meant) and the NodeId.

    >>> parted("index=3;ns=2;s=Commands"), parted("ns=2;s=index=3;")
    ((3, 'ns=2;s=Commands'), (None, 'ns=2;s=index=3;'))
    >>> parted("member=In[1].p;ns=2;s=V1")
    (('In', 1, 'p'), 'ns=2;s=V1')
    """
    match = _PREFIX.fullmatch(text)
    if match is None:
        return None, text
    element, path = match["element"], match["path"]
    return (parse_path(path) if element is None else int(element)), match["node"]


def with_elements(
    changes: DataChanges,
    kind: NDArray[np.uint8],
    compounds: Compounds,
    elements: Mapping[int, Sequence[Element]],
) -> tuple[DataChanges, NDArray[np.uint8]]:
    """Return changes and kinds with a row per element; ``elements`` are by the variable's item.

    A change without a value, of a bad status, is one of each element.
    """
    is_whole = np.isin(changes.item, np.fromiter(elements, np.int32, len(elements)))
    if not is_whole.any():
        return changes, kind
    own = np.flatnonzero(is_whole)
    wanted = [elements[item] for item in changes.item[own].tolist()]
    times = np.ones(len(changes), np.intp)
    times[own] = [len(these) for these in wanted]
    rows = np.repeat(np.arange(len(changes)), times)
    found, kinds = changes[rows], kind[rows]
    item, value = found.item.copy(), found.value.copy()
    places = dict(zip(compounds.rows.tolist(), compounds.places.tolist(), strict=True))
    begins = (np.cumsum(times) - times)[own].tolist()
    for row, begin, these in zip(own.tolist(), begins, wanted, strict=True):
        for k, element in enumerate(these, begin):
            item[k] = element.item
            if row in places:
                kinds[k], value[k] = _taken(compounds.data, places[row], element.place)
    return replace(found, item=item, value=value), kinds


def of_one_variable(nodes: Iterable[N]) -> list[list[N]]:
    """Return nodes in groups: parts of one variable together, any other node alone.

    A group's change comes under the item of its first node.
    """
    groups: dict[object, list[N]] = {}
    for node in nodes:
        key = node.item if node.place is None else ("parts", node.node)
        groups.setdefault(key, []).append(node)
    return list(groups.values())


def _taken(data: bytes, place: int, element: int | Member) -> tuple[int, float]:
    """Return kind and number of a part; an array of one is the element itself."""
    if isinstance(element, Member):
        return taken(data, place, element) or (NO_NUMBER, nan)
    if not data[place] & _IS_ARRAY:
        return NO_NUMBER, nan
    kind = data[place] & _KIND
    form = NUMERIC_FORMATS.get(kind)
    (length,) = _LENGTH.unpack_from(data, place + 1)
    index = 0 if length == 1 else element
    if form is None or not 0 <= index < length:
        return NO_NUMBER, nan
    begins = place + 1 + _LENGTH.size
    return kind, float(form.unpack_from(data, begins + index * form.size)[0])
