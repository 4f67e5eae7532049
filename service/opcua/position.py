"""How far a source was heard, as bytes: what a restarted service goes on from."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from service.opcua.monitored_items import Item
from service.opcua.source_nodes import MonitoredNode
from service.opcua.subscription import Left

_FORMAT = 2


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
    """What a restarted service knows: what there is to take over, and the last time by item."""

    left: Left | None
    known_to: NDArray[np.int64]


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


def position_from_bytes(
    position: bytes, binding: str, nodes: Sequence[MonitoredNode], items: int
) -> Position | None:
    """Unpack a position; None if it is damaged or belongs to others."""
    try:
        kept = json.loads(position)
        if kept["format"] != _FORMAT or kept["binding"] != binding:
            return None
        known_to = np.array(kept["known_to"], np.int64)
        if known_to.shape != (items,):
            return None
        return Position(_left(kept["subscription"], nodes), known_to)
    except (ValueError, KeyError, TypeError, OverflowError):
        return None


def _left(kept: dict[str, Any] | None, nodes: Sequence[MonitoredNode]) -> Left | None:
    if kept is None:
        return None
    by_item = {node.item: node for node in nodes}
    interval, count = float(kept["publishing_interval_ms"]), int(kept["keep_alive_count"])
    message = int(kept["message"])
    if not (interval > 0.0 and count > 0 and 0 < message < 2**32):
        return None
    return Left(
        ua.CreateSubscriptionResult(
            SubscriptionId=int(kept["number"]),
            RevisedPublishingInterval=interval,
            RevisedMaxKeepAliveCount=count,
        ),
        next_message=message + 1 if message < 2**32 - 1 else 1,
        acknowledgements=(),
        buffer=(),
        items=tuple(
            Item(by_item[item], int(number), int(queue), int(handle))
            for item, number, queue, handle in kept["items"]
        ),
        kept_back=(),
    )
