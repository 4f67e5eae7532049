"""Feed-forward of an axis: written within its slew, and not at all where the answer cannot be."""

import numpy as np
import pytest

from support.small_plant import FakeSource
from valvemap.clock import ManualClock
from valvemap.errors import CommandRejected
from valvemap.model.axis import AxisGeometry, AxisSamples
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_ports import RequiredU
from valvemap.pipeline.feedforward import Fallback, FeedForward
from valvemap.runtime.feed_forward_writer import FeedForwardWriter
from valvemap.runtime.led_axes import LedAxes
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import InverseStatus

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
SLEW = 100.0  # %/s
SETTINGS = FeedForward((-100.0, 100.0), SLEW, Fallback.RAMP, 0.0, max_age_s=0.2, has_heartbeat=True)
ROW = 2  # of the second axis
STEP_S = 0.05


class Rig:
    """Two axes, the second of which is led; time and samples by hand."""

    def __init__(self):
        self.clock, self.source = ManualClock(), FakeSource()
        plans = AxisPlan("Lift", GEOMETRY), AxisPlan("Press", GEOMETRY, feed_forward=SETTINGS)
        self.axes = [Axis(plan) for plan in plans]
        self.age_s, self.failures, self.steps, self.path = 0.0, [], 0, []
        self.led = LedAxes(
            self.axes, lambda _: self.age_s, lambda _: None, lambda *of: self.failures.append(of)
        )
        self.writer = FeedForwardWriter(self.led, 4, self.source, self.clock)
        self.answers(RequiredU(60.0, 59.0, 61.0, InverseStatus.OK))

    def answers(self, answer):
        press = self.axes[1]
        press.required, press.learner.known = lambda: answer, object()

    def sample(self, U=20.0, x=400.0):
        self.steps += 1
        press = self.axes[1]
        press.newest_U = U
        press._newest = (x, 40.0, 50.0, 60.0, 180.0, 2.0)

    async def run(self, seconds, *, samples=True):
        for _ in range(round(seconds / STEP_S)):
            self.clock.advance(STEP_S)
            if samples:
                self.sample()
            else:
                self.age_s += STEP_S
            await self.writer.write(np.arange(4))
            self.path.append((self.clock.monotonic(), self.U))

    @property
    def U(self):
        return self.source.written[-1][1] if self.source.written else np.nan

    @property
    def status(self):
        return self.led.shown(1)[1]


@pytest.fixture
def rig():
    return Rig()


async def test_nothing_is_written_until_it_is_armed_and_then_within_the_slew(rig):
    await rig.run(1.0)
    assert rig.source.written == []
    assert rig.status is FeedForwardStatus.DISARMED
    rig.led.arm(1, armed=True)
    await rig.run(1.0)
    assert {row for row, _ in rig.source.written} == {ROW}
    commands = np.array([U for _, U in rig.source.written])
    assert commands[0] == 20.0  # where the valve was
    assert commands[-1] == 60.0
    assert np.abs(np.diff(commands)).max() <= SLEW * STEP_S + 1e-9
    assert len(rig.source.heartbeats) >= 5
    assert rig.status is FeedForwardStatus.WRITING
    rig.led.arm(1, armed=False)
    await rig.run(0.1)
    assert rig.source.heartbeats[-1] == (ROW, 0)


async def test_an_axis_without_a_node_to_write_to_is_not_armed(rig):
    with pytest.raises(CommandRejected, match=r"Lift: nodes\.required_U"):
        rig.led.arm(0, armed=True)
    assert rig.led.shown(0) == (False, FeedForwardStatus.NOT_CONFIGURED)


@pytest.mark.parametrize(
    ("trouble", "status"),
    [
        ("stale", FeedForwardStatus.STALE),
        ("bad", FeedForwardStatus.BAD_SAMPLE),
        ("extrapolating", FeedForwardStatus.EXTRAPOLATED),
        ("unsure", FeedForwardStatus.TOO_UNSURE),
        ("withdrawn", FeedForwardStatus.NO_DEMAND),
    ],
)
async def test_the_fallback_acts_within_half_a_second_and_within_the_slew(rig, trouble, status):
    rig.led.arm(1, armed=True)
    await rig.run(2.0)
    assert rig.U == 60.0
    if trouble == "bad":
        rig.sample = lambda: Rig.sample(rig, x=np.nan)
    elif trouble == "extrapolating":
        rig.answers(RequiredU(90.0, 89.0, 91.0, InverseStatus.EXTRAPOLATING))
    elif trouble == "unsure":
        rig.answers(RequiredU(90.0, 50.0, 100.0, InverseStatus.OK))
    elif trouble == "withdrawn":
        rig.answers(RequiredU(status=InverseStatus.NOT_FINITE))
    began = rig.clock.monotonic()
    await rig.run(1.0, samples=trouble != "stale")
    assert rig.status is status
    moved = next(t for t, U in rig.path if t > began and U < 60.0)
    assert moved - began <= 0.5
    assert rig.U == 0.0
    commands = np.array([U for _, U in rig.source.written])
    assert np.abs(np.diff(commands)).max() <= SLEW * STEP_S + 1e-9


async def test_a_source_that_is_away_gets_nothing(rig):
    rig.led.arm(1, armed=True)
    await rig.run(1.0)
    n = len(rig.source.written)
    rig._age = rig.led._age_s
    rig.led._age_s = lambda _: None
    await rig.run(1.0)
    assert rig.status is FeedForwardStatus.SOURCE_LOST
    assert len(rig.source.written) == n


async def test_an_error_stops_the_axis_alone(rig):
    rig.led.arm(1, armed=True)

    def broken():
        raise ValueError("broken")

    rig.axes[1].required = broken
    await rig.run(0.1)
    assert rig.failures[0][0] == 1
    assert rig.source.written == []


def test_one_sample_with_a_missing_pressure_is_bad():
    one = Axis(AxisPlan("Press", GEOMETRY, feed_forward=SETTINGS))
    one.take(AxisSamples.of([1], U=[20.0], x=[400.0], pA=[50.0], pB=[np.nan], pS=[180.0], pT=[2.0]))
    assert one.situation().map.name == "REJECTED"


def test_the_settings_of_feed_forward_do_not_bind_the_state():
    plain = Axis(AxisPlan("Press", GEOMETRY))
    assert plain.key == Axis(AxisPlan("Press", GEOMETRY, feed_forward=SETTINGS)).key
