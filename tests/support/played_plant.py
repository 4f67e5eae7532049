"""A plant that plays recorded columns over OPC UA, and a service that serves it for a while."""

import asyncio
import time
from contextlib import asynccontextmanager, suppress

from asyncua import ua

from guarded_opcua import HardenedServer, add_object, add_variable
from support.plant_server import plant_settings
from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.config.loading import load_config


class PlayedPlant:
    """Publishes columns (N,) by node name in namespace urn:plant, over and over."""

    def __init__(self, server, variables, columns, rate_hz):
        self.server, self.variables, self.columns = server, variables, columns
        self.rate_hz = rate_hz

    @classmethod
    async def create(cls, columns, rate_hz):
        server = await HardenedServer.create(plant_settings())
        folder = await add_object(server, None, "Plant")
        variables = [
            await add_variable(server, folder, name, None, type=ua.VariantType.Double)
            for name in columns
        ]
        return cls(server, variables, list(columns.values()), rate_hz)

    async def play(self):
        began, t0, written = time.monotonic(), time.time_ns(), 0
        while True:
            due = int((time.monotonic() - began) * self.rate_hz)
            for k in range(written, due):
                t = t0 + round(k * 1e9 / self.rate_hz)
                self.server.write(
                    (variable, float(column[k % len(column)]), 0, t)
                    for variable, column in zip(self.variables, self.columns, strict=True)
                )
            written = due
            await asyncio.sleep(0.01)


@asynccontextmanager
async def served(plant, config, file, open_server, valves, samples):
    """Serve the valves of a configuration file; enter once each of some has so many samples."""
    async with plant.server:
        config = config.model_copy(
            update={
                "valves": load_config(file).valves,
                "source": config.source.model_copy(update={"url": plant.server.url}),
            }
        )
        identification, stop = build_identification(config), asyncio.Event()
        playing = asyncio.ensure_future(plant.play())
        serving = asyncio.ensure_future(serve(config, stop, open_server, identification))
        try:
            async with asyncio.timeout(200):
                while not serving.done() and not (  # noqa: ASYNC110 - no event
                    min(identification.valves.lane(one, "RLS").count for one in valves) > samples
                ):
                    await asyncio.sleep(0.1)
                yield identification
        finally:
            playing.cancel()
            stop.set()
            await serving
            with suppress(asyncio.CancelledError):
                await playing
