"""Requests for monitored items: checked and revised (Part 4, 5.13.2)."""

import math
from collections.abc import Mapping
from typing import Any

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.blocks import Block
from guarded_opcua.address_space.held_attributes import (
    held_attribute,
    is_missing,
    is_readable,
)
from guarded_opcua.binary.index_range import IndexRangeError, Ranges, parse_index_range
from guarded_opcua.monitoring.block_items import BlockItem, serves
from guarded_opcua.monitoring.data_change import DataChangeFilter, FilterRefused, change_rule
from guarded_opcua.monitoring.data_item import DataItem
from guarded_opcua.monitoring.event_filter import EventFilter, EventFilterRefused
from guarded_opcua.monitoring.event_item import EventItem, Listening
from guarded_opcua.monitoring.parameters import Monitoring
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.subscription import Item, Subscription

Place = tuple[Block, int]
_Codes = ua.StatusCodes
_HAS_PROPERTY = ua.NodeId(ua.ObjectIds.HasProperty)


class ItemRefused(Exception):  # noqa: N818 - it is an answer
    """A request for a monitored item was refused, with the status code ``code``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def data_item(
    aspace: AddressSpace,
    limits: Limits,
    subscription: Subscription,
    number: int,
    request: ua.MonitoredItemCreateRequest,
    stamps: ua.TimestampsToReturn,
    blocks: Mapping[ua.NodeId, Place],
) -> tuple[DataItem | BlockItem, ua.MonitoredItemCreateResult]:
    """Create an item that monitors an attribute; ``blocks`` maps variables to their blocks.

    Raises
    ------
    ItemRefused
    """
    wanted = request.ItemToMonitor
    _check_attribute(aspace, wanted)
    ranges = _ranges(wanted)
    monitoring = _monitoring(
        aspace, limits, subscription, wanted, request.RequestedParameters, stamps
    )
    item: DataItem | BlockItem
    place = blocks.get(wanted.NodeId)  # after the node was created, if it is lazy
    if (
        place
        and wanted.AttributeId == ua.AttributeIds.Value
        and ranges is None
        and request.MonitoringMode != ua.MonitoringMode.Sampling
        and serves(place[0], monitoring)
    ):
        item = subscription.block_items(place[0]).add(number, wanted, place[1], monitoring)
        item.set_mode(request.MonitoringMode)
    else:
        item = DataItem(subscription, number, wanted, request.MonitoringMode, monitoring, ranges)
    return item, ua.MonitoredItemCreateResult(
        MonitoredItemId=number,
        RevisedSamplingInterval=monitoring.interval_s * 1e3,
        RevisedQueueSize=monitoring.queue_size,
    )


def event_item(
    aspace: AddressSpace,
    limits: Limits,
    subscription: Subscription,
    number: int,
    request: ua.MonitoredItemCreateRequest,
) -> tuple[EventItem, ua.MonitoredItemCreateResult]:
    """Create an item that monitors events.

    Raises
    ------
    ItemRefused
    """
    wanted, asked = request.ItemToMonitor, request.RequestedParameters
    held = held_attribute(aspace, wanted.NodeId, ua.AttributeIds.EventNotifier)
    if is_missing(held):
        raise ItemRefused(held.StatusCode.value)
    if not held.Value.Value & (1 << ua.EventNotifier.SubscribeToEvents):
        raise ItemRefused(_Codes.BadNotSupported)
    listening = _listening(aspace, limits, asked)
    item = EventItem(subscription, number, wanted, request.MonitoringMode, listening)
    return item, ua.MonitoredItemCreateResult(
        MonitoredItemId=number,
        RevisedSamplingInterval=0.0,
        RevisedQueueSize=listening.queue_size,
        FilterResult=listening.filter.result,
    )


def modified(
    aspace: AddressSpace,
    limits: Limits,
    subscription: Subscription,
    item: Item,
    asked: ua.MonitoringParameters,
    stamps: ua.TimestampsToReturn,
) -> ua.MonitoredItemModifyResult:
    """Modify the parameters of an item.

    Raises
    ------
    ItemRefused
    """
    if isinstance(item, EventItem):
        listening = _listening(aspace, limits, asked)
        item.modify(listening)
        return ua.MonitoredItemModifyResult(
            RevisedSamplingInterval=0.0,
            RevisedQueueSize=listening.queue_size,
            FilterResult=listening.filter.result,
        )
    monitoring = _monitoring(aspace, limits, subscription, item.wanted, asked, stamps)
    if isinstance(item, BlockItem) and not serves(item.of.block, monitoring):
        item = one_by_one(aspace, subscription, item)
    item.modify(monitoring)
    return ua.MonitoredItemModifyResult(
        RevisedSamplingInterval=monitoring.interval_s * 1e3,
        RevisedQueueSize=monitoring.queue_size,
    )


def watch(aspace: AddressSpace, item: DataItem) -> None:
    """Register an item for changes of its attribute."""
    wanted = item.wanted
    code, handle = aspace.add_datachange_callback(wanted.NodeId, wanted.AttributeId, item)
    if not code.is_good():
        raise ItemRefused(code.value)
    item.callback_handle = handle


def one_by_one(aspace: AddressSpace, subscription: Subscription, item: BlockItem) -> DataItem:
    """Replace a block item by a data item, with its queue."""
    mode = item.mode
    queued, reported = item.of.release(item)
    single = DataItem(subscription, item.number, item.wanted, mode, item.monitoring, None)
    single.adopt(queued, reported)
    subscription.items[item.number] = single
    watch(aspace, single)
    callbacks = aspace[item.wanted.NodeId].attributes[ua.AttributeIds.Value].datachange_callbacks
    in_order = sorted(callbacks.items(), key=lambda held: getattr(held[1], "number", 0))
    callbacks.clear()
    callbacks.update(in_order)  # items are notified in the order of their creation
    if queued:
        subscription.has_report(single.number)
    return single


def _listening(aspace: AddressSpace, limits: Limits, asked: ua.MonitoringParameters) -> Listening:
    try:
        wish = EventFilter(aspace, asked.Filter)
    except EventFilterRefused as refused:
        raise ItemRefused(_Codes.BadEventFilterInvalid) from refused
    most = limits.event_queue_size
    size = max(1, min(asked.QueueSize or most, most))
    return Listening(asked.ClientHandle, wish, size, discard_oldest=bool(asked.DiscardOldest))


def _monitoring(
    aspace: AddressSpace,
    limits: Limits,
    subscription: Subscription,
    wanted: ua.ReadValueId,
    asked: ua.MonitoringParameters,
    stamps: ua.TimestampsToReturn,
) -> Monitoring:
    if stamps not in tuple(ua.TimestampsToReturn)[:4]:
        raise ItemRefused(_Codes.BadTimestampsToReturnInvalid)
    is_value = wanted.AttributeId == ua.AttributeIds.Value
    kind = _value_kind(aspace, wanted.NodeId) if is_value else None
    span = _eu_span(aspace, wanted.NodeId) if is_value else None
    try:
        rule = change_rule(asked.Filter, kind, span)
    except FilterRefused as refused:
        raise ItemRefused(refused.code) from refused
    if asked.Filter is not None and not is_value and isinstance(asked.Filter, DataChangeFilter):
        raise ItemRefused(_Codes.BadFilterNotAllowed)
    return Monitoring(
        client_handle=asked.ClientHandle,
        rule=rule,
        queue_size=max(1, min(asked.QueueSize, limits.queue_size)),
        discard_oldest=bool(asked.DiscardOldest),
        interval_s=_sampling_interval(asked.SamplingInterval, limits, subscription),
        stamps=stamps,
    )


def _sampling_interval(wish: float, limits: Limits, subscription: Subscription) -> float:
    """Return the revised interval, s: -1 is the publishing interval, 0 means every change."""
    if math.isnan(wish):
        return 0.0
    seconds = subscription.timing.interval_s if wish < 0.0 else wish / 1e3
    if seconds * 1e3 <= limits.publishing_interval_ms:
        return 0.0
    return min(seconds, limits.longest_publishing_interval_ms / 1e3)


def _check_attribute(aspace: AddressSpace, wanted: ua.ReadValueId) -> None:
    held = held_attribute(aspace, wanted.NodeId, wanted.AttributeId)
    if is_missing(held):
        raise ItemRefused(held.StatusCode.value)
    encoding = wanted.DataEncoding
    if encoding is not None and encoding.Name:
        raise ItemRefused(_Codes.BadDataEncodingInvalid)
    if wanted.AttributeId == ua.AttributeIds.Value and not is_readable(aspace, wanted.NodeId):
        raise ItemRefused(_Codes.BadNotReadable)


def _ranges(wanted: ua.ReadValueId) -> Ranges | None:
    if not wanted.IndexRange:
        return None
    try:
        return parse_index_range(wanted.IndexRange)
    except IndexRangeError as error:
        raise ItemRefused(_Codes.BadIndexRangeInvalid) from error


def _value_kind(aspace: AddressSpace, nodeid: ua.NodeId) -> ua.VariantType | None:
    data_type = aspace.read_attribute_value(nodeid, ua.AttributeIds.DataType)
    found = data_type.Value.Value if data_type.Value is not None else None
    if (
        isinstance(found, ua.NodeId)
        and found.NamespaceIndex == 0
        and isinstance(found.Identifier, int)
        and found.Identifier <= 25
    ):
        return ua.VariantType(found.Identifier)
    held = aspace.read_attribute_value(nodeid, ua.AttributeIds.Value).Value
    return None if held is None else held.VariantType


def _eu_span(aspace: AddressSpace, nodeid: ua.NodeId) -> float | None:
    for reference in aspace[nodeid].references:
        if (
            reference.IsForward
            and reference.ReferenceTypeId == _HAS_PROPERTY
            and reference.BrowseName.Name == "EURange"
        ):
            held = aspace.read_attribute_value(reference.NodeId, ua.AttributeIds.Value).Value
            found: Any = held.Value if held is not None else None
            return None if found is None else float(found.High - found.Low)
    return None
