"""Items that monitor the events of an object (Part 4, 5.13)."""

from collections import deque
from collections.abc import Iterator, Sequence

from asyncua import ua

from service.hardened.monitoring.parameters import Reporter

QueuedEvent = tuple[int, Sequence[ua.Variant]]  # client handle, fields


_COST_OF_FIELD_S = 20e-6


class EventItem:
    """Monitors the events of one object."""

    __slots__ = (
        "_queue",
        "_subscription",
        "callback_handle",
        "client_handle",
        "discard_oldest",
        "links",
        "mode",
        "number",
        "queue_size",
        "wanted",
    )

    def __init__(
        self,
        subscription: Reporter,
        number: int,
        wanted: ua.ReadValueId,
        mode: ua.MonitoringMode,
        client_handle: int,
        queue_size: int,
        *,
        discard_oldest: bool,
    ) -> None:
        self.number = number
        self.wanted = wanted
        self.mode = mode
        self.client_handle = client_handle
        self.queue_size = queue_size
        self.discard_oldest = discard_oldest
        self.callback_handle = 0
        self.links: set[int] = set()
        self._subscription = subscription
        self._queue: deque[tuple[int, Sequence[ua.Variant]]] = deque()

    def __len__(self) -> int:
        return len(self._queue)

    def __bool__(self) -> bool:
        return True

    @property
    def waiting(self) -> Iterator[tuple[int, float]]:
        """Numbers of the changes that the events came with, and what it costs to encode each, s."""
        return ((moment, _COST_OF_FIELD_S * len(fields)) for moment, fields in self._queue)

    def notify(self, event_fields: Sequence[ua.Variant]) -> None:
        """Queue an event."""
        if self.mode == ua.MonitoringMode.Disabled:
            return
        new = (self._subscription.holding.moment, event_fields)
        if len(self._queue) < self.queue_size and self._subscription.holding.has_room():
            self._queue.append(new)
            self._subscription.holding.add(1)
        else:
            self._subscription.holding.lose(1)
            if self.discard_oldest and self._queue:
                self._queue.popleft()
                self._queue.append(new)
        if self.mode == ua.MonitoringMode.Reporting and self._queue:
            self._subscription.has_report(self.number)

    def set_mode(self, mode: ua.MonitoringMode) -> bool:
        """Change the mode; events have no first sample."""
        self.mode = mode
        if mode == ua.MonitoringMode.Disabled:
            self.clear()
            self._subscription.has_no_report(self.number)
        elif mode == ua.MonitoringMode.Reporting and self._queue:
            self._subscription.has_report(self.number)
        return False

    def take(self, most: int) -> list[QueuedEvent]:
        """Take up to ``most`` events out of the queue."""
        count = min(most, len(self._queue))
        self._subscription.holding.add(-count)
        return [(self.client_handle, self._queue.popleft()[1]) for _ in range(count)]

    def clear(self) -> None:
        """Forget what is queued."""
        self._subscription.holding.add(-len(self._queue))
        self._queue.clear()
