"""Three valves behind one flow meter over OPC UA: connected, served, and refused where in doubt."""

import asyncio
import time
from contextlib import suppress

import pytest
from asyncua import Client, ua

from benchmarks.shared_meter import VALVES, flow, work
from guarded_opcua import HardenedServer, ServerSettings, add_object, add_variable
from valvemap.app.build import build_identification
from valvemap.app.serve import serve
from valvemap.config.loading import load_config

pytestmark = pytest.mark.waits

RATE_HZ = 250.0
NODES = ("U", "p1", "p2")


class Plant:
    """Publishes machine work of the valves and the sum of their flows."""

    def __init__(self, server, variables, rows):
        self.server, self.variables, self.rows = server, variables, rows

    @classmethod
    async def create(cls, rows):
        server = await HardenedServer.create(
            ServerSettings(
                url="opc.tcp://127.0.0.1:0/plant/",
                application_uri="urn:test:plant",
                application_name="plant",
                namespace_uri="urn:plant",
                none_on_loopback=True,
            )
        )
        folder = await add_object(server, None, "Press")
        names = [f"{valve}.{name}" for valve in VALVES for name in NODES]
        variables = [
            await add_variable(server, folder, name, None, type=ua.VariantType.Double)
            for name in (*names, "Q")
        ]
        return cls(server, variables, rows)

    async def play(self):
        own = [self.rows[valve][name] for valve in VALVES for name in NODES]
        own.append(sum(one["flow"] for one in self.rows.values()))
        began, t0, written = time.monotonic(), time.time_ns(), 0
        while True:
            due = int((time.monotonic() - began) * RATE_HZ)
            for k in range(written, due):
                t = t0 + round(k * 1e9 / RATE_HZ)
                self.server.write(
                    (variable, float(values[k % len(values)]), 0, t)
                    for variable, values in zip(self.variables, own, strict=True)
                )
            written = due
            await asyncio.sleep(0.01)


def toml():
    text = ""
    for name in VALVES:
        nodes = "\n".join(f'{n} = "nsu=urn:plant;s={name}.{n}"' for n in NODES)
        text += f'[[valves]]\nname = "{name}"\n[valves.nodes]\n{nodes}\nQ = "nsu=urn:plant;s=Q"\n'
        text += '[[valves.estimators]]\nkind = "RLS"\n'
    return text


async def test_each_valve_s_own_flow_is_served(config, open_server, tmp_path):
    plant = await Plant.create(work(3, 120.0))
    file = tmp_path / "meter.toml"
    file.write_text(toml())
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
                    min(identification.valves.lane(name, "RLS").count for name in VALVES) > 4_000
                ):
                    await asyncio.sleep(0.1)
                await asked(config)
        finally:
            playing.cancel()
            stop.set()
            await serving
            with suppress(asyncio.CancelledError):
                await playing


async def asked(config):
    async with Client(config.server.url) as client:
        index = await client.get_namespace_index("urn:valvemap:service")
        compared = 0
        while compared < 3 * len(VALVES):  # of samples that are not of one moment, none counts
            for name in VALVES:
                nodes = [
                    client.get_node(ua.NodeId(f"{name}.Signals.{signal}", index))
                    for signal in ("U", "dp", "Q")
                ]
                read = await client.read_attributes(nodes, ua.AttributeIds.Value)
                if (
                    len({one.SourceTimestamp for one in read}) > 1
                    or not read[2].StatusCode.is_good()
                ):
                    continue
                U, dp, Q = (one.Value.Value for one in read)
                assert pytest.approx(float(flow(name, U, dp)), abs=3.0) == Q
                compared += 1
            await asyncio.sleep(0.05)
