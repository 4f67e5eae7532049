"""A valve with ports over OPC UA: four edges, two lines, and the inverse of a line's flow."""

import asyncio

import numpy as np
import pytest
from asyncua import ua

from support import ports
from support.played_plant import PlayedPlant, served
from support.served import patient

pytestmark = pytest.mark.waits

RATE_HZ = 500.0


async def test_edges_and_lines_are_served(config, open_server, tmp_path):
    recorded = ports.recording(seconds=120.0)
    plant = await PlayedPlant.create({f"V.{name}": recorded[name] for name in ports.NODES}, RATE_HZ)
    file = tmp_path / "ports.toml"
    file.write_text(ports.toml())
    edges = ("V.PA", "V.AT", "V.PB", "V.BT")
    async with served(plant, config, file, open_server, edges, 1_000) as identification:
        await asked(config)
        for number in range(len(identification.plans)):
            assert identification.results.counters(number)["duplicates"] == 0


async def asked(config):
    async with patient(config.server.url) as client:
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
        operator = await node("V.LineA.Inverse.FlowDemand").get_child("0:EURange")
        assert (await operator.read_value()).Low == -200.0
