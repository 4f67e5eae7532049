import asyncio
import threading
import time
from dataclasses import replace
from itertools import repeat

import numpy as np
import pytest
import structlog

from support.plant import as_changes, plant
from valvemap.errors import CommandRejected, SourceLost, SourceRejected, StorageError
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.provenance import ALARMS, MEMORY, PLACES
from valvemap.runtime import learning_pace
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.publishing_turns import VALVES_AT_ONCE
from valvemap.runtime.supervisor import SupervisorSettings, supervise
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import Quality

QUICK = SupervisorSettings(tick_s=0.001, pauses=lambda: repeat(0.0))


@pytest.fixture
def live(identification, source, sink, store, clock):
    return LiveService(identification, source, sink, store, clock, LiveSettings())


async def run_until_the_script_ends(source, live, clock, settings=QUICK):
    stop = asyncio.Event()
    ended = live.lost

    async def lost(reason):
        await ended(reason)
        if not source.script:
            stop.set()

    live.lost = lost
    await supervise(source, live, clock, stop, settings)


async def test_a_cut_connection_turns_results_bad_and_then_good_again(live, source, sink, clock):
    samples = plant(600)
    source.script = [as_changes(samples[:300]), SourceLost("cut"), as_changes(samples[300:])]
    await run_until_the_script_ends(source, live, clock)
    qualities = [r.estimators["RLS"].quality for r in sink.published]
    assert qualities == [Quality.GOOD, Quality.BAD, Quality.GOOD, Quality.BAD]
    assert sink.published[2].estimators["RLS"].sample_count == 600


async def test_a_write_that_finds_the_connection_lost_loses_no_received_sample(
    live, source, sink, clock, monkeypatch
):
    """The first of several pieces is fed forward in vain; the source counts all as delivered."""
    monkeypatch.setattr(learning_pace, "FIRST_AT_ONCE", 60)
    monkeypatch.setattr(learning_pace, "FEWEST_AT_ONCE", 60)
    live._pace = learning_pace.LearningPace(is_interpreted=False)
    samples, cuts, write = plant(600), [SourceLost("cut")], live._feed_forward.write

    async def written(valves):
        if cuts and len(valves):
            raise cuts.pop()
        await write(valves)

    monkeypatch.setattr(live._feed_forward, "write", written)
    source.script = [as_changes(samples[:300]), as_changes(samples[300:]), SourceLost("cut")]
    await run_until_the_script_ends(source, live, clock)
    assert cuts == []
    assert sink.published[-1].estimators["RLS"].sample_count == 600


async def test_a_source_that_never_answers_ends_the_start_with_its_error(live, source, clock):
    source.connects = [SourceLost("opc.tcp://plc refused")] * 3
    settings = SupervisorSettings(startup_timeout_s=1e-9, tick_s=0.001, pauses=lambda: repeat(0.0))
    clock.advance(1.0)
    with pytest.raises(SourceLost, match="refused"):
        await supervise(source, live, _Running(clock), asyncio.Event(), settings)
    assert source.closed


class _Running:
    """A clock that moves on at every look."""

    def __init__(self, clock):
        self._clock = clock

    def now(self):
        return self._clock.now()

    def monotonic(self):
        self._clock.advance(0.1)
        return self._clock.monotonic()


async def test_a_rejection_at_start_is_not_tried_again(live, source, clock):
    source.connects = [SourceRejected("node 'ns=2;s=X' does not exist")]
    with pytest.raises(SourceRejected, match="does not exist"):
        await supervise(source, live, clock, asyncio.Event(), QUICK)


async def test_a_rejection_later_is_waited_out(live, source, sink, clock):
    source.connects = [None, SourceRejected("certificate expired"), None]
    source.script = [as_changes(plant(100)), SourceLost("cut"), as_changes(plant(9, first=100))]
    await run_until_the_script_ends(source, live, clock)
    assert sink.published[-2].estimators["RLS"].sample_count == 109


async def test_silence_makes_results_bad_once(live, sink, clock):
    await live.take(as_changes(plant(300)))
    clock.advance(1.9)
    await live.tick()
    assert sink.published[-1].estimators["RLS"].quality is Quality.GOOD
    clock.advance(0.2)
    await live.tick()
    await live.tick()
    assert [r.estimators["RLS"].quality for r in sink.published] == [Quality.GOOD, Quality.BAD]


@pytest.fixture
def numbered(plan, source, sink, store, clock):
    """A service whose valve has a running number."""
    align = Alignment(AlignmentSettings(), optional=(("T",),), has_sequence=(True,))
    return LiveService(Identification([plan], align), source, sink, store, clock, LiveSettings())


def count(live):
    return live.identification.results.one(0).estimators["RLS"].sample_count


async def test_what_waits_for_a_lost_sample_waits_no_longer_than_a_second(numbered, clock):
    changes = as_changes(plant(300))
    await numbered.take(changes[: 6 * 200])
    await numbered.take(changes[6 * 201 : 6 * 210])
    for _ in range(4):
        clock.advance(0.25)
        await numbered.tick()
    assert count(numbered) == 200
    clock.advance(0.25)
    await numbered.tick()
    assert count(numbered) == 209
    assert numbered.identification.results.counters(0)["gaps"] == 1


async def test_while_there_is_no_connection_or_we_stood_still_waiting_does_not_count(
    numbered, clock
):
    changes = as_changes(plant(300))
    await numbered.take(changes[: 6 * 200])
    await numbered.take(changes[6 * 201 : 6 * 210])
    clock.advance(60.0)  # we stood still
    await numbered.tick()
    await numbered.lost(SourceLost("cut"))
    for _ in range(100):
        clock.advance(0.25)
        await numbered.tick()
    await numbered.take(changes[6 * 200 : 6 * 201])
    assert count(numbered) == 210
    assert numbered.identification.results.counters(0)["gaps"] == 0


async def test_a_source_that_was_restarted_is_gone_on_with_whatever_its_numbers(numbered):
    await numbered.connected(restarted_at=None)
    await numbered.take(as_changes(plant(300)))
    await numbered.connected(restarted_at=None)
    assert numbered.identification.results.counters(0)["restarts"] == 0
    await numbered.connected(restarted_at=1)
    again = as_changes(plant(300, first=360))
    again.value[5::6] += 900
    await numbered.take(again)
    counters = numbered.identification.results.counters(0)
    assert (counters["gaps"], counters["restarts"], counters["lost_by_time"]) == (0, 1, 60)
    assert count(numbered) == 600
    await numbered.connected(restarted_at=1)  # the same restart is told again after a kill
    await numbered.take(again)
    counters = numbered.identification.results.counters(0)
    assert (counters["restarts"], counters["duplicates"]) == (1, 5 * 300)
    assert count(numbered) == 600


async def leading(live, source, clock):
    """A service that has led its valve to the answer; returns the samples taken so far."""
    await live.take(as_changes(plant(1000)))
    live.identification.do(Command.of("freeze", "Valvistor", "RLS"))
    live.identification.do(Command.of("demand", "Valvistor", 50.0, 100.0))
    live.identification.do(Command.of("arm", "Valvistor"))
    clock.advance(10.0)  # the plant's clock: a sample for every 10 ms of the 1,000
    for first in range(1000, 1030):
        clock.advance(0.1)
        await live.take(as_changes(now(plant(1, seed=2, first=first), clock)))
    assert source.written[-1] == (0, live.identification.answers.required(0)[0].U)
    return 1030


def now(samples, clock):
    return replace(samples, t=np.array([clock.now()]))


async def test_nothing_is_written_before_somebody_arms(live, source):
    live.identification.do(Command.of("demand", "Valvistor", 50.0, 100.0))
    await live.take(as_changes(plant(1000)))
    await live.tick()
    assert source.written == source.heartbeats == []


async def test_an_armed_valve_is_led_from_where_it_stands_at_the_slew(live, source, clock):
    await leading(live, source, clock)
    U = [U for _, U in source.written]
    assert U[0] == plant(1, seed=2, first=1000).U[0]
    assert np.abs(np.diff(U)).max() <= 50.0 * 0.1 + 1e-9
    counts = [count for _, count in source.heartbeats]
    assert counts == list(range(1, len(counts) + 1))
    assert len(counts) >= 25


async def test_an_answer_that_stays_is_written_once_and_the_heartbeat_goes_on(live, source, clock):
    first = await leading(live, source, clock)
    written, beats = len(source.written), len(source.heartbeats)
    for k in range(5):
        clock.advance(0.1)
        await live.take(as_changes(now(plant(1, seed=3, first=first + k), clock)))
    assert len(source.written) == written
    assert len(source.heartbeats) == beats + 5


async def test_between_two_samples_a_map_is_inverted_once(live, source, clock, monkeypatch):
    asked, required = [], EstimatorCommands.required

    def noted(self, valve):
        asked.append(valve)
        return required(self, valve)

    first = await leading(live, source, clock)
    monkeypatch.setattr(EstimatorCommands, "required", noted)
    for _ in range(20):
        clock.advance(0.05)
        await live._feed_forward.write(np.array([0]))
    assert len(asked) <= 1
    before = len(asked)
    live.identification.do(Command.of("demand", "Valvistor", 40.0, 100.0))
    await live._feed_forward.write(np.array([0]))
    assert len(asked) == before + 1
    await live.take(as_changes(now(plant(1, seed=3, first=first), clock)))
    assert len(asked) > before + 1


async def test_a_refused_write_is_repeated_and_why_nothing_is_written_is_published(
    live, source, clock, sink
):
    first = await leading(live, source, clock)
    source.refuses = True
    live.identification.do(Command.of("demand", "Valvistor", 60.0, 100.0))
    for k in range(5):
        clock.advance(0.1)
        await live.take(as_changes(now(plant(1, seed=3, first=first + k), clock)))
    assert live.identification.results.one(0).inverse.feed_forward is FeedForwardStatus.REFUSED
    assert sink.published[-1].inverse.feed_forward is FeedForwardStatus.REFUSED
    written, source.refuses = len(source.written), False
    clock.advance(0.1)
    await live.take(as_changes(now(plant(1, seed=3, first=first + 5), clock)))
    assert len(source.written) == written + 1
    assert sink.published[-1].inverse.feed_forward is FeedForwardStatus.REFUSED
    clock.advance(0.1)
    await live.tick()
    assert sink.published[-1].inverse.feed_forward is FeedForwardStatus.WRITING


async def test_samples_of_long_ago_are_stale_though_they_have_just_come(live, source, clock, sink):
    first = await leading(live, source, clock)
    clock.advance(0.1)
    late = now(plant(1, seed=3, first=first), clock)
    clock.advance(0.6)
    await live.take(as_changes(late))
    assert sink.published[-1].inverse.feed_forward is FeedForwardStatus.STALE


async def test_a_lost_source_is_not_written_to_and_the_valve_stays_armed(live, source, clock, sink):
    await leading(live, source, clock)
    await live.lost(SourceLost("cut"))
    assert sink.published[-1].inverse.feed_forward is FeedForwardStatus.SOURCE_LOST
    written, beats = len(source.written), len(source.heartbeats)
    clock.advance(0.1)
    await live.tick()
    assert (len(source.written), len(source.heartbeats)) == (written, beats)
    assert sink.published[-1].inverse.armed


async def test_a_restart_disarms(live, store, fresh):
    live.identification.do(Command.of("arm", "Valvistor"))
    await live.keep()
    again = fresh()
    again.restore(store.load())
    assert not again.armed.is_armed(0)


async def test_a_valve_without_a_node_to_write_to_cannot_be_armed(plan):
    bare = replace(plan, feed_forward=None)
    identification = Identification([bare], Alignment(AlignmentSettings(), optional=(("T",),)))
    with pytest.raises(CommandRejected, match=r"nodes\.required_U"):
        identification.do(Command.of("arm", "Valvistor"))
    inverse = identification.results.one(0).inverse
    assert inverse.feed_forward is FeedForwardStatus.NOT_CONFIGURED


async def test_a_state_that_cannot_be_is_said_in_a_line_and_published(
    live, fresh, store, source, sink, clock
):
    live.identification.take_samples(0, plant(50))
    await live.keep()
    store.kept = [replace(c, lam=7.0) if c.estimator == "RLS" else c for c in store.kept]
    again = LiveService(fresh(), source, sink, store, clock, LiveSettings())
    with structlog.testing.capture_logs() as logs:
        await again.start()
        await again.tick()
    (line,) = [entry["why"] for entry in logs if "set aside" in entry["event"]]
    assert line.startswith("Valvistor.RLS: forgetting factor 7.0")
    assert sink.health.checkpoints_refused == 1
    assert again.identification.results.one(0).estimators["RLS"].sample_count == 0
    assert again.identification.results.one(0).estimators["RML"].sample_count == 50


async def test_states_are_kept_at_their_interval(live, store, clock):
    await live.take(as_changes(plant(100)))
    await live.tick()
    assert store.kept == []
    clock.advance(10.0)
    await live.tick()
    await live.keeper.settle()
    assert [c.estimator for c in store.kept] == ["RLS", "RML", "RBF", MEMORY, ALARMS, PLACES]


def a_disk_that_takes(store, clock, seconds):
    save = store.save

    def slowly(checkpoints):
        clock.advance(seconds)
        save(checkpoints)

    store.save = slowly


async def test_an_end_does_not_wait_for_a_disk_that_is_too_slow(live, store, clock):
    a_disk_that_takes(store, clock, 4.0)
    await live.take(as_changes(plant(100)))
    clock.advance(10.0)
    await live.tick()
    began = clock.monotonic()
    assert not await live.keep(within_s=4.2)  # what is being kept is waited for, not more
    assert clock.monotonic() - began < 5.0
    kept = store.kept
    assert {"RLS", "RML", "RBF", MEMORY} <= {c.estimator for c in kept}
    assert not await live.keep(within_s=3.0)
    assert store.kept is kept


async def test_an_end_keeps_all_where_there_is_time(live, store, clock):
    a_disk_that_takes(store, clock, 0.5)
    await live.take(as_changes(plant(100)))
    clock.advance(10.0)
    await live.tick()
    await live.take(as_changes(plant(100, first=100)))
    assert await live.keep(within_s=4.2)
    again = live.identification.states.checkpoints()
    assert [c.state for c in store.kept[:3]] == [c.state for c in again]


async def test_states_of_many_valves_are_packed_a_few_at_a_time(plan, source, sink, store, clock):
    plans = [replace(plan, name=f"V{n}") for n in range(100)]
    many = Identification(plans, Alignment(AlignmentSettings(), optional=(("T",),) * 100))
    live = LiveService(many, source, sink, store, clock, LiveSettings())
    most, states = [], live.identification.states
    kept = states.kept
    states.kept = lambda valves: most.append(len(valves)) or kept(valves)
    await live.keep()
    assert max(most) <= 16
    assert len({c.valve for c in store.kept}) == 100


async def test_a_full_disk_stops_nothing(live, store, clock, sink):
    def full(_):
        raise StorageError("state.sqlite: disk full")

    store.save = full
    clock.advance(10.0)
    await live.tick()
    await live.take(as_changes(plant(100)))
    assert sink.published[-1].estimators["RLS"].sample_count == 100
    with pytest.raises(StorageError, match="disk full"):
        await live.keep()


async def test_at_start_old_states_are_taken_up_and_nothing_is_good_yet(live, store, sink, fresh):
    before = fresh()
    before.take_samples(0, plant(300))
    store.kept = before.states.checkpoints()
    await live.start()
    result = sink.published[-1].estimators["RLS"]
    assert result.sample_count == 300
    assert result.quality is not Quality.GOOD
    assert np.isfinite(result.theta).all()


async def test_where_time_is_short_the_valves_shown_longest_ago_come_first(
    plan, source, sink, store, clock
):
    n = 3 * VALVES_AT_ONCE
    plans = [replace(plan, name=f"V{k}") for k in range(n)]
    every = Identification(plans, Alignment(AlignmentSettings(), optional=(("T",),) * n))
    settings = LiveSettings(publish_budget_s=0.0)
    live = LiveService(every, source, sink, store, clock, settings)
    one = as_changes(plant(1))
    batch = DataChanges.concatenate(
        [replace(one, item=one.item + np.int32(6 * k)) for k in range(n)]
    )
    await live.take(batch)
    assert len(sink.published) == VALVES_AT_ONCE
    await live.tick()
    await live.take(as_changes(plant(1, first=1)))  # V0 has new results again: it waits its turn
    await live.tick()
    assert [r.valve for r in sink.published] == [*range(n), 0]
    await live.tick()
    assert len(sink.published) == n + 1


async def test_publishing_leaves_most_of_the_time_to_what_comes_in(live, sink, clock):
    published = sink.publish

    async def slowly(results):
        await published(results)
        clock.advance(0.010)

    sink.publish = slowly
    for first in range(100):
        await live.take(as_changes(plant(1, first=first)))
        clock.advance(0.001)
    shown = [r.estimators["RLS"].sample_count for r in sink.published]
    assert shown == [1, 31, 61, 91]


async def test_states_of_many_valves_are_kept_a_few_at_a_time(plan, source, sink, store, clock):
    n = 200
    plans = [replace(plan, name=f"V{k}") for k in range(n)]
    many = Identification(plans, Alignment(AlignmentSettings(), optional=(("T",),) * n))
    live = LiveService(many, source, sink, store, clock, LiveSettings())
    saved = []
    store.save = lambda checkpoints: saved.append([c.valve for c in checkpoints])
    for _ in range(40):
        clock.advance(0.25)
        await live.tick()
        await live.keeper.settle()
    assert sorted(v for some in saved for v in set(some)) == sorted(p.name for p in plans)
    assert max(len(set(some)) for some in saved) == 5


async def test_a_valve_that_cannot_be_what_it_is_called_is_named_once_with_the_remedy(
    live, source, clock
):
    samples = plant(200)
    psi = replace(samples, p1=samples.p1 * 14.5, p2=samples.p2 * 14.5)
    source.script = [as_changes(psi[:100]), as_changes(psi[100:])]
    with structlog.testing.capture_logs() as logs:
        await run_until_the_script_ends(source, live, clock)
    (said,) = [entry for entry in logs if entry["event"] == "implausible samples rejected"]
    assert said["valve"] == "Valvistor"
    assert "is it psi? signals.p1.unit" in said["why"]
    assert "insist = true" in said["remedy"]


async def test_data_that_come_late_are_uncertain_and_then_bad_though_they_keep_coming(
    live, sink, clock
):
    first, qualities = 0, []
    for behind_s in (0.0, 1.5, 2.5, 4.5, 28.0, 0.0):
        samples = plant(300, first=first)
        clock.advance((int(samples.t[-1]) - clock.now()) * 1e-9 + behind_s)
        await live.take(as_changes(samples))
        await live.tick()
        clock.advance(0.1)
        qualities.append(sink.published[-1].estimators["RLS"].quality)
        assert sink.health.age_s[0] == pytest.approx(behind_s, abs=1e-6)
        first += 10_000
    good, uncertain, bad = Quality.GOOD, Quality.UNCERTAIN, Quality.BAD
    assert qualities == [good, good, uncertain, bad, bad, good]


async def test_the_age_is_told_by_the_source_s_clock(live, source, sink, clock):
    source.clock_offset_s = -3600.0
    await live.take(as_changes(plant(300)))
    clock.advance(3603.0)
    await live.take(as_changes(plant(1, first=300)))
    await live.tick()
    assert sink.health.age_s[0] == pytest.approx(0.0, abs=1e-6)
    assert sink.published[-1].estimators["RLS"].quality is Quality.GOOD


async def test_what_became_of_keeping_the_states_is_shown(live, store, sink, clock):
    clock.advance(0.5)
    await live.tick()
    assert np.isnan(sink.health.checkpoint_age_s)
    clock.advance(10.0)
    await live.tick()
    await live.keeper.settle()
    clock.advance(0.5)
    await live.tick()
    assert (sink.health.checkpoint_age_s, sink.health.checkpoint_failures) == (0.5, 0)
    store.save = full_disk
    clock.advance(10.0)
    await live.tick()
    await live.keeper.settle()
    clock.advance(0.5)
    await live.tick()
    assert (sink.health.checkpoint_age_s, sink.health.checkpoint_failures) == (11.0, 1)


def full_disk(_):
    raise StorageError("state.sqlite: disk full")


async def test_much_at_once_is_learnt_in_pieces_and_others_are_served_between(
    live, fresh, source, clock
):
    learn, pieces, served, source.mark = live.identification.take, [], [], 1

    def slowly(changes):
        pieces.append(len(changes))
        clock.advance(1e-4 * len(changes))
        return learn(changes)

    async def another():
        while True:
            served.append(len(pieces))
            await asyncio.sleep(0)

    live.identification.take = slowly
    other = asyncio.create_task(another())
    await live.take(as_changes(plant(3000)))
    other.cancel()
    assert max(pieces[1:]) == 600
    assert sum(pieces) == 6 * 3000
    assert len(set(served)) >= len(pieces)
    once = fresh()
    once.take(as_changes(plant(3000)))
    assert live.identification.states.checkpoints() == once.states.checkpoints()


async def test_what_becomes_old_while_others_are_learnt_is_doubted_at_once(live, sink, clock):
    samples = plant(300)
    await live.take(as_changes(samples))
    clock.advance((int(samples.t[-1]) - clock.now()) * 1e-9 + 1.9)
    learn, doubted = live.identification.take, []

    def slowly(_):
        doubted.append(list(sink.doubted))
        clock.advance(0.3)
        return learn(DataChanges.empty())

    live.identification.take = slowly
    await live.take(as_changes(plant(1000, first=300)))
    assert doubted[:2] == [[], [0]]
    assert sink.doubted == [0]


async def test_an_end_does_not_learn_all_that_has_come_and_the_source_is_asked_again(
    live, source, clock
):
    learn, source.mark = live.identification.take, "before"
    await live.take(as_changes(plant(10)))

    def slowly(changes):
        clock.advance(0.2)
        return learn(changes)

    live.identification.take, source.mark = slowly, "behind"
    live.end_soon()
    await live.take(as_changes(plant(3000, first=10)))
    assert 10 < count(live) < 1000
    assert live.keeper.mark == "before"
    assert live.time_left_s > 3.0


async def test_a_slow_disk_holds_nothing_up(live, store, clock):
    may_go_on = threading.Event()
    store.save = lambda _: may_go_on.wait(10.0)
    await live.take(as_changes(plant(300)))
    clock.advance(2.0)
    began = time.monotonic()
    for first in range(300, 320):
        clock.advance(0.25)
        await live.tick()
        await live.take(as_changes(plant(1, first=first)))
    assert time.monotonic() - began < 5.0  # far less than the disk takes
    assert count(live) == 320
    may_go_on.set()
    await live.keeper.settle()


@pytest.fixture
def starting(plan, source, sink, store, clock):
    """A service whose second estimator waits for the compiler."""
    align = Alignment(AlignmentSettings(), optional=(("T",),), has_sequence=(True,))
    waits = list(plan.estimators)[1:]
    preview = Identification([plan], align, waits=waits)
    return LiveService(preview, source, sink, store, clock, LiveSettings())


def whole(plan):
    align = Alignment(AlignmentSettings(), optional=(("T",),), has_sequence=(True,))
    return Identification([plan], align)


async def test_a_preview_publishes_and_its_successor_misses_no_sample(starting, plan, sink):
    changes = as_changes(plant(300))
    await starting.take(changes[:600])
    first, *waiting = sink.published[-1].estimators.values()
    assert first.sample_count == 100
    assert {one.sample_count for one in waiting} == {0}
    await starting.complete(whole(plan))
    await starting.take(changes[600:])
    assert {one.sample_count for one in sink.published[-1].estimators.values()} == {300}


async def test_a_preview_saves_nothing_and_its_successor_does(starting, plan, store, clock):
    await starting.take(as_changes(plant(300)))
    clock.advance(60.0)
    await starting.tick()
    assert await starting.keep()
    assert not store.load()
    await starting.complete(whole(plan))
    clock.advance(60.0)
    await starting.tick()
    await starting.keeper.settle()
    assert store.load()


async def test_a_preview_that_falls_behind_waits_for_its_successor(starting, plan):
    starting._pace.changes_per_s = 600.0  # a slow machine
    taking = asyncio.create_task(starting.take(as_changes(plant(300))))
    for _ in range(20):
        await asyncio.sleep(0)
    assert not taking.done()
    await starting.complete(whole(plan))
    await taking
    assert count(starting) == 300


async def test_a_preview_that_waits_ends_at_once_when_it_is_asked_to(starting, clock):
    starting._pace.changes_per_s = 600.0
    taking = asyncio.create_task(starting.take(as_changes(plant(300))))
    await asyncio.sleep(0)
    starting.end_soon()
    clock.advance(1.0)
    await taking
    assert count(starting) == 0


async def test_a_stall_of_this_process_makes_results_old_and_is_no_loss_of_sensors(
    live, sink, clock
):
    await live.take(as_changes(plant(300)))
    await live.tick()
    clock.advance(3.0)  # with what has come meanwhile still to be read
    await live.tick()
    assert sink.published[-1].estimators["RLS"].quality == Quality.BAD
    assert "SensorLost" not in active(live)
    for _ in range(6):
        clock.advance(0.4)
        await live.tick()
    assert "SensorLost" in active(live)


def active(live):
    (valve,) = live.identification.plans
    return {alarm.name for alarm in live.identification.alarms(valve.name) if alarm.active}
