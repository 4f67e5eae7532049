"""A service is killed during a move: the machine goes on with its own controller, without a jump.

Time is the simulation's. The service's writer leads the rig's machine as over OPC UA, and the rig's
watchdog notices that the heartbeat stands still.
"""

import numpy as np
import pytest

from support.small_plant import FakeSource
from valvemap.clock import ManualClock
from valvemap.model.axis import AxisGeometry
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_ports import RequiredU
from valvemap.pipeline.feedforward import Fallback, FeedForward
from valvemap.runtime.feed_forward_writer import FeedForwardWriter
from valvemap.runtime.led_axes import LedAxes
from valvemap.vocabulary.statuses import InverseStatus
from valvemap_rig.command import RETURN_PERCENT_PER_S, Command, lead_of
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.machine import Controller, Machine
from valvemap_rig.scenario import Scenario
from valvemap_rig.simulation import Commands, advance, initial

STEP_S = 0.01
SLEW = 2_000.0  # %/s, as of the demo
SETTINGS = FeedForward((-100.0, 100.0), SLEW, Fallback.RAMP, 0.0, max_age_s=0.2, has_heartbeat=True)
WITHIN_S = 0.5
FAST_MM_S = 150.0


class Written(FakeSource):
    """The rig's end: each write changes its command, at once."""

    def __init__(self, clock):
        super().__init__()
        self.clock, self.command = clock, Command()

    async def write_required_U(self, valve, U):
        self.command = self.command.written(U)

    async def write_heartbeat(self, valve, count):
        self.command = self.command.beaten(count, self.clock.monotonic())


def machine(lead):
    valve = DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0)
    return Machine(name="Axis", measures="position", valve=valve, controller=Controller(lead=lead))


async def played(killed_s, seconds):
    """Return t, lead, U, position error and set speed of every sample."""
    clock, scenario = ManualClock(), Scenario(valves=(), machines=(machine("external"),))
    source, state = Written(clock), initial(scenario, 0)
    plan = AxisPlan("Axis", AxisGeometry(63, 45, 800, 1.2, 1.2), feed_forward=SETTINGS)
    axis = Axis(plan)
    axis.learner.known = object()
    led = LedAxes([axis], lambda _: 0.0, lambda _: None, lambda *_: None)
    writer, rows, lead = FeedForwardWriter(led, 2, source, clock), [], 0.0
    led.arm(0, armed=True)
    for k in range(round(seconds / STEP_S)):
        source.command = source.command.seen(clock.monotonic())
        lead = lead_of(source.command, lead, STEP_S)
        state, block = advance(scenario, state, 1, Commands(U={"Axis": lead}))
        found = block.machines["Axis"].truth
        x, x_set, v_set, U = (float(found[name][0]) for name in ("x", "xSet", "vSet", "U"))
        rows.append((k * STEP_S, lead, U, x - x_set, v_set))
        clock.advance(STEP_S)
        if k * STEP_S < killed_s:
            answer = float(np.clip(0.09 * v_set + 6.0 * np.sign(v_set), -90.0, 90.0))
            axis.required = lambda U=answer: RequiredU(U, U - 1.0, U + 1.0, InverseStatus.OK)
            axis.newest_U, axis._newest = U, (x, 40.0, 50.0, 60.0, 180.0, 2.0)
            await writer.write(np.arange(2))
    return np.array(rows).T


@pytest.fixture(scope="module")
def moments():
    """Two moments within quick moves, one out and one in."""
    scenario = Scenario(valves=(), machines=(machine("none"),))
    _, block = advance(scenario, initial(scenario, 0), 3_000, Commands())
    v = block.machines["Axis"].truth["vSet"]
    return [STEP_S * int(np.flatnonzero(s * v[200:] > FAST_MM_S)[0] + 220) for s in (1.0, -1.0)]


@pytest.mark.parametrize("direction", [0, 1])
async def test_the_lead_is_gone_within_half_a_second_and_never_beyond_its_slew(moments, direction):
    killed_s = moments[direction]
    t, lead, U, error, v_set = await played(killed_s, killed_s + 4.0)
    at = round(killed_s / STEP_S)
    assert abs(v_set[at]) > FAST_MM_S
    assert abs(lead[at]) > 20.0
    gone = t[np.flatnonzero(np.abs(lead) > 1e-9)[-1]] + STEP_S
    assert 0.0 < gone - killed_s <= WITHIN_S
    assert np.abs(np.diff(lead)).max() <= max(SLEW, RETURN_PERCENT_PER_S) * STEP_S + 1e-9
    assert np.abs(U).max() <= 100.0
    alone = np.abs(error[t > gone + 2.0])
    assert alone.max() < 150.0  # its own controller follows on
