"""ObjectTypes, declared by the code that adds their instances (Part 3, 6.2)."""

from collections.abc import Callable, Collection, Coroutine, Iterable, Sequence
from typing import Any, Protocol

from asyncua import ua
from asyncua.server.address_space import AddressSpace, AttributeValue

from guarded_opcua.address_space.declarations import Method, Value, Variable
from guarded_opcua.address_space.insertion import insert, property_item, reference
from guarded_opcua.address_space.nodes import NodeOwner

_Ids = ua.ObjectIds
_HAS_RULE = ua.NodeId(_Ids.HasModellingRule)
_PARTS = (ua.NodeId(_Ids.HasComponent), ua.NodeId(_Ids.HasProperty))
_MANDATORY, _OPTIONAL = _Ids.ModellingRule_Mandatory, _Ids.ModellingRule_Optional
_PLACEHOLDER = _Ids.ModellingRule_OptionalPlaceholder
_OF_BASE = {  # class and attributes of the types derived from a base type
    _Ids.Enumeration: (ua.NodeClass.DataType, ua.DataTypeAttributes),
    _Ids.BaseObjectType: (ua.NodeClass.ObjectType, ua.ObjectTypeAttributes),
}


class TypeOwner(NodeOwner, Protocol):
    """The server that types are added to."""

    def add_later(self, folder: ua.NodeId, add: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Populate a folder lazily, when a client first accesses a node below it."""


class Declarations:
    """A node owner for instance declarations, which have no values and no functions.

    It is passed to the code that adds nodes to a server.
    """

    def __init__(self, server: NodeOwner) -> None:
        self.namespace_index = server.namespace_index
        self.address_space = server.address_space
        self.utc = server.utc

    def register_variable(self, variable: Variable, value: Value) -> None:  # noqa: ARG002
        """Keep the variable without a value; arrays get unspecified dimensions."""
        attributes = self.address_space[variable.id].attributes
        held = attributes.get(ua.AttributeIds.ArrayDimensions)
        if variable.array and held is not None and held.value is not None:
            any_length = [0] * len(held.value.Value.Value)
            dimensions = ua.Variant(any_length, ua.VariantType.UInt32, is_array=True)
            held.value = ua.DataValue(dimensions)

    def register_method(self, method: Method) -> None:
        """Keep the method without a function."""

    def write(self, updates: Iterable[Any]) -> None:
        """Ignore the values."""

    def add_history(self, variables: Collection[Variable], historian: Any) -> None:  # noqa: ANN401
        """Ignore the histories."""


def add_enumeration(
    server: NodeOwner,
    id: str,  # noqa: A002 - OPC UA's word
    name: str,
    members: Sequence[tuple[str, str]],
    *,
    description: str = "",
) -> ua.NodeId:
    """Add a DataType, derived from Enumeration, of the values 0, 1, … (Part 3, 8.40).

    Parameters
    ----------
    id, name
        String identifier and BrowseName.
    members
        Name and description of each value.
    description
        Description attribute.
    """
    own = _add_subtype(server, _Ids.Enumeration, id, name, description)
    definition = ua.EnumDefinition(
        Fields=[
            ua.EnumField(
                Value=value,
                DisplayName=ua.LocalizedText(member),
                Description=ua.LocalizedText(sentence),
                Name=member,
            )
            for value, (member, sentence) in enumerate(members)
        ]
    )
    held = ua.DataValue(ua.Variant(definition, ua.VariantType.ExtensionObject))
    attributes = server.address_space[own].attributes
    attributes[ua.AttributeIds.DataTypeDefinition] = AttributeValue(held)
    texts = [ua.LocalizedText(member) for member, _ in members]
    nodeid = ua.NodeId(f"{id}.EnumStrings", server.namespace_index)
    insert(server.address_space, property_item(own, nodeid, "EnumStrings", texts), server.utc())
    return own


Declare = Callable[[Declarations, ua.NodeId], Coroutine[Any, Any, None]]


def add_type(
    server: TypeOwner,
    id: str,  # noqa: A002 - OPC UA's word
    name: str,
    declare: Declare,
    *,
    description: str = "",
    optional: Collection[str] = (),
) -> ua.NodeId:
    """Add an ObjectType, derived from BaseObjectType.

    Parameters
    ----------
    id
        String identifier; those of its instance declarations begin with it and a dot.
    name
        BrowseName.
    declare
        Adds the instance declarations on first access; it must not suspend.
    description
        Description attribute.
    optional
        Names of optional components; names in angle brackets are placeholders.
    """
    own = _add_subtype(server, _Ids.BaseObjectType, id, name, description)

    async def add() -> None:
        await declare(Declarations(server), own)
        _state_rules(server.address_space, own, optional)

    server.add_later(own, add)
    return own


def _add_subtype(
    server: NodeOwner,
    base: int,
    id: str,  # noqa: A002 - OPC UA's word
    name: str,
    description: str,
) -> ua.NodeId:
    kind, attributes = _OF_BASE[base]
    item = ua.AddNodesItem()
    item.ParentNodeId = ua.NodeId(base)
    item.RequestedNewNodeId = ua.NodeId(id, server.namespace_index)
    item.BrowseName = ua.QualifiedName(name, server.namespace_index)
    item.NodeClass = kind
    item.ReferenceTypeId = ua.NodeId(_Ids.HasSubtype)
    item.NodeAttributes = attributes(
        DisplayName=ua.LocalizedText(name),
        Description=ua.LocalizedText(description),
        IsAbstract=False,
    )
    return insert(server.address_space, item, server.utc())


def _state_rules(aspace: AddressSpace, parent: ua.NodeId, optional: Collection[str]) -> None:
    for part in list(aspace[parent].references):
        is_own = str(part.NodeId.Identifier).startswith(f"{parent.Identifier}.")
        if not (part.IsForward and part.ReferenceTypeId in _PARTS and is_own):
            continue
        name = part.BrowseName.Name
        rule = _OPTIONAL if name in optional else _MANDATORY
        if name.startswith("<"):
            rule = _PLACEHOLDER
        stated = reference(_HAS_RULE, aspace[ua.NodeId(rule)], forward=True)
        node = aspace[part.NodeId]
        node.references.append(stated)
        _state_rules(aspace, node.nodeid, optional)
