"""What a subscription has to report, in the order of the changes behind it."""

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

_MESSAGE_S = 0.01  # processor time that the encoding of one message may take


class _Queued(NamedTuple):
    """Number of the change, of the item, the item; s to encode it, later all up to it."""

    moment: int
    number: int
    item: DataItem | EventItem
    cost_so_far: float


class Reports:
    """Items with something to report.

    Attributes
    ----------
    blocks
        The items that are served as arrays; their queues say what they have to report.
    """

    def __init__(self) -> None:
        self.blocks: dict[Block, BlockItems] = {}
        self._items: dict[int, DataItem | EventItem] = {}

    def __bool__(self) -> bool:
        return any(map(len, self._items.values())) or any(
            len(items.queue) for items in self.blocks.values()
        )

    def add(self, item: DataItem | EventItem) -> None:
        """Note that an item has something to report."""
        self._items[item.number] = item

    def forget(self, number: int) -> None:
        """Forget an item."""
        self._items.pop(number, None)

    def clear(self) -> None:
        """Forget all."""
        self._items.clear()
        self.blocks.clear()

    def take(self, most: int) -> list[bytes]:
        """Take up to ``most`` notifications, encoded: data changes, then events.

        Those that are dear to encode make a message end sooner: nobody waits for the others' long.
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
        if is_cut:  # what came after the last of the singles may have come after others of them
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
    """The first of them, until they are too dear for one message; one at least."""
    found, total = [], 0.0
    for one in queued:
        total += one.cost_so_far
        found.append(one._replace(cost_so_far=total))
        if total > _MESSAGE_S:
            break
    return found


class _Content:
    """What goes into one message."""

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
