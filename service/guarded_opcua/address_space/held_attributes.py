"""Stored attributes of nodes: existence (Part 3, 5.9) and read access."""

from asyncua import ua
from asyncua.server.address_space import AddressSpace

_Codes = ua.StatusCodes
_Ids = ua.AttributeIds
_READ = 1 << ua.AccessLevel.CurrentRead


def held_attribute(aspace: AddressSpace, id_: ua.NodeId, attribute: int) -> ua.DataValue:
    """Return an attribute of a node; BadNodeIdUnknown or BadAttributeIdInvalid if missing.

    Null is a valid Value of a Variable. Any other attribute that is Null is an absent optional one,
    such as the default Value of a VariableType.
    """
    held: ua.DataValue = aspace.read_attribute_value(id_, attribute)
    is_null = held.Value is None or held.Value.VariantType == ua.VariantType.Null
    if is_null and not is_missing(held) and not _is_value(aspace, id_, attribute):
        return ua.DataValue(StatusCode=ua.StatusCode(_Codes.BadAttributeIdInvalid))
    return held


def is_missing(held: ua.DataValue) -> bool:
    """Return whether the node or its attribute does not exist."""
    code = 0 if held.StatusCode is None else held.StatusCode.value
    return code in (_Codes.BadNodeIdUnknown, _Codes.BadAttributeIdInvalid)


def is_readable(aspace: AddressSpace, id_: ua.NodeId) -> bool:
    """Return whether the Value of a node may be read; only Variables have an AccessLevel."""
    level = aspace.read_attribute_value(id_, _Ids.AccessLevel).Value
    return level is None or level.Value is None or bool(level.Value & _READ)


def _is_value(aspace: AddressSpace, id_: ua.NodeId, attribute: int) -> bool:
    kind = aspace.read_attribute_value(id_, _Ids.NodeClass).Value
    return attribute == _Ids.Value and kind is not None and kind.Value == ua.NodeClass.Variable
