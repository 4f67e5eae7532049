"""An axis over OPC UA: edges from position and pressures of a cylinder, and the inverse."""

import asyncio
import dataclasses

import numpy as np
import pytest
from asyncua import ua
from pydantic import SecretStr

from guarded_opcua import Role
from guarded_opcua.security.users import UserStore
from support.press import SCENARIO
from support.processes import free_port, rig_url
from support.served import PASSWORD, patient, serving
from valvemap.app.axes import axes_file, plan_of
from valvemap.app.serve import serve
from valvemap.config.loading import load_config
from valvemap.model.axis import AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.kept_axes import LEARNT, Learnt, pack, unpack
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import AxisStatus, InverseStatus
from valvemap_rig.directional import DirectionalValve, true_edge_flow

pytestmark = pytest.mark.waits


SIGMA = 0.4  # l/min
FORMER_KEY = "830111e9fc331cd4d5a1af781992b75ce85a253a7bb6e4219c8378cb4bae5274"  # of AXIS
AXIS = """
[[axes]]
name = "Press"
piston_mm = 63
rod_mm = 45
stroke_mm = 800
dead_A_l = 1.2
[axes.nodes]
U = "nsu=urn:valvemap:rig;s=Axis.U"
position = "nsu=urn:valvemap:rig;s=Axis.x"
pA = "nsu=urn:valvemap:rig;s=Axis.pA"
pB = "nsu=urn:valvemap:rig;s=Axis.pB"
pS = "nsu=urn:valvemap:rig;s=Axis.pS"
pT = "nsu=urn:valvemap:rig;s=Axis.pT"
T = "nsu=urn:valvemap:rig;s=Axis.T"
sequence = "nsu=urn:valvemap:rig;s=Axis.Sequence"
required_U = "nsu=urn:valvemap:rig;s=Axis.UCommand"
heartbeat = "nsu=urn:valvemap:rig;s=Axis.Heartbeat"
[axes.feed_forward]
range_percent = [-40, 40]
slew_percent_per_s = 200
fallback = "hand_back"
"""


@pytest.fixture
def settings(open_server):
    users = UserStore()
    users.add("operator", Role.OPERATOR, PASSWORD)
    return dataclasses.replace(open_server, users=users)


@pytest.fixture
def axis_config(config, tmp_path):
    file = tmp_path / "axis.toml"
    file.write_text(AXIS)
    loaded = load_config(file)
    source = config.source.model_copy(
        update={"user": "operator", "password": SecretStr("password")}  # as start_rig says
    )
    given = {"axes": loaded.axes, "valves": loaded.valves, "source": source}
    return config.model_copy(update=given)


async def inverted(seen, v, *pressures):
    """What the method Invert answers."""
    return await seen.node("Inverse").call_method(
        ua.NodeId("Press.Inverse.Invert", seen.index), v, *pressures, 40.0
    )


async def test_an_axis_is_served_and_its_map_survives_a_restart(
    axis_config, settings, start_rig, tmp_path
):
    scenario = tmp_path / "axis-scenario.toml"
    scenario.write_text(SCENARIO)
    port = free_port()
    config = axis_config.model_copy(
        update={"source": axis_config.source.model_copy(update={"url": rig_url(port)})}
    )
    with start_rig(port, "--scenario", str(scenario)):
        async with serving(serve, config, settings, "Press", "Status") as seen:
            async with asyncio.timeout(200):
                assert await seen.value("Status") == AxisStatus.TOO_SHORT
                assert (await inverted(seen, 100.0, *[np.nan] * 4))[3] == InverseStatus.UNIDENTIFIED
                await seen.until("PA.KnownTo", lambda found: found is not None)
                await check_map(seen)
                await check_inverse(seen)
                await check_feed_forward(seen, rig_url(port))
                alarm = ua.NodeId("Service.Alarms.Checkpoint.Active", seen.index)
                assert not await seen.client.get_node(alarm).read_value()
        with CheckpointFile(axes_file(config)) as store:
            kept = {(one.valve, one.estimator) for one in store.load()}
        assert ("Press", LEARNT) in kept
        async with serving(serve, config, settings, "Press", "Status") as seen:
            async with asyncio.timeout(30):
                await seen.until("Status", lambda status: status == AxisStatus.OK)
            await check_map(seen)


async def check_map(seen):
    assert await seen.value("Status") == AxisStatus.OK
    assert await seen.value("BulkModulus") == pytest.approx(0.9, rel=0.05)
    assert 0.0 < await seen.value("BulkModulusStd") < 0.1
    assert await seen.value("Play") == pytest.approx(2.0, abs=0.5)
    assert await seen.value("Leakage") == pytest.approx(0.002, rel=0.4)
    U, valve = np.array(await seen.value("U")), DirectionalValve(leakage_l_min_bar=0.0)
    for edge in EDGES:
        rows = (U >= 12.0) & (U <= 45.0)
        off = np.array(await seen.value(f"{edge}.Flow")) - true_edge_flow(valve, edge, U, 70.0, 1.0)
        assert np.sqrt(np.mean(np.square(off[rows]))) < SIGMA, edge
        assert await seen.value(f"{edge}.KnownTo") > 20.0


async def check_inverse(seen):
    pressures = 90.0, 60.0, 175.0, 3.0
    for v in (150.0, -150.0):
        U, lower, upper, status = await inverted(seen, v, *pressures)
        assert status == InverseStatus.OK
        assert lower < U < upper
        assert np.sign(U) == np.sign(v)
        assert 10.0 < abs(U) < 60.0
    await seen.node("Inverse.SpeedDemand").write_value(200.0)
    await seen.until("Inverse.RequiredUStatus", lambda status: status == InverseStatus.OK)
    assert await seen.value("Inverse.RequiredULower") < await seen.value("Inverse.RequiredUUpper")
    await seen.node("Inverse.SpeedDemand").write_value(np.nan)
    await seen.until("Inverse.RequiredUStatus", lambda status: status == InverseStatus.NOT_FINITE)


async def reads(node, is_so):
    async with asyncio.timeout(20):
        while not is_so(await node.read_value()):  # noqa: ASYNC110 - of another process
            await asyncio.sleep(0.05)


async def check_feed_forward(seen, url):
    """Armed, the answer reaches the rig; without a demand the valve is handed back."""
    inverse = seen.node("Inverse")

    async def call(name):
        await inverse.call_method(ua.NodeId(f"Press.Inverse.{name}", seen.index))

    async with patient(url) as rig:
        index = await rig.get_namespace_index("urn:valvemap:rig")
        command = rig.get_node(ua.NodeId("Axis.UCommand", index))
        assert await seen.value("Inverse.FeedForwardStatus") == FeedForwardStatus.DISARMED
        await call("Arm")
        await seen.until(
            "Inverse.FeedForwardStatus", lambda status: status == FeedForwardStatus.NO_DEMAND
        )
        await seen.node("Inverse.SpeedDemand").write_value(100.0)
        await seen.until(
            "Inverse.FeedForwardStatus", lambda status: status == FeedForwardStatus.WRITING
        )
        await reads(command, lambda U: 8.0 < U < 40.0)
        await seen.node("Inverse.SpeedDemand").write_value(np.nan)
        await seen.until(
            "Inverse.FeedForwardStatus", lambda status: status == FeedForwardStatus.NO_DEMAND
        )
        heartbeat = rig.get_node(ua.NodeId("Axis.Heartbeat", index))
        await reads(heartbeat, lambda count: count == 0)
        await call("Disarm")
        await seen.until("Inverse.Armed", lambda armed: not armed)


async def test_a_node_that_is_missing_is_named_at_the_start(axis_config, open_server, start_rig):
    port = free_port()
    with start_rig(port, "--scenario", "axis"):
        (axis,) = axis_config.axes
        nodes = axis.nodes.model_copy(update={"pB": "nsu=urn:valvemap:rig;s=Axis.pZ"})
        config = axis_config.model_copy(
            update={
                "source": axis_config.source.model_copy(update={"url": rig_url(port)}),
                "axes": (axis.model_copy(update={"nodes": nodes}),),
            }
        )
        with pytest.raises(Exception, match=r"Axis\.pZ' \(pB of axis Press\) does not exist"):
            async with asyncio.timeout(60):
                await serve(config, asyncio.Event(), open_server)


async def test_a_unit_that_contradicts_the_source_is_refused(axis_config, open_server, start_rig):
    port = free_port()
    with start_rig(port, "--scenario", "axis"):
        (axis,) = axis_config.axes
        given = axis.signals.model_copy(
            update={"position": axis.signals.position.model_copy(update={"unit": "m"})}
        )
        config = axis_config.model_copy(
            update={
                "source": axis_config.source.model_copy(update={"url": rig_url(port)}),
                "axes": (axis.model_copy(update={"signals": given}),),
            }
        )
        with pytest.raises(
            Exception, match=r"comes in mm, configured is m.*signals\.position of axis"
        ):
            async with asyncio.timeout(60):
                await serve(config, asyncio.Event(), open_server)


def test_a_state_of_another_geometry_is_not_resumed(axis_config):
    (axis,) = axis_config.axes
    other = axis.model_copy(update={"piston_mm": 64.0})
    assert Axis(plan_of(axis_config, axis)).key != Axis(plan_of(axis_config, other)).key


def test_a_state_of_a_version_without_meanings_is_resumed_if_all_is_as_it_was(axis_config):
    """The hash is the one that version computed for this configuration."""
    (axis,) = axis_config.axes
    plan = plan_of(axis_config, axis)
    assert plan.former_key == FORMER_KEY
    regression = AxisRegression(plan.geometry, period_s=0.01)
    learnt = Learnt(regression, regression.initial_state(), np.zeros((SIZE, SIZE)))
    now = Axis(plan)
    now.resume(LEARNT, pack(learnt, FORMER_KEY))
    assert now.learner.learnt.regression.period_s == regression.period_s
    assert unpack(now.to_bytes()[LEARNT], now.key, regression)
    other = axis.model_copy(update={"memory_s": 60.0})
    with pytest.raises(StateMismatchError, match="other hyper-parameters"):
        Axis(plan_of(axis_config, other)).resume(LEARNT, pack(learnt, FORMER_KEY))
