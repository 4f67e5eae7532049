"""A service in this process, and a client of one valve or axis of it."""

import asyncio
from contextlib import suppress

from asyncua import Client, ua

PASSWORD = "correct horse"
PATIENCE_S = 30.0  # of a client in one process with its server, on a busy machine


def patient(url):
    """Return a client that does not take a busy event loop for a lost connection."""
    return Client(url, timeout=PATIENCE_S, watchdog_intervall=PATIENCE_S)


class Seen:
    """What a client sees of a valve or axis."""

    def __init__(self, client, index, owner):
        self.client, self.index, self.owner = client, index, owner

    def node(self, name):
        return self.client.get_node(ua.NodeId(f"{self.owner}.{name}", self.index))

    async def value(self, name):
        """A value, though it be old: a busy machine is late."""
        return (await self.node(name).read_data_value(raise_on_bad_status=False)).Value.Value

    async def until(self, name, is_so):
        while not is_so(await self.value(name)):  # noqa: ASYNC110 - no event
            await asyncio.sleep(0.1)


class serving:  # noqa: N801 - a context
    """Runs ``serve`` with a configuration; ``first`` is a variable that has a value at once."""

    def __init__(self, serve, config, settings, owner, first):
        self.start = lambda: serve(config, self.stop, settings)
        self.url, self.owner, self.first = config.server.url, owner, first
        self.stop = asyncio.Event()

    async def __aenter__(self):
        self.task = asyncio.ensure_future(self.start())
        async with asyncio.timeout(60):
            while True:
                if self.task.done():
                    self.task.result()
                with suppress(OSError, ua.UaError, asyncio.TimeoutError):
                    self.client = patient(self.url)
                    self.client.set_user("operator")
                    self.client.set_password(PASSWORD)
                    await self.client.connect()
                    index = await self.client.get_namespace_index("urn:valvemap:service")
                    seen = Seen(self.client, index, self.owner)
                    if await seen.value(self.first) is not None:
                        return seen
                    await self.client.disconnect()
                await asyncio.sleep(0.2)

    async def __aexit__(self, *_):
        with suppress(Exception):
            await self.client.disconnect()
        self.stop.set()
        await self.task
