"""Add objects, variables and methods to the server's namespace."""

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.declarations import (
    Argument,
    Function,
    Method,
    OnWrite,
    Range,
    Value,
    Variable,
    argument_of_method,
)
from guarded_opcua.address_space.insertion import insert, property_item
from guarded_opcua.address_space.units import Unit
from guarded_opcua.errors import ServerError
from guarded_opcua.security.accounts import Role

_ANALOG_UNIT_RANGE_TYPE = ua.NodeId(17570)


class NodeOwner(Protocol):
    """The server that nodes are added to."""

    namespace_index: int

    @property
    def address_space(self) -> AddressSpace:
        """All nodes."""

    def utc(self) -> dt.datetime:
        """Return the time of day."""

    def register_variable(self, variable: Variable, value: Value) -> None:
        """Register a variable and publish its first value."""

    def register_method(self, method: Method) -> None:
        """Register a method."""


async def add_object(
    server: NodeOwner,
    parent: ua.NodeId | None,
    id: str,  # noqa: A002 - OPC UA's word
    *,
    description: str = "",
    type_definition: ua.NodeId | None = None,
    name: ua.QualifiedName | None = None,
    as_add_in: bool = False,
) -> ua.NodeId:
    """Add an object.

    Parameters
    ----------
    server
        Server that gets the node.
    parent
        Object that organizes it; None: the Objects folder.
    id
        String identifier; its last segment (after ``.``) becomes the BrowseName.
    description
        Description attribute.
    type_definition
        Type of the object; None: BaseObjectType.
    name
        BrowseName, if it is in another namespace.
    as_add_in
        Use HasAddIn as the reference from the parent (Part 3, 4.10.3).

    Returns
    -------
    NodeId
    """
    item = _item(server, parent, id, ua.NodeClass.Object, name)
    organizes = parent is None or parent.NamespaceIndex == 0
    kind = ua.ObjectIds.Organizes if organizes else ua.ObjectIds.HasComponent
    item.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HasAddIn if as_add_in else kind)
    item.TypeDefinition = type_definition or ua.NodeId(ua.ObjectIds.BaseObjectType)
    item.NodeAttributes = ua.ObjectAttributes(
        DisplayName=ua.LocalizedText(item.BrowseName.Name),
        Description=ua.LocalizedText(description),
        EventNotifier=0,
    )
    return await _add(server, item)


async def add_variable(
    server: NodeOwner,
    parent: ua.NodeId,
    id: str,  # noqa: A002 - OPC UA's word
    value: Value,
    *,
    description: str = "",
    type: ua.VariantType = ua.VariantType.Double,  # noqa: A002
    unit: Unit | None = None,
    value_range: Range | None = None,
    instrument_range: Range | None = None,
    dimensions: Sequence[int] | None = None,
    enum_strings: Sequence[str] | None = None,
    writable_by: Role | None = None,
    on_write: OnWrite | None = None,
    or_nan: bool = False,
    type_definition: ua.NodeId | None = None,
    data_type: ua.NodeId | None = None,
    name: ua.QualifiedName | None = None,
) -> Variable:
    """Add a variable.

    Parameters
    ----------
    server, parent
        Server, and the node that has the variable as a component.
    id
        String identifier, e.g. ``Valvistor.U``; its last segment becomes the BrowseName.
    value
        First value; None: BadWaitingForInitialData.
    description
        Description attribute.
    type
        Data type.
    unit
        Engineering unit; the variable becomes an AnalogUnitRangeType with EURange.
    value_range
        Lowest and highest value, enforced on writes. Required with a unit.
    instrument_range
        Range of the instrument, as property InstrumentRange; only with a unit.
    dimensions
        Length of each dimension, 0 = any; None: a scalar.
    enum_strings
        Names of the values 0, 1, …, as property EnumStrings.
    writable_by
        Lowest role that may write; None: read-only.
    on_write
        Called with each value a peer writes, after the checks of type and range and before the
        value is stored; raise :class:`~guarded_opcua.errors.CommandRejected` to refuse it.
    or_nan
        Accept NaN in writes.
    type_definition
        VariableType; None: AnalogUnitRangeType with a unit, BaseDataVariableType without.
    data_type
        DataType, if it is derived from ``type``, such as an enumeration.
    name
        BrowseName, if it is in another namespace.

    Returns
    -------
    Variable
        Handle for :meth:`HardenedServer.write`.
    """
    item = _item(server, parent, id, ua.NodeClass.Variable, name)
    item.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HasComponent)
    item.TypeDefinition = type_definition or _variable_type(unit, value_range)
    access = 1 << ua.AccessLevel.CurrentRead
    if writable_by is not None:
        access |= 1 << ua.AccessLevel.CurrentWrite
    item.NodeAttributes = ua.VariableAttributes(
        DisplayName=ua.LocalizedText(item.BrowseName.Name),
        Description=ua.LocalizedText(description),
        DataType=data_type or ua.NodeId(type.value),
        ValueRank=ua.ValueRank.Scalar if dimensions is None else ua.ValueRank(len(dimensions)),
        ArrayDimensions=list(dimensions or ()),
        AccessLevel=access,
        UserAccessLevel=access,
        MinimumSamplingInterval=0.0,
        Historizing=False,
        Value=ua.Variant(None, ua.VariantType.Null),
    )
    variable = Variable(
        id=await _add(server, item),
        type=type,
        array=dimensions is not None,
        value_range=value_range,
        writable_by=writable_by,
        on_write=on_write,
        or_nan=or_nan,
    )
    if unit is not None and value_range is not None:
        await add_property(server, variable.id, "EngineeringUnits", unit.information)
        await add_property(server, variable.id, "EURange", _span(value_range))
        if instrument_range is not None:
            await add_property(server, variable.id, "InstrumentRange", _span(instrument_range))
    if enum_strings is not None:
        texts = [ua.LocalizedText(text) for text in enum_strings]
        await add_property(server, variable.id, "EnumStrings", texts)
    server.register_variable(variable, value)
    return variable


async def add_method(
    server: NodeOwner,
    parent: ua.NodeId,
    id: str,  # noqa: A002 - OPC UA's word
    function: Function,
    *,
    inputs: Sequence[Argument] = (),
    outputs: Sequence[Argument] = (),
    required: Role,
    description: str = "",
) -> ua.NodeId:
    """Add a method.

    Parameters
    ----------
    server, parent
        Server, and the object that has the method as a component.
    id
        String identifier; its last segment becomes the BrowseName.
    function
        Called with the arguments' plain values, after the checks of number, types and ranges; may
        be a coroutine function. Returns the outputs: a tuple, one value for a single output, or
        None for none. :class:`~guarded_opcua.errors.CommandRejected` becomes BadInvalidState,
        :class:`OutOfRange` BadOutOfRange.
    inputs, outputs
        Arguments.
    required
        Lowest role that may call it.
    description
        Description attribute.
    """
    item = _item(server, parent, id, ua.NodeClass.Method)
    item.ReferenceTypeId = ua.NodeId(ua.ObjectIds.HasComponent)
    item.NodeAttributes = ua.MethodAttributes(
        DisplayName=ua.LocalizedText(item.BrowseName.Name),
        Description=ua.LocalizedText(description),
        Executable=True,
        UserExecutable=True,
    )
    method = Method(await _add(server, item), function, tuple(inputs), tuple(outputs), required)
    for name, arguments in (("InputArguments", inputs), ("OutputArguments", outputs)):
        if arguments:
            await add_property(server, method.id, name, [argument_of_method(a) for a in arguments])
    server.register_method(method)
    return method.id


async def add_property(
    server: NodeOwner,
    parent: ua.NodeId,
    name: str | ua.QualifiedName,
    value: Value,
    data_type: ua.NodeId | None = None,
    code: int = ua.StatusCodes.Good,
    description: str = "",
) -> None:
    """Add a property; ``data_type`` None: the type of the value."""
    last = name.Name if isinstance(name, ua.QualifiedName) else name
    nodeid = ua.NodeId(f"{parent.Identifier}.{last}", server.namespace_index)
    item = property_item(parent, nodeid, name, value)
    if data_type is not None:
        item.NodeAttributes.DataType = data_type
    if description:
        item.NodeAttributes.Description = ua.LocalizedText(description)
    insert(server.address_space, item, server.utc())
    if code != ua.StatusCodes.Good:
        held = server.address_space[nodeid].attributes[ua.AttributeIds.Value]
        held.value = replace(held.value, StatusCode=ua.StatusCode(code))


def _item(
    server: NodeOwner,
    parent: ua.NodeId | None,
    id_: str,
    node_class: ua.NodeClass,
    name: ua.QualifiedName | None = None,
) -> ua.AddNodesItem:
    item = ua.AddNodesItem()
    item.ParentNodeId = parent or ua.NodeId(ua.ObjectIds.ObjectsFolder)
    item.RequestedNewNodeId = ua.NodeId(id_, server.namespace_index)
    own = ua.QualifiedName(id_.rsplit(".", 1)[-1], server.namespace_index)
    item.BrowseName = name or own
    item.NodeClass = node_class
    return item


async def _add(server: NodeOwner, item: ua.AddNodesItem) -> ua.NodeId:
    return insert(server.address_space, item, server.utc())


def _span(bounds: Range) -> ua.Range:
    low, high = bounds
    return ua.Range(Low=low, High=high)


def _variable_type(unit: Unit | None, value_range: Range | None) -> ua.NodeId:
    if unit is None:
        return ua.NodeId(ua.ObjectIds.BaseDataVariableType)
    if value_range is None:
        raise ServerError("a variable with a unit needs a value_range")
    return _ANALOG_UNIT_RANGE_TYPE
