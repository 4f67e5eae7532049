"""Bounded queue of changes to publish; on overflow, the oldest are dropped and counted."""

from collections import deque
from collections.abc import Iterable
from itertools import count

from valvemap.sparkplug.edge_node import Change
from valvemap.sparkplug.metrics import Tag, Value


class Outbox:
    """Changes in order, kept until the broker has confirmed them.

    Sparkplug demands QoS 0, which MQTT does not acknowledge. Changes taken therefore stay in the
    queue until :meth:`confirm`; after a loss of the connection, :meth:`put_back` requeues them.

    Parameters
    ----------
    most
        Capacity, unconfirmed changes included.

    Attributes
    ----------
    lost : int
        Number of changes dropped.
    newest : int
        Number of the last change added; the first is 1.

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
        """Take the oldest changes, to be followed by :meth:`confirm` or :meth:`put_back`."""
        some = [self._waiting.popleft() for _ in range(min(most, len(self._waiting)))]
        self._taken += some
        return some

    def confirm(self) -> None:
        """Remove the changes taken: the broker has received them."""
        self._taken.clear()

    def put_back(self) -> None:
        """Requeue the changes taken: the broker may not have received them."""
        self._waiting.extendleft(reversed(self._taken))
        self._taken.clear()
        self._make_room()

    def keep_only(self, tags: Iterable[Tag]) -> None:
        """Drop the changes of all other metrics."""
        there = set(tags)
        kept = [change for change in self._waiting if change.tag in there]
        self.lost += len(self._waiting) - len(kept)
        self._waiting = deque(kept)

    def _make_room(self) -> None:
        while len(self) > self._most and self._waiting:
            self._waiting.popleft()
            self.lost += 1
