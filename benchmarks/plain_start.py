"""The least that a server of asyncua is: one variable. Prints a line when it listens."""

import asyncio
import sys

from asyncua import Server


async def run(url: str) -> None:
    """Start, say so, stop."""
    server = Server()
    await server.init()
    server.set_endpoint(url)
    index = await server.register_namespace("urn:plain")
    await server.nodes.objects.add_variable(index, "Value", 0.0)
    async with server:
        print(url, flush=True)


if __name__ == "__main__":
    asyncio.run(run(sys.argv[1]))
