"""The pending notifications of a subscription, in the order of the changes."""

from collections.abc import Iterator
from heapq import merge
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np

from guarded_opcua.address_space.blocks import Block
from guarded_opcua.binary.encoding import encode_data_changes, encode_events
from guarded_opcua.monitoring.block_items import BlockItems
from guarded_opcua.monitoring.block_queue import Notifications
from guarded_opcua.monitoring.data_item import DataItem
from guarded_opcua.monitoring.event_item import EventItem, QueuedEvent

_MESSAGE_S = 0.01  # s of processor time for the encoding of one message


class _Queued(NamedTuple):
    """Moment, item number, item, and encoding cost, s; later the cumulative cost."""

    moment: int
    number: int
    item: DataItem | EventItem
    cost_so_far: float


class Reports:
    """Items with pending notifications.

    Attributes
    ----------
    blocks
        The block items of the subscription, by block; their queues hold the pending notifications.
    """

    def __init__(self) -> None:
        self.blocks: dict[Block, BlockItems] = {}
        self._items: dict[int, DataItem | EventItem] = {}

    def __bool__(self) -> bool:
        return any(map(len, self._items.values())) or any(
            len(items.queue) for items in self.blocks.values()
        )

    def add(self, item: DataItem | EventItem) -> None:
        """Add an item with pending notifications."""
        self._items[item.number] = item

    def forget(self, number: int) -> None:
        """Remove an item."""
        self._items.pop(number, None)

    def clear(self) -> None:
        """Remove all items."""
        self._items.clear()
        self.blocks.clear()

    def take(self, most: int) -> list[bytes]:
        """Remove and encode up to ``most`` notifications: data changes, then events.

        A message ends early if its encoding takes too long, so that other clients are not delayed.
        """
        content = _Content()
        singles = _affordable(islice(merge(*map(_queued, self._items.values())), most))
        is_cut = len(singles) < most and bool(singles) and singles[-1].cost_so_far > _MESSAGE_S
        fronts = [(items, items.queue.front(most)) for items in self.blocks.values()]
        known = [(items, front) for items, front in fronts if front]
        self._take(content, singles, known, most, is_cut=is_cut)
        self._items = {number: item for number, item in self._items.items() if len(item)}
        return content.notifications()

    def _take(
        self,
        content: "_Content",
        singles: list[_Queued],
        fronts: list[tuple[BlockItems, Notifications]],
        most: int,
        *,
        is_cut: bool,
    ) -> None:
        if not fronts:
            content.add_all(singles)
            return
        moments = [front.moment for _, front in fronts]
        numbers = [items.number[front.slot] for items, front in fronts]
        moments.append(np.array([single.moment for single in singles], np.int64))
        numbers.append(np.array([single.number for single in singles], np.int64))
        source = np.repeat(np.arange(len(fronts) + 1), [len(part) for part in moments])
        order = np.lexsort((np.concatenate(numbers), np.concatenate(moments)))[:most]
        source = source[order]
        if is_cut:  # after the last single taken, the order to the remaining singles is unknown
            source = source[: int(np.flatnonzero(source == len(fronts))[-1]) + 1]
        taken = [
            items.take(front[: int((source == which).sum())])
            for which, (items, front) in enumerate(fronts)
        ]
        done = [0] * (len(fronts) + 1)
        runs = np.flatnonzero(np.diff(source, prepend=-1, append=-1)).tolist()
        for start, stop in pairwise(runs):
            which = int(source[start])
            first = done[which]
            last = done[which] = first + stop - start
            if which == len(fronts):
                content.add_all(singles[first:last])
                continue
            data, ends = taken[which]
            content.changes.append(data[int(ends[first]) : int(ends[last])])
            content.count += last - first


def _queued(item: DataItem | EventItem) -> Iterator[_Queued]:
    return (_Queued(moment, item.number, item, cost) for moment, cost in item.waiting)


def _affordable(queued: Iterator[_Queued]) -> list[_Queued]:
    """Return the first notifications up to the encoding cost of one message; at least one."""
    found, total = [], 0.0
    for one in queued:
        total += one.cost_so_far
        found.append(one._replace(cost_so_far=total))
        if total > _MESSAGE_S:
            break
    return found


class _Content:
    """The content of one message."""

    def __init__(self) -> None:
        self.changes: list[bytes] = []
        self.count = 0
        self.events: list[QueuedEvent] = []

    def add_all(self, queued: list[_Queued]) -> None:
        for _, _, item, _ in queued:
            if isinstance(item, DataItem):
                self.changes += item.take(1)
                self.count += 1
            else:
                self.events += item.take(1)

    def notifications(self) -> list[bytes]:
        found = []
        if self.count:
            found.append(encode_data_changes(self.changes, self.count))
        if self.events:
            found.append(encode_events(self.events))
        return found
