"""The servers of the rig and of the service, as clients that walk them find them."""

import asyncio
from contextlib import asynccontextmanager, suppress

from guarded_opcua import ServerSettings
from support.interoperation import raised
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.server import RigServer


@asynccontextmanager
async def rig(_):
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/rig/",
        application_uri="urn:test:rig",
        application_name="rig",
        namespace_uri="urn:valvemap:rig",
        none_on_loopback=True,
    )
    async with await RigServer.create(settings, BUILTIN["demo"]) as server:
        playing = asyncio.create_task(server.run())
        yield server.url
        playing.cancel()
        with suppress(asyncio.CancelledError):
            await playing


@asynccontextmanager
async def service(folder):
    async with raised(folder, none_on_loopback=True) as stage:
        yield stage.server.url
