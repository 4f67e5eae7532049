"""How far a source was heard, as bytes: what a restarted service goes on from."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.opcua_source.monitored_items import Item
from valvemap.opcua_source.source_nodes import MonitoredNode
from valvemap.opcua_source.subscription import Left

_FORMAT = 2
_LARGEST = 2**32 - 1  # of OPC UA's numbers
_LONGEST_MS = 1e7  # between two messages


@dataclass(frozen=True)
class Mark:
    """How far changes were handed out: the last message, and of each item the last time.

    ``subscription`` is 0 while nothing of the present one was.
    """

    subscription: int
    message: int
    known_to: NDArray[np.int64]


@dataclass(frozen=True)
class Position:
    """What a restarted service knows: the last time by item, and what there is to take over."""

    known_to: NDArray[np.int64]
    subscription: "Kept | None"

    def left(self, nodes: Sequence[MonitoredNode]) -> Left | None:
        """What there is to take over, with the nodes that the server has now."""
        kept, by_item = self.subscription, {node.item: node for node in nodes}
        if kept is None or any(item not in by_item for item, *_ in kept.items):
            return None
        return Left(
            ua.CreateSubscriptionResult(
                SubscriptionId=kept.number,
                RevisedPublishingInterval=kept.publishing_interval_ms,
                RevisedMaxKeepAliveCount=kept.keep_alive_count,
            ),
            next_message=kept.message + 1 if kept.message < _LARGEST else 1,
            acknowledgements=(),
            buffer=(),
            items=tuple(Item(by_item[item], *rest) for item, *rest in kept.items),
            kept_back=(),
        )


@dataclass(frozen=True)
class Kept:
    """A subscription; ``items`` are item, number, queue size and handle of each."""

    number: int
    message: int
    publishing_interval_ms: float
    keep_alive_count: int
    items: tuple[tuple[int, int, int, int], ...]


def position_to_bytes(
    binding: str, mark: Mark, created: ua.CreateSubscriptionResult | None, items: Sequence[Item]
) -> bytes:
    """Pack a position; ``binding`` names server, user and nodes that it belongs to.

    ``created`` is None where there is nothing to take over.
    """
    kept = {
        "format": _FORMAT,
        "binding": binding,
        "known_to": mark.known_to.tolist(),
        "subscription": None
        if created is None
        else {
            "number": mark.subscription,
            "message": mark.message,
            "publishing_interval_ms": created.RevisedPublishingInterval,
            "keep_alive_count": created.RevisedMaxKeepAliveCount,
            "items": [
                (item.node.item, item.number, item.queue_size, item.handle) for item in items
            ],
        },
    }
    return json.dumps(kept).encode()


def position_from_bytes(position: bytes, binding: str, items: int, latest: int) -> Position | None:
    """Unpack a position; None if it is damaged, belongs to others or cannot be.

    ``items`` is how many items there may be, ``latest`` the newest time that one can have, UTC ns.
    """
    try:
        kept = json.loads(position)
        if kept["format"] != _FORMAT or kept["binding"] != binding:
            return None
        known_to = np.array(kept["known_to"], np.int64)
        if known_to.shape != (items,) or (known_to > latest).any():
            return None
        return Position(known_to, _subscription(kept["subscription"], items))
    except (ValueError, KeyError, TypeError, OverflowError):
        return None


def _subscription(kept: dict[str, Any] | None, items: int) -> Kept | None:
    if kept is None:
        return None
    rows = tuple(tuple(map(int, row)) for row in kept["items"])
    found = Kept(
        int(kept["number"]),
        int(kept["message"]),
        float(kept["publishing_interval_ms"]),
        int(kept["keep_alive_count"]),
        tuple((item, number, queue, handle) for item, number, queue, handle in rows),
    )
    numbers = (found.number, found.message, *(n for _, *rest in rows for n in rest))
    if not (
        all(0 <= n <= _LARGEST for n in numbers)
        and found.message > 0
        and 0.0 < found.publishing_interval_ms < _LONGEST_MS
        and 0 < found.keep_alive_count <= _LARGEST
        and all(0 <= item < items for item, *_ in rows)
        and len({item for item, *_ in rows}) == len(rows)
    ):
        raise ValueError("no subscription is like this")
    return found
