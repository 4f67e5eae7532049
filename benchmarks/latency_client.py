"""A client that timestamps each notification.

``python -m benchmarks.latency_client WHOSE URL INTERVAL SECONDS``, WHOSE being ``ours`` or
``asyncua``. Prints the median, the 99th percentile and the largest of the times from
SourceTimestamp to here, ms, and how many results came.
"""

import asyncio
import gc
import sys
import time
from datetime import UTC

import numpy as np
from asyncua import Client, Node, ua

from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes

SETTLING_S = 2.0


class Handler:
    """Notes how old each result is."""

    def __init__(self) -> None:
        self.ages: list[float] = []

    def datachange_notification(self, _node: Node, _value: float, data: object) -> None:
        """Take one result."""
        then = data.monitored_item.Value.SourceTimestamp.replace(tzinfo=UTC)
        self.ages.append(1e3 * (time.time() - then.timestamp()))


async def ours(url: str, interval_ms: float, seconds: float) -> list[float]:
    """Ages of all results, ms, at our own client."""
    names = ("PredictedFlow", "Residual", "ResidualRmse", "NoiseStd")
    nodes = (f"nsu=urn:valvemap:service;s=Valvistor.RLS.{name}" for name in names)
    settings = SourceSettings(url, publishing_interval_ms=interval_ms)
    source = OpcUaSource(settings, [ValveNodes("Valvistor", *nodes, insist=True)])
    ages: list[float] = []
    await source.connect()
    try:
        begin = time.perf_counter() + SETTLING_S
        while time.perf_counter() < begin + seconds:
            changes = await source.receive()
            if time.perf_counter() >= begin:
                first = changes.item == changes.item[0]
                ages += (1e-6 * (time.time_ns() - changes.source_time[first])).tolist()
    finally:
        await source.close()
    return ages


async def plain(url: str, interval_ms: float, seconds: float) -> list[float]:
    """Ages of all results, ms, at asyncua's client."""
    handler = Handler()
    async with Client(url) as client:
        index = await client.get_namespace_index("urn:valvemap:service")
        node = client.get_node(ua.NodeId("Valvistor.RLS.PredictedFlow", index))
        subscription = await client.create_subscription(interval_ms, handler)
        await subscription.subscribe_data_change(node, queuesize=1000, sampling_interval=0)
        await asyncio.sleep(SETTLING_S)
        gc.collect()
        gc.freeze()  # else this client's garbage collection is measured
        handler.ages.clear()
        await asyncio.sleep(seconds)
        return list(handler.ages)


if __name__ == "__main__":
    whose, url, *numbers = sys.argv[1:]
    ages = asyncio.run({"ours": ours, "asyncua": plain}[whose](url, *map(float, numbers)))
    print(*np.percentile(ages, [50, 99, 100]), len(ages))
