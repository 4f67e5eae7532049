"""Watches every configured node: reads it now and then, and monitors it again if it came back.

The data changes show type, status and rate of an item at once (:mod:`item_table`); a node that
falls silent, becomes Bad or sends no numbers is read next, all others in turn. From both follows
one state per node (:class:`~valvemap.vocabulary.item_states.ItemState`), in words.
"""

import asyncio
import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from asyncua import ua

from guarded_opcua.logs import bounded_logger
from valvemap.clock import Clock
from valvemap.errors import SourceError, SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import namespaces_of
from valvemap.opcua_client.source_errors import status_name
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.checked_nodes import CheckedNodes, MonitoredNode
from valvemap.opcua_source.item_table import QUIET_S, ItemTable
from valvemap.opcua_source.members import Member
from valvemap.opcua_source.monitored_items import Item
from valvemap.opcua_source.node_looks import Looked, look
from valvemap.opcua_source.source_nodes import ValveNodes, Wanted, copies_of, wanted_nodes
from valvemap.opcua_source.subscription import Subscription
from valvemap.opcua_source.wire import NUMERIC_FORMATS
from valvemap.vocabulary.item_states import ItemState
from valvemap.vocabulary.signals import PER_VALVE

LOOK_S: Final = 1.0  # s; interval of the reads
_AT_ONCE: Final = 50  # nodes of one read; 250 attributes take 5 ms
_NAMESPACES_EVERY: Final = 5  # reads
_NEWER_NS: Final = 1_000_000_000  # ns; a value at the source that much newer was not reported
_SERIOUS: Final = {ItemState.BAD, ItemState.WRONG_TYPE, ItemState.REFUSED, ItemState.GONE}
_BOOLEAN: Final = int(ua.VariantType.Boolean.value)
_GOOD: Final = (ItemState.GOOD, "")
_log = bounded_logger(__name__)


class ItemWatch:
    """The state of every monitored node of one source, over all connections.

    Parameters
    ----------
    settings, valves
        Of the source.
    clock
        Its monotonic time.

    Attributes
    ----------
    table : ItemTable
        To be filled with the data changes.
    """

    def __init__(
        self, settings: SourceSettings, valves: Sequence[ValveNodes], clock: Clock
    ) -> None:
        self._settings, self._clock = settings, clock
        self._copies = copies_of(valves)
        copies = {item for items in self._copies.values() for item in items}
        self._wanted = {
            node.item: node
            for node in wanted_nodes(valves)
            if node.item is not None and node.item not in copies
        }
        self.table = ItemTable(len(valves))
        self._accepted: dict[int, int] = {}  # first type of each item
        self._looked: dict[int, Looked] = {}
        self._looked_at = dict.fromkeys(self._wanted, -np.inf)
        self._missed: set[int] = set()  # items whose change was not reported at the last look
        self._states: dict[int, tuple[ItemState, str]] = {}
        self._before: tuple[str, ...] = ()
        self._namespaces: tuple[str, ...] = ()
        self._task: asyncio.Task[None] | None = None
        self._remarks: dict[int, tuple[str, ...]] = {}

    @property
    def remarks(self) -> Mapping[int, tuple[str, ...]]:
        """By number of the valve, sentences on its nodes that are not as configured."""
        return self._remarks

    @property
    def namespaces(self) -> tuple[str, ...]:
        """The NamespaceArray at the first connection; empty before it."""
        return self._before

    def state(self, item: int) -> ItemState:
        """State of one item."""
        return self._states.get(item, _GOOD)[0]

    def accept(self, nodes: CheckedNodes) -> None:
        """Note the nodes as found at a connection; unusable ones are monitored when they return."""
        self._before = self._namespaces = nodes.namespaces
        for node in nodes.monitored:
            self._looked.pop(node.item, None)
            if node.type in NUMERIC_FORMATS:
                self._accepted.setdefault(node.item, int(node.type))
            self.table.takes_booleans[node.item] = self._accepted.get(node.item) in {None, _BOOLEAN}
        for item, sentence in nodes.faults.items():
            if item not in self._wanted:
                continue  # its node is watched as that of another item
            fault = sentence.removeprefix(self._wanted[item].label + " ")
            self._looked[item] = Looked(None, fault, ItemState.GONE)
        self.judge({})

    def start(self, connection: Connection, subscription: Subscription) -> None:
        """Watch over a connection until `stop`."""
        began = self._clock.monotonic()
        self.table.heard[:] = np.maximum(self.table.heard, began)  # it may be silent at first
        self._task = asyncio.create_task(self._watch(connection, subscription))

    async def stop(self) -> None:
        """Stop; safe to call twice."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _watch(self, connection: Connection, subscription: Subscription) -> None:
        turn = 0
        while True:
            await asyncio.sleep(LOOK_S)
            try:
                if turn % _NAMESPACES_EVERY == 0:
                    self._namespaces = tuple(await namespaces_of(connection))
                await self._look(connection, subscription)
            except SourceError:
                pass  # the receiver gets the loss of a connection, too
            turn += 1

    async def _look(self, connection: Connection, subscription: Subscription) -> None:
        chosen = self._chosen()
        looked = await look(
            connection, [self._wanted[item] for item in chosen], self._namespaces, self._before
        )
        now = self._clock.monotonic()
        items = {item.node.item: item for item in subscription.watched.items}
        for item, found in zip(chosen, looked, strict=True):
            before = self._looked.get(item)
            self._looked[item], self._looked_at[item] = found, now
            if found.fault is None and not subscription.waits:
                returned = before is not None and before.state is ItemState.GONE
                await self._follow(
                    subscription, self._wanted[item], found, items, returned=returned
                )
        self.judge(items)

    async def _follow(
        self,
        subscription: Subscription,
        wanted: Wanted,
        found: Looked,
        items: Mapping[int, Item],
        *,
        returned: bool,
    ) -> None:
        """Monitor a usable node again that has no item, or whose item does not report."""
        item, table = wanted.item, self.table
        if item is None or found.node is None:
            return
        quiet = self._clock.monotonic() - table.heard[item] > QUIET_S
        missed = quiet and found.time > table.time[item] + _NEWER_NS
        again, self._missed = missed and item in self._missed, self._missed - {item}
        before = items[item].node if item in items else None
        moved = before is not None and (before.node, before.place) != (found.node, found.place)
        if before is not None and not moved and _read_anew(before.place, found.place):
            subscription.watched.read_as(replace(before, place=found.place))
        if item not in items or moved or (returned and quiet) or again:
            node = MonitoredNode(item, found.node, wanted.label, found.type, found.place)
            try:
                await subscription.watched.monitor_again(node)
            except SourceRejected as error:
                self._looked[item] = Looked(found.node, str(error), ItemState.REFUSED)
                return
            table.forget(item)
            table.heard[item] = self._clock.monotonic()
            _log.info("%s: %s is monitored again", self._settings.url, wanted.label)
        elif missed:
            self._missed.add(item)

    def _chosen(self) -> list[int]:
        """Return the items to read now: newly suspicious ones, known faults, then in turn."""
        now, table = self._clock.monotonic(), self.table
        suspects = table.suspects(now)

        def order(item: int) -> tuple[int, float]:
            at = self._looked_at[item]
            if suspects[item] and at <= table.heard[item] + QUIET_S:
                return 0, at
            return (1 if item in self._states else 2), at

        return sorted(self._wanted, key=order)[:_AT_ONCE]

    def judge(self, items: Mapping[int, Item]) -> None:
        """Set the state of every node, and log each new one."""
        now, table = self._clock.monotonic(), self.table
        shown = table.status >> 31 > 0
        shown |= ~table.is_number | table.still(now) | table.slower()
        seconds = self._settings.sampling_interval_ms
        slow = {n for n, i in items.items() if 0.0 < seconds < i.sampling_ms} if items else set()
        affected = {*np.flatnonzero(shown).tolist(), *self._looked, *self._missed, *slow}
        states = {}
        for item in sorted(affected & self._wanted.keys()):
            found = next(self._found(item, items.get(item), now), _GOOD)
            if found[0] is not ItemState.GOOD:
                states[item] = found
        for item in sorted(states.keys() | self._states.keys()):
            state, words = states.get(item, _GOOD)
            if state is not self.state(item):
                said = f"{self._wanted[item].label} {words or 'is as configured again'}"
                serious = state in _SERIOUS
                _log.log(logging.WARNING if serious else logging.INFO, "%s", said)
        self._states = states
        remarks: dict[int, tuple[str, ...]] = {}
        for item, (_, words) in states.items():
            said = f"{self._wanted[item].label} {words}"
            for valve in {one // PER_VALVE for one in (item, *self._copies.get(item, ()))}:
                remarks[valve] = (*remarks.get(valve, ()), said)
        self._remarks = remarks

    def _found(
        self, item: int, monitored: Item | None, now: float
    ) -> Iterator[tuple[ItemState, str]]:
        """Yield the states that apply, the worst first; words are the end of a sentence."""
        table, looked, url = self.table, self._looked.get(item), self._settings.url
        if looked is not None and looked.fault is not None:
            yield looked.state, looked.fault
        kind, status = int(table.kind[item]), int(table.status[item])
        if not table.is_number[item]:
            name = "Boolean" if kind in NUMERIC_FORMATS else "no number"
            yield ItemState.WRONG_TYPE, f"sends values of type {name} at {url}; they are not used"
        if status >> 31:
            yield ItemState.BAD, f"has the status {status_name(status)} at {url}"
        if item in self._missed:
            yield ItemState.SILENT, f"changes at {url}, but is not reported; is monitored again"
        first, present = self._accepted.get(item), looked.type if looked is not None else None
        if first is not None and present == _BOOLEAN != first:
            yield ItemState.WRONG_TYPE, f"is of type Boolean at {url}; its values are not used"
        if first is not None and present in NUMERIC_FORMATS and present != first:
            names = [ua.VariantType(number).name for number in (first, present)]
            said = f"changed its type from {names[0]} to {names[1]} at {url}"
            yield ItemState.RETYPED, f"{said}; its values are used, check unit and resolution"
        asked = self._settings.sampling_interval_ms
        if monitored is not None and 0.0 < asked < monitored.sampling_ms:
            present_ms = f"{monitored.sampling_ms:g} ms"
            yield ItemState.SLOW, f"is sampled every {present_ms} at {url} instead of {asked:g} ms"
        if table.slower()[item]:
            pace = table.pace(item)
            yield (
                ItemState.SLOW,
                f"sends a value every {pace.now_s:.3g} s, before every {pace.usual_s:.3g} s",
            )
        if table.still(now)[item]:
            rest, before = table.rest(item)
            how = "has sent nothing" if now - table.heard[item] > QUIET_S else "has had one value"
            yield (
                ItemState.STILL,
                f"{how} for {rest} samples, while other signals vary; before, for {before} at most",
            )


def _read_anew(before: int | Member | None, now: int | Member | None) -> bool:
    """Whether the definition of a member's structure was read again, over another connection."""
    if not isinstance(before, Member) or not isinstance(now, Member):
        return False
    return before.structure is not now.structure
