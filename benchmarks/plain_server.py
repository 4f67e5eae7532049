"""The rig that a user would write with asyncua's server: every signal of every valve, in a loop.

``python -m benchmarks.plain_server URL VALVES`` writes as fast as it can; it prints the URL when
it listens, and ends when its input does.
"""

import asyncio
import sys
from datetime import UTC, datetime

from asyncua import Server, ua

SIGNALS = "U", "p1", "p2", "Q", "Temperature"


async def run(url: str, valves: list[str]) -> None:
    """Serve until the input ends."""
    server = Server()
    await server.init()
    server.set_endpoint(url)
    index = await server.register_namespace("urn:valvemap:rig")
    variables = [
        await server.nodes.objects.add_variable(
            ua.NodeId(f"{valve}.{signal}", index), f"{valve}.{signal}", 0.0
        )
        for valve in valves
        for signal in SIGNALS
    ]
    async with server:
        print(url, flush=True)
        over = asyncio.ensure_future(asyncio.to_thread(sys.stdin.read))
        k = 0
        while not over.done():
            now = datetime.now(UTC)
            for variable in variables:
                k += 1
                value = ua.Variant(50.0 + k % 40, ua.VariantType.Double)
                await variable.write_value(ua.DataValue(value, SourceTimestamp=now))
            await asyncio.sleep(0)


if __name__ == "__main__":
    asyncio.run(run(sys.argv[1], sys.argv[2].split(",")))
