"""The state that a closed source transfers to its successor, which may have other valves."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from valvemap.opcua_client.connection import Ticket
from valvemap.opcua_source.history import Knowledge
from valvemap.opcua_source.received import Left, Part, Tally
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.vocabulary.signals import PER_VALVE


@dataclass(frozen=True)
class Estate:
    """The state of a source when it is closed.

    Attributes
    ----------
    valves
        The valves that define the item numbers.
    knowledge, parts
        The last time known of each item, and the changes received since.
    tally, ticket, left, left_at
        Counters, session and subscription, and the time of the disconnection (monotonic, s).
    surplus
        Ids of monitored items that are no longer needed.
    """

    valves: tuple[ValveNodes, ...]
    knowledge: Knowledge
    parts: tuple[Part, ...]
    tally: Tally
    ticket: Ticket | None
    left: Left | None
    left_at: float
    surplus: tuple[int, ...] = ()


def divided(estate: Estate, valves: Sequence[ValveNodes]) -> Estate:
    """Return the part for these valves: signals of the same name and node, renumbered."""
    ours = {key: item for item, key in _keys(valves)}
    item_of = np.full(len(estate.knowledge.known_to), -1, np.int32)
    for item, key in _keys(estate.valves):
        item_of[item] = ours.get(key, -1)
    both = item_of >= 0
    knowledge = Knowledge(len(valves) * PER_VALVE)
    knowledge.known_to[item_of[both]] = estate.knowledge.known_to[both]
    knowledge.doubtful[item_of[both]] = estate.knowledge.doubtful[both]
    left, surplus = estate.left, estate.surplus
    if left is not None:
        surplus += tuple(i.number for i in left.items if item_of[i.node.item] < 0)
        items = tuple(
            replace(i, node=replace(i.node, item=int(item_of[i.node.item])))
            for i in left.items
            if item_of[i.node.item] >= 0
        )
        left = replace(left, items=items)
    return replace(
        estate,
        valves=tuple(valves),
        knowledge=knowledge,
        parts=tuple(_of(part, item_of) for part in estate.parts),
        left=left,
        surplus=surplus,
    )


def _of(part: Part, item_of: NDArray[np.int32]) -> Part:
    item = item_of[part.changes.item]
    return replace(part, changes=replace(part.changes, item=item)[item >= 0])


def _keys(valves: Sequence[ValveNodes]) -> Iterator[tuple[int, tuple[object, ...]]]:
    """Yield the items of the given valves, each with the key that identifies it."""
    for number, valve in enumerate(valves):
        for signal, _, text in valve.signals():
            yield number * PER_VALVE + signal, (valve.valve, signal, text)
