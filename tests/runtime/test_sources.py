"""Several sources in one service: each lives by itself, all teach one identification."""

import asyncio
from dataclasses import dataclass, field, replace
from itertools import repeat

import numpy as np
import pytest

from support.plant import as_changes, plant
from support.stream import until
from valvemap.errors import SourceLost, SourceRejected
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.sources import Part, Sources, supervise_all
from valvemap.runtime.supervisor import SupervisorSettings

QUICK = SupervisorSettings(0.0, tick_s=0.001, pauses=lambda: repeat(0.0))


@dataclass
class Scripted:
    """A source that hands out what it was given, then waits; an exception is raised instead."""

    script: list = field(default_factory=list)
    away: bool = False
    connects: int = 0
    mark: object = None
    committed: list = field(default_factory=list)
    resumed: list = field(default_factory=list)
    written: list = field(default_factory=list)
    refuses_position: bool = False
    is_held: bool = False
    started: int = 0
    clock_offset_s: float = 0.0
    remarks: dict = field(default_factory=dict)
    counters: SourceCounters = field(default_factory=SourceCounters)
    closed: bool = False
    checked: list = field(default_factory=list)

    async def connect(self):
        self.connects += 1
        await asyncio.sleep(0)
        if self.away:
            raise SourceLost("away")

    async def receive(self):
        if not self.script:
            await asyncio.get_running_loop().create_future()  # nothing comes any more
        step = self.script.pop(0)
        if isinstance(step, Exception):
            raise step
        self.mark = (self.mark or 0) + 1
        return step

    def hold_back(self):
        pass

    def commit(self, mark):
        self.committed.append(mark)

    def position(self, mark):
        return b"%d" % mark

    def resume_at(self, position):
        self.resumed.append(position)
        return not self.refuses_position

    async def write_required_U(self, valve, U):
        self.written.append((valve, U))

    async def write_heartbeat(self, valve, count):
        self.written.append((valve, count))

    async def check(self):
        for error in self.checked:
            raise error

    async def drop(self):
        pass

    async def close(self):
        self.closed = True


@pytest.fixture
def two(plan):
    plans = [replace(plan, name=name) for name in ("a", "b", "c")]
    return Identification(plans, Alignment(AlignmentSettings(), optional=(("T",),) * 3))


def parts(north, south):
    """Of three valves the second is of the south."""
    return Sources([Part("north", north, (0, 2)), Part("south", south, (1,))])


def of_both(n):
    """Changes of two valves, numbered by their own source."""
    first, second = as_changes(plant(n, seed=1)), as_changes(plant(n, seed=2))
    moved = replace(second, item=second.item + np.int32(6))
    return first.concatenate([first, moved])


async def run_until(sources, live, clock, done):
    stop = asyncio.Event()
    running = asyncio.create_task(supervise_all(sources, live, clock, stop, QUICK))
    await until(lambda: done() or running.done())
    stop.set()
    await running


def counts(identification):
    return [identification.results.one(v).estimators["RLS"].sample_count for v in range(3)]


async def test_each_source_teaches_its_valves_though_another_is_away(two, sink, store, clock):
    north, south = Scripted([of_both(100)]), Scripted(away=True)
    sources = parts(north, south)
    live = LiveService(two, sources, sink, store, clock, LiveSettings())
    await live.start()
    await run_until(sources, live, clock, lambda: south.connects > 3 and not north.script)
    assert counts(two) == [100, 0, 100]
    assert [line.split(", ")[0] for line in sources.states] == ["north: away", "south: away"]
    assert north.closed
    assert south.closed


class Late(Scripted):
    """Changes come while the connection ends, ``turns`` of the event loop after it began to."""

    begins_to_end: asyncio.Event
    turns: int

    async def receive(self):
        await self.begins_to_end.wait()
        for _ in range(self.turns):
            await asyncio.sleep(0)
        return await super().receive()


@pytest.mark.parametrize("turns", range(6))
@pytest.mark.parametrize("lost", [False, True])
async def test_what_is_received_while_a_connection_ends_is_taken(
    turns, lost, plan, sink, store, clock
):
    source, stop = Late([as_changes(plant(100, seed=1))]), asyncio.Event()
    source.begins_to_end, source.turns = asyncio.Event(), turns
    alone = Identification([plan], Alignment(AlignmentSettings(), optional=(("T",),)))
    sources = Sources([Part(None, source, (0,))])

    class Consumer(LiveService):
        async def tick(self, valves=None):
            await super().tick(valves)
            if not source.begins_to_end.is_set():
                source.begins_to_end.set()
                stop.set()
                await asyncio.sleep(0)
                if lost:
                    raise SourceLost("while writing")

    live = Consumer(alone, sources, sink, store, clock, LiveSettings())
    await live.start()
    await supervise_all(sources, live, clock, stop, QUICK)
    handed_out = 100 * (not source.script)
    assert alone.results.one(0).estimators["RLS"].sample_count == handed_out


async def test_what_both_send_is_learnt_as_from_one(two, plan, sink, store, clock):
    north, south = Scripted([of_both(100)]), Scripted([as_changes(plant(100, seed=3))])
    sources = parts(north, south)
    live = LiveService(two, sources, sink, store, clock, LiveSettings())
    await live.start()
    await run_until(sources, live, clock, lambda: min(counts(two)) == 100)
    alone = Identification([plan], Alignment(AlignmentSettings(), optional=(("T",),)))
    alone.take(as_changes(plant(100, seed=3)))
    theta = two.results.one(1).estimators["RLS"].theta
    np.testing.assert_array_equal(theta, alone.results.one(0).estimators["RLS"].theta)


async def test_a_cut_makes_the_valves_of_that_source_bad_alone(two, sink, store, clock):
    north, south = Scripted([of_both(50)]), Scripted([as_changes(plant(50, seed=3))])
    sources = parts(north, south)
    live = LiveService(two, sources, sink, store, clock, LiveSettings())
    await live.start()
    await run_until(sources, live, clock, lambda: min(counts(two)) == 50)
    sink.published.clear()
    await live.lost(SourceLost("cut"), np.array([1]))
    assert {result.valve for result in sink.published} == {1}


async def test_a_rejected_source_ends_the_start(two, sink, store, clock):
    south = Scripted([SourceRejected("no such node")])
    sources = parts(Scripted(), south)

    async def refuse():
        raise SourceRejected("no such node")

    south.connect = refuse
    live = LiveService(two, sources, sink, store, clock, LiveSettings())
    with pytest.raises(SourceRejected, match="no such node"):
        await supervise_all(sources, live, clock, asyncio.Event(), QUICK)
    assert sources.parts[0].source.closed


def test_positions_are_kept_by_name_and_each_goes_on_from_its_own():
    north, south = Scripted(mark=7), Scripted(mark=9)
    kept = parts(north, south).position((7, 9))
    again = Sources([Part("south", Scripted(), (0,)), Part("north", Scripted(), (1, 2))])
    assert again.resume_at(kept)
    assert [part.source.resumed for part in again.parts] == [[b"9"], [b"7"]]
    assert not parts(Scripted(), Scripted()).resume_at(b"damaged")
    assert not parts(Scripted(refuses_position=True), Scripted()).resume_at(kept)
    sources = parts(north, south)
    sources.commit((7, None))
    assert (north.committed, south.committed) == ([7], [])


def test_a_source_that_has_given_nothing_yet_keeps_its_place():
    kept = parts(Scripted(), Scripted()).position((7, 9))
    again = parts(Scripted(), Scripted())
    assert again.resume_at(kept)
    later = parts(Scripted(), Scripted())
    assert later.resume_at(again.position((8, None)))
    assert [part.source.resumed for part in later.parts] == [[b"8"], [b"9"]]
    heir = parts(Scripted(), Scripted())
    again.taken = [8, None]
    for part in again.parts:
        part.source.succeed = lambda before: None
    for part in heir.parts:
        part.source.succeed = lambda before: None
    heir.succeed(again)
    assert parts(Scripted(), Scripted()).resume_at(heir.position((None, None)))
    assert heir.position((None, 10)) == parts(Scripted(), Scripted()).position((8, 10))


async def test_what_waits_for_its_turn_is_not_taken(two, sink, store, clock):
    north, south = Scripted([of_both(10)]), Scripted([as_changes(plant(10, seed=3))])
    sources, seen = parts(north, south), []
    live = LiveService(two, sources, sink, store, clock, LiveSettings())
    take = live.take

    async def slowly(changes, valves):
        await asyncio.sleep(0.01)  # meanwhile the other has handed something out, too
        seen.append((sources.mark, north.mark, south.mark))
        await take(changes, valves)

    live.take = slowly
    await run_until(sources, live, clock, lambda: min(counts(two)) == 10)
    assert seen == [((1, None), 1, 1), ((1, 1), 1, 1)]


async def test_what_is_written_goes_to_the_valves_own_source():
    north, south = Scripted(), Scripted()
    sources = parts(north, south)
    await sources.write_required_U(2, 40.0)
    await sources.write_heartbeat(1, 5)
    assert (north.written, south.written) == ([(1, 40.0)], [(0, 5)])


async def test_it_is_said_how_each_source_stands(two, sink, store, clock):
    north = Scripted([of_both(10)], counters=SourceCounters(missing_messages=4))
    sources = parts(north, Scripted(away=True))
    live = LiveService(two, sources, sink, store, clock, LiveSettings())
    await live.start()
    seen = []
    await run_until(sources, live, clock, lambda: seen.append(sources.states) or not north.script)
    assert seen[-1] == (
        "north: connected, 4 messages missing, 0 overflows, 0 undecodable",
        "south: away, 0 messages missing, 0 overflows, 0 undecodable",
    )


def test_clocks_are_those_of_each_source_and_counts_the_sum():
    north = Scripted(clock_offset_s=3.0, counters=SourceCounters(missing_messages=1))
    south = Scripted(counters=SourceCounters(missing_messages=2))
    sources = parts(north, south)
    assert sources.clock_offset_s.tolist() == [3.0, 0.0, 3.0]
    assert sources.counters.missing_messages == 3


async def test_of_several_one_may_be_away_when_a_configuration_is_tried():
    await parts(Scripted(checked=[SourceLost("away")]), Scripted()).check()
    with pytest.raises(SourceRejected):
        await parts(Scripted(checked=[SourceRejected("no")]), Scripted()).check()
    with pytest.raises(SourceLost):
        await Sources([Part(None, Scripted(checked=[SourceLost("away")]), (0,))]).check()
