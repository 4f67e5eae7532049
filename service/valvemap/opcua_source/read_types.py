"""Data types that were read of a server, put together into structures."""

from collections.abc import Sequence
from typing import Final

from asyncua import ua

from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.source_errors import in_one_line
from valvemap.opcua_source.structures import (
    DEEPEST,
    Field,
    Form,
    Structure,
)
from valvemap.opcua_source.wire import EXTENSION_OBJECT

MOST_TYPES: Final = 2_000  # of a connection
_ENUMERATION: Final = 29
_INT32: Final = 6
_VARIANT: Final = 24
_LAST_BUILT_IN: Final = 25
_FORMS: Final = {0: Form.PLAIN, 1: Form.OPTIONAL, 2: Form.UNION, 3: Form.PLAIN, 4: Form.UNION}
_WITH_SUBTYPES: Final = {3, 4}
_OPEN_RANKS: Final = {-3, -2, 0}  # each value says whether it is an array
_TOO_DEEP: Final = f"has structures inside each other, more than {DEEPEST} levels deep"

Definition = tuple[ua.StructureDefinition | None, bool, str]
"""Definition (None: no structure), whether it is abstract, and its name."""


class Undescribed(Exception):  # noqa: N818 - becomes a sentence
    """Why a type is not known, as the end of a sentence."""


def assemble(
    connection: Connection,
    data_type: ua.NodeId,
    made: dict[ua.NodeId, Structure],
    above: tuple[ua.NodeId, ...],
) -> Structure:
    """Return the structure of a type, with the structures inside.

    Raises
    ------
    Undescribed
        if one of them is unknown, no structure, or too deep.
    """
    if data_type in made:
        return made[data_type]
    definition, _, name = definition_of(connection, data_type)
    if definition is None:
        raise Undescribed("is no structure")
    if data_type in above or len(above) >= DEEPEST:
        raise Undescribed(_TOO_DEEP)
    inner = (*above, data_type)
    form = int(definition.StructureType)
    fields = tuple(_field(connection, own, form, made, inner) for own in fields_of(definition))
    found = Structure(name, fields, _FORMS[form])
    if found.depth + len(above) > DEEPEST:
        raise Undescribed(_TOO_DEEP)
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
        raise Undescribed(f"has a member '{in_one_line(name)}' of no fixed rank")
    built_in, structure = EXTENSION_OBJECT, None
    said = connection.types.get(own.DataType)
    if is_built_in(own.DataType):
        built_in = built_in_of(own.DataType)
    elif isinstance(said, int):
        built_in = said
    elif not definition_of(connection, own.DataType)[1]:  # of an abstract one, each value says
        structure = assemble(connection, own.DataType, made, above)
    if form in _WITH_SUBTYPES and own.IsOptional:
        built_in, structure = (EXTENSION_OBJECT if structure else _VARIANT), None
    optional = _FORMS[form] is Form.OPTIONAL and bool(own.IsOptional)
    return Field(name, built_in, max(own.ValueRank, 0), structure, optional)


def keep_type(connection: Connection, node: ua.NodeId, said: object) -> None:
    """Keep a type for the connection; raise Undescribed beyond MOST_TYPES."""
    if len(connection.types) >= MOST_TYPES:
        raise Undescribed(f"needs more types than the {MOST_TYPES} that are read of a server")
    connection.types[node] = said


def definition_of(connection: Connection, node: ua.NodeId) -> Definition:
    """Return the definition of a type that was read; raise Undescribed if it was not."""
    said = connection.types.get(node)
    if isinstance(said, tuple):
        return said
    if isinstance(said, int):
        return None, False, ""
    raise Undescribed(_TOO_DEEP)


def fields_of(definition: ua.StructureDefinition) -> Sequence[ua.StructureField]:
    """Return the fields of a definition."""
    return definition.Fields or ()


def is_built_in(node: ua.NodeId) -> bool:
    """Whether a data type is built in, an abstract number or Enumeration (Part 6, 5.1.2)."""
    own = node.Identifier
    in_zero = node.NamespaceIndex == 0 and isinstance(own, int)
    return in_zero and (0 < own <= _VARIANT + 5)


def built_in_of(node: ua.NodeId) -> int:
    """Return the built-in type that encodes such a type; Variant for abstract numbers."""
    own = int(node.Identifier)
    if own == _ENUMERATION:
        return _INT32
    return own if own <= _LAST_BUILT_IN else _VARIANT
