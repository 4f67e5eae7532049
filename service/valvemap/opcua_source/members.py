"""Members of structures as signals: ``member=Inlet.Pressure;nsu=urn:plc;s=Valve1``.

The path of a member is the names of the fields from the outermost structure in, parted by points;
``[3]`` is an element of an array, counted from 0. A value is walked as its type's definition says
(Part 6, 5.2.6) and must end where the definition ends: what was changed at the server without a new
definition gives no number. Nothing here does I/O.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import nan
from typing import Final

from valvemap.foreign_text import printable
from valvemap.opcua_source.wire import FIXED_SIZES, NUMERIC_FORMATS, DecodeError, Reader

DEEPEST: Final = 16  # structures inside each other
MOST_FIELDS: Final = 2_000  # of a structure
NO_VALUE: Final = 0
"""The kind of a member that is not there: an optional one, or another member of a union."""

Path = tuple[str | int, ...]

_NAME: Final = r"[^.;\[\]]+"
PATH: Final = rf"(?:{_NAME}|\[\d{{1,6}}\])(?:\.{_NAME}|\[\d{{1,6}}\])*"
"""The pattern of a path."""
_STEP: Final = re.compile(rf"\[(\d+)\]|({_NAME})")
_MOST_WALKED: Final = 4_000  # strings, arrays and structures of a value that are walked one by one
_EXTENSION_OBJECT: Final = 22
_NAMED: Final = 20  # members in a message
_UNFIT: Final = re.compile(r"[.;\[\]\x00-\x1f]")


class Form(Enum):
    """How the fields of a structure are encoded: all; those of a mask; one."""

    PLAIN = 0
    OPTIONAL = 1
    UNION = 2


@dataclass(frozen=True)
class Field:
    """A field: the built-in type of its values, or their structure; ``rank`` 0: one value.

    ``optional`` fields have a bit in the mask.
    """

    name: str
    kind: int
    rank: int = 0
    structure: "Structure | None" = None
    optional: bool = False

    @property
    def size(self) -> int | None:
        """Bytes of one value; None: it says itself."""
        if self.structure is not None:
            return self.structure.size
        return FIXED_SIZES.get(self.kind)


@dataclass(frozen=True, eq=False)
class Structure:
    """The fields of a structure in order; ``size`` in bytes, None if values differ in size."""

    name: str
    fields: tuple[Field, ...]
    form: Form = Form.PLAIN
    size: int | None = field(init=False)
    depth: int = field(init=False)

    def __post_init__(self) -> None:
        """Sum up the fields' sizes."""
        sizes = [None if one.rank else one.size for one in self.fields]
        known = [size for size in sizes if size is not None]
        is_fixed = self.form is Form.PLAIN and len(known) == len(sizes)
        object.__setattr__(self, "size", sum(known) if is_fixed else None)
        inner = (one.structure.depth for one in self.fields if one.structure is not None)
        object.__setattr__(self, "depth", 1 + max(inner, default=0))


@dataclass(frozen=True)
class Member:
    """A member of a variable's structure: where it is, and the built-in type of its values.

    ``encodings`` are the forms of the NodeId that a value of this structure begins with; none where
    the server does not say: then each value of the variable is taken for one.
    """

    path: Path
    kind: int
    encodings: frozenset[bytes]
    structure: Structure = field(compare=False)


def parse_path(text: str) -> Path:
    """Return the steps of a path.

    >>> parse_path("Inlet.Pressure[2].Value")
    ('Inlet', 'Pressure', 2, 'Value')
    """
    return tuple(int(index) if index else name for index, name in _STEP.findall(text))


def path_text(path: Path) -> str:
    """Return the text of a path.

    >>> path_text(("Inlet", "Pressure", 2, "Value"))
    'Inlet.Pressure[2].Value'
    """
    steps = (f"[{one}]" if isinstance(one, int) else f".{one}" for one in path)
    return "".join(steps).removeprefix(".")


def has_a_text(path: Path) -> bool:
    """Whether each name of a path can be written in one."""
    return not any(isinstance(one, str) and (not one or _UNFIT.search(one)) for one in path)


def kind_of(structure: Structure, path: Path) -> int | str:
    """Return the built-in type of a member, or why there is none, as the end of a sentence."""
    own = Field("", _EXTENSION_OBJECT, int(isinstance(path[0], int)), structure)
    for depth, step in enumerate(path):
        shown = path_text(path[:depth])
        found = _element_of(own, step, shown) if isinstance(step, int) else _in(own, step, shown)
        if isinstance(found, str):
            return found
        own = found
    shown = path_text(path)
    if own.structure is not None and not own.rank:
        return f"has a structure at '{shown}'; its members are {_names(own.structure)}"
    if own.rank or own.kind not in NUMERIC_FORMATS:
        return _needs_index(shown) if own.rank else f"has no number at '{shown}'"
    return own.kind


def _element_of(own: Field, index: int, shown: str) -> Field | str:
    if own.rank > 1:
        return f"has an array of several dimensions at '{shown}'"
    if not own.rank:
        return f"has no array at '{shown}'; leave out [{index}]"
    return Field(own.name, own.kind, 0, own.structure)


def _in(own: Field, name: str, shown: str) -> Field | str:
    if own.rank:
        return _needs_index(shown)
    if own.structure is None:
        return f"has no structure at '{shown}' whose members are known"
    found = next((one for one in own.structure.fields if one.name == name), None)
    there = _names(own.structure)
    return found or f"has no member '{shown}.{name}'; there are {there}".replace("'.", "'", 1)


def _needs_index(shown: str) -> str:
    return f"has an array at '{shown}'; it needs an index such as [0]"


def _names(structure: Structure) -> str:
    names = [printable(one.name) for one in structure.fields]
    return ", ".join(names[:_NAMED]) + (", …" if len(names) > _NAMED else "")


def taken(data: bytes, place: int, member: Member) -> tuple[int, float] | None:
    """Return kind and number of a member of the Variant at ``place``; None if it has none."""
    reader = Reader(data, most=_MOST_WALKED)
    reader.skip(place)
    path = member.path
    try:
        encoding = reader.u1()
        if encoding & 0x3F != _EXTENSION_OBJECT:
            return None
        if encoding & 0x80:
            if not isinstance(path[0], int) or not 0 <= path[0] < reader.count(3):
                return None
            for _ in range(path[0]):
                reader.spend(1)
                reader.extension_object()
            path = path[1:]
        elif isinstance(path[0], int):
            return None
        begins = reader.position
        reader.node_id()
        if member.encodings and data[begins : reader.position] not in member.encodings:
            return None
        reader.position = begins
        _, body = reader.extension_object()
        found = _Found()
        _walk(body, member.structure, path, found)
        is_whole = body.at_end or not member.encodings
    except DecodeError:
        return None
    return (found.kind, found.value) if is_whole else None


def numbers_in(
    structure: Structure, body: bytes, longest: int, most: int
) -> list[tuple[Path, int]]:
    """Return path and kind of at most ``most`` numbers of a structure's body.

    Elements of arrays of more than ``longest`` are left out.

    Raises
    ------
    DecodeError
        if the body is none of this structure.
    """
    reader = Reader(body, most=_MOST_WALKED)
    found: list[tuple[Path, int]] = []
    for path, kind in _numbers(reader, structure, (), longest):
        if len(found) < most:
            found.append((path, kind))
    if not reader.at_end:
        raise DecodeError("the value does not end where its type ends")
    return found


@dataclass
class _Found:
    """What a walk has taken; NO_VALUE until the member comes."""

    kind: int = NO_VALUE
    value: float = nan


def _walk(reader: Reader, structure: Structure, path: Path, found: _Found) -> None:
    """Pass over a structure; take the member at ``path``; () takes none."""
    for own in _present(reader, structure):
        if path and own.name == path[0]:
            _take(reader, own, path[1:], found)
        else:
            _pass(reader, own)


def _take(reader: Reader, own: Field, path: Path, found: _Found) -> None:
    if own.rank:
        index, rest = path[0], path[1:]
        one = Field(own.name, own.kind, 0, own.structure)
        count = _length(reader, own)
        if not isinstance(index, int) or index >= count:
            _pass_all(reader, one, count)
            return
        _pass_all(reader, one, index)
        _take(reader, one, rest, found)
        _pass_all(reader, one, count - index - 1)
    elif own.structure is not None:
        _walk(reader, own.structure, path, found)
    else:
        form = NUMERIC_FORMATS[own.kind]
        found.value = float(form.unpack_from(reader.data, reader.skip(form.size))[0])
        found.kind = own.kind


def _pass(reader: Reader, own: Field) -> None:
    if own.rank:
        _pass_all(reader, Field(own.name, own.kind, 0, own.structure), _length(reader, own))
    else:
        _pass_all(reader, own, 1)


def _pass_all(reader: Reader, own: Field, count: int) -> None:
    size = own.size
    if size is not None:
        reader.skip(size * count)
        return
    for _ in range(count):
        reader.spend(1)
        if own.structure is None:
            reader.skip_element(own.kind)
        else:
            for inner in _present(reader, own.structure):
                _pass(reader, inner)


def _present(reader: Reader, structure: Structure) -> Iterator[Field]:
    """Yield the fields that a value has; each is to be read before the next."""
    match structure.form:
        case Form.PLAIN:
            yield from structure.fields
        case Form.OPTIONAL:
            mask, bit = reader.u4(), 1
            for own in structure.fields:
                if not own.optional or mask & bit:
                    yield own
                bit <<= own.optional
        case Form.UNION:
            chosen = reader.u4()
            if chosen > len(structure.fields):
                raise DecodeError(f"a union has no member {chosen}")
            yield from structure.fields[chosen - 1 : chosen] if chosen else ()


def _length(reader: Reader, own: Field) -> int:
    """Read the number of elements of an array; that of several dimensions has one for each."""
    if own.rank == 1:
        return max(reader.i4(), 0)
    count = 1
    for one in reader.u4_array():
        count *= one
    return count


def _numbers(
    reader: Reader, structure: Structure, path: Path, longest: int
) -> Iterator[tuple[Path, int]]:
    for own in _present(reader, structure):
        if not own.rank:
            yield from _numbers_of(reader, own, (*path, own.name), longest)
            continue
        count, one = _length(reader, own), Field(own.name, own.kind, 0, own.structure)
        if own.rank > 1 or count > longest:
            _pass_all(reader, one, count)
            continue
        for index in range(count):
            yield from _numbers_of(reader, one, (*path, own.name, index), longest)


def _numbers_of(reader: Reader, own: Field, path: Path, longest: int) -> Iterator[tuple[Path, int]]:
    reader.spend(1)
    if own.structure is not None:
        yield from _numbers(reader, own.structure, path, longest)
        return
    if own.kind in NUMERIC_FORMATS:
        yield path, own.kind
    _pass_all(reader, own, 1)


def encodings_of(namespace: int, identifier: object) -> Sequence[bytes]:
    """Return the binary forms of a NodeId (Part 6, 5.2.2.9); none of a kind that is not known."""
    if isinstance(identifier, int):
        forms = [b"\x02" + namespace.to_bytes(2, "little") + identifier.to_bytes(4, "little")]
        if namespace < 256 and identifier < 65_536:
            forms.append(b"\x01" + bytes([namespace]) + identifier.to_bytes(2, "little"))
        if namespace == 0 and identifier < 256:
            forms.append(b"\x00" + bytes([identifier]))
        return forms
    if isinstance(identifier, (str, bytes)):
        own = identifier.encode() if isinstance(identifier, str) else identifier
        first = b"\x03" if isinstance(identifier, str) else b"\x05"
        length = len(own).to_bytes(4, "little")
        return [first + namespace.to_bytes(2, "little") + length + own]
    own = getattr(identifier, "bytes_le", b"")
    return [b"\x04" + namespace.to_bytes(2, "little") + own] if own else []
