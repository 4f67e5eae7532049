"""What all queues of notifications hold and lose, and whose room it is."""

from dataclasses import dataclass


@dataclass
class Ledger:
    """What all queues hold and have lost, and among how many sessions the room is shared.

    ``moment`` counts changes, so that what changed first is published first.
    """

    capacity: int
    queued: int = 0
    lost: int = 0
    sessions: int = 1
    moment: int = 0


class Holding:
    """What the queues of one session hold.

    While there is room, anybody may queue; once there is none, only who holds less than his share
    of it, so that a greedy session loses its own notifications and nobody else's.
    """

    def __init__(self, ledger: Ledger) -> None:
        self.queued = 0
        self._ledger = ledger

    @property
    def moment(self) -> int:
        """Number of the change that is being reported."""
        return self._ledger.moment

    def next_moment(self) -> int:
        """Begin with what is reported without a change, and return its number."""
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
        """Count what was queued, or taken out."""
        self.queued += count
        self._ledger.queued += count

    def lose(self, count: int) -> None:
        """Count what was discarded."""
        self._ledger.lost += count
