"""Reads what a server says of its structures: DataTypeDefinition (Part 3, 8.48), once a connection.

Bounded in types, fields and nesting; what exceeds a bound, or is not described, is a sentence on
the variables of that type alone.
"""

from collections.abc import Sequence
from typing import Final

from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary

from valvemap.errors import SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import in_chunks, read_attributes
from valvemap.opcua_client.source_errors import in_one_line
from valvemap.opcua_source.members import (
    DEEPEST,
    MOST_FIELDS,
    Field,
    Form,
    Member,
    Path,
    Structure,
    encodings_of,
    has_a_text,
    kind_of,
    numbers_in,
)
from valvemap.opcua_source.wire import DecodeError

MOST_TYPES: Final = 2_000  # of a connection
_BROWSED_AT_ONCE: Final = 20
_MOST_REFERENCES: Final = 20
_ENUMERATION: Final = 29
_INT32: Final = 6
_BOOLEAN: Final = 1
_VARIANT: Final = 24
_EXTENSION_OBJECT: Final = 22
_LAST_BUILT_IN: Final = 25
_ATTRIBUTES: Final = (
    ua.AttributeIds.DataTypeDefinition,
    ua.AttributeIds.IsAbstract,
    ua.AttributeIds.BrowseName,
)
_FORMS: Final = {0: Form.PLAIN, 1: Form.OPTIONAL, 2: Form.UNION, 3: Form.PLAIN, 4: Form.UNION}
_WITH_SUBTYPES: Final = {3, 4}
_OPEN_RANKS: Final = {-3, -2, 0}  # each value says whether it is an array
_TOO_DEEP: Final = f"has structures inside each other, more than {DEEPEST} levels deep"

_Said = tuple[ua.StructureDefinition | None, bool, str]
"""Definition (None: no structure), whether it is abstract, and its name."""


class _Undescribed(Exception):  # noqa: N818 - never leaves the module
    """Why a type is not known, as the end of a sentence."""


async def member_of(
    connection: Connection, data_type: ua.NodeId | None, value: object, path: Path
) -> Member | str:
    """Return the member of a variable's structure, or why there is none: the end of a sentence.

    ``value`` is that of the variable, or None: it tells the type where DataType does not.

    Raises
    ------
    SourceLost
    """
    described = await structure_of(connection, data_type, value)
    if isinstance(described, str):
        return described
    structure, encodings = described
    kind = kind_of(structure, path)
    if isinstance(kind, str):
        return kind
    return Member(path, kind, encodings, structure)


async def structure_of(
    connection: Connection, data_type: ua.NodeId | None, value: object
) -> tuple[Structure, frozenset[bytes]] | str:
    """Return the structure of a variable, and what its values begin with; or why none is known.

    Raises
    ------
    SourceLost
    """
    try:
        with connection.errors("reading the definition of a structure"):
            sent = _encoding_of(value)
            if sent is not None:
                data_type = await _type_of_encoding(connection, sent)
            if data_type is None:
                return "has a type that is not known"
            structure, encoding = await _structure(connection, data_type)
    except (_Undescribed, SourceRejected) as error:
        return str(error)
    if sent is None and encoding.Identifier:
        sent = encoding
    forms = () if sent is None else encodings_of(sent.NamespaceIndex, sent.Identifier)
    return structure, frozenset(forms)


async def numbers_of(
    connection: Connection, node: ua.NodeId, value: object, longest: int, most: int
) -> list[tuple[Path, int]] | str:
    """Return path and kind of the numbers in a variable's structure, or why none is known.

    ``value`` is its present one, which has the lengths of arrays; Booleans are left out.

    Raises
    ------
    SourceLost
    """
    ((data_type,),) = await read_attributes(connection, [node], (ua.AttributeIds.DataType,))
    own = data_type.Value.Value if data_type.Value is not None else None
    values = value if isinstance(value, list) else [value]
    if all(isinstance(one, ua.ExtensionObject) and not one.Body for one in values):
        return "a structure that has no value yet; its members are not browsed"
    if len(values) > longest:
        return f"an array of more than {longest} structures; name members by hand"
    described = await structure_of(connection, own, value)
    if isinstance(described, str):
        return described
    found: list[tuple[Path, int]] = []
    for index, one in enumerate(values):
        try:
            numbers = numbers_in(described[0], _body(one), longest, most)
        except DecodeError as error:
            return f"a structure whose value is not as its type says: {error}"
        first = (index,) if isinstance(value, list) else ()
        found += [((*first, *path), kind) for path, kind in numbers if kind != _BOOLEAN]
    return [(path, kind) for path, kind in found[:most] if has_a_text(path)]


def _body(value: object) -> bytes:
    """Return a structure's bytes; one of OPC UA's own was decoded before."""
    if isinstance(value, ua.ExtensionObject):
        return value.Body or b""
    encoded: bytes = struct_to_binary(value)
    return encoded


def _encoding_of(value: object) -> ua.NodeId | None:
    """Return the NodeId that a value as it was sent begins with."""
    if isinstance(value, list):
        value = next((one for one in value if isinstance(one, ua.ExtensionObject)), None)
    if isinstance(value, ua.ExtensionObject) and value.TypeId.Identifier:
        return value.TypeId
    return None


async def _type_of_encoding(connection: Connection, encoding: ua.NodeId) -> ua.NodeId:
    known = connection.types.get(encoding)
    if isinstance(known, ua.NodeId):
        return known
    found = await _above(connection, [encoding], ua.ObjectIds.HasEncoding)
    if found[0] is None:
        raise _Undescribed(f"has values of a type that nothing describes ({_shown(encoding)})")
    _keep(connection, encoding, found[0])
    return found[0]


async def _structure(connection: Connection, data_type: ua.NodeId) -> tuple[Structure, ua.NodeId]:
    """Read the types that a type consists of, level by level; then put them together."""
    known = connection.types.get((data_type,))
    if isinstance(known, tuple):
        return known
    wanted = [data_type]
    for _ in range(DEEPEST + 1):
        if not wanted:
            break
        await _read(connection, wanted)
        inner: dict[ua.NodeId, None] = {}
        for one in wanted:
            said = connection.types.get(one)
            definition = said[0] if isinstance(said, tuple) else None
            if definition is not None:
                inner.update(dict.fromkeys(own.DataType for own in _fields(definition)))
        wanted = [one for one in inner if not _is_built_in(one) and one not in connection.types]
    made: dict[ua.NodeId, Structure] = {}
    structure = _made(connection, data_type, made, ())
    definition = _said(connection, data_type)[0]
    assert definition is not None  # noqa: S101 - it was made of it
    both = structure, definition.DefaultEncodingId
    connection.types[data_type,] = both
    return both


async def _read(connection: Connection, types: Sequence[ua.NodeId]) -> None:
    """Keep of each type: its definition, or the built-in type that it is derived from."""
    missing = [one for one in types if one not in connection.types]
    plain = []
    answers = await read_attributes(connection, missing, _ATTRIBUTES)
    for one, (definition, abstract, name) in zip(missing, answers, strict=True):
        own = None if definition.Value is None else definition.Value.Value
        if not isinstance(own, ua.StructureDefinition):
            plain.append(one)
            continue
        if len(own.Fields or ()) > MOST_FIELDS:
            raise _Undescribed(f"has a structure of more than {MOST_FIELDS} members")
        is_abstract = abstract.Value is not None and abstract.Value.Value is True
        shown = name.Value.Value.Name if name.Value is not None else ""
        _keep(connection, one, (own, is_abstract, in_one_line(str(shown))))
    left = {one: one for one in plain}
    for _ in range(DEEPEST):
        if not left:
            return
        bases = await _above(connection, list(left.values()), ua.ObjectIds.HasSubtype)
        for (own, _), base in zip(list(left.items()), bases, strict=True):
            if base is None:
                raise _Undescribed(
                    f"needs the type {_shown(own)}, which the server does not describe"
                )
            if _is_built_in(base):
                kind = _built_in(base)
                if kind == _EXTENSION_OBJECT:
                    raise _Undescribed(
                        f"needs the structure {_shown(own)}, of which the server states no "
                        "DataTypeDefinition; let it show each member that is a signal as a variable"
                    )
                _keep(connection, own, kind)
                del left[own]
            else:
                left[own] = base


def _made(
    connection: Connection,
    data_type: ua.NodeId,
    made: dict[ua.NodeId, Structure],
    above: tuple[ua.NodeId, ...],
) -> Structure:
    if data_type in made:
        return made[data_type]
    definition, _, name = _said(connection, data_type)
    if definition is None:
        raise _Undescribed("is no structure")
    if data_type in above or len(above) >= DEEPEST:
        raise _Undescribed(_TOO_DEEP)
    inner = (*above, data_type)
    form = int(definition.StructureType)
    fields = tuple(_field(connection, own, form, made, inner) for own in _fields(definition))
    found = Structure(name, fields, _FORMS[form])
    if found.depth + len(above) > DEEPEST:
        raise _Undescribed(_TOO_DEEP)
    made[data_type] = found
    return found


def _field(
    connection: Connection,
    own: ua.StructureField,
    form: int,
    made: dict[ua.NodeId, Structure],
    above: tuple[ua.NodeId, ...],
) -> Field:
    name = own.Name or ""
    if own.ValueRank in _OPEN_RANKS:
        raise _Undescribed(f"has a member '{in_one_line(name)}' of no fixed rank")
    built_in, structure = _EXTENSION_OBJECT, None
    said = connection.types.get(own.DataType)
    if _is_built_in(own.DataType):
        built_in = _built_in(own.DataType)
    elif isinstance(said, int):
        built_in = said
    elif not _said(connection, own.DataType)[1]:  # of an abstract one, each value says
        structure = _made(connection, own.DataType, made, above)
    if form in _WITH_SUBTYPES and own.IsOptional:
        built_in, structure = (_EXTENSION_OBJECT if structure else _VARIANT), None
    optional = _FORMS[form] is Form.OPTIONAL and bool(own.IsOptional)
    return Field(name, built_in, max(own.ValueRank, 0), structure, optional)


async def _above(
    connection: Connection, nodes: Sequence[ua.NodeId], reference: int
) -> list[ua.NodeId | None]:
    """Return the node that each node is referred to by."""

    async def browse(some: Sequence[ua.NodeId]) -> list[ua.BrowseResult]:
        return await connection.session.browse(
            ua.BrowseParameters(
                View=ua.ViewDescription(),
                RequestedMaxReferencesPerNode=_MOST_REFERENCES,
                NodesToBrowse=[
                    ua.BrowseDescription(
                        NodeId=node,
                        BrowseDirection=ua.BrowseDirection.Inverse,
                        ReferenceTypeId=ua.NodeId(reference),
                        IncludeSubtypes=True,
                        NodeClassMask=0,
                        ResultMask=ua.BrowseResultMask.None_,
                    )
                    for node in some
                ],
            )
        )

    results = await in_chunks(nodes, _BROWSED_AT_ONCE, browse)
    return [_plain(one.References[0].NodeId) if one.References else None for one in results]


def _plain(node: ua.NodeId) -> ua.NodeId:
    return ua.NodeId(node.Identifier, node.NamespaceIndex, node.NodeIdType)


def _keep(connection: Connection, node: ua.NodeId, said: object) -> None:
    if len(connection.types) >= MOST_TYPES:
        raise _Undescribed(f"needs more types than the {MOST_TYPES} that are read of a server")
    connection.types[node] = said


def _said(connection: Connection, node: ua.NodeId) -> _Said:
    said = connection.types.get(node)
    if isinstance(said, tuple):
        return said
    if isinstance(said, int):
        return None, False, ""
    raise _Undescribed(_TOO_DEEP)


def _fields(definition: ua.StructureDefinition) -> Sequence[ua.StructureField]:
    return definition.Fields or ()


def _is_built_in(node: ua.NodeId) -> bool:
    own = node.Identifier
    in_zero = node.NamespaceIndex == 0 and isinstance(own, int)
    return in_zero and (0 < own <= _VARIANT + 5)


def _built_in(node: ua.NodeId) -> int:
    own = int(node.Identifier)
    if own == _ENUMERATION:
        return _INT32
    return own if own <= _LAST_BUILT_IN else _VARIANT


def _shown(node: ua.NodeId) -> str:
    return in_one_line(node.to_string())
