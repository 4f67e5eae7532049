"""An axis at rest behind a source that sends on change alone: its silence is no loss."""

import numpy as np
import pytest

from support.small_plant import FakeSource, FakeStore
from valvemap.clock import ManualClock
from valvemap.errors import SourceLost
from valvemap.model.axis import AxisGeometry
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.runtime.axes import LiveAxes
from valvemap.vocabulary.signals import PER_VALVE, Signal

PLAN = AxisPlan("Press", AxisGeometry(63, 45, 800, 1.2, 1.2))
SENSORS = Signal.U, Signal.P1, Signal.P2, Signal.Q
PERIOD_S, STALE_S = 0.05, 2.0


class Machine:
    """One axis, whose source sends what has changed; time goes on by hand."""

    def __init__(self):
        self.clock, self.shown, self.has_begun = ManualClock(), {}, False
        optional = ((), ())
        self.live = LiveAxes(
            [PLAN],
            Arrivals(
                ["Press A", "Press B"],
                Alignment(AlignmentSettings(), optional=optional),
                Timing(TimingSettings(), optional=optional),
            ),
            self,
            FakeSource(),
            FakeStore(),
            self.clock,
            reorder_s=0.2,
            stale_after_s=STALE_S,
            checkpoint_interval_s=1e9,
        )
        self.live.start()

    def show_axis(self, axis, results):
        self.shown[axis] = results

    async def sends(self, seconds, signals, lacking=()):
        """``signals`` change with each scan; the others have sent one value, but ``lacking``."""
        rng = np.random.default_rng(0)
        for _ in range(round(seconds / PERIOD_S)):
            self.clock.advance(PERIOD_S)
            new = [j for j in SENSORS if j in signals or (not self.has_begun and j not in lacking)]
            self.has_begun = True
            item = np.array([PER_VALVE * line + j for line in (0, 1) for j in new], np.int32)
            if len(item):
                times = np.full(len(item), self.clock.now(), np.int64)
                good, x = np.zeros(len(item), np.uint32), rng.normal(50.0, 5.0, len(item))
                await self.live.take(DataChanges(item, x, good, times))
            await self.live.tick()

    @property
    def is_silent(self):
        return {one.name: one.active for one in self.shown["Press"].alarms}["AxisSilent"]


@pytest.mark.parametrize(
    "signals",
    [(), (Signal.P1, Signal.P2), (Signal.P1, Signal.P2, Signal.Q)],
    ids=["nothing moves", "the pressures move", "all but U"],
)
async def test_an_axis_at_rest_is_not_silent_while_its_source_is_there(signals):
    machine = Machine()
    await machine.live.connected(restarted_at=None)
    await machine.sends(10.0, signals)
    assert not machine.is_silent
    await machine.live.lost(SourceLost("cut"))
    await machine.sends(2.0 * STALE_S + 0.5, ())  # it is looked at every STALE_S
    assert machine.is_silent
    assert machine.shown["Press"].is_stale


async def test_an_axis_whose_pressure_never_came_is_silent():
    machine = Machine()
    await machine.live.connected(restarted_at=None)
    await machine.sends(STALE_S + 0.5, (), lacking=(Signal.P2,))
    assert machine.is_silent


@pytest.mark.parametrize("moved_s", [1.0, 6.0, 12.0])
async def test_an_axis_whose_command_moved_at_the_start_is_not_silent_when_it_rests(moved_s):
    machine = Machine()
    await machine.live.connected(restarted_at=None)
    await machine.sends(moved_s, SENSORS)
    await machine.sends(8.0, (Signal.P1, Signal.P2, Signal.Q))
    assert not machine.is_silent
    assert not machine.shown["Press"].is_stale
    newest = machine.live.axes[0].t
    assert machine.clock.now() - newest < 2_000_000_000


async def test_an_axis_that_comes_to_rest_keeps_its_results():
    machine = Machine()
    await machine.live.connected(restarted_at=None)
    await machine.sends(8.0, (Signal.P1, Signal.P2, Signal.Q))
    await machine.sends(STALE_S + 3.0, ())
    assert not machine.is_silent
    assert not machine.shown["Press"].is_stale
