"""Nodes that are taken away while clients look at them."""

import asyncio

import pytest
from asyncua import ua

from guarded_opcua import HardenedServer, ServerSettings, add_object, add_variable
from support.served import patient

NAMESPACE = "urn:removal"
UNKNOWN = ua.StatusCodes.BadNodeIdUnknown


@pytest.fixture
async def server():
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/removal/",
        application_uri="urn:test:removal",
        application_name="removal",
        namespace_uri=NAMESPACE,
        none_on_loopback=True,
    )
    made = await HardenedServer.create(settings)
    made.root = await add_object(made, None, "Root")
    for name in ("A", "A1"):
        await planted(made, name)
    async with made:
        yield made


async def planted(server, name):
    """A folder that is filled later, with a variable alone and one of a block."""
    folder = await add_object(server, server.root, name)

    async def fill():
        await add_variable(server, folder, f"{name}.Alone", 1.0)
        in_block = await add_variable(server, folder, f"{name}.Block", 2.0)
        server.add_block([in_block])

    server.add_later(folder, fill)


class Seen:
    def __init__(self):
        self.codes = asyncio.Queue()

    def datachange_notification(self, node, value, data):
        code = data.monitored_item.Value.StatusCode.value
        self.codes.put_nowait((node.nodeid.Identifier, code))


def nodes(client, index, *names):
    return [client.get_node(ua.NodeId(name, index)) for name in names]


async def test_who_monitors_hears_that_the_node_is_unknown_and_may_stop(server):
    index = server.namespace_index
    async with patient(server.url) as client:
        seen = Seen()
        subscription = await client.create_subscription(50, seen)
        handles = await subscription.subscribe_data_change(
            nodes(client, index, "A.Alone", "A.Block")
        )
        async with asyncio.timeout(20.0):
            first = {await seen.codes.get() for _ in handles}
        assert first == {("A.Alone", 0), ("A.Block", 0)}
        server.remove([ua.NodeId("A", index)], [server.root])
        async with asyncio.timeout(20.0):
            then = {await seen.codes.get() for _ in handles}
        assert then == {("A.Alone", UNKNOWN), ("A.Block", UNKNOWN)}
        await subscription.unsubscribe(handles)


async def test_what_begins_alike_stays(server):
    index = server.namespace_index
    server.remove([ua.NodeId("A", index)], [server.root])
    async with patient(server.url) as client:
        gone, there = nodes(client, index, "A.Alone", "A1.Alone")
        with pytest.raises(ua.uaerrors.BadNodeIdUnknown):
            await gone.read_value()
        assert await there.read_value() == 1.0
        (root,) = nodes(client, index, "Root")
        assert [one.nodeid.Identifier for one in await root.get_children()] == ["A1"]


@pytest.mark.parametrize("looked_at", [False, True])
async def test_a_node_may_come_again(server, looked_at):
    index = server.namespace_index
    async with patient(server.url) as client:
        alone, block = nodes(client, index, "A.Alone", "A.Block")
        if looked_at:
            assert await block.read_value() == 2.0
        server.remove([ua.NodeId("A", index)], [server.root])
        await planted(server, "A")
        assert (await alone.read_value(), await block.read_value()) == (1.0, 2.0)
