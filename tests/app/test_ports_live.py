"""A valve with ports over OPC UA: four edges, two lines, and the inverse of a line's flow."""

import asyncio
import time
from contextlib import suppress

import numpy as np
import pytest
from asyncua import Client, ua

from guarded_opcua import HardenedServer, ServerSettings, add_object, add_variable
from support import ports
from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.config.loading import load_config

pytestmark = pytest.mark.waits

RATE_HZ = 500.0


class Plant:
    """Publishes a recording of a valve with ports, quicker than it was recorded."""

    def __init__(self, server, variables, recorded):
        self.server, self.variables, self.recorded = server, variables, recorded

    @classmethod
    async def create(cls, recorded):
        server = await HardenedServer.create(
            ServerSettings(
                url="opc.tcp://127.0.0.1:0/plant/",
                application_uri="urn:test:plant",
                application_name="plant",
                namespace_uri="urn:plant",
                none_on_loopback=True,
            )
        )
        folder = await add_object(server, None, "V")
        variables = [
            await add_variable(server, folder, f"V.{name}", None, type=ua.VariantType.Double)
            for name in ports.NODES
        ]
        return cls(server, variables, recorded)

    async def play(self):
        began, t0, written = time.monotonic(), time.time_ns(), 0
        n = len(self.recorded["t"])
        while True:
            due = int((time.monotonic() - began) * RATE_HZ)
            for k in range(written, due):
                t = t0 + round(k * 1e9 / RATE_HZ)
                values = (float(self.recorded[name][k % n]) for name in ports.NODES)
                self.server.write(
                    (one, value, 0, t) for one, value in zip(self.variables, values, strict=True)
                )
            written = due
            await asyncio.sleep(0.01)


async def test_edges_and_lines_are_served(config, open_server, tmp_path):
    plant = await Plant.create(ports.recording(seconds=120.0))
    file = tmp_path / "ports.toml"
    file.write_text(ports.toml())
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
                edges = ("V.PA", "V.AT", "V.PB", "V.BT")
                while not serving.done() and not (  # noqa: ASYNC110 - no event
                    min(identification.valves.lane(edge, "RLS").count for edge in edges) > 1_000
                ):
                    await asyncio.sleep(0.1)
                await asked(config)
                for number in range(len(identification.plans)):
                    assert identification.results.counters(number)["duplicates"] == 0
        finally:
            playing.cancel()
            stop.set()
            await serving
            with suppress(asyncio.CancelledError):
                await playing


async def asked(config):
    async with Client(config.server.url) as client:
        index = await client.get_namespace_index("urn:valvemap:service")

        def node(name):
            return client.get_node(ua.NodeId(name, index))

        async def value(name):
            """Return a value, though it be old: a busy machine is late."""
            return (await node(name).read_data_value(raise_on_bad_status=False)).Value.Value

        for edge in ports.GAINS:
            assert await value(f"V.{edge}.RLS.SampleCount") > 500
            assert await value(f"V.{edge}.Signals.U") >= 0.0
        for line in ("A", "B"):
            leakage = await value(f"V.Line{line}.Leakage")
            std = await value(f"V.Line{line}.LeakageStd")
            assert leakage == pytest.approx(ports.LEAKAGE, rel=0.2)
            assert 0.0 < std < 0.2 * ports.LEAKAGE
        children = await node("V.LineA.Inverse").get_children()
        names = {(await child.read_browse_name()).Name for child in children}
        wanted = {"FlowDemand", "Edge", "RequiredU", "RequiredULower", "RequiredUUpper"}
        assert wanted | {"RequiredUStatus"} <= names
        meaning = await node("V.LineA.Inverse.Edge").get_child("0:EnumStrings")
        assert [text.Text for text in await meaning.read_value()] == ["NONE", *ports.GAINS]
        for Q in (20.0, -20.0):
            status = None
            while status != 0:  # the samples must surround the demand first
                U, lower, upper, status = await node("V.LineA.Inverse").call_method(
                    ua.NodeId("V.LineA.Inverse.Invert", index), Q, 80.0, 40.0
                )
                await asyncio.sleep(0.1)
            assert np.sign(U) == np.sign(Q)
            assert lower < U < upper
