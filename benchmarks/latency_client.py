"""A client that looks at the clock: ``python -m benchmarks.latency_client URL INTERVAL SECONDS``.

Prints the median, the 99th percentile and the largest of the times from SourceTimestamp to here,
ms, and how many results came.
"""

import asyncio
import gc
import sys
import time
from datetime import UTC

import numpy as np
from asyncua import Client, Node, ua

SETTLING_S = 2.0


class Handler:
    """Notes how old each result is."""

    def __init__(self) -> None:
        self.ages: list[float] = []

    def datachange_notification(self, _node: Node, _value: float, data: object) -> None:
        """Take one result."""
        then = data.monitored_item.Value.SourceTimestamp.replace(tzinfo=UTC)
        self.ages.append(1e3 * (time.time() - then.timestamp()))


async def run(url: str, interval_ms: float, seconds: float) -> list[float]:
    """Ages of all results, ms."""
    handler = Handler()
    async with Client(url) as client:
        index = await client.get_namespace_index("urn:valvemap:service")
        node = client.get_node(ua.NodeId("Valvistor.RLS.PredictedFlow", index))
        subscription = await client.create_subscription(interval_ms, handler)
        await subscription.subscribe_data_change(node, queuesize=1000, sampling_interval=0)
        await asyncio.sleep(SETTLING_S)
        gc.collect()
        gc.freeze()  # what is measured is not this client's garbage collection
        handler.ages.clear()
        await asyncio.sleep(seconds)
        return list(handler.ages)


if __name__ == "__main__":
    ages = asyncio.run(run(sys.argv[1], *(float(x) for x in sys.argv[2:])))
    print(*np.percentile(ages, [50, 99, 100]), len(ages))
