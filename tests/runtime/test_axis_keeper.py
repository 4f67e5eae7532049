"""States of axes that cannot be saved: counted, alarmed, and saved once they can be."""

import numpy as np
import pytest
import structlog

from support.small_plant import FakeSource
from valvemap.errors import StateFileLost, StorageError
from valvemap.model.axis import AxisGeometry
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_states import AxisStates
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.state_keeper import StateKeeper


class Store:
    error = None
    saved = 0

    def save(self, checkpoints):
        del checkpoints
        if self.error is not None:
            raise self.error
        self.saved += 1

    def load(self, _together=()):
        return []


@pytest.fixture
def disk():
    return Store()


@pytest.fixture
def keeper(disk, clock):
    axes = [Axis(AxisPlan("Press", AxisGeometry(63, 45, 800, 1, 1)))]
    arrivals = Arrivals(["A", "B"], Alignment(AlignmentSettings(), ((), ())))
    return StateKeeper(AxisStates(axes, arrivals), FakeSource(), disk, clock, 10.0)


async def turn(live, keeper, clock, seconds=10.0):
    clock.advance(seconds)
    keeper.keep_in_turn(clock.monotonic())
    await keeper.settle()
    await live.tick()
    await live.keeper.settle()


def alarm_of(sink):
    (alarm,) = [a for a in sink.health.alarms if a.name == "Checkpoint"]
    return alarm


async def test_failed_saves_raise_the_alarm_until_one_succeeds(
    keeper, disk, identification, source, sink, store, clock
):
    live = LiveService(identification, source, sink, store, clock, LiveSettings())
    await live.start()
    live.note_states_elsewhere(keeper)
    await turn(live, keeper, clock)
    assert disk.saved == 1
    disk.error = StorageError("disk full")
    with structlog.testing.capture_logs() as logs:
        for _ in range(8):
            await turn(live, keeper, clock)
    assert keeper.failures == 8
    assert sink.health.checkpoint_failures == 8
    assert sink.health.checkpoint_age_s == pytest.approx(80.0, abs=1.0)
    assert alarm_of(sink).active
    assert logs[0]["reason"] == "disk full"
    disk.error = None
    await turn(live, keeper, clock)
    assert not alarm_of(sink).active


async def test_a_lost_file_raises_it_at_once(
    keeper, disk, identification, source, sink, store, clock
):
    live = LiveService(identification, source, sink, store, clock, LiveSettings())
    await live.start()
    live.note_states_elsewhere(keeper)
    disk.error = StateFileLost("removed")
    await turn(live, keeper, clock)
    assert alarm_of(sink).active
    assert not np.isinf(sink.health.checkpoint_age_s)


async def test_its_refused_states_are_counted_with_the_valves(
    keeper, identification, source, sink, store, clock
):
    live = LiveService(identification, source, sink, store, clock, LiveSettings())
    await live.start()
    live.note_states_elsewhere(keeper)
    keeper.refused, live.keeper.refused = 2, 1
    await turn(live, keeper, clock)
    assert sink.health.checkpoints_refused == 3
