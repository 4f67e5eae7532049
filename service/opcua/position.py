"""Where a subscription stood, as bytes: what a restarted service goes on from."""

import json
from collections.abc import Sequence

from asyncua import ua

from service.opcua.monitored_items import Item
from service.opcua.source_nodes import MonitoredNode
from service.opcua.subscription import Left, Mark

_FORMAT = 1


def position_to_bytes(
    binding: str, mark: Mark, created: ua.CreateSubscriptionResult, items: Sequence[Item]
) -> bytes:
    """Pack a position; ``binding`` names server, user and nodes that it belongs to."""
    kept = {
        "format": _FORMAT,
        "binding": binding,
        "subscription": mark.subscription,
        "message": mark.message,
        "publishing_interval_ms": created.RevisedPublishingInterval,
        "keep_alive_count": created.RevisedMaxKeepAliveCount,
        "items": [(item.node.item, item.number, item.queue_size) for item in items],
    }
    return json.dumps(kept).encode()


def left_at(position: bytes, binding: str, nodes: Sequence[MonitoredNode]) -> Left | None:
    """What there is to take over at a position; None if it is damaged or belongs to others."""
    by_item = {node.item: node for node in nodes}
    try:
        kept = json.loads(position)
        if kept["format"] != _FORMAT or kept["binding"] != binding:
            return None
        interval, count = float(kept["publishing_interval_ms"]), int(kept["keep_alive_count"])
        message = int(kept["message"])
        if not (interval > 0.0 and count > 0 and 0 < message < 2**32):
            return None
        return Left(
            ua.CreateSubscriptionResult(
                SubscriptionId=int(kept["subscription"]),
                RevisedPublishingInterval=interval,
                RevisedMaxKeepAliveCount=count,
            ),
            next_message=message + 1 if message < 2**32 - 1 else 1,
            acknowledgements=(),
            buffer=(),
            items=tuple(
                Item(by_item[item], int(number), int(queue))
                for item, number, queue in kept["items"]
            ),
            kept_back=(),
            handed_out=message,
        )
    except (ValueError, KeyError, TypeError):
        return None
