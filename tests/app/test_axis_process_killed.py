"""The service's process is killed during a move; the rig is another process, between them OPC UA.

The rig's controller adds nothing (both gains are 0), so that its U is what the service has written.
``test_axis_killed.py`` is the short form, in the simulation's time.
"""

import asyncio
import os
import signal
import sys
import time
from datetime import UTC, datetime

import numpy as np
import pytest
from asyncua import ua

from support.press import SCENARIO
from support.processes import free_port, program, rig_url, service_url
from support.served import PASSWORD, Seen, patient
from valvemap.app.axes import axes_file, plan_of
from valvemap.config.loading import load_config
from valvemap.model.axis import AxisRegression, AxisSamples
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_search import fitted
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_states import checkpoints_of
from valvemap.pipeline.kept_axes import Learnt
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import InverseStatus
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import advance, initial

pytestmark = [pytest.mark.soak, pytest.mark.waits]

SLEW = 200.0  # %/s
WITHIN_S = 0.5
BLOCK_S = 0.1  # of the rig: U may be noticed to be safe so much later
AT_REST = """
k_p_percent_mm = 0.0
k_i_percent_mm_s = 0.0
[machines.load]
moves_N = 0.0
sine_N = 0.0
"""
CONFIG = """
valves = []
[source]
url = "{rig}"
security = "None"
user = "operator"
password = "password"
startup_timeout_s = 60.0
[server]
url = "{service}"
[state]
file = "{state}"
[[axes]]
name = "Press"
piston_mm = 63
rod_mm = 45
stroke_mm = 800
dead_A_l = 1.2
frozen = true
[axes.nodes]
{nodes}
[axes.feed_forward]
range_percent = [-60, 60]
slew_percent_per_s = {slew}
fallback = "ramp"
"""
NODES = {name: name for name in ("U", "pA", "pB", "pS", "pT", "T")} | {
    "position": "x",
    "sequence": "Sequence",
    "required_U": "UCommand",
    "heartbeat": "Heartbeat",
}


def learnt(geometry):
    """The rig's axis, from a minute of its work with its own controller."""
    machine = Machine(name="Axis", measures="position", valve={"play_percent": 2.0})
    work = Scenario(valves=(), machines=(machine,))
    _, block = advance(work, initial(work, 0), 6_000)
    shown = block.machines["Axis"].shown
    samples = AxisSamples.of(
        block.t,
        **{name: shown[name] for name in ("U", "x")}
        | {name: shown[name] for name in ("pA", "pB", "pS", "pT", "T")},
    )
    regression = AxisRegression(geometry, play_percent=2.0, spool_hz=40.0)
    state, _ = fitted(regression, samples)
    return Learnt(regression, state, np.zeros((SIZE, SIZE)))


@pytest.fixture
def written(tmp_path):
    """The configuration's file, with a map beside it; ports of rig and service."""
    rig, service = free_port(), free_port()
    nodes = "\n".join(
        f'{name} = "nsu=urn:valvemap:rig;s=Axis.{its}"' for name, its in NODES.items()
    )
    file = tmp_path / "press.toml"
    state = (tmp_path / "state.sqlite").as_posix()
    file.write_text(
        CONFIG.format(
            rig=rig_url(rig), service=service_url(service), state=state, nodes=nodes, slew=SLEW
        )
    )
    config = load_config(file)
    axis = Axis(plan_of(config, config.axes[0]))
    axis.learner.continue_from(learnt(axis.plan.geometry))
    with CheckpointFile(axes_file(config)) as store:
        store.save(checkpoints_of(axis, 1, axis.to_bytes()))
    return file, rig, service


async def as_operator(url, password):
    async with asyncio.timeout(120):
        while True:
            client = patient(url)  # a busy machine answers late
            client.set_user("operator")
            client.set_password(password)
            try:
                await client.connect()
            except (TimeoutError, OSError, ua.UaError):
                await asyncio.sleep(0.3)
            else:
                return client


async def past(rig, name, since):
    """Source times (s) and values of a signal of the rig."""
    index = await rig.get_namespace_index("urn:valvemap:rig")
    node = rig.get_node(ua.NodeId(f"Axis.{name}", index))
    start = datetime.fromtimestamp(since, UTC).replace(tzinfo=None)
    found = await node.read_raw_history(start, None, 100_000)
    t = [one.SourceTimestamp.replace(tzinfo=UTC).timestamp() for one in found]
    return np.array(t), np.array([one.Value.Value for one in found])


@pytest.mark.parametrize("v", [120.0, -120.0])
async def test_u_is_safe_within_half_a_second_and_never_beyond_its_slew(
    written, start_rig, tmp_path, v
):
    file, rig_port, service_port = written
    scenario = tmp_path / "press-scenario.toml"
    scenario.write_text(SCENARIO + AT_REST)
    path = {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = sys.executable, "-m", "support.axis_service", str(file)
    with (
        start_rig(rig_port, "--scenario", str(scenario)),
        program(*command, env=path, log=tmp_path / "service.log") as process,
    ):
        client = await as_operator(service_url(service_port), PASSWORD)
        rig = await as_operator(rig_url(rig_port), "password")
        index = await client.get_namespace_index("urn:valvemap:service")
        seen = Seen(client, index, "Press")
        by_hand = rig.get_node(
            ua.NodeId("Axis.UCommand", await rig.get_namespace_index("urn:valvemap:rig"))
        )
        async with asyncio.timeout(60):
            U = 1.0  # %, within the overlap: only a signal that changes is sent
            while await seen.value("Inverse.RequiredUStatus") != InverseStatus.NOT_FINITE:
                await by_hand.write_value(U)
                await asyncio.sleep(0.2)
                U = -U
            await seen.node("Inverse").call_method(ua.NodeId("Press.Inverse.Arm", index))
            began = time.time()
            await seen.node("Inverse.SpeedDemand").write_value(v)
            await seen.until("Inverse.FeedForwardStatus", lambda s: s == FeedForwardStatus.WRITING)
        await asyncio.sleep(1.0)
        asked = time.monotonic()
        await seen.value("Status")
        late_s = time.monotonic() - asked  # of a busy machine
        killed = time.time()
        process.send_signal(signal.SIGKILL)
        await asyncio.sleep(2.0 + 5.0 * late_s)
        t, U = await past(rig, "U", began)
        t_x, x = await past(rig, "x", began)
        await rig.disconnect()
        assert process.wait(10) == -signal.SIGKILL
    moving = (t > killed - 0.3) & (t < killed)
    assert np.abs(U[moving]).min() > 8.0  # in the middle of a move
    assert np.sign(np.diff(np.interp([killed - 0.3, killed], t_x, x))) == np.sign(v)
    gone = t[np.flatnonzero(U != 0.0)[-1]]
    assert 0.0 < gone - killed <= WITHIN_S + BLOCK_S + late_s
    assert np.abs(U).max() <= 60.0
    after = np.abs(U[t > killed])
    assert np.diff(after).max() <= SLEW * (BLOCK_S + late_s)
    first = np.flatnonzero(U != 0.0)[0]
    steps, at = np.diff(U[first:][t[first:] < killed]), np.diff(t[first:][t[first:] < killed])
    held_s = np.diff(np.flatnonzero(steps), prepend=0).max() * at.max()
    assert np.abs(steps).max() <= SLEW * (held_s + BLOCK_S)
