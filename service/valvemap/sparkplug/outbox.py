"""What waits for the broker: bounded; the oldest goes where there is too much, and is counted."""

from collections import deque
from collections.abc import Iterable
from itertools import count

from valvemap.sparkplug.edge_node import Change
from valvemap.sparkplug.metrics import Tag, Value


class Outbox:
    """Changes in their order, until it is known that the broker has them.

    MQTT says nothing of messages of QoS 0, which Sparkplug demands. So what was taken stays here
    until it is confirmed; after a break it is put back, and sent again.

    Parameters
    ----------
    most
        So many may wait, those that were taken among them.

    Attributes
    ----------
    lost : int
        How many found no room.
    newest : int
        Number of the last change that was put in; they begin with 1.

    Examples
    --------
    >>> from valvemap.sparkplug.schema import DataType
    >>> tag = Tag("V1.RLS.Residual", "V1", "RLS/Residual", DataType.DOUBLE, alias=1)
    >>> outbox = Outbox(most=2)
    >>> for x in (1.0, 2.0, 3.0):
    ...     outbox.put(tag, Value(x, 0, 0))
    >>> outbox.lost, [change.value.value for change in outbox.take(9)]
    (1, [2.0, 3.0])
    """

    def __init__(self, most: int) -> None:
        self.lost = 0
        self.newest = 0
        self._most = most
        self._numbers = count(1)
        self._waiting: deque[Change] = deque()
        self._taken: list[Change] = []

    def __len__(self) -> int:
        return len(self._waiting) + len(self._taken)

    def put(self, tag: Tag, value: Value) -> None:
        """Add a change."""
        self.newest = next(self._numbers)
        self._waiting.append(Change(tag, value, self.newest))
        self._make_room()

    def take(self, most: int) -> list[Change]:
        """The oldest, to be sent; :meth:`confirm` or :meth:`put_back` says what became of them."""
        some = [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]
        self._taken += some
        return some

    def confirm(self) -> None:
        """The broker has all that was taken."""
        self._taken.clear()

    def put_back(self) -> None:
        """Nobody knows what the broker has of it."""
        self._waiting.extendleft(reversed(self._taken))
        self._taken.clear()
        self._make_room()

    def keep_only(self, tags: Iterable[Tag]) -> None:
        """Give up what waits of metrics that are there no more."""
        there = set(tags)
        kept = [change for change in self._waiting if change.tag in there]
        self.lost += len(self._waiting) - len(kept)
        self._waiting = deque(kept)

    def _make_room(self) -> None:
        while len(self) > self._most and self._waiting:
            self._waiting.popleft()
            self.lost += 1
