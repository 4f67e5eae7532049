"""ConditionRefresh: events of all retained conditions for one subscription (Part 9, 4.5)."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from guarded_opcua.clock import Clock
from guarded_opcua.conditions.keeper import ConditionKeeper
from guarded_opcua.monitoring.event_item import EventItem
from guarded_opcua.monitoring.events import Event
from guarded_opcua.subscriptions.registry import Subscriptions
from guarded_opcua.subscriptions.subscription import Subscription

_STEPS_AT_ONCE = 16  # events before other refreshes continue
_NO_ROOM_S = 0.05  # s; retry interval while the queue is full
_PATIENCE_S = 10.0  # s; then remaining events overflow the queue of a client that does not read


class Refresh:
    """Queues the retained conditions in slices, charged to the client, as its queue has room.

    Parameters
    ----------
    items
        Event items of the subscription that receive the refresh.
    marks
        RefreshStart and RefreshEnd events, which bypass the filter.
    """

    def __init__(
        self,
        subscriptions: Subscriptions,
        subscription: Subscription,
        items: Sequence[EventItem],
        marks: tuple[Event, Event],
        keeper: ConditionKeeper,
        clock: Clock,
    ) -> None:
        self._subscriptions = subscriptions
        self._subscription = subscription
        self._items = items
        self._clock = clock
        self._groups = _groups(marks, keeper)
        self._pending: deque[tuple[EventItem, Event, bool]] = deque()
        self._waited_s = 0.0
        self._ended: Callable[[], None]

    def begin(self, ended: Callable[[], None]) -> None:
        """Start the refresh; ``ended`` is called at its end."""
        self._ended = ended
        self._go_on()

    def _go_on(self) -> None:
        self._subscriptions.chores.add(self._steps(), self._subscription.owner.charge)

    def _steps(self) -> Iterator[None]:
        for _ in range(_STEPS_AT_ONCE):
            if not self._pending and not self._next_group():
                self._ended()
                return
            if self._pending and not self._offer_one():
                self._waited_s += _NO_ROOM_S
                self._clock.call_at(self._clock.monotonic() + _NO_ROOM_S, self._go_on)
                return
            yield
        self._go_on()

    def _next_group(self) -> bool:
        group = next(self._groups, None)
        for event, unfiltered in group or ():
            self._pending.extend(
                (item, event, unfiltered)
                for item in self._items
                if unfiltered or item.wanted.NodeId in event.emitters
            )
        return group is not None

    def _offer_one(self) -> bool:
        """Deliver the next event; return False if the queue is full."""
        item, event, unfiltered = self._pending[0]
        if self._is_there(item):
            if item.room <= 0 and self._waited_s < _PATIENCE_S:
                return False
            if item.room > 0:
                self._waited_s = 0.0
            self._subscriptions.events.offer(self._subscription, item, event, unfiltered=unfiltered)
        self._pending.popleft()
        return True

    def _is_there(self, item: EventItem) -> bool:
        number = self._subscription.number
        is_known = self._subscriptions.by_number.get(number) is self._subscription
        return is_known and self._subscription.items.get(item.number) is item


def _groups(
    marks: tuple[Event, Event], keeper: ConditionKeeper
) -> Iterator[list[tuple[Event, bool]]]:
    """Yield the events in order, in groups, each with whether it bypasses the filter."""
    begin, end = marks
    yield [(begin, True)]
    for some in keeper.retained():
        yield [(condition.event(), False) for condition in some]
    yield [(end, True)]
