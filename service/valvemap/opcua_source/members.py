"""Members of structures as signals: ``member=Inlet.Pressure;nsu=urn:plc;s=Valve1``.

The path of a member is the names of the fields from the outermost structure in, parted by points;
``[3]`` is an element of an array, counted from 0. A value is walked as its type's definition says
(Part 6, 5.2.6) and must end where the definition ends: a change at the server without a new
definition gives no number. Nothing here does I/O.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import Final

from valvemap.opcua_source.structures import Field, Form, Path, Structure
from valvemap.opcua_source.wire import EXTENSION_OBJECT, NUMERIC_FORMATS, DecodeError, Reader

NO_VALUE: Final = 0
"""The kind of a member that is not there: an optional one, or another member of a union."""

_MOST_WALKED: Final = 4_000  # strings, arrays and structures of a value that are walked one by one


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


def taken(data: bytes, place: int, member: Member) -> tuple[int, float] | None:
    """Return kind and number of a member of the Variant at ``place``; None if it has none."""
    reader = Reader(data, most=_MOST_WALKED)
    reader.skip(place)
    path = member.path
    try:
        encoding = reader.u1()
        if encoding & 0x3F != EXTENSION_OBJECT:
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
