"""The monitored items of one subscription on one block, served as arrays (Part 4, 5.13).

The rules are those of ``monitored_item``; the tests hold the two against each other byte by byte.
What needs more than arrays can do (a sampling interval of its own, links to other items) is served
there, item by item: see :func:`serves`.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from service.opcua.hardened.block_encoding import encode_records
from service.opcua.hardened.block_queue import BlockQueue, Counts, Notifications, Slots
from service.opcua.hardened.blocks import Batch, Block, Bools
from service.opcua.hardened.monitored_item import OVERFLOW, Monitoring

if TYPE_CHECKING:
    from service.opcua.hardened.subscription import Subscription

_FEWEST = 50  # variables: in a smaller block they are faster one by one
_Mode = ua.MonitoringMode
_Trigger = ua.DataChangeTrigger
_Pair = tuple[NDArray[Any], NDArray[Any]]


def serves(block: Block, monitoring: Monitoring) -> bool:
    """Tell whether arrays can serve an item with these parameters."""
    exact = monitoring.rule.deadband == 0.0 or block.dtype == np.float64
    return monitoring.interval_s == 0.0 and exact and len(block) >= _FEWEST


class BlockItem:
    """One of the items; monitors the value of one variable."""

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
        self.links: set[int] = set()  # stays empty: who triggers others is served one by one

    def __len__(self) -> int:
        return self.of.queue.length(self.slot)

    def __bool__(self) -> bool:
        return True

    @property
    def client_handle(self) -> int:
        """The client's own number of the item."""
        return self.monitoring.client_handle

    @property
    def mode(self) -> ua.MonitoringMode:
        """The monitoring mode."""
        return _Mode(int(self.of.modes[self.slot]))

    def start(self, _: ua.DataValue | None = None) -> None:
        """Sample for the first time, or again after the item was disabled."""
        self.of.start(self.slot)

    def repeat(self, _: ua.DataValue | None = None) -> None:
        """Report the value even if it was reported before (for a new owner)."""
        if self.mode != _Mode.Disabled and not len(self):
            self.start()

    def set_mode(self, mode: ua.MonitoringMode) -> bool:
        """Change the mode; tell whether a first sample is due."""
        return self.of.set_mode(self.slot, mode)

    def modify(self, monitoring: Monitoring) -> None:
        """Take new parameters; a shorter queue loses its surplus."""
        self.monitoring = monitoring
        self.of.modify(self.slot, monitoring)

    def has_news(self) -> None:
        """Note that the item has something to report."""
        self.of.has_news(self.slot)

    def clear(self) -> None:
        """Forget what is queued."""
        self.of.clear(self.slot)


class BlockItems:
    """All of them; each has a slot in arrays of shape (slots,).

    Attributes
    ----------
    modes
        Monitoring modes; a free slot is disabled.
    news
        Number of the change since which an item has something to report, 0 if it has nothing.
    """

    def __init__(self, subscription: "Subscription", block: Block) -> None:
        self.block = block
        self.queue = BlockQueue(block.width, block.dtype)
        self.modes = np.zeros(0, np.int8)
        self.news = np.zeros(0, np.int64)
        self.number = np.zeros(0, np.int64)
        self._subscription = subscription
        self._free: list[int] = []
        self._order: Slots | None = None
        self._column = np.zeros(0, np.intp)
        self._handle = np.zeros(0, np.uint32)
        self._size = np.zeros(0, np.int64)
        self._oldest = np.zeros(0, np.bool_)
        self._trigger = np.zeros(0, np.int8)
        self._deadband = np.zeros(0)
        self._stamps = np.zeros(0, np.int8)
        # what was reported last
        self._reported = np.zeros(0, np.bool_)
        self._values = np.zeros((0, block.width), block.dtype)
        self._codes = np.zeros(0, np.uint32)
        self._has = np.zeros(0, np.bool_)
        self._source = np.zeros(0, np.int64)

    def add(
        self, number: int, wanted: ua.ReadValueId, column: int, monitoring: Monitoring
    ) -> BlockItem:
        """Add an item; it is disabled yet."""
        if not self._free:
            self._grow()
        slot = self._free.pop()
        self.number[slot] = number
        self._column[slot] = column
        self.modes[slot] = _Mode.Disabled
        self.news[slot] = 0
        self._set(slot, monitoring)
        return BlockItem(self, slot, number, wanted, monitoring)

    def remove(self, item: BlockItem) -> None:
        """Forget an item."""
        self.clear(item.slot)
        self.modes[item.slot] = _Mode.Disabled
        self.news[item.slot] = 0
        self.number[item.slot] = 0
        self._free.append(item.slot)
        self._order = None

    def start(self, slot: int) -> None:
        """Sample for the first time."""
        self._reported[slot] = False
        column = int(self._column[slot])
        batch = self.block.batch_of(column, self.block.current(column))
        self._take_in(batch, np.array([slot]), self._subscription.holding.moment - column)

    def set_mode(self, slot: int, mode: ua.MonitoringMode) -> bool:
        """Change the mode of an item; tell whether a first sample is due."""
        was_disabled = bool(self.modes[slot] == _Mode.Disabled)
        self.modes[slot] = mode
        self._order = None
        if mode == _Mode.Disabled:
            self.clear(slot)
            return False
        if mode == _Mode.Reporting and self.queue.length(slot):
            self.has_news(slot)
        return was_disabled

    def modify(self, slot: int, monitoring: Monitoring) -> None:
        """Give an item new parameters."""
        self._set(slot, monitoring)
        surplus = self.queue.length(slot) - monitoring.queue_size
        if surplus > 0:
            if monitoring.discard_oldest:
                self.queue.drop_oldest(slot, surplus)
            else:
                self.queue.drop_newest(slot, surplus)
            self._subscription.holding.add(-surplus)
            self._subscription.holding.lose(surplus)

    def has_news(self, slot: int) -> None:
        """Note that an item has something to report."""
        if not self.news[slot]:
            self.news[slot] = self._subscription.holding.moment

    def clear(self, slot: int) -> None:
        """Empty an item's queue."""
        self._subscription.holding.add(-self.queue.length(slot))
        self.queue.clear(slot)

    def take_in(self, batch: Batch, moment: int) -> None:
        """Take samples in, the first of which belongs to the moment."""
        if self._order is None:
            used = np.flatnonzero(self.modes != _Mode.Disabled)
            self._order = used[np.lexsort((self.number[used], self._column[used]))]
        if len(self._order):
            self._take_in(batch, self._order, moment)

    def take(self, slots: Slots, counts: Counts) -> tuple[bytes, Counts]:
        """Take notifications, encoded: all bytes, and where those of each item end."""
        taken = self.queue.take(slots, counts)
        self._subscription.holding.add(-len(taken))
        handles, stamps = self._handle[taken.slot], self._stamps[taken.slot]
        data, ends = encode_records(taken, handles, stamps, self.block)
        return data, ends[np.cumsum(counts)]

    def release(self, item: BlockItem) -> tuple[list[ua.DataValue], ua.DataValue | None, int]:
        """Give an item away: what it had queued, what it reported last, since when it has news."""
        slot, block = item.slot, self.block
        last = None
        if self._reported[slot]:
            last = block.data_value(
                self._values[slot],
                int(self._codes[slot]),
                bool(self._has[slot]),
                int(self._source[slot]),
                0,
            )
        length, news = self.queue.length(slot), int(self.news[slot])
        taken = self.queue.take(np.array([slot]), np.array([length]))
        queued = [
            block.data_value(
                taken.values[i],
                int(taken.codes[i]),
                bool(taken.has[i]),
                int(taken.source[i]),
                int(taken.server[i]),
            )
            for i in range(length)
        ]
        self.remove(item)
        return queued, last, news

    def _take_in(self, batch: Batch, slots: Slots, moment: int) -> None:
        columns = self._column[slots]
        whole = len(columns) == len(self.block) and bool((columns == np.arange(len(columns))).all())
        if not whole:
            batch = Batch(
                batch.values[:, columns],
                batch.codes[:, columns],
                batch.has[:, columns],
                batch.source[:, columns],
                batch.server,
                None if batch.present is None else batch.present[:, columns],
            )
        changed = self._changes(batch, slots)
        if not changed.any():
            return
        self._push(batch, slots, changed)
        quiet = (self.news[slots] == 0) & (self.modes[slots] == _Mode.Reporting)
        quiet &= changed.any(axis=0)
        if quiet.any():
            first = np.argmax(changed, axis=0)
            since = moment + first * len(self.block) + columns
            self.news[slots[quiet]] = since[quiet]

    def _changes(self, batch: Batch, slots: Slots) -> Bools:
        """Tell what is worth a notification, shape (k, slots): see ``ChangeRule.is_change``."""
        if batch.present is None and not self._deadband[slots].any():
            return self._changes_of_all(batch, slots)
        changed = np.zeros(batch.codes.shape, np.bool_)
        for row in range(len(batch)):
            one = self._is_change(
                slots,
                ~self._reported[slots],
                (self._values[slots], batch.values[row]),
                (self._codes[slots], batch.codes[row]),
                (self._has[slots], batch.has[row]),
                (self._source[slots], batch.source[row]),
            )
            if batch.present is not None:
                one &= batch.present[row]
            self._remember(slots[one], batch, row, np.flatnonzero(one))
            changed[row] = one
        return changed

    def _changes_of_all(self, batch: Batch, slots: Slots) -> Bools:
        """Without a deadband, to differ from the last report is to differ from the last sample."""
        unreported = np.zeros(batch.codes.shape, np.bool_)
        unreported[0] = ~self._reported[slots]
        changed = self._is_change(
            slots,
            unreported,
            (np.concatenate((self._values[None, slots], batch.values[:-1])), batch.values),
            (np.concatenate((self._codes[None, slots], batch.codes[:-1])), batch.codes),
            (np.concatenate((self._has[None, slots], batch.has[:-1])), batch.has),
            (np.concatenate((self._source[None, slots], batch.source[:-1])), batch.source),
        )
        if changed[-1].all():
            self._remember(slots, batch, -1, slice(None))
        else:
            which = np.flatnonzero(changed.any(axis=0))
            last = len(batch) - 1 - np.argmax(changed[::-1, which], axis=0)
            self._remember(slots[which], batch, last, which)
        return changed

    def _is_change(
        self,
        slots: Slots,
        unreported: Bools,
        values: _Pair,
        codes: _Pair,
        has: _Pair,
        source: _Pair,
    ) -> Bools:
        """Compare what was reported with what is new; shapes (slots, …) or (k, slots, …)."""
        trigger, deadband = self._trigger[slots], self._deadband[slots]
        old, new = values
        differs = old != new
        if deadband.any():
            with np.errstate(invalid="ignore"):
                far = np.abs(new - old)
            beyond = np.where(np.isnan(far), differs, far > deadband[:, None])
            differs = np.where(deadband[:, None] > 0.0, beyond, differs)
        if self.block.dtype.kind == "f":
            differs &= ~(np.isnan(old) & np.isnan(new))
        differs = differs[..., 0] if differs.shape[-1] == 1 else differs.any(axis=-1)
        differs = (differs & has[1]) | (has[0] != has[1])
        differs |= (trigger == _Trigger.StatusValueTimestamp) & (source[0] != source[1])
        differs &= trigger != _Trigger.Status
        return differs | (codes[0] != codes[1]) | unreported

    def _remember(self, slots: Slots, batch: Batch, row: int | Slots, which: Slots | slice) -> None:
        self._reported[slots] = True
        self._values[slots] = batch.values[row, which]
        self._codes[slots] = batch.codes[row, which]
        self._has[slots] = batch.has[row, which]
        self._source[slots] = batch.source[row, which]

    def _push(self, batch: Batch, slots: Slots, changed: Bools) -> None:
        queue, holding = self.queue, self._subscription.holding
        counts = changed.sum(axis=0)
        total = int(counts.sum())
        lengths = queue.tail[slots] - queue.head[slots]
        if bool((lengths + counts <= self._size[slots]).all()) and total <= holding.room():
            numbers = queue.tail[slots] + np.cumsum(changed, axis=0) - 1
            queue.tail[slots] += counts
            holding.add(total)
            self._log(batch, slots, changed, numbers, batch.codes)
            return
        for row in range(len(batch)):
            if changed[row].any():
                self._push_row(batch, slots, changed, row)

    def _push_row(self, batch: Batch, slots: Slots, changed: Bools, row: int) -> None:
        """Queue one sample of each item where not everything may fit."""
        queue, holding = self.queue, self._subscription.holding
        pushed = changed[row]
        lengths, size = queue.tail[slots] - queue.head[slots], self._size[slots]
        fits = pushed & (lengths < size)
        added = fits & ((np.cumsum(fits) <= holding.room()) | (lengths == 0))
        full = pushed & ~added
        single = full & (lengths == 1) & (size == 1)  # holds the newest; no overflow is told of it
        oldest = full & ~single & self._oldest[slots]
        newest = full & ~single & ~oldest
        holding.add(int(added.sum()))
        holding.lose(int(oldest.sum() + newest.sum()))
        numbers = np.where(added | oldest, queue.tail[slots], queue.tail[slots] - 1)
        queue.tail[slots[added | oldest]] += 1
        queue.head[slots[oldest]] += 1
        queue.flag(slots[oldest])
        queue.unflag(slots[single])
        codes = np.where(newest, batch.codes[row] | np.uint32(OVERFLOW), batch.codes[row])
        one = Batch(
            batch.values[row : row + 1],
            batch.codes[row : row + 1],
            batch.has[row : row + 1],
            batch.source[row : row + 1],
            batch.server,
            None,
        )
        self._log(one, slots, pushed[None], numbers[None], codes[None])

    def _log(
        self, batch: Batch, slots: Slots, pushed: Bools, numbers: Counts, codes: NDArray[np.uint32]
    ) -> None:
        k = len(batch)
        if pushed.all():
            flat = pushed.size
            new = Notifications(
                np.tile(slots, k),
                numbers.reshape(flat),
                batch.values.reshape(flat, -1),
                codes.reshape(flat),
                batch.has.reshape(flat),
                batch.source.reshape(flat),
                np.full(flat, batch.server),
            )
        else:
            which = np.broadcast_to(slots, pushed.shape)[pushed]
            new = Notifications(
                which,
                numbers[pushed],
                batch.values[pushed],
                codes[pushed],
                batch.has[pushed],
                batch.source[pushed],
                np.full(len(which), batch.server),
            )
        self.queue.append(new)

    def _set(self, slot: int, monitoring: Monitoring) -> None:
        self._handle[slot] = monitoring.client_handle
        self._size[slot] = monitoring.queue_size
        self._oldest[slot] = monitoring.discard_oldest
        self._trigger[slot] = monitoring.rule.trigger
        self._deadband[slot] = monitoring.rule.deadband
        self._stamps[slot] = monitoring.stamps

    def _grow(self) -> None:
        old, new = len(self.modes), max(16, 2 * len(self.modes))
        more = new - old
        self._free = list(range(new - 1, old - 1, -1))
        self.queue.grow(new)
        for name in (
            "modes",
            "news",
            "number",
            "_column",
            "_handle",
            "_size",
            "_oldest",
            "_trigger",
            "_deadband",
            "_stamps",
            "_reported",
            "_values",
            "_codes",
            "_has",
            "_source",
        ):
            held = getattr(self, name)
            empty = np.zeros((more, *held.shape[1:]), held.dtype)
            setattr(self, name, np.concatenate((held, empty)))
