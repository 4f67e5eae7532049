"""The attributes and properties by which nodes offer their history (Part 11, 5)."""

from collections.abc import Iterable

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.address_space.insertion import reference
from guarded_opcua.binary.encoding import DTYPES
from guarded_opcua.errors import ServerError
from guarded_opcua.monitoring.event_filter import filter_of_fields

_LEVELS = ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel
_EMITS_AND_REMEMBERS = 1 << ua.EventNotifier.SubscribeToEvents | 1 << ua.EventNotifier.HistoryRead
_FILTER = ua.NodeId(ua.ObjectIds.HistoricalEventFilter)


def offer_values(aspace: AddressSpace, variable: Variable) -> None:
    """Mark a variable as one with a history.

    Raises
    ------
    ServerError
        if it is not a scalar number.
    """
    if variable.array or variable.type not in DTYPES:
        raise ServerError(f"{variable.id.Identifier}: histories are of scalar numbers")
    attributes = aspace[variable.id].attributes
    for of_level in _LEVELS:
        level = attributes[of_level].value.Value.Value | 1 << ua.AccessLevel.HistoryRead
        attributes[of_level].value = ua.DataValue(ua.Variant(level, ua.VariantType.Byte))
    historizing = ua.DataValue(ua.Variant(True, ua.VariantType.Boolean))  # noqa: FBT003
    attributes[ua.AttributeIds.Historizing].value = historizing


def offer_events(aspace: AddressSpace, source: ua.NodeId) -> None:
    """Mark an object as one whose events are stored; it gets the property HistoricalEventFilter."""
    has_property = reference(ua.NodeId(ua.ObjectIds.HasProperty), aspace[_FILTER], forward=True)
    aspace[source].references.append(has_property)
    notifier = ua.DataValue(ua.Variant(_EMITS_AND_REMEMBERS, ua.VariantType.Byte))
    aspace[source].attributes[ua.AttributeIds.EventNotifier].value = notifier


def state_stored_fields(aspace: AddressSpace, fields: Iterable[str]) -> None:
    """Set the value of HistoricalEventFilter: the browse paths of the event fields stored."""
    attributes = aspace[_FILTER].attributes
    kept = ua.Variant(filter_of_fields(fields), ua.VariantType.ExtensionObject)
    attributes[ua.AttributeIds.Value].value = ua.DataValue(kept)
    scalar = ua.DataValue(ua.Variant(int(ua.ValueRank.Scalar), ua.VariantType.Int32))
    attributes[ua.AttributeIds.ValueRank].value = scalar
