"""The subscriptions of all sessions: create, modify, transfer and delete, within the limits."""

import itertools
import math
from collections.abc import Awaitable, Callable, Iterable, Iterator
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.held_attributes import held_attribute
from guarded_opcua.chores import Chores
from guarded_opcua.clock import Clock
from guarded_opcua.ledger import Ledger
from guarded_opcua.logs import bounded_logger
from guarded_opcua.monitoring.block_items import BlockItem
from guarded_opcua.monitoring.data_item import DataItem
from guarded_opcua.monitoring.event_item import EventItem
from guarded_opcua.security.users import Role
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
from guarded_opcua.subscriptions.subscription import (
    Item,
    Owner,
    RepublishStore,
    Subscription,
    Timing,
)

_log = bounded_logger(__name__)
_Codes = ua.StatusCodes

Breathe = Callable[[], Awaitable[None]]


class Subscriptions:
    """All subscriptions; each service checks that the session owns the named subscription."""

    def __init__(self, aspace: AddressSpace, limits: Limits, clock: Clock) -> None:
        self.ledger = Ledger(limits.queued_notifications)
        self.chores = Chores(clock)
        self.by_number: dict[int, Subscription] = {}
        self.created = 0
        self._aspace = aspace
        self._limits = limits
        self._store = RepublishStore(limits.unacknowledged_messages, limits.unacknowledged_bytes)
        self._clock = clock
        self._item_numbers = itertools.count(1)
        self._items = 0
        self._watchers: dict[tuple[ua.NodeId, int], dict[int, int]] = {}
        self.blocks: dict[ua.NodeId, Place] = {}
        self.events = EventDelivery(self.chores, clock)

    def create(
        self, session: Owner, params: ua.CreateSubscriptionParameters
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription."""
        limits = self._limits
        room = limits.subscriptions - self._reserved(session, limits.subscriptions)
        if (
            len(session.subscriptions) >= limits.subscriptions_per_session
            or len(self.by_number) >= room
        ):
            raise ServiceError(_Codes.BadTooManySubscriptions)
        timing = self._timing(params, params.Priority)
        self.created += 1
        subscription = Subscription(
            self.created,
            session,
            timing,
            self._store,
            self._clock,
            self._expire,
            publishing=bool(params.PublishingEnabled),
        )
        self.by_number[subscription.number] = subscription
        session.subscriptions[subscription.number] = subscription
        self._share()
        return ua.CreateSubscriptionResult(
            SubscriptionId=subscription.number,
            RevisedPublishingInterval=timing.interval_s * 1e3,
            RevisedLifetimeCount=timing.lifetime_count,
            RevisedMaxKeepAliveCount=timing.keep_alive_count,
        )

    def modify(
        self, session: Owner, params: ua.ModifySubscriptionParameters
    ) -> ua.ModifySubscriptionResult:
        """Modify the parameters of a subscription."""
        subscription = self._owned(session, params.SubscriptionId)
        timing = self._timing(params, params.Priority)
        subscription.retime(timing)
        return ua.ModifySubscriptionResult(
            RevisedPublishingInterval=timing.interval_s * 1e3,
            RevisedLifetimeCount=timing.lifetime_count,
            RevisedMaxKeepAliveCount=timing.keep_alive_count,
        )

    def set_publishing(self, session: Owner, number: int, *, enabled: bool) -> int:
        """Enable or disable the publishing of a subscription; return a status code."""
        subscription = session.subscriptions.get(number)
        if subscription is None:
            return int(_Codes.BadSubscriptionIdInvalid)
        subscription.publishing = enabled
        subscription.heard_of()
        return int(_Codes.Good)

    def delete(self, session: Owner, number: int) -> int:
        """Delete a subscription; return a status code."""
        subscription = session.subscriptions.get(number)
        if subscription is None:
            return int(_Codes.BadSubscriptionIdInvalid)
        self.end(subscription)
        return int(_Codes.Good)

    def end(self, subscription: Subscription) -> None:
        """Delete a subscription now, and its items in the background."""
        owner = subscription.owner
        subscription.stop()
        self.by_number.pop(subscription.number, None)
        owner.lose(subscription)
        self._share()
        self.chores.add(self._forget_all(subscription), owner.charge)

    async def transfer(
        self, session: Owner, number: int, breathe: Breathe, *, send_values: bool
    ) -> ua.TransferResult:
        """Transfer a subscription of the same user to this session."""
        moves = number not in session.subscriptions
        result = self._transfer(session, number)
        if moves and send_values and number in session.subscriptions:
            await self.resend(session, number, breathe)
        return result

    def republish(self, session: Owner, params: ua.RepublishParameters) -> bytes:
        """Return an unacknowledged message."""
        subscription = self._owned(session, params.SubscriptionId)
        content = subscription.republish(params.RetransmitSequenceNumber)
        if content is None:
            raise ServiceError(_Codes.BadMessageNotAvailable)
        return content

    def acknowledge(
        self, session: Owner, acks: Iterable[ua.SubscriptionAcknowledgement]
    ) -> tuple[int, ...]:
        """Acknowledge messages; return a status code for each."""
        codes = []
        for ack in acks:
            subscription = session.subscriptions.get(ack.SubscriptionId)
            if subscription is None:
                codes.append(_Codes.BadSubscriptionIdInvalid)
            else:
                codes.append(subscription.acknowledge(ack.SequenceNumber))
        return tuple(codes)

    def create_item(
        self,
        session: Owner,
        number: int,
        request: ua.MonitoredItemCreateRequest,
        stamps: ua.TimestampsToReturn,
    ) -> ua.MonitoredItemCreateResult:
        """Create a monitored item."""
        subscription = self._owned(session, number)
        subscription.heard_of()
        return self._create_item(subscription, request, stamps)

    def modify_item(
        self,
        session: Owner,
        number: int,
        request: ua.MonitoredItemModifyRequest,
        stamps: ua.TimestampsToReturn,
    ) -> ua.MonitoredItemModifyResult:
        """Modify a monitored item."""
        subscription = self._owned(session, number)
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

    def delete_item(self, session: Owner, number: int, item_number: int) -> int:
        """Delete a monitored item; return a status code."""
        subscription = self._owned(session, number)
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
        subscription = self._owned(session, number)
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
        subscription = self._owned(session, number)
        for item_number in list(subscription.items):
            item = subscription.items.get(item_number)
            if item is not None and not isinstance(item, EventItem):
                item.repeat(self._current(item))
            await breathe()

    def items_of(self, session: Owner, number: int) -> list[tuple[int, int]]:
        """List (monitored item, client handle) of a subscription (method GetMonitoredItems)."""
        items = self._owned(session, number).items.values()
        return [(item.number, item.client_handle) for item in items]

    def event_items(
        self, session: Owner, number: int, item_number: int | None = None
    ) -> list[EventItem]:
        """List the items of a subscription that monitor events, or the one of that number."""
        items = self._owned(session, number).items
        if item_number is None:
            return [item for item in items.values() if isinstance(item, EventItem)]
        item = items.get(item_number)
        if not isinstance(item, EventItem):
            raise ServiceError(_Codes.BadMonitoredItemIdInvalid)
        return [item]

    @property
    def item_count(self) -> int:
        """Number of monitored items."""
        return self._items

    def _share(self) -> None:
        owners = {id(subscription.owner) for subscription in self.by_number.values()}
        self.ledger.sessions = max(1, len(owners))

    def _reserved(self, owner: Owner, most: int) -> int:
        """Return how many of ``most`` are reserved, thus not available to this session."""
        return 0 if owner.hears(Role.OPERATOR) else int(self._limits.reserved_share * most)

    def _trigger(self, session: Owner, number: int, trigger: int) -> tuple[Subscription, Item]:
        subscription = self._owned(session, number)
        subscription.heard_of()
        item = subscription.items.get(trigger)
        if item is None:
            raise ServiceError(_Codes.BadMonitoredItemIdInvalid)
        return subscription, item

    def _owned(self, session: Owner, number: int) -> Subscription:
        subscription = session.subscriptions.get(number)
        if subscription is None:
            raise ServiceError(_Codes.BadSubscriptionIdInvalid)
        return subscription

    def _timing(self, params: Any, priority: int) -> Timing:  # noqa: ANN401 - create or modify
        limits = self._limits
        interval = params.RequestedPublishingInterval
        if not interval >= limits.publishing_interval_ms:  # NaN too
            interval = limits.publishing_interval_ms
        interval = min(interval, limits.longest_publishing_interval_ms)
        asked = params.RequestedMaxKeepAliveCount or limits.keep_alive_count
        keep_alive = min(asked, limits.keep_alive_count)
        longest = max(3, math.floor(limits.longest_lifetime_s * 1e3 / interval))
        keep_alive = max(1, min(keep_alive, longest // 3))
        lifetime = min(params.RequestedLifetimeCount, limits.lifetime_count, longest)
        most = limits.notifications_per_publish
        wanted = params.MaxNotificationsPerPublish or most
        return Timing(
            interval_s=interval / 1e3,
            keep_alive_count=keep_alive,
            lifetime_count=max(lifetime, 3 * keep_alive),
            notifications_per_publish=min(wanted, most),
            priority=priority,
        )

    def _create_item(
        self,
        subscription: Subscription,
        request: ua.MonitoredItemCreateRequest,
        stamps: ua.TimestampsToReturn,
    ) -> ua.MonitoredItemCreateResult:
        limits = self._limits
        room = limits.monitored_items - self._reserved(subscription.owner, limits.monitored_items)
        if (
            self._items >= room
            or len(subscription.items) >= limits.monitored_items_per_subscription
        ):
            return _refused(_Codes.BadTooManyMonitoredItems)
        wanted = request.ItemToMonitor
        if self._is_crowded(subscription, wanted):
            return _refused(_Codes.BadTooManyMonitoredItems)
        number = next(self._item_numbers)
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
        if len(self.events) >= most - self._reserved(subscription.owner, most):
            return _refused(_Codes.BadTooManyMonitoredItems)
        item, result = event_item(self._aspace, self._limits, subscription, number, request)
        self.events.watch(subscription, item)
        self._keep(subscription, item)
        self.events.welcome(subscription, item)
        return result

    def _is_crowded(self, subscription: Subscription, wanted: ua.ReadValueId) -> bool:
        """Return whether an attribute has reached its maximum number of monitored items."""
        watchers = self._watchers.get((wanted.NodeId, wanted.AttributeId), {})
        limits = self._limits
        own = watchers.get(id(subscription.owner), 0)
        room = limits.monitored_items_per_node
        room -= self._reserved(subscription.owner, room)
        return own >= limits.monitored_items_per_node_and_session or sum(watchers.values()) >= room

    def _keep(self, subscription: Subscription, item: Item) -> None:
        subscription.items[item.number] = item
        self._items += 1
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
            self.events.forget(item)
        subscription.forget(item)
        self._items -= 1
        self._watch(subscription.owner, item, -1)

    def _forget_all(self, subscription: Subscription) -> Iterator[None]:
        for item in list(subscription.items.values()):
            self._forget(subscription, item)
            yield

    def _current(self, item: Item) -> ua.DataValue:
        return held_attribute(self._aspace, item.wanted.NodeId, item.wanted.AttributeId)

    def _transfer(self, session: Owner, number: int) -> ua.TransferResult:
        subscription = self.by_number.get(number)
        if subscription is None or not session.is_same_client(subscription.owner):
            denied = _Codes.BadSubscriptionIdInvalid
            if subscription is not None:
                denied = _Codes.BadUserAccessDenied
            return ua.TransferResult(StatusCode=ua.StatusCode(denied))
        if subscription.owner is session:
            return ua.TransferResult(
                StatusCode=ua.StatusCode(), AvailableSequenceNumbers=subscription.available
            )
        if len(session.subscriptions) >= self._limits.subscriptions_per_session:
            code = ua.StatusCode(_Codes.BadTooManySubscriptions)
            return ua.TransferResult(StatusCode=code)
        available = subscription.available
        old = subscription.owner
        old.lose(subscription, _Codes.GoodSubscriptionTransferred)
        for item in subscription.items.values():
            self._watch(old, item, -1)
            self._watch(session, item, 1)
        subscription.give_to(session)
        session.subscriptions[number] = subscription
        return ua.TransferResult(StatusCode=ua.StatusCode(), AvailableSequenceNumbers=available)

    def _expire(self, subscription: Subscription) -> None:
        _log.info(
            "subscription %d expired: no publish request within its lifetime", subscription.number
        )
        self.end(subscription)


def _refused(code: int) -> ua.MonitoredItemCreateResult:
    return ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(code))
