"""Which items of a subscription have something to report, and in which order they do."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.opcua.hardened.block_items import BlockItem, BlockItems
from service.opcua.hardened.blocks import Block
from service.opcua.hardened.encoding import encode_data_changes, encode_events
from service.opcua.hardened.monitored_item import DataItem, Event, EventItem


class News:
    """Items with something to report: what changed first comes first, all of an item at once.

    Attributes
    ----------
    blocks
        The items that are served as arrays; they note themselves what they have to report.
    """

    def __init__(self) -> None:
        self.blocks: dict[Block, BlockItems] = {}
        self._items: dict[int, tuple[int, DataItem | EventItem]] = {}

    def __bool__(self) -> bool:
        return bool(self._items) or any(items.news.any() for items in self.blocks.values())

    def add(self, item: DataItem | EventItem | BlockItem, moment: int) -> None:
        """Note that an item has something to report since a moment."""
        if isinstance(item, BlockItem):
            item.has_news()
        else:
            self._items.setdefault(item.number, (moment, item))

    def forget(self, number: int) -> None:
        """Forget an item."""
        self._items.pop(number, None)

    def clear(self) -> None:
        """Forget all."""
        self._items.clear()
        self.blocks.clear()

    def take(self, most: int) -> list[bytes]:
        """Take up to ``most`` notifications, encoded: data changes, then events."""
        told = _Told()
        blocks = [items for items in self.blocks.values() if items.news.any()]
        if blocks:
            self._take_all(told, blocks, most)
        else:
            self._take_items(told, most)
        return told.notifications()

    def _take_items(self, told: "_Told", most: int) -> None:
        for _, number in sorted((since, number) for number, (since, _) in self._items.items()):
            if most <= 0:
                break
            item = self._items[number][1]
            before = len(item)
            self._take_item(told, item, most)
            most -= before - len(item)

    def _take_all(self, told: "_Told", blocks: list[BlockItems], most: int) -> None:
        """Put the items of blocks and the others in one order, and take them as it says."""
        single = list(self._items.values())
        slots = [np.flatnonzero(items.news) for items in blocks]
        found = list(zip(blocks, slots, strict=True))
        since: list[ArrayLike] = [
            *(items.news[of] for items, of in found),
            [moment for moment, _ in single],
        ]
        number: list[ArrayLike] = [
            *(items.number[of] for items, of in found),
            [item.number for _, item in single],
        ]
        length: list[ArrayLike] = [
            *(items.queue.lengths[of] for items, of in found),
            [len(i) for _, i in single],
        ]
        kind = np.repeat(np.arange(len(blocks) + 1), [*map(len, slots), len(single)])
        order = np.lexsort((_joined(number), _joined(since)))
        kind, lengths = kind[order], _joined(length)[order]
        slot = _joined([*slots, range(len(single))])[order]
        counts = np.clip(most - (np.cumsum(lengths) - lengths), 0, lengths)
        reached = np.cumsum(lengths) - lengths < most
        kind, slot, lengths, counts = (
            kind[reached],
            slot[reached],
            lengths[reached],
            counts[reached],
        )

        taken = []
        for which, items in enumerate(blocks):
            mine = kind == which
            data, until = items.take(slot[mine], counts[mine])
            taken.append((data, [0, *until.tolist()]))
            items.news[slot[mine & (counts == lengths)]] = 0
        done = [0] * len(blocks)
        runs = np.flatnonzero(np.diff(kind, prepend=-1, append=-1)).tolist()
        for start, stop in pairwise(runs):
            which = int(kind[start])
            if which == len(blocks):
                for place in range(start, stop):
                    self._take_item(told, single[int(slot[place])][1], int(counts[place]))
                continue
            data, ends = taken[which]
            first, done[which] = done[which], done[which] + stop - start
            told.changes.append(data[ends[first] : ends[done[which]]])
            told.count += int(counts[start:stop].sum())

    def _take_item(self, told: "_Told", item: DataItem | EventItem, most: int) -> None:
        told.add(item, most)
        if not len(item):
            del self._items[item.number]


def _joined(parts: Sequence[ArrayLike]) -> NDArray[np.int64]:
    return np.concatenate([np.asarray(part, np.int64) for part in parts])


class _Told:
    """What goes into one message."""

    def __init__(self) -> None:
        self.changes: list[bytes] = []
        self.count = 0
        self.events: list[Event] = []

    def add(self, item: DataItem | EventItem, most: int) -> None:
        if isinstance(item, DataItem):
            records = item.take(most)
            self.changes += records
            self.count += len(records)
        else:
            self.events += item.take(most)

    def notifications(self) -> list[bytes]:
        found = []
        if self.count:
            found.append(encode_data_changes(self.changes, self.count))
        if self.events:
            found.append(encode_events(self.events))
        return found
