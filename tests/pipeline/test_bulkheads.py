"""What raises at one of several valves stops it alone: the others learn the same, to the bit."""

from functools import cache

import numpy as np
import pytest
import structlog

from support.bulkheads import (
    CULPRIT,
    LANES,
    STEPS,
    VALVES,
    Recorder,
    Sink,
    broken,
    plans,
    signals,
)
from support.plant import START
from valvemap.clock import ManualClock
from valvemap.errors import CommandRejected
from valvemap.pipeline.alarm_results import Remark
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.past import PastKeeper
from valvemap.vocabulary.statuses import Quality, Status

SIGNALS = 6
BATCHES = 4


def fresh():
    return Identification(plans(), Alignment(AlignmentSettings(), (("T",),) * VALVES))


@cache
def changes_of(number):
    """The changes of all valves in one batch of 20 samples."""
    parts = []
    for v in range(VALVES):
        samples = signals(v, number)
        n = len(samples)
        columns = [samples.U, samples.p1, samples.p2, samples.Q, samples.T, np.arange(n)]
        parts.append(
            DataChanges(
                item=np.tile(np.arange(6, dtype=np.int32) + np.int32(SIGNALS * v), n),
                value=np.stack(columns, axis=1).ravel(),
                status=np.zeros(6 * n, np.uint32),
                source_time=np.repeat(samples.t, 6),
            )
        )
    return DataChanges.concatenate(parts)


class Past:
    """A history in memory."""

    def __init__(self):
        self.kept, self.size, self.lost = {}, 0, 0

    def save(self, pieces):
        for piece in list(pieces):
            self.kept.setdefault(piece.series, []).append(piece.t)

    def note(self, changes):
        pass

    def take_notes(self):
        return []

    def forget(self):
        pass

    def rows(self, valve):
        return {
            name: np.concatenate(rows).tolist()
            for name, rows in self.kept.items()
            if name.startswith(f"{valve}.")
        }


class Running:
    """A live service of all valves with its sink and history."""

    def __init__(self, source, store, clock):
        self.sink, self.past, self.clock = Sink(), Past(), clock
        self.known = fresh()
        names = [plan.name for plan in self.known.plans]
        recorder, keeper = Recorder(), PastKeeper(self.past, names)
        self.live = LiveService(
            *(self.known, source, self.sink, store, clock, LiveSettings()),
            *(lambda *given: recorder.take(*given), keeper),  # noqa: PLW0108 - it is patched later
        )
        self.keeper = keeper
        for name in names:
            self.known.do(Command.of("demand", name, 30.0, 100.0))

    async def run(self):
        for number in range(BATCHES):
            await self.live.take(changes_of(number))
            self.clock.advance(0.2)
            await self.live.tick()
            if number == 1:
                self.known.maps.refresh_all()
            await self.keeper.settle()
            await self.live.keep()
        self.clock.advance(0.2)
        await self.live.tick()

    def of(self, valve):
        """Published sample counts of a valve in their order, repetitions left out."""
        found = [counts for number, counts in self.sink.published if number == valve]
        return [counts for k, counts in enumerate(found) if counts not in found[:k]]

    def alarm(self, valve):
        return next(a for a in self.known.alarms(f"V{valve}") if a.name == "LaneFailed")


@pytest.fixture
def running(source, store, clock):
    return Running(source, store, clock)


UNDISTURBED = {}


@pytest.fixture
async def undisturbed(source, store):
    """The same without any error, run once."""
    if not UNDISTURBED:
        one = UNDISTURBED["one"] = Running(source, store, ManualClock(START))
        await one.run()
    return UNDISTURBED["one"]


def others():
    return [v for v in range(VALVES) if v != CULPRIT]


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
async def test_an_error_in_any_step_of_one_valve_costs_the_others_nothing(
    step, running, undisturbed, monkeypatch
):
    with structlog.testing.capture_logs() as logged, monkeypatch.context() as patch:
        broken(patch, step)
        await running.run()
    known = running.known
    assert known.states.checkpoints(others()) == undisturbed.known.states.checkpoints(others())
    for v in others():
        result = known.results.one(v)
        assert {r.status for r in result.estimators.values()}.isdisjoint({Status.FAILED})
        assert {r.sample_count for r in result.estimators.values()} == {20 * BATCHES}
        assert known.results.counters(v)["lane_failures"] == 0
        assert not running.alarm(v).active
        assert running.of(v) == undisturbed.of(v)
        assert running.past.rows(f"V{v}")[f"V{v}.Signals"] == times(v)
    errors = [entry for entry in logged if entry["event"] == "lane failed"]
    assert len(errors) == 1
    assert errors[0]["exc_info"].args == ("injected",)
    failed = [
        name for name in LANES if known.valves.lane(f"V{CULPRIT}", name).status is Status.FAILED
    ]
    assert failed == list(step.stops)
    assert known.results.counters(CULPRIT)["lane_failures"] == 1
    alarm = running.alarm(CULPRIT)
    assert alarm.active
    assert f"{step.said}: RuntimeError: injected" in alarm.text
    shown = known.results.one(CULPRIT)
    for name in step.stops:
        assert shown.estimators[name].status is Status.FAILED
        assert shown.estimators[name].quality is Quality.BAD
    for name in set(LANES) - set(step.stops):
        assert shown.estimators[name].sample_count == 20 * BATCHES
    known.do(Command.of("reset", f"V{CULPRIT}", step.stops[0]))
    assert not running.alarm(CULPRIT).active
    assert known.valves.lane(f"V{CULPRIT}", step.stops[0]).status is not Status.FAILED
    before = known.results.one(CULPRIT).estimators[step.stops[0]].sample_count
    await running.live.take(changes_of(BATCHES))
    after = known.results.one(CULPRIT).estimators[step.stops[0]]
    assert (before, after.sample_count) == (0, 20)
    assert after.status is not Status.FAILED


@cache
def times(v):
    return [t for number in range(BATCHES) for t in signals(v, number).t.tolist()]


def test_a_lane_that_failed_keeps_its_last_state_and_stays_failed_over_a_restart(monkeypatch):
    known, changes = fresh(), [changes_of(number) for number in range(7)]
    for some in changes[:4]:
        known.take(some)
    before = known.states.checkpoints([CULPRIT])
    with monkeypatch.context() as patch:
        broken(patch, next(step for step in STEPS if step.name == "learning RLS"))
        known.take(changes[4])
    kept = {one.estimator: one for one in known.states.checkpoints([CULPRIT])}
    assert kept["RLS"].state == before[0].state
    again = fresh()
    again.restore(known.states.kept())
    again.take(changes[5])
    assert again.valves.lane(f"V{CULPRIT}", "RLS").status is Status.FAILED
    alarm = next(a for a in again.alarms(f"V{CULPRIT}") if a.name == "LaneFailed")
    assert alarm.active
    assert "RLS, learning: RuntimeError: injected" in alarm.text
    again.do(Command.of("acknowledge", f"V{CULPRIT}", "LaneFailed", Remark("seen", "operator", 1)))
    again.do(Command.of("reset", f"V{CULPRIT}", "RLS"))
    again.take(changes[6])
    assert again.results.one(CULPRIT).estimators["RLS"].sample_count == 20


def test_a_half_written_state_is_undone_before_a_lane_stops(monkeypatch):
    known = fresh()
    samples = signals(CULPRIT, 0)
    known.take_samples(CULPRIT, samples)
    before = known.states.checkpoints([CULPRIT])
    with monkeypatch.context() as patch:
        broken(patch, next(step for step in STEPS if step.name == "learning RLS"))
        known.take_samples(CULPRIT, signals(CULPRIT, 1))
    after = known.states.checkpoints([CULPRIT])
    assert after[0].state == before[0].state
    assert after[1].state != before[1].state


def test_what_an_operator_asks_of_a_lane_that_failed_is_answered(monkeypatch):
    known = fresh()
    known.take_samples(CULPRIT, signals(CULPRIT, 0))
    known.stop(CULPRIT, next(iter(STEPS)).step, RuntimeError("x" * 10_000))
    assert known.predict(f"V{CULPRIT}", "RLS", 50.0, 100.0, 40.0)[2] is Status.FAILED
    known.do(Command.of("freeze", f"V{CULPRIT}", "RLS"))
    known.do(Command.of("resume", f"V{CULPRIT}", "RLS"))
    assert known.valves.lane(f"V{CULPRIT}", "RLS").status is Status.FAILED
    with pytest.raises(CommandRejected, match="stopped at an unexpected error"):
        known.do(Command.of("approve", f"V{CULPRIT}"))
    assert known.answers.required(CULPRIT)[1] is Status.FAILED
    alarm = next(a for a in known.alarms(f"V{CULPRIT}") if a.name == "LaneFailed")
    assert len(alarm.text) < 1_000


def test_a_failure_is_logged_once_and_beyond_a_hundred_they_are_counted_alone():
    known = fresh()
    for _ in range(3):  # stopped already
        known.stop(CULPRIT, STEPS[0].step, RuntimeError("again"))
    assert len(known.failures.take_new()) == 1
    for _ in range(200):
        known.stop(CULPRIT, STEPS[0].step, RuntimeError("again"))
        known.do(Command.of("reset", f"V{CULPRIT}", "RLS"))
    assert len(known.failures.take_new()) == 100
    assert known.results.counters(CULPRIT)["lane_failures"] == 200
