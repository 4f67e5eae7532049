"""Finds the numeric variables of a foreign server by browsing, with names, unit and range."""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import Final

from asyncua import ua

from valvemap.errors import ConfigurationError, SourceRejected
from valvemap.foreign_text import printable, toml_string
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import children_of, namespaces_of, read_attributes
from valvemap.opcua_client.source_errors import in_one_line
from valvemap.opcua_source.node_ids import parse_node_id
from valvemap.opcua_source.source_units import read_units
from valvemap.opcua_source.structures import Path, path_text
from valvemap.opcua_source.text_values import as_text, has_number
from valvemap.opcua_source.type_definitions import numbers_of
from valvemap.opcua_source.wire import NUMERIC_FORMATS
from valvemap.plant.candidates import Candidate

MOST_ELEMENTS: Final = 64  # of an array; more are a curve or a buffer
MOST_NODES: Final = 50_000  # browsed; further nodes are ignored
DEEPEST: Final = 12  # levels of folders
_ATTRIBUTES: Final = (
    ua.AttributeIds.Value,
    ua.AttributeIds.ValueRank,
    ua.AttributeIds.UserAccessLevel,
    ua.AttributeIds.Description,
)
_FEWEST_NAMED: Final = 2  # elements that a list names
_NUMBER: Final = re.compile(r"^\s*\[?\d+\]?\s*[:=.)]\s*")  # 0: or [0] = before an element's name
_UNIT_OF_ALL: Final = re.compile(r"(.*?)(?:\s*\[([^\]]*)\])?", re.DOTALL)
_LONGEST: Final = 4_096  # characters; the most that an identifier may have (Part 3, 8.2.4)
_LONGEST_NAME: Final = 300  # characters of a name that are used
_FARTHEST: Final = 1e9  # of a range, in any unit
_HAS_PROPERTY: Final = ua.NodeId(ua.ObjectIds.HasProperty)
_NO_SIGNALS: Final = {ua.VariantType.Boolean.value}
_STRUCTURE: Final = ua.VariantType.ExtensionObject
_SCALARS: Final = {-3, -2, -1}
_FLOATING: Final = {ua.VariantType.Float.value, ua.VariantType.Double.value}
_LARGEST: Final = {
    ua.VariantType.SByte.value: 127.0,
    ua.VariantType.Byte.value: 255.0,
    ua.VariantType.Int16.value: 2.0**15 - 1,
    ua.VariantType.UInt16.value: 2.0**16 - 1,
    ua.VariantType.Int32.value: 2.0**31 - 1,
    ua.VariantType.UInt32.value: 2.0**32 - 1,
    ua.VariantType.Int64.value: 2.0**63,
    ua.VariantType.UInt64.value: 2.0**64,
}
_CLASSES: Final = ua.NodeClass.Object | ua.NodeClass.Variable

_Place = tuple[ua.NodeId, tuple[str, ...]]


async def find_numbers(
    connection: Connection, named: Collection[str] = ()
) -> tuple[list[Candidate], list[str]]:
    """Return all readable numbers below the Objects folder, except the Server object's.

    Each element of an array is one, each member of a structure that has no nodes for them; of a
    longer array those that are ``named``. The second list has a line for each array that is too
    long or of several dimensions, each structure whose type is not known, and each variable whose
    NodeId cannot be written in a configuration.

    Raises
    ------
    SourceLost, SourceRejected
    """
    with connection.errors("browsing"):
        places = await _variables(connection)
        answers = await read_attributes(connection, [node for node, _ in places], _ATTRIBUTES)
    both = list(zip(places, answers, strict=True))
    numbers = [(place, a) for place, a in both if _is_number(a) or has_number(a)]
    said = await read_units(connection, [node for (node, _), _ in numbers])
    namespaces = await namespaces_of(connection)
    skipped = [*_unusable(places, answers)]
    found = await _members(connection, both, namespaces, skipped)
    for ((node, path), answer), of_node in zip(numbers, said, strict=True):
        text = _text(node, namespaces)
        if text is None:
            skipped.append(f"{printable('/'.join(path))}: its NodeId cannot be written as text")
            continue
        candidate = Candidate(
            node=text,
            path=path,
            unit=of_node.unit,
            bounds=_bounds(of_node.bounds),
            writable=bool((answer[2].Value.Value or 0) & 2) if answer[2].Value else False,
            description=_words(answer[3]),
            symbol=of_node.symbol,
            largest=_largest(answer[0]),
        )
        if has_number(answer):
            found += as_text(candidate, answer)
            continue
        found += _elements(candidate, answer[0], named) if _is_array(answer) else [candidate]
    return found, skipped


async def _members(
    connection: Connection,
    both: Sequence[tuple[_Place, Sequence[ua.DataValue]]],
    namespaces: Sequence[str],
    skipped: list[str],
) -> list[Candidate]:
    """Return the numbers in structures that have no nodes for their members."""
    parents = {path[:-1] for (_, path), _ in both}
    found: list[Candidate] = []
    for (node, path), answer in both:
        value, text = answer[0].Value, _text(node, namespaces)
        if value is None or value.VariantType != _STRUCTURE or path in parents or text is None:
            continue
        own = await numbers_of(connection, node, value.Value, MOST_ELEMENTS, MOST_NODES)
        if isinstance(own, str):
            skipped.append(f"{printable('/'.join(path))}: {own}")
            continue
        for place, kind in own[: MOST_NODES - len(found)]:
            shown = (*path[:-1], *_joined(path[-1], place))
            member = f"member={path_text(place)};{text}"
            found.append(Candidate(node=member, path=shown, largest=_largest_of(kind)))
    return found


def _joined(name: str, place: Path) -> Iterator[str]:
    """Yield the names from a variable's to its member's; an index belongs to the name before it.

    >>> list(_joined("Valves", (2, "p", 0)))
    ['Valves[2]', 'p[0]']
    """
    shown = name
    for step in place:
        if isinstance(step, int):
            shown += f"[{step}]"
        else:
            yield shown
            shown = step
    yield shown


async def _variables(connection: Connection) -> list[_Place]:
    found: list[_Place] = []
    seen = {ua.NodeId(ua.ObjectIds.ObjectsFolder), ua.NodeId(ua.ObjectIds.Server)}
    front: list[_Place] = [(ua.NodeId(ua.ObjectIds.ObjectsFolder), ())]
    for _ in range(DEEPEST):
        below: list[_Place] = []
        children = await children_of(connection, [node for node, _ in front], _CLASSES)
        for (_, path), references in zip(front, children, strict=True):
            for reference in references:
                target = reference.NodeId
                node = ua.NodeId(target.Identifier, target.NamespaceIndex, target.NodeIdType)
                is_property = reference.ReferenceTypeId == _HAS_PROPERTY
                if is_property or node in seen or len(seen) > MOST_NODES:
                    continue
                seen.add(node)
                shown = reference.DisplayName.Text if reference.DisplayName else None
                own = (*path, str(shown or node.Identifier)[:_LONGEST_NAME])
                if reference.NodeClass == ua.NodeClass.Variable:
                    found.append((node, own))
                below.append((node, own))
        front = below
    return found


def _is_number(answer: Sequence[ua.DataValue]) -> bool:
    value, rank = answer[0].Value, answer[1].Value
    kind = None if value is None else value.VariantType.value
    is_scalar = rank is None or rank.Value in _SCALARS
    is_usable = (is_scalar and not _has_array(answer)) or _is_array(answer)
    return is_usable and kind in NUMERIC_FORMATS and kind not in _NO_SIGNALS


def _largest(value: ua.DataValue) -> float | None:
    """Return the largest number of an integer type; None of a floating one."""
    return None if value.Value is None else _largest_of(int(value.Value.VariantType.value))


def _largest_of(kind: int) -> float | None:
    return None if kind in _FLOATING else _LARGEST.get(kind)


def _has_array(answer: Sequence[ua.DataValue]) -> bool:
    return answer[0].Value is not None and bool(answer[0].Value.is_array)


def _is_array(answer: Sequence[ua.DataValue]) -> bool:
    """Whether it is an array of one dimension whose elements may be signals."""
    value = answer[0].Value
    if value is None or not value.is_array or len(value.Dimensions or ()) > 1:
        return False
    return len(value.Value) > 0 and not isinstance(value.Value[0], list)


def _elements(array: Candidate, value: ua.DataValue, named: Collection[str]) -> Iterator[Candidate]:
    """Yield the elements of an array as variables: ``cmd[0]``, or below it as the text has them."""
    *folders, name = array.path
    number_of = len(value.Value.Value)
    texts = element_names(array.description, number_of)
    for number in range(number_of):
        node = f"index={number};{array.node}"
        if number_of > MOST_ELEMENTS and node not in named:
            continue
        own = (f"{name}[{number}]",) if texts is None else (name, texts[number])
        text = array.description if texts is None else ""
        yield replace(array, node=node, path=(*folders, *own), description=text, writable=False)


def element_names(text: str, n: int) -> list[str] | None:
    """Return the names of the n elements of an array that its description lists; None if none.

    >>> element_names("P, T, A, B [bar]", 4)
    ['P [bar]', 'T [bar]', 'A [bar]', 'B [bar]']
    >>> element_names("0: U [%]; 1: p1 [bar]; 2: p2 [bar]; 3: Q [l/min]", 4)
    ['U [%]', 'p1 [bar]', 'p2 [bar]', 'Q [l/min]']
    >>> element_names("Pressures of the four ports", 4) is None
    True
    """
    plain, unit = _UNIT_OF_ALL.fullmatch(text.strip()).groups()  # type: ignore[union-attr]
    if "[" in plain:  # each has a separate unit
        plain, unit = text, None
    for mark in ";|,/":
        parts = re.split(rf"{re.escape(mark)}(?![^\[]*\])", plain)
        names = [_NUMBER.sub("", part).strip() for part in parts]
        if n >= _FEWEST_NAMED and len(names) == n and all(names) and len(set(names)) == n:
            return [f"{name} [{unit}]" if unit else name for name in names]
    return None


def _unusable(places: Sequence[_Place], answers: Sequence[Sequence[ua.DataValue]]) -> Iterator[str]:
    """Yield a line for each array of numbers whose elements are not browsed."""
    for (_, path), answer in zip(places, answers, strict=True):
        value = answer[0].Value
        is_number = value is not None and value.VariantType.value in NUMERIC_FORMATS
        if not is_number or not value.is_array:
            continue
        if not _is_array(answer):
            yield f"{printable('/'.join(path))}: an array that is empty or of several dimensions"
        elif len(value.Value) > MOST_ELEMENTS:
            yield (
                f"{printable('/'.join(path))}: an array of more than {MOST_ELEMENTS} elements; "
                "name those that are signals, such as --signal=VALVE.U=index=70;NODE"
            )


def _words(answer: ua.DataValue) -> str:
    text = answer.Value.Value if answer.Value is not None else None
    return in_one_line(text.Text or "") if isinstance(text, ua.LocalizedText) else ""


def _bounds(given: tuple[float, float] | None) -> tuple[float, float] | None:
    """Return a range if it is plausible, else None."""
    return given if given and -_FARTHEST < given[0] < given[1] < _FARTHEST else None


def _text(node: ua.NodeId, namespaces: Sequence[str]) -> str | None:
    """Return the text form of a NodeId with its namespace URI, independent of namespace indices.

    None if no text form can be stored in TOML and parsed back to the same node.
    """
    try:
        own = ua.NodeId(node.Identifier, 0, node.NodeIdType).to_string()
    except (TypeError, ValueError, ua.UaError):
        return None
    index = node.NamespaceIndex
    forms = [own] if index == 0 else [f"ns={index};{own}"]
    if 0 < index < len(namespaces):
        forms.insert(0, f"nsu={namespaces[index]};{own}")
    return next((text for text in forms if _is_read_as(text, node, namespaces)), None)


def _is_read_as(text: str, node: ua.NodeId, namespaces: Sequence[str]) -> bool:
    try:
        toml_string(text)
        read = parse_node_id(text, namespaces)
    except (ValueError, ConfigurationError, SourceRejected):
        return False
    same = read.Identifier == node.Identifier and read.NamespaceIndex == node.NamespaceIndex
    return same and len(text) <= _LONGEST
