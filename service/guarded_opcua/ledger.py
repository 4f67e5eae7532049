"""Counters and shared capacity of all notification queues."""

from dataclasses import dataclass


@dataclass
class Ledger:
    """Notifications queued and lost in all queues, and the number of sessions sharing the capacity.

    ``moment`` numbers the changes; notifications are published in this order.
    """

    capacity: int
    queued: int = 0
    lost: int = 0
    sessions: int = 1
    moment: int = 0


class Holding:
    """The notifications in the queues of one session.

    While the shared capacity is not exhausted, every session may queue. Once it is, only sessions
    below their equal share may, so that a session with large queues loses only its own
    notifications.
    """

    def __init__(self, ledger: Ledger) -> None:
        self.queued = 0
        self._ledger = ledger

    @property
    def moment(self) -> int:
        """Number of the change that is being reported."""
        return self._ledger.moment

    def next_moment(self) -> int:
        """Return a new moment, for values that are reported without a change."""
        self._ledger.moment += 1
        return self._ledger.moment

    def has_room(self) -> bool:
        """Whether one more notification fits."""
        return self._ledger.queued < self._ledger.capacity or self.room() > 0

    def room(self) -> int:
        """Return how many more notifications fit."""
        ledger = self._ledger
        share = -(-ledger.capacity // ledger.sessions)
        return max(ledger.capacity - ledger.queued, share - self.queued)

    def add(self, count: int) -> None:
        """Add to the number of queued notifications; negative when they are removed."""
        self.queued += count
        self._ledger.queued += count

    def lose(self, count: int) -> None:
        """Add to the number of lost notifications."""
        self._ledger.lost += count
