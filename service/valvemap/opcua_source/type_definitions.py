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
from valvemap.opcua_source.members import Member, encodings_of, numbers_in
from valvemap.opcua_source.read_types import (
    Undescribed,
    assemble,
    built_in_of,
    definition_of,
    fields_of,
    is_built_in,
    keep_type,
)
from valvemap.opcua_source.structures import (
    DEEPEST,
    MOST_FIELDS,
    Path,
    Structure,
    has_a_text,
    kind_of,
)
from valvemap.opcua_source.wire import EXTENSION_OBJECT, DecodeError

_BROWSED_AT_ONCE: Final = 20
_MOST_REFERENCES: Final = 20
_BOOLEAN: Final = 1
_ATTRIBUTES: Final = (
    ua.AttributeIds.DataTypeDefinition,
    ua.AttributeIds.IsAbstract,
    ua.AttributeIds.BrowseName,
)


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
    except (Undescribed, SourceRejected) as error:
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
        raise Undescribed(f"has values of a type that nothing describes ({_shown(encoding)})")
    keep_type(connection, encoding, found[0])
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
                inner.update(dict.fromkeys(own.DataType for own in fields_of(definition)))
        wanted = [one for one in inner if not is_built_in(one) and one not in connection.types]
    made: dict[ua.NodeId, Structure] = {}
    structure = assemble(connection, data_type, made, ())
    definition = definition_of(connection, data_type)[0]
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
            raise Undescribed(f"has a structure of more than {MOST_FIELDS} members")
        is_abstract = abstract.Value is not None and abstract.Value.Value is True
        shown = name.Value.Value.Name if name.Value is not None else ""
        keep_type(connection, one, (own, is_abstract, in_one_line(str(shown))))
    left = {one: one for one in plain}
    for _ in range(DEEPEST):
        if not left:
            return
        bases = await _above(connection, list(left.values()), ua.ObjectIds.HasSubtype)
        for (own, _), base in zip(list(left.items()), bases, strict=True):
            if base is None:
                raise Undescribed(
                    f"needs the type {_shown(own)}, which the server does not describe"
                )
            if is_built_in(base):
                kind = built_in_of(base)
                if kind == EXTENSION_OBJECT:
                    raise Undescribed(
                        f"needs the structure {_shown(own)}, of which the server states no "
                        "DataTypeDefinition; let it show each member that is a signal as a variable"
                    )
                keep_type(connection, own, kind)
                del left[own]
            else:
                left[own] = base


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


def _shown(node: ua.NodeId) -> str:
    return in_one_line(node.to_string())
