"""Items that monitor the events of an object (Part 4, 5.13)."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from asyncua import ua

from guarded_opcua.monitoring.event_filter import EventFilter
from guarded_opcua.monitoring.events import Event
from guarded_opcua.monitoring.parameters import Reporter

QueuedEvent = tuple[int, Sequence[ua.Variant]]  # client handle, fields


_COST_OF_FIELD_S = 20e-6
_OVERFLOW = ua.NodeId(ua.ObjectIds.EventQueueOverflowEventType)
_SERVER = ua.NodeId(ua.ObjectIds.Server)
_OVERFLOW_SEVERITY = 500


@dataclass(frozen=True)
class Listening:
    """Revised parameters of an event item."""

    client_handle: int
    filter: EventFilter
    queue_size: int
    discard_oldest: bool


class EventItem:
    """Monitors the events of one object.

    The queue holds references to events shared by all items; the fields are selected when a message
    is encoded. On overflow, one EventQueueOverflowEventType event is queued in place of the lost
    ones.

    Attributes
    ----------
    inbox
        Events to be filtered, and whether each bypasses the filter.
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
        """ClientHandle, the client's number of the item."""
        return self._listening.client_handle

    @property
    def filter(self) -> EventFilter:
        """The EventFilter."""
        return self._listening.filter

    @property
    def queue_size(self) -> int:
        """Maximum number of queued events."""
        return self._listening.queue_size

    @property
    def room(self) -> int:
        """Free places in the queue, with the events in the inbox counted as queued."""
        return self._listening.queue_size - len(self._queue) - len(self.inbox)

    @property
    def waiting(self) -> Iterator[tuple[int, float]]:
        """Moments of the queued events, and the cost of encoding each, s."""
        cost = _COST_OF_FIELD_S * len(self.filter)
        return ((moment, cost) for moment, _ in self._queue)

    def modify(self, listening: Listening) -> None:
        """Set new parameters; the queue is kept."""
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
        """Count a lost event, and queue an overflow event unless one is queued."""
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
        """Remove up to ``most`` events of the queue; return their selected fields."""
        count = min(most, len(self._queue))
        self._subscription.holding.add(-count)
        events = [self._queue.popleft()[1] for _ in range(count)]
        self._overflowed = self._overflowed and all(event.kind != _OVERFLOW for event in events)
        return [(self.client_handle, self.filter.select(event)) for event in events]

    def clear(self) -> None:
        """Empty the queue and the inbox."""
        self._subscription.holding.add(-len(self._queue))
        self._queue.clear()
        self.inbox.clear()
        self._overflowed = False

    def _report(self) -> None:
        if self.mode == ua.MonitoringMode.Reporting and self._queue:
            self._subscription.has_report(self.number)


def _overflow(lost: Event) -> Event:
    """Return an overflow event with the time of the first lost event (Part 4, 5.13.1.5)."""
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
