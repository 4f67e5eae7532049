"""Delivery of events to the items that monitor their objects."""

from collections import deque
from collections.abc import Iterator, Sequence

from asyncua import ua

from guarded_opcua.chores import Chores
from guarded_opcua.clock import Clock
from guarded_opcua.logs import bounded_logger
from guarded_opcua.monitoring.event_item import EventItem
from guarded_opcua.monitoring.events import Event
from guarded_opcua.security.accounts import Role
from guarded_opcua.subscriptions.subscription import Subscription

_log = bounded_logger(__name__)
_MOST_STANDING = 10  # events kept for new items
_TURN_S = 0.001  # s of processor time for the filter of one item before the next item


class EventDelivery:
    """The event items of each object.

    Evaluating a where clause may cost much more than the event. Such filters are evaluated in
    slices, item by item, and charged to the sessions that own the items.
    """

    def __init__(self, chores: Chores, clock: Clock) -> None:
        self._chores = chores
        self._clock = clock
        self._listeners: dict[ua.NodeId, dict[int, tuple[Subscription, EventItem]]] = {}
        self._standing: deque[tuple[float, Event]] = deque(maxlen=_MOST_STANDING)

    def __len__(self) -> int:
        """Return the number of event items."""
        return sum(map(len, self._listeners.values()))

    def watch(self, subscription: Subscription, item: EventItem) -> None:
        """Start the delivery of an object's events to an item."""
        self._listeners.setdefault(item.wanted.NodeId, {})[item.number] = subscription, item

    def forget(self, item: EventItem) -> None:
        """Stop the delivery to an item."""
        listeners = self._listeners.get(item.wanted.NodeId, {})
        listeners.pop(item.number, None)
        if not listeners:
            self._listeners.pop(item.wanted.NodeId, None)

    def trigger(self, event: Event) -> None:
        """Deliver an event to the items of its emitters whose user may receive it."""
        for emitter in event.emitters:
            for subscription, item in self._listeners.get(emitter, {}).values():
                if subscription.owner.hears(event.audience):
                    self.offer(subscription, item, event)

    def stand(self, event: Event, for_s: float) -> None:
        """Deliver an event now, and to each item that is created within ``for_s``."""
        self._standing.append((self._clock.monotonic() + for_s, event))
        self.trigger(event)

    def welcome(self, subscription: Subscription, item: EventItem) -> None:
        """Deliver the kept events to a new item."""
        now = self._clock.monotonic()
        while self._standing and self._standing[0][0] <= now:
            self._standing.popleft()
        for _, event in self._standing:
            is_its = item.wanted.NodeId in event.emitters
            if is_its and subscription.owner.hears(event.audience):
                self.offer(subscription, item, event)

    def offer(
        self,
        subscription: Subscription,
        item: EventItem,
        event: Event,
        *,
        unfiltered: bool = False,
    ) -> None:
        """Deliver an event to one item; ``unfiltered`` events bypass the filter."""
        if item.mode == ua.MonitoringMode.Disabled:
            return
        if not item.filter.judges:
            item.notify(event)
        elif len(item.inbox) < item.queue_size:
            item.inbox.append((event, unfiltered))
            if len(item.inbox) == 1:
                self._chores.add(self._judge(subscription, item), subscription.owner.charge)
        else:
            item.lose(event)

    def has_audience(self, emitters: Sequence[ua.NodeId], role: Role) -> bool:
        """Return whether a user with that role or above monitors one of the objects."""
        return any(
            subscription.owner.hears(role)
            for emitter in emitters
            for subscription, _ in self._listeners.get(emitter, {}).values()
        )

    def _judge(self, subscription: Subscription, item: EventItem) -> Iterator[None]:
        began = self._clock.processor()
        while item.inbox and self._clock.processor() - began < _TURN_S:
            event, unfiltered = item.inbox.popleft()
            try:
                if unfiltered or item.filter.passes(event):
                    item.notify(event)
            except Exception:  # noqa: BLE001 - a bulkhead: later events and other items are served
                _log.exception("the filter of an item failed")
                item.lose(event)
            yield
        if item.inbox:  # after the other items
            self._chores.add(self._judge(subscription, item), subscription.owner.charge)
