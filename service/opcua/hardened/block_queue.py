"""The queues of many monitored items, as one log of arrays.

Every notification gets a number within its item. An item's queue is the range ``head`` to ``tail``
of these numbers, and the log keeps notifications of all items in the order they came. To discard
the oldest is to move ``head``; to replace the newest is to write its number once more; to take is
to put each into its place, counted from ``head``. None of it looks at a notification by itself.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.opcua.hardened.blocks import Codes, Ticks, Values
from service.opcua.hardened.monitored_item import OVERFLOW

Slots = NDArray[np.intp]
Counts = NDArray[np.int64]
_SPARE = 4_096  # superseded notifications that are no reason to tidy up


@dataclass(frozen=True)
class Notifications:
    """N notifications: whose, the number within that item's, and what is told (see ``Batch``)."""

    slot: Slots
    number: Counts
    values: Values
    codes: Codes
    has: NDArray[np.bool_]
    source: Ticks
    server: Ticks

    def __len__(self) -> int:
        return len(self.slot)


class BlockQueue:
    """Queues by slot; slots are added with :meth:`grow`."""

    def __init__(self, width: int, dtype: np.dtype[Any]) -> None:
        self.head = np.zeros(0, np.int64)
        self.tail = np.zeros(0, np.int64)
        self._flagged = np.zeros(0, np.int64)  # number of the one that tells of an overflow
        self._log: list[Notifications] = []
        self._logged = 0
        self._width, self._dtype = width, dtype

    @property
    def lengths(self) -> Counts:
        """How many notifications each queue holds, shape (slots,)."""
        return np.asarray(self.tail - self.head)

    def length(self, slot: int) -> int:
        """Return how many notifications a queue holds."""
        return int(self.tail[slot] - self.head[slot])

    def grow(self, slots: int) -> None:
        """Have room for so many slots."""
        more = slots - len(self.head)
        self.head = np.append(self.head, np.zeros(more, np.int64))
        self.tail = np.append(self.tail, np.zeros(more, np.int64))
        self._flagged = np.append(self._flagged, np.full(more, -1, np.int64))

    def append(self, new: Notifications) -> None:
        """Put notifications in, under the numbers they have; the last one of a number counts."""
        self._log.append(new)
        self._logged += len(new)
        if self._logged > _SPARE and self._logged > 2 * int(self.lengths.sum()) + len(new):
            self._tidy()

    def flag(self, slots: Slots) -> None:
        """Let the oldest of each queue tell that others are lost."""
        self._flagged[slots] = self.head[slots]

    def unflag(self, slots: Slots) -> None:
        """Let nothing be told of losses: the newest value is all that is wanted."""
        self._flagged[slots] = -1

    def drop_oldest(self, slot: int, count: int) -> None:
        """Drop the oldest ones of a queue."""
        self.head[slot] += count

    def drop_newest(self, slot: int, count: int) -> None:
        """Drop the newest ones of a queue."""
        self.tail[slot] -= count

    def clear(self, slot: int) -> None:
        """Empty a queue."""
        self.head[slot] = self.tail[slot]
        self._flagged[slot] = -1

    def take(self, slots: Slots, counts: Counts) -> Notifications:
        """Take the oldest ``counts`` of each of ``slots``, one item after the other."""
        taken = self._gathered(slots, counts)
        flagged = self._flagged[slots] - self.head[slots]
        told = (flagged >= 0) & (flagged < counts)
        if told.any():
            places = (np.cumsum(counts) - counts + flagged)[told]
            taken.codes[places] |= np.uint32(OVERFLOW)
        self.head[slots] += counts
        if not self.lengths.any():
            self._log.clear()
            self._logged = 0
        return taken

    def _tidy(self) -> None:
        slots = np.flatnonzero(self.lengths)
        self._log = [self._gathered(slots, self.lengths[slots])]
        self._logged = len(self._log[0])

    def _gathered(self, slots: Slots, counts: Counts) -> Notifications:
        most = np.zeros(len(self.head), np.int64)
        most[slots] = counts
        shift = np.zeros(len(self.head), np.int64)
        shift[slots] = np.cumsum(counts) - counts - self.head[slots]
        total = int(counts.sum())
        found = Notifications(
            np.repeat(slots, counts),
            np.arange(total) - np.repeat(shift[slots], counts),
            np.empty((total, self._width), self._dtype),
            np.empty(total, np.uint32),
            np.empty(total, np.bool_),
            np.empty(total, np.int64),
            np.empty(total, np.int64),
        )
        for part in self._log:
            place = part.number - self.head[part.slot]
            inside = (place >= 0) & (place < most[part.slot])
            here: slice | NDArray[np.bool_] = slice(None) if inside.all() else inside
            at = (part.number + shift[part.slot])[here]
            # of a number that comes twice numpy keeps the last
            found.values[at] = part.values[here]
            found.codes[at] = part.codes[here]
            found.has[at] = part.has[here]
            found.source[at] = part.source[here]
            found.server[at] = part.server[here]
        return found
