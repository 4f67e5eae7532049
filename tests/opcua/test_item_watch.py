"""A source that changes shape is described in words at once; nodes created again report again."""

import asyncio
import itertools
from contextlib import suppress
from datetime import UTC, datetime

import numpy as np
import pytest
from asyncua import Server, ua

from support.stream import until
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.item_table import ItemTable
from valvemap.opcua_source.node_looks import look
from valvemap.opcua_source.source_nodes import ValveNodes, wanted_nodes
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.item_states import ItemState
from valvemap.vocabulary.signals import PER_VALVE, Signal

pytestmark = pytest.mark.waits

PLANT = "urn:plant"
NAMES = ("U", "p1", "p2", "Q")
NODES = ValveNodes("V1", *(f"nsu={PLANT};s=V1.{name}" for name in NAMES))
FLOAT = ua.VariantType.Float


class Plant:
    """A server of four Floats that change 20 times a second."""

    def __init__(self, server, index):
        self.server, self.index, self.nodes, self.made = server, index, {}, {}
        self.received = {}

    async def add(self, name, value=1.0, kind=FLOAT):
        node_id = ua.NodeId(f"V1.{name}", self.index)
        variant = ua.Variant(value, kind)
        self.made[name] = (value, kind)
        self.nodes[name] = await self.server.nodes.objects.add_variable(node_id, name, variant)

    async def delete(self, name):
        await self.server.delete_nodes([self.nodes.pop(name)])

    async def again(self, name, value, kind):
        await self.delete(name)
        await self.add(name, value, kind)

    async def write(self, status=None):
        """Write for ever; ``status`` by name."""
        for k in itertools.count():
            await asyncio.sleep(0.05)
            now = datetime.now(UTC)
            for name, node in list(self.nodes.items()):
                value, kind = self.made[name]
                value = value + k % 7 if kind is FLOAT and not isinstance(value, list) else value
                code = ua.StatusCode((status or {}).get(name, 0))
                shown = ua.DataValue(ua.Variant(value, kind), code, now, now)
                with suppress(ua.UaError):
                    await self.server.write_attribute_value(node.nodeid, shown)

    async def receive(self, source):
        while True:
            changes = await source.receive()
            self.received |= dict(zip(changes.item.tolist(), changes.value.tolist(), strict=True))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of asyncua
async def test_eight_kinds_of_change_and_the_return_from_each():
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/plant")
    plant = Plant(server, await server.register_namespace(PLANT))
    for name in NAMES:
        await plant.add(name)
    await server.start()
    port = server.bserver._server.sockets[0].getsockname()[1]
    status = {}
    settings = SourceSettings(f"opc.tcp://127.0.0.1:{port}/plant", publishing_interval_ms=100.0)
    source = OpcUaSource(settings, [NODES])
    await source.connect()
    tasks = [asyncio.create_task(plant.write(status)), asyncio.create_task(plant.receive(source))]

    async def said(words):
        await until(lambda: words in " ".join(source.remarks.get(0, ())), seconds=5.0)

    async def returned():
        plant.received.clear()
        await until(lambda: Signal.Q in plant.received and not source.remarks, seconds=10.0)

    try:
        await returned()
        for value, kind, words in (
            (7, ua.VariantType.Int16, "changed its type from Float to Int16"),
            ("x", ua.VariantType.String, "is of type String"),
            (True, ua.VariantType.Boolean, "is of type Boolean"),
        ):
            await plant.again("Q", value, kind)
            await said(words)
            plant.received.clear()
            if kind is ua.VariantType.Boolean:
                await until(lambda: Signal.Q in plant.received, seconds=5.0)
                assert np.isnan(plant.received[Signal.Q])
            await plant.again("Q", 1.0, FLOAT)
            await returned()
        plant.made["Q"] = ([1.0, 2.0], FLOAT)
        await said("is an array")
        plant.made["Q"] = (1.0, FLOAT)
        await returned()
        status["Q"] = ua.StatusCodes.BadSensorFailure
        await said("has the status BadSensorFailure")
        status.clear()
        await returned()
        await plant.delete("Q")
        await said("does not exist")
        await plant.add("Q")
        await returned()
        await withdraw(server, plant.nodes["Q"], 0)
        await said("cannot be read by this user")
        await withdraw(server, plant.nodes["Q"], 1)
        await returned()
        await moved_namespace(source)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await source.close()
        await server.stop()


async def withdraw(server, node, level):
    shown = ua.DataValue(ua.Variant(level, ua.VariantType.Byte))
    for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
        await server.write_attribute_value(node.nodeid, shown, attribute)


async def moved_namespace(source):
    """An index means the namespace that it had at the first connection."""
    now = source._watch._namespaces
    index = now.index(PLANT)
    before = ("a", "b", "c", "d", PLANT)
    wanted = list(wanted_nodes([ValveNodes("V1", *(f"ns=4;s=V1.{name}" for name in NAMES))]))
    found = await look(source._connection, wanted, now, before)
    assert {one.state for one in found} == {ItemState.GOOD}
    assert {one.node.NamespaceIndex for one in found} == {index}
    lost = await look(source._connection, wanted, ("a", "b"), before)
    assert {one.state for one in lost} == {ItemState.GONE}
    assert "ns=4 was urn:plant" in lost[0].fault


@pytest.mark.parametrize("stall_s", [0.0, 30.0])
def test_a_value_that_no_longer_moves_is_noticed_unless_all_rest(stall_s):
    table, now = ItemTable(1), 0.0
    for k in range(200):
        now += 0.05 + stall_s * (k == 50)
        table.note(*changes(k, {Signal.P2: k, Signal.Q: k}), now)
    assert not table.still(now).any()
    for k in range(200, 300):
        now += 0.05
        table.note(*changes(k, {Signal.P2: 7.0, Signal.Q: k}), now)
    assert np.flatnonzero(table.still(now)).tolist() == [Signal.P2]
    for k in range(300, 400):
        now += 0.05
        table.note(*changes(k, {Signal.P2: 7.0, Signal.Q: 7.0}), now)
    assert not table.still(now).any()


def test_a_source_that_becomes_slower_is_noticed():
    table, t = ItemTable(1), 0
    for k in range(100):
        t += 100_000_000 if k < 60 else 500_000_000
        table.note(*changes(k, {Signal.Q: k}, t), k * 0.1)
        assert table.slower().any() == (k >= 62)
    assert table.pace(Signal.Q).now_s == pytest.approx(0.5)


def changes(k, values, t=None):
    n = len(values)
    t = 1_000_000_000 + k * 50_000_000 if t is None else t
    items = np.array(list(values), np.int32)
    assert (items < PER_VALVE).all()
    numbers, kinds = np.array(list(values.values()), float), np.full(n, 11, np.uint8)
    return DataChanges(items, numbers, np.zeros(n, np.uint32), np.full(n, t)), kinds
