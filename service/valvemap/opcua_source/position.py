"""The position in a source's data as bytes, from which a restarted service resumes."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.monitored_items import Item
from valvemap.opcua_source.received import Left

_FORMAT = 2
_LARGEST = 2**32 - 1  # largest UInt32
_LONGEST_MS = 1e7  # longest publishing interval


@dataclass(frozen=True)
class Mark:
    """The position of the last returned changes: the last message, and the last time by item.

    ``subscription`` is 0 before the first change of the current subscription. ``started`` is the
    start time of the server that sent them, UTC ns; 0: unknown.
    """

    subscription: int
    message: int
    known_to: NDArray[np.int64]
    started: int


@dataclass(frozen=True)
class Position:
    """A restored position: the last time by item, and the subscription to resume, if any.

    ``started`` is the start time of the server then, UTC ns; 0: unknown.
    """

    known_to: NDArray[np.int64]
    started: int
    subscription: "Kept | None"

    def left(self, nodes: Sequence[MonitoredNode]) -> Left | None:
        """Return the subscription to resume, with the server's current nodes; None if none."""
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
    """A stored subscription; each of ``items`` is item, id, queue size and client handle."""

    number: int
    message: int
    publishing_interval_ms: float
    keep_alive_count: int
    items: tuple[tuple[int, int, int, int], ...]


def position_to_bytes(
    binding: str, mark: Mark, created: ua.CreateSubscriptionResult | None, items: Sequence[Item]
) -> bytes:
    """Encode a position; ``binding`` identifies the server, user and nodes that it belongs to.

    ``created`` is None if there is no subscription to resume.
    """
    kept = {
        "format": _FORMAT,
        "binding": binding,
        "known_to": mark.known_to.tolist(),
        "started": mark.started,
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
    """Decode a position; None if it is damaged, invalid or belongs to another source.

    ``items`` is the number of items, ``latest`` the latest valid time, UTC ns.
    """
    try:
        kept = json.loads(position)
        if kept["format"] != _FORMAT or kept["binding"] != binding:
            return None
        known_to = np.array(kept["known_to"], np.int64)
        if known_to.shape != (items,) or (known_to > latest).any():
            return None
        started = int(kept.get("started", 0))  # not in positions up to 0.2.0
        return Position(known_to, started, _subscription(kept["subscription"], items))
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
