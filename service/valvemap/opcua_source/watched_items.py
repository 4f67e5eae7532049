"""The monitored items of a subscription: their handles, their queues, and parts of values."""

import asyncio
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, repeat
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guarded_opcua.logs import bounded_logger
from valvemap.clock import Clock
from valvemap.errors import SourceError
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.decoding import Message
from valvemap.opcua_source.elements import (
    COMPOUND,
    NO_COMPOUNDS,
    Element,
    of_one_variable,
    with_elements,
)
from valvemap.opcua_source.item_table import ItemTable
from valvemap.opcua_source.monitored_items import Item, create_items, delete_items, enlarge_queues
from valvemap.opcua_source.received import Tally
from valvemap.pipeline.data_changes import DataChanges

_log = bounded_logger(__name__)

QUEUED_S: Final = 60.0  # of samples that the server should queue during an outage
_NOTICEABLY: Final = 1.1  # smallest ratio of new to old queue size worth a request
_MEASURE_S: Final = 2.0
_SPARE: Final = 1.2  # margin of the queue size over the measured rate
_MEASURE_AFTER_S: Final = (2.0, 10.0, 60.0)  # … then repeated at the last interval


class WatchedItems:
    """The monitored items of one subscription, and what their changes are called here."""

    def __init__(
        self,
        connection: Connection,
        subscription: int,
        tally: Tally,
        clock: Clock,
        table: ItemTable,
    ) -> None:
        self.items: tuple[Item, ...] = ()
        self._connection, self._id = connection, subscription
        self._settings = connection.settings
        self._tally, self._clock, self._table = tally, clock, table
        self._item_of_handle: NDArray[np.int32] | None = None  # None: they are equal
        self._elements: dict[int, list[Element]] = {}  # by the item of the change
        self._asked = 0  # size of the queues
        self._counted: NDArray[np.int64] | None = None  # changes by item, during a measurement

    def watch(self, items: Sequence[Item]) -> None:
        """Set the monitored items; their queues are adapted to their rates from now on."""
        self.items = tuple(items)
        self._item_of_handle = _items_by_handle(self.items)
        self._elements.clear()
        by_handle: dict[int, list[MonitoredNode]] = {}
        for item in items:
            by_handle.setdefault(item.handle, []).append(item.node)
        for nodes in by_handle.values():
            self.expect(nodes)

    def expect(self, nodes: Iterable[MonitoredNode]) -> None:
        """Note which parts the changes of these nodes hold, before they come."""
        for own in of_one_variable(nodes):
            elements = [Element(n.item, n.place) for n in own if n.place is not None]
            if elements:
                self._elements[own[0].item] = elements

    def read_as(self, node: MonitoredNode) -> None:
        """Take a signal from another place in its variable's values from now on."""
        own = (replace(one, node=node) if one.node.item == node.item else one for one in self.items)
        self.watch(tuple(own))

    async def change(self, nodes: Sequence[MonitoredNode], surplus: Sequence[int]) -> None:
        """Monitor exactly these nodes: create missing items and delete the surplus ones.

        Raises
        ------
        SourceLost, SourceRejected
        """
        watched = {item.node.item for item in self.items}
        handle = max((item.handle for item in self.items), default=-1) + 1
        missing = [node for node in nodes if node.item not in watched]
        with self._connection.errors("changing the subscription"):
            if unused := set(surplus) - {item.number for item in self.items}:
                await delete_items(self._connection, self._id, sorted(unused))
            if missing:
                self.expect(missing)
                by_handle = dict(enumerate(missing, handle))
                added = await create_items(self._connection, self._id, by_handle)
                self.watch((*self.items, *added))

    async def monitor_again(self, node: MonitoredNode) -> None:
        """Delete the monitored item of a node, if there is one, and create it again.

        That of a variable with other signals is kept for these.

        Raises
        ------
        SourceLost
        SourceRejected
            if the node cannot be monitored.
        """
        own = [item for item in self.items if item.node.item == node.item]
        others = [item for item in self.items if item.node.item != node.item]
        handle = max((item.handle for item in self.items), default=-1) + 1
        numbers = {item.number for item in own} - {item.number for item in others}
        handle = own[0].handle if numbers else handle
        with self._connection.errors("monitoring a node again"):
            await delete_items(self._connection, self._id, sorted(numbers))
            self.watch(others)
            self.expect([node])
            self.watch((*others, *await create_items(self._connection, self._id, {handle: node})))

    def changes_of(self, message: Message) -> DataChanges:
        """Return the changes with known handles, numbered by item instead of handle."""
        changes, table = message.changes, self._item_of_handle
        if table is not None and len(changes):
            known = (changes.item >= 0) & (changes.item < len(table))
            item = np.where(known, table[np.where(known, changes.item, 0)], np.int32(-1))
            changes = replace(changes, item=item)
        kind = message.kind
        if self._elements and len(changes):
            compounds = message.compounds or NO_COMPOUNDS
            changes, kind = with_elements(changes, kind, compounds, self._elements)
        self._tally.undecodable += int(np.count_nonzero(kind >= COMPOUND))
        return self._table.note(changes, kind, self._clock.monotonic())

    def count(self, changes: DataChanges) -> None:
        """Count the changes by item, during a measurement of their rate."""
        if self._counted is not None:
            self._counted += np.bincount(
                np.clip(changes.item, 0, len(self._counted) - 1), minlength=len(self._counted)
            )

    async def adapt_queues(self) -> None:
        """Measure the rate of changes and enlarge queues to hold one minute of them."""
        for pause_s in chain(_MEASURE_AFTER_S, repeat(_MEASURE_AFTER_S[-1])):
            await asyncio.sleep(pause_s - _MEASURE_S)
            if not self.items:
                continue
            self._counted = np.zeros(1 + max(item.node.item for item in self.items), np.int64)
            began = self._clock.monotonic()
            await asyncio.sleep(_MEASURE_S)
            passed, counted = self._clock.monotonic() - began, self._counted
            self._counted = None
            wanted = math.ceil(_SPARE * QUEUED_S * int(counted.max()) / passed)
            with suppress(SourceError):  # publishing reports it, too
                await self._have_queues_of(wanted)

    async def _have_queues_of(self, size: int) -> None:
        if size <= _NOTICEABLY * max(self._settings.queue_size, self._asked):
            return
        self._asked = size
        with self._connection.errors("enlarging queues"):
            self.items = await enlarge_queues(self._connection, self._id, self.items, size)
        _log.info("%s: queues of %d values asked for", self._settings.url, size)


def _items_by_handle(items: Sequence[Item]) -> NDArray[np.int32] | None:
    if all(item.handle == item.node.item for item in items):
        return None
    table = np.full(1 + max(item.handle for item in items), -1, np.int32)
    for item in reversed(items):  # of parts of one variable, the first
        table[item.handle] = item.node.item
    return table
