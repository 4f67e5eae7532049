"""Three valves behind one flow meter over OPC UA: connected, served, and refused where in doubt."""

import asyncio

import pytest
from asyncua import ua

from benchmarks.shared_meter import VALVES, flow, work
from support.played_plant import PlayedPlant, served
from support.served import patient

pytestmark = pytest.mark.waits

RATE_HZ = 250.0
NODES = ("U", "p1", "p2")


def columns(rows):
    own = {f"{valve}.{name}": rows[valve][name] for valve in VALVES for name in NODES}
    return own | {"Q": sum(one["flow"] for one in rows.values())}


def toml():
    text = ""
    for name in VALVES:
        nodes = "\n".join(f'{n} = "nsu=urn:plant;s={name}.{n}"' for n in NODES)
        text += f'[[valves]]\nname = "{name}"\n[valves.nodes]\n{nodes}\nQ = "nsu=urn:plant;s=Q"\n'
        text += '[[valves.estimators]]\nkind = "RLS"\n'
    return text


async def test_each_valve_s_own_flow_is_served(config, open_server, tmp_path):
    plant = await PlayedPlant.create(columns(work(3, 120.0)), RATE_HZ)
    file = tmp_path / "meter.toml"
    file.write_text(toml())
    async with served(plant, config, file, open_server, VALVES, 500):  # worth a sample each
        await asked(config)


async def asked(config):
    async with patient(config.server.url) as client:
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
