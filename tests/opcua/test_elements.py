"""Elements of arrays are signals: of servers that know index ranges, and of those that do not."""

import asyncio
import struct
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest
from asyncua import Server, ua

from guarded_opcua import HardenedServer, add_object, add_variable
from support.plant_server import plant_settings
from support.received import until
from valvemap.errors import ConfigurationError, SourceRejected
from valvemap.opcua_client.connection import open_connection
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.browsing import find_numbers
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.elements import (
    COMPOUND,
    NO_COMPOUNDS,
    NO_NUMBER,
    Compounds,
    Element,
    with_elements,
)
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.data_changes import DataChanges

pytestmark = pytest.mark.waits

ARRAY, FLOW = "nsu=urn:plant;s=Inputs", "nsu=urn:plant;s=Flow"
NODES = ValveNodes("V1", f"index=3;{ARRAY}", f"index=0;{ARRAY}", f"index=1;{ARRAY}", FLOW)
VALUES = {
    "Inputs": [170.5, 40.25, -1.0, 62.5],
    "Flow": 30.0,
    "Curve": [0.0] * 100,
    "Limits": ua.Range(0.0, 1.0),
}


@asynccontextmanager
async def whole_arrays():
    """A server of asyncua: it sends the whole array, whatever the index range."""
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/plant/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace("urn:plant")
    for name, value in VALUES.items():
        await server.nodes.objects.add_variable(ua.NodeId(name, index), name, value)
    async with server:
        port = server.bserver._server.sockets[0].getsockname()[1]
        yield f"opc.tcp://127.0.0.1:{port}/plant/"


@asynccontextmanager
async def single_elements():
    """Our own server: it knows index ranges."""
    server = await HardenedServer.create(plant_settings())
    folder = await add_object(server, None, "Plant")
    for name, value in VALUES.items():
        dimensions = (0,) if isinstance(value, list) else None
        if name != "Limits":
            await add_variable(server, folder, name, value, dimensions=dimensions)
    async with server:
        yield server.url


@pytest.mark.parametrize("served", [whole_arrays, single_elements])
async def test_elements_are_read_browsed_and_named_if_they_are_not_there(served):
    async with served() as url:
        settings = SourceSettings(url, publishing_interval_ms=50.0)
        source = OpcUaSource(settings, [NODES])
        await source.connect()
        async with asyncio.timeout(20):
            changes = await source.receive()
        found = dict(zip(changes.item.tolist(), changes.value.tolist(), strict=True))
        assert [found[item] for item in range(4)] == [62.5, 170.5, 40.25, 30.0]
        assert source.counters.undecodable == 0
        await source.close()

        for wrong, words in (
            ({"U": f"index=4;{ARRAY}"}, "has 4 elements .* none with index=4; index=0 to index=3"),
            ({"U": ARRAY}, "is an array .* a scalar is needed, or index=0 to index=3; before"),
            ({"Q": f"index=2;{FLOW}"}, "Q of valve V1.* is no array .* leave out index=2;"),
        ):
            with pytest.raises(SourceRejected, match=words):
                await OpcUaSource(settings, [replace(NODES, **wrong)]).connect()

        connection = await open_connection(settings)
        numbers, skipped = await find_numbers(connection, {"index=70;nsu=urn:plant;s=Curve"})
        await connection.close()
        own = {one.path[-1]: one.node for one in numbers if one.path[0] != "Server"}
        elements = {f"Inputs[{n}]": f"index={n};{ARRAY}" for n in range(4)}
        curve = {"Curve[70]": "index=70;nsu=urn:plant;s=Curve"}
        assert own == {"Flow": FLOW} | elements | curve
        structures = [line for line in skipped if "states no DataTypeDefinition" in line]
        assert ["Limits" in line for line in structures] == [True] * (served is whole_arrays)
        assert any("Curve: an array of more than 64 elements" in line for line in skipped)


async def test_elements_have_the_names_that_the_array_s_description_lists():
    server = await HardenedServer.create(plant_settings())
    folder = await add_object(server, None, "Plant")
    await add_variable(
        server, folder, "Gauges", [1.0, 2.0], dimensions=(0,), description="inlet; outlet [kPa]"
    )
    async with server:
        connection = await open_connection(SourceSettings(server.url))
        numbers, _ = await find_numbers(connection)
        await connection.close()
    found = {one.node: one.path[-2:] for one in numbers if "index=" in one.node}
    assert found == {
        "index=0;nsu=urn:plant;s=Gauges": ("Gauges", "inlet [kPa]"),
        "index=1;nsu=urn:plant;s=Gauges": ("Gauges", "outlet [kPa]"),
    }


def test_an_element_is_no_command_and_its_index_is_a_number():
    with pytest.raises(ConfigurationError, match="an element of an array is not written"):
        replace(NODES, required_U=f"index=0;{ARRAY}")
    with pytest.raises(ConfigurationError, match=r"index=<number>; for an element of an array"):
        replace(NODES, Q=f"index=x;{ARRAY}")


@pytest.mark.parametrize("served", [whole_arrays, single_elements])
async def test_an_array_is_one_monitored_item_for_all_its_signals(served):
    second = ValveNodes("V2", f"index=2;{ARRAY}", f"index=0;{ARRAY}", f"index=1;{ARRAY}", FLOW)
    async with served() as url:
        settings = SourceSettings(url, publishing_interval_ms=50.0)
        source = OpcUaSource(settings, [NODES, second])
        await source.connect()
        items = source._subscription.watched.items
        assert len(items) == 5
        assert len({item.number for item in items}) == len({item.handle for item in items}) == 2
        found = await until(source, {0: 62.5, 1: 170.5, 2: 40.25, 3: 30.0, 6: -1.0, 7: 170.5})
        assert found[9] == 30.0
        await source._subscription.watched.monitor_again(items[0].node)
        numbers = [item.number for item in source._subscription.watched.items]
        assert len(set(numbers)) == 3  # the array is kept for the others, and asked once more
        await until(source, {0: 62.5})
        await source.close()


def test_a_change_of_an_array_is_one_of_each_element():
    data = bytes([0x8B]) + struct.pack("<i3d", 3, 1.5, 2.5, 3.5)
    changes = DataChanges(
        np.array([7, 4, 7], np.int32),
        np.array([9.0, np.nan, np.nan]),
        np.array([0, 0, 0x80000000], np.uint32),
        np.array([5, 6, 7]),
    )
    kind = np.array([11, COMPOUND, 0], np.uint8)
    arrays = Compounds(data, np.array([1]), np.array([0]))
    wanted = {4: [Element(4, 2), Element(9, 0), Element(2, 3)]}
    found, kinds = with_elements(changes, kind, arrays, wanted)
    assert found.item.tolist() == [7, 4, 9, 2, 7]
    assert found.value[:3].tolist() == [9.0, 3.5, 1.5]
    assert kinds.tolist() == [11, 11, 11, NO_NUMBER, 0]
    assert found.source_time.tolist() == [5, 6, 6, 6, 7]
    lost, _ = with_elements(changes[1:2], kind[1:2], NO_COMPOUNDS, wanted)
    assert np.isnan(lost.value).all()
    assert lost.item.tolist() == [4, 9, 2]
