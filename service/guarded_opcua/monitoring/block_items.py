"""The monitored items of one subscription on one block, served as arrays (Part 4, 5.13).

The rules are those of ``data_item``; the tests compare both byte by byte. Items with a sampling
interval, a queue that discards the newest, triggering links or mode Sampling are served by
``data_item``: see :func:`serves`.
"""

import numpy as np
from asyncua import ua

from guarded_opcua.address_space.batches import Batch, Bools
from guarded_opcua.address_space.blocks import Block
from guarded_opcua.binary.records import Form, encode_records
from guarded_opcua.monitoring.block_changes import BlockChanges, grown
from guarded_opcua.monitoring.block_queue import (
    BlockQueue,
    Counts,
    Notifications,
    Slots,
    notifications,
)
from guarded_opcua.monitoring.parameters import Monitoring, Queued, Reporter

_FEWEST = 50  # variables; smaller blocks are faster item by item
_Mode = ua.MonitoringMode
_Order = tuple[Slots, Slots]  # slots in use, ordered by column, and these columns


def serves(block: Block, monitoring: Monitoring) -> bool:
    """Return whether block items support these parameters."""
    exact = monitoring.rule.deadband == 0.0 or block.dtype == np.float64
    simple = monitoring.interval_s == 0.0 and monitoring.discard_oldest
    return simple and exact and len(block) >= _FEWEST


class BlockItem:
    """Monitors the value of one variable of a block."""

    __slots__ = ("links", "monitoring", "number", "of", "slot", "wanted")

    def __init__(
        self,
        of: "BlockItems",
        slot: int,
        number: int,
        wanted: ua.ReadValueId,
        monitoring: Monitoring,
    ) -> None:
        self.of = of
        self.slot = slot
        self.number = number
        self.wanted = wanted
        self.monitoring = monitoring
        self.links: set[int] = set()  # always empty: items with links are data items

    def __len__(self) -> int:
        return self.of.queue.length(self.slot)

    def __bool__(self) -> bool:
        return True

    @property
    def client_handle(self) -> int:
        """ClientHandle, the client's number of the item."""
        return self.monitoring.client_handle

    @property
    def mode(self) -> ua.MonitoringMode:
        """The monitoring mode."""
        return _Mode(int(self.of.modes[self.slot]))

    def start(self, _: ua.DataValue | None = None) -> None:
        """Sample for the first time, or again after the item was disabled."""
        self.of.start(self.slot)

    def repeat(self, _: ua.DataValue | None = None) -> None:
        """Report the value again unless one is queued (for ResendData or a new owner)."""
        if self.mode != _Mode.Disabled and not len(self):
            self.start()

    def set_mode(self, mode: ua.MonitoringMode) -> bool:
        """Change the mode; return whether a first sample is due."""
        return self.of.set_mode(self.slot, mode)

    def modify(self, monitoring: Monitoring) -> None:
        """Set new parameters; the oldest notifications in excess of a shorter queue are lost."""
        self.monitoring = monitoring
        self.of.modify(self.slot, monitoring)

    def clear(self) -> None:
        """Empty the queue."""
        self.of.clear(self.slot)


class BlockItems:
    """The block items of one subscription on one block; each has a slot in arrays (slots,).

    Attributes
    ----------
    queue
        The queues of all items.
    modes
        Monitoring modes, Reporting or Disabled; free slots are Disabled.
    number
        MonitoredItemIds.
    """

    def __init__(self, subscription: Reporter, block: Block) -> None:
        self.block = block
        self.queue = BlockQueue()
        self.modes = np.zeros(0, np.int8)
        self.number = np.zeros(0, np.int64)
        self._subscription = subscription
        self._free: list[int] = []
        self._order: _Order | None = None
        self._column = np.zeros(0, np.intp)
        self._handle = np.zeros(0, np.uint32)
        self._size = np.zeros(0, np.int64)
        self._stamps = np.zeros(0, np.int8)
        self._changes = BlockChanges(block)

    def add(
        self, number: int, wanted: ua.ReadValueId, column: int, monitoring: Monitoring
    ) -> BlockItem:
        """Add an item in mode Disabled."""
        if not self._free:
            self._grow()
        slot = self._free.pop()
        self.number[slot] = number
        self._column[slot] = column
        self.modes[slot] = _Mode.Disabled
        self._set(slot, monitoring)
        return BlockItem(self, slot, number, wanted, monitoring)

    def remove(self, item: BlockItem) -> None:
        """Remove an item."""
        self.clear(item.slot)
        self.modes[item.slot] = _Mode.Disabled
        self.number[item.slot] = 0
        self._free.append(item.slot)
        self._order = None

    def start(self, slot: int) -> None:
        """Sample for the first time."""
        self._changes.forget(slot)
        column = int(self._column[slot])
        moment = self._subscription.holding.next_moment() - column
        self._see(self.block.newest(column), np.array([slot]), np.array([column]), moment)

    def set_mode(self, slot: int, mode: ua.MonitoringMode) -> bool:
        """Change the mode of an item; return whether a first sample is due."""
        was_disabled = bool(self.modes[slot] == _Mode.Disabled)
        self.modes[slot] = mode
        self._order = None
        if mode == _Mode.Disabled:
            self.clear(slot)
            return False
        return was_disabled

    def modify(self, slot: int, monitoring: Monitoring) -> None:
        """Set new parameters of an item."""
        self._set(slot, monitoring)
        surplus = self.queue.length(slot) - monitoring.queue_size
        if surplus > 0:
            self.queue.drop(slot, surplus)
            self._subscription.holding.add(-surplus)
            self._subscription.holding.lose(surplus)

    def clear(self, slot: int) -> None:
        """Empty an item's queue."""
        self._subscription.holding.add(-self.queue.length(slot))
        self.queue.clear(slot)

    def take_in(self, batch: Batch, moment: int) -> None:
        """Process the samples of a batch; ``moment`` is that of the first."""
        if self._order is None:
            self._order = self._by_column()
        slots, columns = self._order
        if not len(slots):
            return
        if batch.columns is not None:
            which, of_batch = _common(columns, batch.columns)
            slots, columns, batch = slots[which], columns[which], batch.of(of_batch)
        elif len(columns) != len(self.block) or (columns != np.arange(len(columns))).any():
            batch = batch.of(columns)
        if len(slots):
            self._see(batch, slots, columns, moment)

    def _by_column(self) -> _Order:
        used = np.flatnonzero(self.modes != _Mode.Disabled)
        order = used[np.lexsort((self.number[used], self._column[used]))]
        return order, self._column[order]

    def take(self, front: Notifications) -> tuple[bytes, Counts]:
        """Remove and encode (the beginning of) the front; return the bytes and end offsets."""
        taken = self.queue.take(front)
        self._subscription.holding.add(-len(taken))
        handles, stamps = self._handle[taken.slot], self._stamps[taken.slot]
        block = self.block
        return encode_records(
            Form(block.type, block.dtype.str, block.length, handle=True),
            stamps,
            {
                "handle": handles,
                "value": taken.values,
                "status": taken.codes,
                "has": taken.has,
                "source": taken.source,
                "server": taken.server,
            },
        )

    def release(self, item: BlockItem) -> tuple[list[Queued], ua.DataValue | None]:
        """Remove an item; return its queue, with the moments, and its last reported value."""
        last, taken = self._changes.last(item.slot), self.queue.take_all_of(item.slot)
        queued = [] if taken is None else [self._queued(taken, i) for i in range(len(taken))]
        self.remove(item)
        return queued, last

    def _queued(self, taken: Notifications, i: int) -> Queued:
        return int(taken.moment[i]), self.block.data_value(
            taken.values[i],
            int(taken.codes[i]),
            bool(taken.has[i]),
            int(taken.source[i]),
            int(taken.server[i]),
        )

    def _see(self, batch: Batch, slots: Slots, columns: Slots, moment: int) -> None:
        """Queue the changes in a batch of exactly these columns."""
        changed = self._changes.find(batch, slots)
        if not changed.any():
            return
        rows = np.arange(len(batch))[:, None]
        self._push(batch, slots, changed, moment + rows * len(self.block) + columns)
        self._subscription.hurry()

    def _push(self, batch: Batch, slots: Slots, changed: Bools, moments: Counts) -> None:
        queue, holding = self.queue, self._subscription.holding
        counts = changed.sum(axis=0)
        total = int(counts.sum())
        lengths = queue.tail[slots] - queue.head[slots]
        if bool((lengths + counts <= self._size[slots]).all()) and total <= holding.room():
            numbers = queue.tail[slots] + np.cumsum(changed, axis=0) - 1
            queue.tail[slots] += counts
            holding.add(total)
            queue.append(notifications(batch, slots, changed, numbers, moments))
            return
        for row in np.flatnonzero(changed.any(axis=1)):
            here = slice(row, row + 1)
            self._push_row(batch[here], slots, changed[here], moments[here])

    def _push_row(self, batch: Batch, slots: Slots, changed: Bools, moments: Counts) -> None:
        """Queue one sample of each item when queues may overflow."""
        queue, holding = self.queue, self._subscription.holding
        pushed = changed[0]
        lengths, size = queue.tail[slots] - queue.head[slots], self._size[slots]
        fits = pushed & (lengths < size)
        added = fits & ((np.cumsum(fits) <= holding.room()) | (lengths == 0))
        full = pushed & ~added
        lost = full & ~((lengths == 1) & (size == 1))  # a queue of size 1: no overflow bit
        holding.add(int(added.sum()))
        holding.lose(int(lost.sum()))
        numbers = queue.tail[slots]
        queue.tail[slots[pushed]] += 1
        queue.discard(slots[full])
        queue.flag(slots[lost])
        queue.append(notifications(batch, slots, changed, numbers[None], moments))

    def _set(self, slot: int, monitoring: Monitoring) -> None:
        self._handle[slot] = monitoring.client_handle
        self._size[slot] = monitoring.queue_size
        self._changes.set_rule(slot, monitoring.rule)
        self._stamps[slot] = monitoring.stamps

    def _grow(self) -> None:
        old, new = len(self.modes), max(16, 2 * len(self.modes))
        self._free = list(range(new - 1, old - 1, -1))
        self.queue.grow(new)
        self._changes.grow(new)
        for name in ("modes", "number", "_column", "_handle", "_size", "_stamps"):
            setattr(self, name, grown(getattr(self, name), new))


def _common(columns: Slots, written: Slots) -> tuple[Slots, Slots]:
    """Return matching indices into ascending ``columns`` (with repeats) and ``written``."""
    first = np.searchsorted(columns, written, "left")
    counts = np.searchsorted(columns, written, "right") - first
    of_batch = np.repeat(np.arange(len(written)), counts)
    nth = np.arange(len(of_batch)) - np.repeat(np.cumsum(counts) - counts, counts)
    which = first[of_batch] + nth
    order = np.argsort(which)
    return which[order], of_batch[order]
