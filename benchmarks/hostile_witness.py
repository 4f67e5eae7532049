"""The second client: reads and subscribes while others attack, and reports its delays.

``python -m benchmarks.hostile_witness URL operator|anybody``; each line on stdin ends a phase and
is answered with a line of JSON.
"""

import asyncio
import json
import math
import sys
import time
from itertools import pairwise
from statistics import median

from asyncua import Client

PAUSE_S, PATIENCE_S = 0.01, 4.0
PERIOD_S = 0.1
NODE = "ns=2;s=Plant.Counter"
USER, PASSWORD = "operator", "correct horse"


class Counting:
    def __init__(self):
        self.numbers = []
        self.times = []

    def datachange_notification(self, _, value, __):
        self.numbers.append(value)
        self.times.append(time.perf_counter())


async def read_for_ever(node, waits):
    while True:
        began = time.perf_counter()
        try:
            async with asyncio.timeout(PATIENCE_S):
                await node.read_value()
        except Exception:  # noqa: BLE001 - whatever it is, the client was not served
            waits.append(max(PATIENCE_S, time.perf_counter() - began))
            await asyncio.sleep(0.2)
            continue
        waits.append(time.perf_counter() - began)
        await asyncio.sleep(PAUSE_S)


def gap_ms(times):
    """Longest time between two notifications of a counter, beyond the counter's own."""
    longest = max((b - a for a, b in pairwise(times)), default=math.inf)
    return 1e3 * (longest - PERIOD_S)


async def witness(url, who):
    loop = asyncio.get_running_loop()
    counting, waits = Counting(), []
    client = Client(url, timeout=PATIENCE_S)
    if who == "operator":
        client.set_user(USER)
        client.set_password(PASSWORD)
    async with client:
        node = client.get_node(NODE)
        subscription = await client.create_subscription(50, counting)
        await subscription.subscribe_data_change(node, queuesize=1_000)
        await asyncio.sleep(0.3)
        counting.numbers.clear()
        counting.times.clear()
        reading = asyncio.create_task(read_for_ever(node, waits))
        print("ready", flush=True)
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            settle = float(line)
            await asyncio.sleep(settle)  # for pending requests
            numbers = counting.numbers
            print(
                json.dumps(
                    {
                        "reads": len(waits),
                        "median_ms": 1e3 * median(waits) if waits else None,
                        "worst_ms": 1e3 * max(waits, default=0.0),
                        "first": numbers[0] if numbers else None,
                        "last": numbers[-1] if numbers else None,
                        "got": len(set(numbers)),
                        "gap_ms": gap_ms(counting.times),
                    }
                ),
                flush=True,
            )
            waits.clear()
            del numbers[:-1]  # the last one again, so that a gap between phases shows
            del counting.times[:-1]
        reading.cancel()


if __name__ == "__main__":
    asyncio.run(witness(*sys.argv[1:]))
