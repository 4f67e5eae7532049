"""Events, made once, handed to the items that monitor the objects they come from."""

from collections import deque
from collections.abc import Iterator, Sequence

from asyncua import ua

from guarded_opcua.chores import Chores
from guarded_opcua.clock import Clock
from guarded_opcua.logs import bounded_logger
from guarded_opcua.monitoring.event_filter import Event
from guarded_opcua.monitoring.event_item import EventItem
from guarded_opcua.security.users import Role
from guarded_opcua.subscriptions.subscription import Subscription

_log = bounded_logger(__name__)
_MOST_STANDING = 10  # events that newcomers still hear
_TURN_S = 0.001  # processor time for the events of one item, before other items' are judged


class EventDelivery:
    """Who listens to which object.

    A filter may cost much more than the event: those that leave events out are asked in slices, on
    the account of whose they are, one item after the other.
    """

    def __init__(self, chores: Chores, clock: Clock) -> None:
        self._chores = chores
        self._clock = clock
        self._listeners: dict[ua.NodeId, dict[int, tuple[Subscription, EventItem]]] = {}
        self._standing: deque[tuple[float, Event]] = deque(maxlen=_MOST_STANDING)

    def __len__(self) -> int:
        """How many items listen."""
        return sum(map(len, self._listeners.values()))

    def watch(self, subscription: Subscription, item: EventItem) -> None:
        """Hand an item the events of its object from now on."""
        self._listeners.setdefault(item.wanted.NodeId, {})[item.number] = subscription, item

    def forget(self, item: EventItem) -> None:
        """Hand it no more."""
        listeners = self._listeners.get(item.wanted.NodeId, {})
        listeners.pop(item.number, None)
        if not listeners:
            self._listeners.pop(item.wanted.NodeId, None)

    def trigger(self, event: Event) -> None:
        """Hand an event to those who listen, if their user may hear of it."""
        for emitter in event.emitters:
            for subscription, item in self._listeners.get(emitter, {}).values():
                if subscription.owner.hears(event.audience):
                    self.offer(subscription, item, event)

    def stand(self, event: Event, for_s: float) -> None:
        """Hand an event to those who listen, and for so long to those who begin to."""
        self._standing.append((self._clock.monotonic() + for_s, event))
        self.trigger(event)

    def welcome(self, subscription: Subscription, item: EventItem) -> None:
        """Hand an item that begins to listen what still stands."""
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
        """Hand an event to one item; ``unfiltered`` ones pass whatever the filter says."""
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
        """Whether anybody of that role listens to any of some objects."""
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
            except Exception:  # noqa: BLE001 - a bulkhead: later events are judged, other items served
                _log.exception("the filter of an item failed")
                item.lose(event)
            yield
        if item.inbox:  # the others' turn
            self._chores.add(self._judge(subscription, item), subscription.owner.charge)
