"""The monitored items of all subscriptions: create, modify, link and delete, within the limits."""

import itertools
from collections.abc import Awaitable, Callable, Iterator

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.held_attributes import held_attribute
from guarded_opcua.monitoring.block_items import BlockItem
from guarded_opcua.monitoring.data_item import DataItem
from guarded_opcua.monitoring.event_item import EventItem
from guarded_opcua.security.accounts import Role
from guarded_opcua.settings import Limits
from guarded_opcua.subscriptions.events import EventDelivery
from guarded_opcua.subscriptions.item_requests import (
    ItemRefused,
    Place,
    data_item,
    event_item,
    modified,
    one_by_one,
    watch,
)
from guarded_opcua.subscriptions.subscription import Item, Owner, Subscription

_Codes = ua.StatusCodes

Breathe = Callable[[], Awaitable[None]]


class MonitoredItems:
    """All monitored items; each service checks that the session owns the named subscription.

    Attributes
    ----------
    count : int
        Number of monitored items.
    blocks
        Variables whose values are a column of a block.
    """

    def __init__(self, aspace: AddressSpace, limits: Limits, events: EventDelivery) -> None:
        self.count = 0
        self.blocks: dict[ua.NodeId, Place] = {}
        self._aspace, self._limits, self._events = aspace, limits, events
        self._numbers = itertools.count(1)
        self._watchers: dict[tuple[ua.NodeId, int], dict[int, int]] = {}

    def create(
        self,
        session: Owner,
        number: int,
        request: ua.MonitoredItemCreateRequest,
        stamps: ua.TimestampsToReturn,
    ) -> ua.MonitoredItemCreateResult:
        """Create a monitored item."""
        subscription = owned(session, number)
        subscription.heard_of()
        return self._create(subscription, request, stamps)

    def modify(
        self,
        session: Owner,
        number: int,
        request: ua.MonitoredItemModifyRequest,
        stamps: ua.TimestampsToReturn,
    ) -> ua.MonitoredItemModifyResult:
        """Modify a monitored item."""
        subscription = owned(session, number)
        subscription.heard_of()
        item = subscription.items.get(request.MonitoredItemId)
        if item is None:
            code = _Codes.BadMonitoredItemIdInvalid
            return ua.MonitoredItemModifyResult(StatusCode=ua.StatusCode(code))
        asked = request.RequestedParameters
        try:
            return modified(self._aspace, self._limits, subscription, item, asked, stamps)
        except ItemRefused as refused:
            return ua.MonitoredItemModifyResult(StatusCode=ua.StatusCode(refused.code))

    def delete(self, session: Owner, number: int, item_number: int) -> int:
        """Delete a monitored item; return a status code."""
        subscription = owned(session, number)
        subscription.heard_of()
        item = subscription.items.get(item_number)
        if item is None:
            return int(_Codes.BadMonitoredItemIdInvalid)
        self._forget(subscription, item)
        return int(_Codes.Good)

    def set_monitoring(
        self, session: Owner, number: int, item_number: int, mode: ua.MonitoringMode
    ) -> int:
        """Set the monitoring mode of an item; return a status code."""
        subscription = owned(session, number)
        subscription.heard_of()
        item = subscription.items.get(item_number)
        if item is None:
            return int(_Codes.BadMonitoredItemIdInvalid)
        if isinstance(item, BlockItem) and mode == ua.MonitoringMode.Sampling:
            item = one_by_one(self._aspace, subscription, item)
        if item.set_mode(mode) and not isinstance(item, EventItem):
            item.start(self._current(item))
        return int(_Codes.Good)

    def unlink(self, session: Owner, number: int, trigger: int, linked: int) -> int:
        """Remove a triggering link; return a status code."""
        subscription, item = self._trigger(session, number, trigger)
        known = subscription.unlink(item, linked)
        return int(_Codes.Good if known else _Codes.BadMonitoredItemIdInvalid)

    def link(self, session: Owner, number: int, trigger: int, linked: int) -> int:
        """Add a link by which an item triggers the reporting of another; return a status code."""
        subscription, item = self._trigger(session, number, trigger)
        other = subscription.items.get(linked)
        if other is None:
            return int(_Codes.BadMonitoredItemIdInvalid)
        if linked not in item.links and subscription.links >= self._limits.links_per_subscription:
            return int(_Codes.BadTooManyMonitoredItems)
        if isinstance(other, BlockItem):  # linked items need the order of single samples
            one_by_one(self._aspace, subscription, other)
        item = subscription.items[trigger]
        if isinstance(item, BlockItem):
            item = one_by_one(self._aspace, subscription, item)
        subscription.link(item, linked)
        return int(_Codes.Good)

    async def resend(self, session: Owner, number: int, breathe: Breathe) -> None:
        """Report the current values of all items again (method ResendData)."""
        subscription = owned(session, number)
        for item_number in list(subscription.items):
            item = subscription.items.get(item_number)
            if item is not None and not isinstance(item, EventItem):
                item.repeat(self._current(item))
            await breathe()

    def of(self, session: Owner, number: int) -> list[tuple[int, int]]:
        """List (monitored item, client handle) of a subscription (method GetMonitoredItems)."""
        items = owned(session, number).items.values()
        return [(item.number, item.client_handle) for item in items]

    def event_items(
        self, session: Owner, number: int, item_number: int | None = None
    ) -> list[EventItem]:
        """List the items of a subscription that monitor events, or the one of that number."""
        items = owned(session, number).items
        if item_number is None:
            return [item for item in items.values() if isinstance(item, EventItem)]
        item = items.get(item_number)
        if not isinstance(item, EventItem):
            raise ServiceError(_Codes.BadMonitoredItemIdInvalid)
        return [item]

    def forget_all(self, subscription: Subscription) -> Iterator[None]:
        """Delete the items of a subscription one after the other."""
        for item in list(subscription.items.values()):
            self._forget(subscription, item)
            yield

    def move(self, subscription: Subscription, old: Owner, new: Owner) -> None:
        """Count the items of a subscription as those of another session."""
        for item in subscription.items.values():
            self._watch(old, item, -1)
            self._watch(new, item, 1)

    def _trigger(self, session: Owner, number: int, trigger: int) -> tuple[Subscription, Item]:
        subscription = owned(session, number)
        subscription.heard_of()
        item = subscription.items.get(trigger)
        if item is None:
            raise ServiceError(_Codes.BadMonitoredItemIdInvalid)
        return subscription, item

    def _create(
        self,
        subscription: Subscription,
        request: ua.MonitoredItemCreateRequest,
        stamps: ua.TimestampsToReturn,
    ) -> ua.MonitoredItemCreateResult:
        limits = self._limits
        room = limits.monitored_items
        room -= reserved(limits, subscription.owner, room)
        if self.count >= room or len(subscription.items) >= limits.monitored_items_per_subscription:
            return _refused(_Codes.BadTooManyMonitoredItems)
        wanted = request.ItemToMonitor
        if self._is_crowded(subscription, wanted):
            return _refused(_Codes.BadTooManyMonitoredItems)
        number = next(self._numbers)
        try:
            if wanted.AttributeId == ua.AttributeIds.EventNotifier:
                return self._create_event_item(subscription, number, request)
            current = held_attribute(self._aspace, wanted.NodeId, wanted.AttributeId)
            item, result = data_item(
                self._aspace, limits, subscription, number, request, stamps, self.blocks
            )
        except ItemRefused as refused:
            return _refused(refused.code)
        if isinstance(item, DataItem):
            watch(self._aspace, item)
        self._keep(subscription, item)
        if item.mode != ua.MonitoringMode.Disabled:
            item.start(current)
        return result

    def _create_event_item(
        self, subscription: Subscription, number: int, request: ua.MonitoredItemCreateRequest
    ) -> ua.MonitoredItemCreateResult:
        most = self._limits.event_items
        if len(self._events) >= most - reserved(self._limits, subscription.owner, most):
            return _refused(_Codes.BadTooManyMonitoredItems)
        item, result = event_item(self._aspace, self._limits, subscription, number, request)
        self._events.watch(subscription, item)
        self._keep(subscription, item)
        self._events.welcome(subscription, item)
        return result

    def _is_crowded(self, subscription: Subscription, wanted: ua.ReadValueId) -> bool:
        """Return whether an attribute has reached its maximum number of monitored items."""
        watchers = self._watchers.get((wanted.NodeId, wanted.AttributeId), {})
        limits = self._limits
        own = watchers.get(id(subscription.owner), 0)
        room = limits.monitored_items_per_node
        room -= reserved(self._limits, subscription.owner, room)
        return own >= limits.monitored_items_per_node_and_session or sum(watchers.values()) >= room

    def _keep(self, subscription: Subscription, item: Item) -> None:
        subscription.items[item.number] = item
        self.count += 1
        self._watch(subscription.owner, item, 1)

    def _watch(self, owner: object, item: Item, change: int) -> None:
        key = (item.wanted.NodeId, item.wanted.AttributeId)
        watchers = self._watchers.setdefault(key, {})
        watchers[id(owner)] = watchers.get(id(owner), 0) + change
        if not watchers[id(owner)]:
            del watchers[id(owner)]
        if not watchers:
            del self._watchers[key]

    def _forget(self, subscription: Subscription, item: Item) -> None:
        if isinstance(item, DataItem):
            self._aspace.delete_datachange_callback(item.callback_handle)
        elif isinstance(item, EventItem):
            self._events.forget(item)
        subscription.forget(item)
        self.count -= 1
        self._watch(subscription.owner, item, -1)

    def _current(self, item: Item) -> ua.DataValue:
        return held_attribute(self._aspace, item.wanted.NodeId, item.wanted.AttributeId)


def owned(session: Owner, number: int) -> Subscription:
    """Return a subscription of this session.

    Raises
    ------
    ServiceError
        if it owns none of this number.
    """
    subscription = session.subscriptions.get(number)
    if subscription is None:
        raise ServiceError(_Codes.BadSubscriptionIdInvalid)
    return subscription


def reserved(limits: Limits, owner: Owner, most: int) -> int:
    """Return how many of ``most`` are reserved, thus not available to this session."""
    return 0 if owner.hears(Role.OPERATOR) else int(limits.reserved_share * most)


def _refused(code: int) -> ua.MonitoredItemCreateResult:
    return ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(code))
