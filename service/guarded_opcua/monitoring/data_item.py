"""Items that monitor an attribute: sampling, queue, overflow (Part 4, 5.13)."""

import dataclasses
from collections import deque
from collections.abc import Generator, Iterable, Iterator

from asyncua import ua

from guarded_opcua.binary.encoding import encode_or_refuse, encoding_cost
from guarded_opcua.binary.index_range import Ranges, select
from guarded_opcua.monitoring.parameters import OVERFLOW, Monitoring, Queued, Reporter


class _Done:
    """An awaitable that is done: asyncua awaits its callbacks, but this one is synchronous."""

    def __await__(self) -> Generator[None, None, None]:
        yield from ()


_DONE = _Done()


class DataItem:
    """Monitors one attribute of one node."""

    __slots__ = (
        "_due",
        "_loss_before_first",
        "_pending",
        "_queue",
        "_reported",
        "_subscription",
        "callback_handle",
        "links",
        "mode",
        "monitoring",
        "number",
        "ranges",
        "wanted",
    )

    def __init__(
        self,
        subscription: Reporter,
        number: int,
        wanted: ua.ReadValueId,
        mode: ua.MonitoringMode,
        monitoring: Monitoring,
        ranges: Ranges | None,
    ) -> None:
        self.number = number
        self.wanted = wanted
        self.mode = mode
        self.monitoring = monitoring
        self.ranges = ranges
        self.callback_handle = 0
        self.links: set[int] = set()
        self._subscription = subscription
        self._queue: deque[Queued] = deque()
        self._reported: ua.DataValue | None = None
        self._pending: ua.DataValue | None = None
        self._due = 0.0
        self._loss_before_first = False  # the overflow bit of the first is set when it is taken

    def __len__(self) -> int:
        return len(self._queue)

    def __bool__(self) -> bool:
        return True

    @property
    def client_handle(self) -> int:
        """ClientHandle, the client's number of the item."""
        return self.monitoring.client_handle

    def __call__(
        self, _handle: int, value: ua.DataValue | None, error: ua.StatusCode | None = None
    ) -> _Done:
        """Process a change (asyncua's callback)."""
        if self.mode != ua.MonitoringMode.Disabled:
            self._sample(ua.DataValue(StatusCode=error) if value is None else value)
        return _DONE

    @property
    def waiting(self) -> Iterator[tuple[int, float]]:
        """Moments of the queued changes, and the cost of encoding each, s."""
        return ((moment, encoding_cost(value)) for moment, value in self._queue)

    def start(self, value: ua.DataValue) -> None:
        """Sample for the first time, or again after the item was disabled."""
        self._subscription.holding.next_moment()
        self._due = 0.0
        self._reported = None
        self._sample(value)

    def repeat(self, value: ua.DataValue) -> None:
        """Report the value again unless one is queued (for ResendData or a new owner)."""
        if self.mode != ua.MonitoringMode.Disabled and not self._queue:
            self.start(value)

    def sample_pending(self, now: float) -> bool:
        """Sample the held value if its sampling time has come; return whether it is still held."""
        if self._pending is None:
            return False
        if now < self._due:
            return True
        value, self._pending = self._pending, None
        self._sample(value)
        return False

    def set_mode(self, mode: ua.MonitoringMode) -> bool:
        """Change the mode; return whether a first sample is due."""
        was_disabled = self.mode == ua.MonitoringMode.Disabled
        self.mode = mode
        if mode == ua.MonitoringMode.Disabled:
            self.clear()
            self._subscription.has_no_report(self.number)
            return False
        if mode == ua.MonitoringMode.Reporting and self._queue:
            self._subscription.has_report(self.number)
        return was_disabled

    def modify(self, monitoring: Monitoring) -> None:
        """Set new parameters; notifications in excess of a shorter queue are lost."""
        self.monitoring = monitoring
        while len(self._queue) > monitoring.queue_size:
            if monitoring.discard_oldest:
                self._queue.popleft()
                self._loss_before_first = False
            else:
                self._queue.pop()
            self._subscription.holding.add(-1)
            self._subscription.holding.lose(1)

    def take(self, most: int) -> list[bytes]:
        """Remove and encode up to ``most`` notifications of the queue."""
        monitoring, queue = self.monitoring, self._queue
        handle = monitoring.client_handle.to_bytes(4, "little")
        stamps = monitoring.stamps
        count = min(most, len(queue))
        self._subscription.holding.add(-count)
        if self._loss_before_first and count:
            queue[0] = _overflown(queue[0])
            self._loss_before_first = False
        return [handle + encode_or_refuse(queue.popleft()[1], stamps) for _ in range(count)]

    def adopt(self, queue: Iterable[Queued], reported: ua.DataValue | None) -> None:
        """Adopt the queue and last report of a block item; they are already in the counters."""
        self._queue.extend(queue)
        self._reported = reported

    def clear(self) -> None:
        """Empty the queue."""
        self._subscription.holding.add(-len(self._queue))
        self._queue.clear()
        self._pending = None
        self._loss_before_first = False

    def _sample(self, value: ua.DataValue) -> None:
        interval = self.monitoring.interval_s
        if interval > 0.0:
            now = self._subscription.clock.monotonic()
            if self._pending is not None and now >= self._due:
                self._report(self._pending)
                self._due += interval
            if now < self._due:
                self._pending = value
                self._subscription.has_pending(self.number)
                return
            # Sampling times lie on a grid, so that jitter drops no sample of a signal with this
            # rate. All items with one interval share the grid, so that values of one moment stay
            # together.
            self._due = (now // interval + 1.0) * interval
        self._pending = None
        self._report(value)

    def _report(self, value: ua.DataValue) -> None:
        if self.ranges is not None:
            value = _cut(value, self.ranges)
        if self.monitoring.rule.is_change(self._reported, value):
            self._reported = value
            self._push(value)

    def _push(self, value: ua.DataValue) -> None:
        queue, holding, size = self._queue, self._subscription.holding, self.monitoring.queue_size
        new = (holding.moment, value)
        if len(queue) < size and (holding.has_room() or not queue):
            queue.append(new)
            holding.add(1)
        elif len(queue) == 1 == size:
            queue[0] = new  # a queue of size 1 holds the newest value, without overflow bit
            self._loss_before_first = False
        elif self.monitoring.discard_oldest:
            holding.lose(1)
            queue.popleft()
            queue.append(new)
            self._loss_before_first = True
        else:
            holding.lose(1)
            queue[-1] = _overflown(new)
        if self.mode == ua.MonitoringMode.Reporting:
            self._subscription.has_report(self.number)
        if self.links:
            self._subscription.trigger(self.number)


def _cut(value: ua.DataValue, ranges: Ranges) -> ua.DataValue:
    if value.StatusCode is not None and value.StatusCode.is_bad():
        return value
    piece = select(value.Value, ranges)
    if piece is None:
        code = ua.StatusCode(ua.StatusCodes.BadIndexRangeNoData)
        return dataclasses.replace(value, Value=ua.Variant(), StatusCode=code)
    return dataclasses.replace(value, Value=piece)


def _overflown(queued: Queued) -> Queued:
    moment, value = queued
    code = value.StatusCode.value if value.StatusCode is not None else 0
    flagged = dataclasses.replace(value, StatusCode=ua.StatusCode(code | OVERFLOW))
    return moment, flagged
