"""An axis is killed during a move: it goes on where its states end; losses are counted, worded."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import structlog

from support.small_plant import FakeSource, FakeStore
from valvemap.clock import ManualClock
from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axis_memory import MEMORY
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_states import checkpoints_of
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kept_axes import LEARNT, Learnt
from valvemap.pipeline.meaning import Meaning, SignalMeaning
from valvemap.runtime.axes import LiveAxes
from valvemap.runtime.kept_position import POSITION
from valvemap.vocabulary.signals import PER_VALVE, Signal

MEANING = Meaning("opc.tcp://plant", {"U": SignalMeaning("ns=2;s=U")})
PLAN = AxisPlan("Press", AxisGeometry(63, 45, 800, 1.2, 1.2), meaning=MEANING)
START = 1_900_000_000_000_000_000
PERIOD_NS = 10_000_000


class Source(FakeSource):
    """Sends samples as messages, and keeps each until it is acknowledged, to send it again."""

    def __init__(self):
        super().__init__()
        self.kept, self.sent = {}, 0
        self.mark = None

    def message(self, rows, without=()):
        """The changes of these samples; ``without`` are (line, k) that are lost on their way."""
        self.sent += 1
        self.kept[self.sent] = rows, without
        return self.changes(self.sent)

    def changes(self, number):
        rows, without = self.kept[number]
        self.mark = number
        item, value, t = [], [], []
        for k in rows:
            for line in (0, 1):
                if (line, k) in without:
                    continue
                for signal, number_ in signals_of(k, line).items():
                    item.append(PER_VALVE * line + signal)
                    value.append(number_)
                    t.append(START + k * PERIOD_NS)
        good = np.zeros(len(item), np.uint32)
        return DataChanges(np.array(item, np.int32), np.array(value), good, np.array(t, np.int64))

    def commit(self, mark):
        for number in [n for n in self.kept if n <= mark]:
            del self.kept[number]

    def position(self, mark):
        return json.dumps(mark).encode()

    def resume_at(self, position):
        self.mark = json.loads(position)
        return True

    def again(self):
        return [self.changes(number) for number in sorted(self.kept) if number > self.mark]


def signals_of(k, line):
    """A move with 0.5 Hz: U, both pressures, the position and the running number."""
    s = k * PERIOD_NS * 1e-9
    p1, p2 = (180.0, 90.0 + 5.0 * math.sin(9.0 * s)) if line == 0 else (60.0, 2.0)
    x = 400.0 + 300.0 * math.sin(math.pi * s)
    U = 40.0 * math.cos(math.pi * s)
    own = zip((Signal.U, Signal.P1, Signal.P2, Signal.Q), (U, p1, p2, x), strict=True)
    return {**dict(own), Signal.SEQUENCE: float(k)}


class Service:
    """One life of a service that identifies the axis."""

    def __init__(self, source, store, clock, plan=PLAN):
        self.shown, self.learnt, self.clock = {}, [], clock
        alignment = Alignment(AlignmentSettings(), ((), ()), (True, True))
        self.live = LiveAxes(
            [plan],
            Arrivals(["Press A", "Press B"], alignment),
            self,
            source,
            store,
            clock,
            reorder_s=0.2,
            stale_after_s=2.0,
            checkpoint_interval_s=10.0,
            tap=lambda _operator, _axis, samples: self.learnt.extend(samples.t.tolist()),
        )
        self.axis = self.live.axes[0]
        self.live.start()

    def show_axis(self, axis, results):
        self.shown[axis] = results

    async def keep(self):
        self.clock.advance(1.0)
        self.live.keeper.keep_in_turn(self.clock.monotonic())
        await self.live.keeper.settle()


def store_with_map():
    """A store with a map, so that the axis learns from each of its samples that moves."""
    store = FakeStore()
    service = Service(Source(), store, ManualClock(START))
    regression = AxisRegression(PLAN.geometry, period_s=0.01, play_percent=2.0, spool_hz=40.0)
    service.axis.learner.continue_from(
        Learnt(regression, regression.initial_state(), np.zeros((SIZE, SIZE)))
    )
    store.kept += checkpoints_of(service.axis, 1, service.axis.to_bytes())
    return store


def alive(source, store):
    """A life that resumes the stored states; its jobs would need seconds, and are left."""
    service = Service(source, store, ManualClock(START))
    service.axis.learner.job = lambda: None
    return service


def counters_of(service):
    """Its counters, shown now."""
    service.live._show(0)
    return service.shown["Press"].counters


MESSAGES = [range(5 * n, 5 * n + 5) for n in range(40)]
EVERY = [START + k * PERIOD_NS for k in range(5 * len(MESSAGES))]


async def killed_after(sent, saved, source, store, without=()):
    """A life that is killed behind ``sent`` messages, of which ``saved`` are in its last save."""
    service = alive(source, store)
    for number in range(sent):
        await service.live.take(source.message(MESSAGES[number], without))
        if number + 1 == saved:
            await service.keep()
    return service


async def rest_of(source, store, sent):
    """The next life: what was not acknowledged comes again, then the rest."""
    service = alive(source, store)
    for changes in source.again():
        await service.live.take(changes)
    for rows in MESSAGES[sent:]:
        await service.live.take(source.message(rows))
    return service


async def test_an_axis_killed_during_a_move_learns_each_sample_once():
    source, store = Source(), store_with_map()
    first = await killed_after(20, 14, source, store)
    assert list(source.kept) == list(range(15, 21))
    second = await rest_of(source, store, 20)
    assert first.learnt[: 5 * 14] + second.learnt == EVERY
    undisturbed = await rest_of(Source(), store_with_map(), 0)
    assert second.axis.to_bytes()[LEARNT] == undisturbed.axis.to_bytes()[LEARNT]
    counters = counters_of(second)
    assert (counters["aligned"], counters["gaps"], counters["missing"]) == (len(EVERY), 0, 0)


async def test_samples_that_the_saved_state_has_already_are_not_learnt_again():
    source, store = Source(), store_with_map()
    first = await killed_after(20, 14, source, store)
    lost = {n: (MESSAGES[n - 1], ()) for n in range(10, 15)}  # their acknowledgement never came
    source.kept = lost | source.kept
    store.kept = [
        replace(one, state=b"9") if (one.valve, one.estimator) == POSITION else one
        for one in store.kept
    ]
    second = await rest_of(source, store, 20)
    assert first.learnt[: 5 * 14] + second.learnt == EVERY


async def test_samples_that_the_source_dropped_while_the_service_was_away_are_counted():
    source, store = Source(), store_with_map()
    await killed_after(20, 14, source, store)
    del source.kept[16]
    second = await rest_of(source, store, 20)
    second.live._use(second.live._arrivals.wait_no_longer(np.arange(2)))
    assert counters_of(second)["gaps"] == 5


@pytest.mark.parametrize("line", [0, 1])
async def test_a_sample_that_one_line_lacks_is_lost_once_over_a_kill_too(line):
    source, store = Source(), store_with_map()
    await killed_after(20, 14, source, store, without={(line, 7), (line, 41)})
    second = await rest_of(source, store, 20)
    counters = counters_of(second)
    assert counters["gaps"] + counters["missing"] == 2
    assert counters["aligned"] == len(EVERY) - 2


async def test_a_signal_that_stops_is_named_as_in_the_configuration():
    source, store = Source(), store_with_map()
    clock = ManualClock(START)
    service = Service(source, store, clock)
    service.axis.learner.job = lambda: None
    await service.live.connected(restarted_at=None)
    lacking = Signal.P2  # of line A
    for number in range(14):
        changes = source.message(range(100 * number, 100 * number + 5))
        await service.live.take(changes if number < 5 else changes[changes.item != lacking])
        clock.advance(1.0)
        await service.live.tick()
    shown = service.shown["Press"]
    assert shown.is_stale
    assert any(words.startswith("pA sent its last value") for words in shown.waiting)


async def test_a_state_of_other_nodes_is_set_aside_and_named():
    source, store = Source(), store_with_map()
    await killed_after(20, 14, source, store)
    with structlog.testing.capture_logs() as logs:
        other = replace(MEANING, signals={"U": SignalMeaning("ns=2;s=U2")})
        Service(Source(), store, ManualClock(START), replace(PLAN, meaning=other))
    aside = {one.estimator for one, _ in store.aside}
    assert {LEARNT, MEMORY} <= aside
    (said,) = (line for line in logs if "their axes are reset" in line["event"])
    assert "U came from ns=2;s=U, now from ns=2;s=U2" in said["why"]
    assert "Press.Axis" in said["why"]


async def test_a_renamed_axis_keeps_what_it_learnt_and_its_place_at_the_source():
    source, store = Source(), store_with_map()
    first = await killed_after(20, 14, source, store)
    service = Service(source, store, ManualClock(START), replace(PLAN, name="Ram"))
    service.axis.learner.job = lambda: None
    for changes in source.again():
        await service.live.take(changes)
    assert first.learnt[: 5 * 14] + service.learnt == EVERY[: 5 * 20]
    await service.keep()
    assert {one.valve for one in store.kept} == {"Ram", "Service"}


async def test_an_axis_in_another_unit_is_set_aside_and_another_memory_keeps_its_map():
    source, store = Source(), store_with_map()
    first = await killed_after(20, 14, source, store)
    kept = first.axis.to_bytes()[LEARNT]
    again = Service(source, store, ManualClock(START), replace(PLAN, memory_s=900.0))
    assert again.axis.learner.learnt is not None
    in_inches = SignalMeaning("ns=2;s=U", "V", gain=10.0)
    other = replace(MEANING, signals={"U": in_inches})
    Service(source, store, ManualClock(START), replace(PLAN, meaning=other))
    aside = {one.estimator: why for one, why in store.aside}
    assert "U was read as" in aside[LEARNT]
    assert kept
