"""The queues of many monitored items, as one log of arrays.

Each notification has a number within its item, and an item's queue is the range ``head`` to
``tail`` of these numbers. The log stores the notifications of all items in order of arrival.
Discarding the oldest increments ``head``; taking removes the front of the log. All operations are
vectorised, and none reads further than it takes.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from guarded_opcua.address_space.batches import Batch, Bools, Codes, Ticks, Values
from guarded_opcua.monitoring.parameters import OVERFLOW

Slots = NDArray[np.intp]
Counts = NDArray[np.int64]
_PIECE = 16_384  # notifications; maximum length of an array in the log
_SPARE = 4_096  # discarded notifications kept before the log is compacted


@dataclass(frozen=True)
class Notifications:
    """N notifications in order: all arrays of length N.

    ``slot`` of the item, ``number`` within the item, ``moment`` of the change; the other fields are
    the reported values (see ``Batch``).
    """

    slot: Slots
    number: Counts
    moment: Counts
    values: Values
    codes: Codes
    has: NDArray[np.bool_]
    source: Ticks
    server: Ticks

    def __len__(self) -> int:
        return len(self.slot)

    def __getitem__(self, rows: slice | NDArray[Any]) -> Self:
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Concatenate notifications."""
        if len(parts) == 1:
            return parts[0]
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class BlockQueue:
    """Queues by slot; slots are added with :meth:`grow`."""

    def __init__(self) -> None:
        self.head = np.zeros(0, np.int64)
        self.tail = np.zeros(0, np.int64)
        self._flagged = np.zeros(0, np.int64)  # number of the notification with the overflow bit
        self._log: deque[Notifications] = deque()
        self._logged = 0
        self._live = 0

    def __len__(self) -> int:
        return self._live

    def length(self, slot: int) -> int:
        """Return the number of notifications in a queue."""
        return int(self.tail[slot] - self.head[slot])

    def grow(self, slots: int) -> None:
        """Grow to this number of slots."""
        more = slots - len(self.head)
        self.head = np.append(self.head, np.zeros(more, np.int64))
        self.tail = np.append(self.tail, np.zeros(more, np.int64))
        self._flagged = np.append(self._flagged, np.full(more, -1, np.int64))

    def append(self, new: Notifications) -> None:
        """Append notifications."""
        self._log.extend(new[i : i + _PIECE] for i in range(0, len(new), _PIECE))
        self._logged += len(new)
        self._live += len(new)
        if self._logged > _SPARE and self._logged > 2 * (self._live + len(new)):
            self._tidy()

    def discard(self, slots: Slots) -> None:
        """Discard the oldest notification of each of these queues."""
        self.head[slots] += 1
        self._live -= len(slots)

    def flag(self, slots: Slots) -> None:
        """Set the overflow bit of the oldest notification of each queue."""
        self._flagged[slots] = self.head[slots]

    def drop(self, slot: int, count: int) -> None:
        """Discard the oldest notifications of a queue."""
        self.head[slot] += count
        self._live -= count

    def clear(self, slot: int) -> None:
        """Empty a queue."""
        self.drop(slot, self.length(slot))

    def front(self, most: int) -> Notifications | None:
        """Return the next notifications, up to ``most``, without removing them."""
        parts: list[Notifications] = []
        for part in self._log:
            if most <= 0:
                break
            if self._live == self._logged:
                found = part[:most]
            else:
                found = part[np.flatnonzero(self._alive(part))[:most]]
            if len(found):
                parts.append(found)
            most -= len(found)
        return Notifications.joined(parts) if parts else None

    def take(self, front: Notifications) -> Notifications:
        """Remove (the beginning of) the front."""
        all_alive = self._live == self._logged
        self.head[front.slot] = front.number + 1  # with repeated slots the last assignment holds
        self._live -= len(front)
        left = len(front)
        while self._log and (left > 0 or not all_alive):
            first = self._log[0]
            if all_alive:
                start = min(left, len(first))
            else:
                alive = self._alive(first)
                start = int(np.argmax(alive)) if alive.any() else len(first)
            left -= start
            self._logged -= start
            if start < len(first):
                self._log[0] = first[start:]
                break
            self._log.popleft()
        return self._flagging(front)

    def take_all_of(self, slot: int) -> Notifications | None:
        """Remove and return one queue, None if it is empty."""
        parts = [part[(part.slot == slot) & self._alive(part)] for part in self._log]
        parts = [part for part in parts if len(part)]
        self.clear(slot)
        return self._flagging(Notifications.joined(parts)) if parts else None

    def _flagging(self, taken: Notifications) -> Notifications:
        flagged = self._flagged[taken.slot] == taken.number
        if not flagged.any():
            return taken
        return replace(
            taken, codes=np.where(flagged, taken.codes | np.uint32(OVERFLOW), taken.codes)
        )

    def _alive(self, part: Notifications) -> NDArray[np.bool_]:
        return np.asarray(part.number >= self.head[part.slot])

    def _tidy(self) -> None:
        left = [part[self._alive(part)] for part in self._log]
        self._log = deque(part for part in left if len(part))
        self._logged = self._live


def notifications(
    batch: Batch, slots: Slots, pushed: Bools, numbers: Counts, moments: Counts
) -> Notifications:
    """Return those samples of a batch that were pushed, (k, slots), with number and moment."""
    everything = bool(pushed.all())

    def flat(array: NDArray[Any]) -> NDArray[Any]:
        return array.reshape(pushed.size, *array.shape[2:]) if everything else array[pushed]

    slot = flat(np.broadcast_to(slots, pushed.shape))
    return Notifications(
        slot,
        flat(numbers),
        flat(moments),
        flat(batch.values),
        flat(batch.codes),
        flat(batch.has),
        flat(batch.source),
        np.full(len(slot), batch.server),
    )
