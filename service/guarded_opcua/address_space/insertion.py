"""Direct insertion of nodes into the address space.

asyncua's AddNodes searches all references of the parent for each new child and takes 0.25 ms per
node; thousands of valves would take minutes. The resulting nodes are identical.
"""

import datetime as dt
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace, AttributeValue, NodeData

from guarded_opcua.errors import ServerError

_Ids = ua.AttributeIds
_Types = ua.VariantType
_HAS_TYPE = ua.NodeId(ua.ObjectIds.HasTypeDefinition)
_TYPED = (ua.NodeClass.Object, ua.NodeClass.Variable)
# attributes of AddNodes: name, bit, attribute, type of the value (None: a Variant)
_ATTRIBUTES = tuple(
    (name, int(getattr(ua.NodeAttributesMask, name)), getattr(_Ids, name), kind)
    for name, kind in (
        ("AccessLevel", _Types.Byte),
        ("ArrayDimensions", _Types.UInt32),
        ("DataType", _Types.NodeId),
        ("Description", _Types.LocalizedText),
        ("DisplayName", _Types.LocalizedText),
        ("EventNotifier", _Types.Byte),
        ("Executable", _Types.Boolean),
        ("Historizing", _Types.Boolean),
        ("IsAbstract", _Types.Boolean),
        ("MinimumSamplingInterval", _Types.Double),
        ("UserAccessLevel", _Types.Byte),
        ("UserExecutable", _Types.Boolean),
        ("ValueRank", _Types.Int32),
        ("WriteMask", _Types.UInt32),
        ("UserWriteMask", _Types.UInt32),
        ("Value", None),
    )
)


@contextmanager
def many_nodes() -> Iterator[None]:
    """Disable the garbage collector while nodes are added, then freeze them; halves the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
        gc.freeze()


def insert(aspace: AddressSpace, item: ua.AddNodesItem, utc: dt.datetime) -> ua.NodeId:
    """Add a node of any class below its parent; ``utc`` is the timestamp of its value.

    Raises
    ------
    ServerError
        if the node exists, or its parent or type does not.
    """
    id_, parent = item.RequestedNewNodeId, aspace.get(item.ParentNodeId)
    for wrong, code in (
        (id_ in aspace, "BadNodeIdExists"),
        (parent is None, "BadParentNodeIdInvalid"),
        (_is_typed(item) and item.TypeDefinition not in aspace, "BadTypeDefinitionInvalid"),
    ):
        if wrong:
            raise ServerError(f"node {id_.to_string()}: cannot be added: {code}")
    assert parent is not None  # noqa: S101 - see above
    node = NodeData(id_)
    given = item.NodeAttributes
    held = node.attributes
    held[_Ids.NodeId] = AttributeValue(ua.DataValue(ua.Variant(id_, _Types.NodeId)))
    held[_Ids.BrowseName] = _attribute(item.BrowseName, _Types.QualifiedName)
    held[_Ids.NodeClass] = _attribute(item.NodeClass, _Types.Int32)
    for name, bit, attribute, kind in _ATTRIBUTES:
        if not given.SpecifiedAttributes & bit:
            continue
        value = getattr(given, name)
        if kind is None:
            data = ua.DataValue(
                value if isinstance(value, ua.Variant) else ua.Variant(value),
                SourceTimestamp=utc,
            )
            held[attribute] = AttributeValue(data)
        else:
            held[attribute] = _attribute(value, kind)
    aspace[id_] = node
    forward = ua.ReferenceDescription(
        ReferenceTypeId=item.ReferenceTypeId,
        NodeId=id_,
        NodeClass=item.NodeClass,
        BrowseName=item.BrowseName,
        DisplayName=given.DisplayName,
        TypeDefinition=item.TypeDefinition,
    )
    forward.IsForward = True
    parent.references.append(forward)
    node.references.append(reference(item.ReferenceTypeId, parent, forward=False))
    if _is_typed(item):
        node.references.append(reference(_HAS_TYPE, aspace[item.TypeDefinition], forward=True))
    return id_


def property_item(
    parent: ua.NodeId,
    id_: ua.NodeId,
    name: str | ua.QualifiedName,
    value: Any,  # noqa: ANN401 - of any type
) -> ua.AddNodesItem:
    """Return the AddNodesItem of a property; a ``str`` name is in namespace 0."""
    content = ua.Variant(value)
    named = name if isinstance(name, ua.QualifiedName) else ua.QualifiedName(name, 0)
    text = ua.LocalizedText(named.Name)
    item = ua.AddNodesItem()
    item.RequestedNewNodeId = id_
    item.ParentNodeId = parent
    item.BrowseName = named
    item.NodeClass = ua.NodeClass.Variable
    item.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HasProperty)
    item.TypeDefinition = ua.NodeId(ua.ObjectIds.PropertyType)
    attributes = ua.VariableAttributes()
    attributes.Description = attributes.DisplayName = text
    attributes.DataType = _data_type(content)
    attributes.Value = content
    rank = ua.ValueRank.OneDimension if content.is_array else ua.ValueRank.Scalar
    attributes.ValueRank = rank
    item.NodeAttributes = attributes
    return item


def _is_typed(item: ua.AddNodesItem) -> bool:
    return not item.TypeDefinition.is_null()


def _attribute(value: Any, kind: ua.VariantType) -> AttributeValue:  # noqa: ANN401
    if isinstance(value, int | float | ua.NodeId):
        return AttributeValue(_shared(value, kind))
    is_array = kind == _Types.UInt32  # ArrayDimensions
    return AttributeValue(ua.DataValue(ua.Variant(value, kind, is_array=is_array)))


@lru_cache(10_000)
def _shared(value: Any, kind: ua.VariantType) -> ua.DataValue:  # noqa: ANN401
    """Return a shared DataValue: most nodes have equal attributes, and writes replace it."""
    return ua.DataValue(ua.Variant(value, kind))


def reference(kind: ua.NodeId, target: NodeData, *, forward: bool) -> ua.ReferenceDescription:
    """Return the ReferenceDescription of a node."""
    attributes = target.attributes
    found = ua.ReferenceDescription(
        ReferenceTypeId=kind,
        NodeId=target.nodeid,
        NodeClass=_held(attributes, _Ids.NodeClass),
        BrowseName=_held(attributes, _Ids.BrowseName),
        DisplayName=_held(attributes, _Ids.DisplayName),
    )
    found.IsForward = forward
    if found.NodeClass in _TYPED:
        types = (ref.NodeId for ref in target.references if ref.ReferenceTypeId == _HAS_TYPE)
        found.TypeDefinition = next(types, ua.NodeId())
    return found


def _held(attributes: dict[ua.AttributeIds, AttributeValue], attribute: ua.AttributeIds) -> Any:  # noqa: ANN401
    value = attributes[attribute].value
    return None if value is None else value.Value.Value


def _data_type(content: ua.Variant) -> ua.NodeId:
    sample = content.Value[0] if content.is_array else content.Value
    if content.VariantType == _Types.ExtensionObject:
        return ua.NodeId(sample.data_type.Identifier)
    return ua.NodeId(content.VariantType.value)
