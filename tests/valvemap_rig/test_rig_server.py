import asyncio
import itertools

import numpy as np
import pytest
import pytest_asyncio
from asyncua import ua

from guarded_opcua import ManualClock, Role, ServerSettings, UserStore
from support.served import patient
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.server import RigServer

pytestmark = pytest.mark.asyncio(loop_scope="module")

PASSWORD = "correct horse"
NS = 2


class Recorded:
    """Collects what a subscription brings, by node."""

    def __init__(self):
        self.values = {}
        self.lost = 0

    def datachange_notification(self, node, _, data):
        value = data.monitored_item.Value
        self.values.setdefault(node.nodeid.Identifier, []).append(value)
        self.lost += bool(value.StatusCode.value & 0x80)


@pytest.fixture(scope="module")
def blocks():
    return []


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(blocks):
    users = UserStore()
    users.add("operator", Role.OPERATOR, PASSWORD)
    settings = ServerSettings(
        url="opc.tcp://127.0.0.1:0/valvemap/rig/",
        application_uri="urn:test:valvemap:rig",
        application_name="valvemap rig",
        namespace_uri="urn:valvemap:rig",
        users=users,
        none_on_loopback=True,
    )
    async with await RigServer.create(settings, BUILTIN["demo"], on_block=blocks.append) as server:
        playing = asyncio.create_task(server.run())
        yield server
        playing.cancel()
        await asyncio.gather(playing, return_exceptions=True)


@pytest_asyncio.fixture(loop_scope="module")
async def observer(rig):
    async with patient(rig.url) as client:
        yield client


@pytest_asyncio.fixture(loop_scope="module")
async def operator(rig):
    client = patient(rig.url)
    client.set_user("operator")
    client.set_password(PASSWORD)
    async with client:
        yield client


def node(client, name):
    return client.get_node(ua.NodeId(name, NS))


async def record(client, names, seconds):
    recorded = Recorded()
    subscription = await client.create_subscription(100, recorded)
    await subscription.subscribe_data_change(
        [node(client, name) for name in names], queuesize=10_000
    )
    await asyncio.sleep(seconds)
    await subscription.delete()
    return recorded


async def test_the_namespace_and_the_browse_paths_are_those_of_the_contract(observer):
    assert (await observer.get_namespace_array())[NS] == "urn:valvemap:rig"
    for name in (
        "U",
        "p1",
        "p2",
        "Q",
        "Temperature",
        "Sequence",
        "UCommand",
        "LoadCommand",
        "Heartbeat",
        "InjectFault",
    ):
        found = await observer.nodes.objects.get_child(
            [f"{NS}:TestRig", f"{NS}:Valvistor", f"{NS}:{name}"]
        )
        assert found.nodeid == ua.NodeId(f"Valvistor.{name}", NS)


async def test_a_valve_has_what_its_type_declares(observer):
    valve = node(observer, "Valvistor")
    kind = observer.get_node(await valve.read_type_definition())
    assert (await kind.read_browse_name()).Name == "RigValveType"
    parts = {(await part.read_browse_name()).Name for part in await kind.get_children()}
    mine = {(await part.read_browse_name()).Name for part in await valve.get_children()}
    assert parts == mine
    assert {"U", "p1", "p2", "Q", "Temperature", "Sequence", "InjectFault"} <= parts


@pytest.mark.parametrize(
    ("name", "unit", "high"),
    [("U", "%", 105), ("p1", "bar", 210), ("Q", "l/min", 210), ("Temperature", "°C", 105)],
)
async def test_signals_have_unit_and_range(observer, name, unit, high):
    signal = node(observer, f"Valvistor.{name}")
    assert await signal.read_type_definition() == ua.NodeId(17570)
    properties = {(await p.read_browse_name()).Name: p for p in await signal.get_properties()}
    assert (await properties["EngineeringUnits"].read_value()).DisplayName.Text == unit
    assert (await properties["EURange"].read_value()).High == pytest.approx(high)
    assert (await properties["InstrumentRange"].read_value()).High == pytest.approx(high)


@pytest.mark.waits
async def test_every_sample_arrives_once_in_order_with_one_time_for_all_signals(observer):
    names = ("Sequence", "U", "p1", "p2", "Q", "Temperature")
    recorded = await record(observer, [f"Valvistor.{name}" for name in names], 1.5)
    sequence = [v.Value.Value for v in recorded.values["Valvistor.Sequence"]]
    assert len(sequence) > 100
    assert np.all(np.diff(sequence) == 1)
    times = {v.SourceTimestamp for v in recorded.values["Valvistor.Sequence"]}
    for name in names[1:]:
        assert {v.SourceTimestamp for v in recorded.values[f"Valvistor.{name}"]} <= times
    spacing = {b - a for a, b in itertools.pairwise(sorted(times))}
    assert {s.total_seconds() for s in spacing} == {0.01}
    assert recorded.lost == 0


async def test_blocks_hold_what_was_published(rig, blocks):
    assert sum(len(block) for block in blocks) == rig.samples
    sequence = np.concatenate([block.sequence for block in blocks])
    assert np.all(np.diff(sequence.astype(np.int64)) == 1)


async def test_an_observer_can_neither_write_nor_call(observer):
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await node(observer, "Valvistor.UCommand").write_value(50.0)
    rig_object = node(observer, "TestRig")
    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        await rig_object.call_method(ua.NodeId("Rig.StopScenario", NS))
    with pytest.raises(ua.uaerrors.BadNotWritable):
        await node(observer, "Valvistor.Q").write_value(50.0)


async def test_an_operators_command_drives_the_valve_in_the_external_scenario(operator):
    rig_object = node(operator, "TestRig")
    await rig_object.call_method(ua.NodeId("Rig.StartScenario", NS), "external")
    assert await node(operator, "Rig.Scenario").read_value() == "external"
    await node(operator, "Valvistor.UCommand").write_value(37.5)
    await asyncio.sleep(0.4)
    assert await node(operator, "Valvistor.U").read_value() == pytest.approx(37.5, abs=1.0)
    await rig_object.call_method(ua.NodeId("Rig.StartScenario", NS), "demo")


async def test_a_command_acts_within_three_samples():
    clock, U = ManualClock(), []
    server = await RigServer.create(
        ServerSettings(
            url="opc.tcp://127.0.0.1:0/valvemap/rig/",
            application_uri="urn:test:valvemap:rig",
            application_name="valvemap rig",
            namespace_uri="urn:valvemap:rig",
            users=UserStore(),
            none_on_loopback=True,
        ),
        BUILTIN["external"],
        on_block=lambda block: U.extend(block.valves["Valvistor"].U_true.tolist()),
        clock=clock,
    )
    playing = asyncio.create_task(server.run())

    async def played(samples):
        while len(U) < samples:
            await asyncio.sleep(0.001)
            if server.samples == len(U):
                clock.advance(1.0 / BUILTIN["external"].sample_rate_hz)

    for command in (30.0, 50.0, 70.0):
        await played(len(U) + 7)
        server.command_U("Valvistor", command)
        written = len(U)
        await played(written + 4)
        assert U[written + 3] == command
    playing.cancel()
    await asyncio.gather(playing, return_exceptions=True)


async def test_a_command_out_of_range_is_refused(operator):
    with pytest.raises(ua.uaerrors.BadOutOfRange):
        await node(operator, "Valvistor.UCommand").write_value(101.0)
    with pytest.raises(ua.uaerrors.BadOutOfRange):
        await node(operator, "Valvistor.UCommand").write_value(float("nan"))
    with pytest.raises(ua.uaerrors.BadTypeMismatch):
        await node(operator, "Valvistor.UCommand").write_value("fifty")


async def test_an_unknown_scenario_or_fault_is_refused_and_the_rig_plays_on(operator, rig):
    before = rig.samples
    with pytest.raises(ua.uaerrors.BadInvalidArgument):
        await node(operator, "TestRig").call_method(ua.NodeId("Rig.StartScenario", NS), "circus")
    with pytest.raises(ua.uaerrors.BadInvalidArgument):
        await node(operator, "Valvistor").call_method(
            ua.NodeId("Valvistor.InjectFault", NS), "rust", 1.0, 0.0
        )
    await asyncio.sleep(0.2)
    assert rig.samples > before


@pytest.mark.waits
async def test_an_injected_fault_shows_as_bad_quality_and_ends(operator):
    await node(operator, "Valvistor").call_method(
        ua.NodeId("Valvistor.InjectFault", NS), "bad_quality.Q", 1.0, 0.5
    )
    recorded = await record(operator, ["Valvistor.Q"], 1.2)
    codes = [v.StatusCode.value for v in recorded.values["Valvistor.Q"]]
    assert 0x808C0000 in codes
    assert codes[-1] == 0


async def test_a_stopped_scenario_leaves_uncertain_values_and_sequence_goes_on_after_it(
    operator, rig
):
    rig_object = node(operator, "TestRig")
    await rig_object.call_method(ua.NodeId("Rig.StopScenario", NS))
    value = await node(operator, "Valvistor.Q").read_data_value(raise_on_bad_status=False)
    assert value.StatusCode.is_uncertain()
    assert value.Value.Value is not None
    last = await node(operator, "Valvistor.Sequence").read_value()
    with pytest.raises(ua.uaerrors.BadInvalidState):
        await rig_object.call_method(ua.NodeId("Rig.StopScenario", NS))
    await rig_object.call_method(ua.NodeId("Rig.StartScenario", NS), "demo")
    await asyncio.sleep(0.3)
    assert last < await node(operator, "Valvistor.Sequence").read_value() < last + 100
    assert rig.scenario.name == "demo"


async def test_the_reachable_region_is_published(observer):
    U = await node(observer, "Valvistor.ReachableU").read_value()
    dp = await node(observer, "Valvistor.ReachableDp").read_value()
    assert len(U) == len(dp) == 21
    assert U[0] == 0.0
    assert U[-1] == 100.0
    assert all(0 < drop <= 200 for drop in dp)
    assert dp[-1] < dp[1]
