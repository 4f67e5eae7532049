"""Items that monitor the events of an object (Part 4, 5.13)."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from asyncua import ua

from guarded_opcua.monitoring.event_filter import Event, EventFilter
from guarded_opcua.monitoring.parameters import Reporter

QueuedEvent = tuple[int, Sequence[ua.Variant]]  # client handle, fields


_COST_OF_FIELD_S = 20e-6
_OVERFLOW = ua.NodeId(ua.ObjectIds.EventQueueOverflowEventType)
_SERVER = ua.NodeId(ua.ObjectIds.Server)
_OVERFLOW_SEVERITY = 500


@dataclass(frozen=True)
class Listening:
    """What a client wants of an item that monitors events."""

    client_handle: int
    filter: EventFilter
    queue_size: int
    discard_oldest: bool


class EventItem:
    """Monitors the events of one object.

    What is queued are the events themselves, which all items share; an item's fields are selected
    when a message is made. Where one finds no room, an event in the queue says so
    (EventQueueOverflowEventType), once, where the lost ones would have been.

    Attributes
    ----------
    inbox
        Events that are still to be judged by the filter, and whether they pass in any case.
    """

    __slots__ = (
        "_listening",
        "_overflowed",
        "_queue",
        "_subscription",
        "callback_handle",
        "inbox",
        "links",
        "mode",
        "number",
        "wanted",
    )

    def __init__(
        self,
        subscription: Reporter,
        number: int,
        wanted: ua.ReadValueId,
        mode: ua.MonitoringMode,
        listening: Listening,
    ) -> None:
        self.number = number
        self.wanted = wanted
        self.mode = mode
        self.callback_handle = 0
        self.links: set[int] = set()
        self.inbox: deque[tuple[Event, bool]] = deque()
        self._listening = listening
        self._subscription = subscription
        self._queue: deque[tuple[int, Event]] = deque()
        self._overflowed = False

    def __len__(self) -> int:
        return len(self._queue)

    def __bool__(self) -> bool:
        return True

    @property
    def client_handle(self) -> int:
        """The client's own number of the item."""
        return self._listening.client_handle

    @property
    def filter(self) -> EventFilter:
        """Which events the client wants, and what of them."""
        return self._listening.filter

    @property
    def queue_size(self) -> int:
        """How many events it may queue."""
        return self._listening.queue_size

    @property
    def room(self) -> int:
        """How many more events fit, those that are still to be judged taken for wanted."""
        return self._listening.queue_size - len(self._queue) - len(self.inbox)

    @property
    def waiting(self) -> Iterator[tuple[int, float]]:
        """Numbers of the changes that the events came with, and what it costs to encode each, s."""
        cost = _COST_OF_FIELD_S * len(self.filter)
        return ((moment, cost) for moment, _ in self._queue)

    def modify(self, listening: Listening) -> None:
        """Listen otherwise from now on; what is queued stays."""
        self._listening = listening

    def notify(self, event: Event) -> None:
        """Queue an event."""
        if self.mode == ua.MonitoringMode.Disabled:
            return
        holding = self._subscription.holding
        if len(self._queue) - self._overflowed < self._listening.queue_size and holding.has_room():
            self._queue.append((holding.moment, event))
            holding.add(1)
        else:
            self.lose(event)
            if self._listening.discard_oldest and len(self._queue) > 1:
                del self._queue[1]
                self._queue.append((holding.moment, event))
        self._report()

    def lose(self, event: Event) -> None:
        """Let the client know that an event is lost, or an older one for it."""
        queue, holding = self._queue, self._subscription.holding
        holding.lose(1)
        if not self._overflowed:
            self._overflowed = True
            holding.add(1)
            said = _overflow(event)
            if self._listening.discard_oldest and queue:
                queue.appendleft((queue[0][0], said))
            else:
                queue.append((holding.moment, said))
        self._report()

    def set_mode(self, mode: ua.MonitoringMode) -> bool:
        """Change the mode; events have no first sample."""
        self.mode = mode
        if mode == ua.MonitoringMode.Disabled:
            self.clear()
            self._subscription.has_no_report(self.number)
        self._report()
        return False

    def take(self, most: int) -> list[QueuedEvent]:
        """Take up to ``most`` events out of the queue."""
        count = min(most, len(self._queue))
        self._subscription.holding.add(-count)
        events = [self._queue.popleft()[1] for _ in range(count)]
        self._overflowed = self._overflowed and all(event.kind != _OVERFLOW for event in events)
        return [(self.client_handle, self.filter.select(event)) for event in events]

    def clear(self) -> None:
        """Forget what is queued."""
        self._subscription.holding.add(-len(self._queue))
        self._queue.clear()
        self.inbox.clear()
        self._overflowed = False

    def _report(self) -> None:
        if self.mode == ua.MonitoringMode.Reporting and self._queue:
            self._subscription.has_report(self.number)


def _overflow(lost: Event) -> Event:
    """Say that from this event on something was lost (Part 4, 5.13.1.5)."""
    said = ua.LocalizedText("Events were lost: the queue was full.", "en")
    own = {
        "EventId": ua.Variant(b"overflow", ua.VariantType.ByteString),
        "EventType": ua.Variant(_OVERFLOW, ua.VariantType.NodeId),
        "SourceNode": ua.Variant(_SERVER, ua.VariantType.NodeId),
        "SourceName": ua.Variant("Internal/EventQueueOverflow", ua.VariantType.String),
        "Message": ua.Variant(said, ua.VariantType.LocalizedText),
        "Severity": ua.Variant(_OVERFLOW_SEVERITY, ua.VariantType.UInt16),
    }
    times = {name: lost.fields[name] for name in ("Time", "ReceiveTime") if name in lost.fields}
    return Event(lost.emitters, _OVERFLOW, {**own, **times}, lost.audience)
