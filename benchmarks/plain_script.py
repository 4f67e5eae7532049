"""A user's script: asyncua's client, padasip's filter, one sample at a time.

``python -m benchmarks.plain_script URL VALVE,… SECONDS`` prints how many notifications of the
virtual rig's open endpoint it processes per second.
"""

import asyncio
import sys
import time

import numpy as np
import padasip
from asyncua import Client, Node, ua

SIGNALS = "U", "p1", "p2", "Q", "Temperature"
SETTLING_S = 3.0


class Handler:
    """Puts signals of equal time together and adapts the valve's filter."""

    def __init__(self) -> None:
        self.notifications = 0
        self._filters: dict[str, padasip.filters.FilterRLS] = {}
        self._samples: dict[tuple[str, object], dict[str, float]] = {}

    def datachange_notification(self, node: Node, value: float, data: object) -> None:
        """Take one signal of one valve."""
        self.notifications += 1
        valve, _, signal = node.nodeid.Identifier.rpartition(".")
        time_ = data.monitored_item.Value.SourceTimestamp
        sample = self._samples.setdefault((valve, time_), {})
        sample[signal] = value
        if len(sample) == len(SIGNALS):
            del self._samples[valve, time_]
            self._adapt(valve, **sample)

    def _adapt(self, valve: str, U: float, p1: float, p2: float, Q: float, **_: float) -> None:
        if valve not in self._filters:
            self._filters[valve] = padasip.filters.FilterRLS(n=5, mu=0.998)
        s = np.sqrt(max(p1 - p2, 0.0))
        self._filters[valve].adapt(Q, np.array([1.0, U, s, U * s, p1 - p2]))


async def run(url: str, valves: list[str], seconds: float) -> float:
    """Notifications per second, once it is under way."""
    handler = Handler()
    async with Client(url) as client:
        index = await client.get_namespace_index("urn:valvemap:rig")
        nodes = [client.get_node(ua.NodeId(f"{v}.{s}", index)) for v in valves for s in SIGNALS]
        subscription = await client.create_subscription(100, handler)
        await subscription.subscribe_data_change(nodes, queuesize=1000, sampling_interval=0)
        await asyncio.sleep(SETTLING_S)
        began, before = time.perf_counter(), handler.notifications
        await asyncio.sleep(seconds)
        return (handler.notifications - before) / (time.perf_counter() - began)


if __name__ == "__main__":
    print(asyncio.run(run(sys.argv[1], sys.argv[2].split(","), float(sys.argv[3]))))
