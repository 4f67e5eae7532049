"""What queues no longer hold is had from the source's history: nothing is lost, nothing twice."""

import asyncio
import time
from contextlib import asynccontextmanager
from itertools import repeat

import numpy as np
import pytest

from guarded_opcua import Limits, Role, UserStore
from support.stream import NODES, RATE_HZ, Collector, NumberedServer, until, watching
from support.users import CHEAP
from valvemap.clock import SystemClock
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.history import NEVER, Knowledge
from valvemap.pipeline.data_changes import DataChanges
from valvemap.runtime.supervisor import SupervisorSettings, supervise
from valvemap.vocabulary.signals import PER_VALVE

pytestmark = pytest.mark.waits

SHORT = Limits(queue_size=30)  # 0.3 s of what comes
FORGETFUL = Limits(longest_lifetime_s=1.0, lifetime_count=20, keep_alive_count=5)
STEP_NS = 10_000_000
CUT_S = 1.6
AT_ONCE = SupervisorSettings(pauses=lambda: repeat(0.1))


@asynccontextmanager
async def plant(limits, remembers=100_000):
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    made = await NumberedServer.create(users=users, limits=limits, remembers=remembers)
    async with made.server:
        yield made, password


async def all_in_order(served, collector):
    target = served[0].written - 1
    await until(lambda: collector.numbers[-1] >= target)
    numbers = collector.numbers
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert collector.counters.keys() <= {"aligned"}


@pytest.mark.parametrize(
    ("limits", "named"),
    [(SHORT, False), (FORGETFUL, False), (FORGETFUL, True)],
    ids=["queue too short", "subscription gone", "subscription of a user gone"],
)
async def test_a_cut_longer_than_the_source_holds_costs_nothing(limits, named):
    async with (
        plant(limits) as served,
        watching(served, named=named, supervision=AT_ONCE) as (proxy, source, collector),
    ):
        await proxy.cut_for(CUT_S)
        await all_in_order(served, collector)
        assert source.counters.from_history >= RATE_HZ * PER_VALVE / 2
        asked = RATE_HZ * PER_VALVE * collector.longest_wait_s
        assert source.counters.from_history < 2 * asked  # it is asked for what is missing alone


async def test_a_cut_while_the_past_is_read_costs_nothing():
    async with (
        plant(FORGETFUL) as served,
        watching(served, supervision=AT_ONCE) as (proxy, source, collector),
    ):
        proxy.refuses = True
        proxy.cut()
        served[0].remember(20_000, time.time_ns(), 10_000)
        await asyncio.sleep(CUT_S)
        proxy.refuses = False
        await until(lambda: source.counters.from_history > 20_000)
        proxy.cut()
        await all_in_order(served, collector)


async def test_without_history_what_is_lost_is_counted_to_the_sample():
    async with (
        plant(FORGETFUL, remembers=0) as served,
        watching(served, supervision=AT_ONCE) as (proxy, source, collector),
    ):
        await proxy.cut_for(CUT_S)
        heard = len(collector.numbers)
        await until(lambda: len(collector.numbers) > heard + RATE_HZ)
        await until(lambda: "gaps" in collector.counters)  # once nothing waits behind the hole
        numbers = collector.numbers
        lost = numbers[-1] - numbers[0] + 1 - len(numbers)
        assert lost > RATE_HZ / 2
        assert collector.counters["gaps"] == lost
        assert collector.counters.keys() == {"aligned", "gaps"}
        assert source.counters.from_history == 0


async def test_what_a_short_history_has_no_more_is_counted_to_the_sample():
    async with (
        plant(FORGETFUL, remembers=50) as served,
        watching(served, supervision=AT_ONCE) as (proxy, source, collector),
    ):
        await proxy.cut_for(CUT_S)
        heard = len(collector.numbers)
        await until(lambda: len(collector.numbers) > heard + 2 * RATE_HZ)
        numbers = collector.numbers
        lost = numbers[-1] - numbers[0] + 1 - len(numbers)
        assert lost > 0
        assert collector.counters["gaps"] == lost
        assert 0 < source.counters.from_history <= 50 * PER_VALVE


async def test_who_does_not_want_history_does_not_get_it():
    async with (
        plant(FORGETFUL) as served,
        watching(served, supervision=AT_ONCE, history_s=0.0) as (proxy, source, collector),
    ):
        await proxy.cut_for(CUT_S)
        heard = len(collector.numbers)
        await until(lambda: len(collector.numbers) > heard + RATE_HZ)
        assert source.counters.from_history == 0


async def test_five_minutes_at_100_hz_are_caught_up_at_more_than_20_times_real_time():
    async with plant(FORGETFUL) as served:
        made, stop, collector = served[0], asyncio.Event(), Collector()
        settings = SourceSettings(f"opc.tcp://127.0.0.1:{made.port}/plant/")
        source = OpcUaSource(settings, [NODES])
        t0 = time.time_ns()
        made.publish(t0)
        await source.connect()
        await collector.take(await source.receive())
        await source.drop()
        made.remember(30_000, t0 + STEP_NS, STEP_NS)
        await asyncio.sleep(1.5)  # until the source has forgotten us
        began = time.monotonic()
        watching = asyncio.create_task(
            supervise(source, collector, SystemClock(), stop, SupervisorSettings())
        )
        await until(lambda: collector.numbers[-1] == 30_000)
        took_s = time.monotonic() - began
        stop.set()
        await watching
        assert collector.numbers == list(range(30_001))
        assert 300.0 / took_s > 20.0


def changes_of(rows):
    item, t = zip(*rows, strict=True)
    n = len(rows)
    return DataChanges(
        np.array(item, np.int32), np.zeros(n), np.zeros(n, np.uint32), np.array(t, np.int64)
    )


def test_a_hole_is_what_lies_between_the_last_and_the_next_of_each_signal():
    known = Knowledge(12)
    known.note(changes_of([(0, 100), (1, 100), (5, 100), (6, 50)]))
    ahead = changes_of([(0, 400), (1, 500), (0, 600), (7, 500)])
    assert len(known.holes(ahead, 10**9)) == 0  # nothing is in doubt
    known.doubt()
    found = known.holes(ahead, 10**9)
    assert found.items.tolist() == [0, 1, 5]
    assert found.low.tolist() == [101] * 3
    assert found.high.tolist() == [399, 499, 499]
    assert known.holes(ahead, 50).low.tolist() == [349, 449, 449]
    known.fill(found, 200)
    assert known.holes(ahead, 10**9).low.tolist() == [201] * 3
    known.fill(found, 10**6)
    known.note(ahead)
    assert not known.doubtful[[0, 1]].any()
    assert known.known_to[[0, 1, 5, 6]].tolist() == [600, 500, 499, 50]


def test_nothing_is_asked_for_before_the_first_sample_ever():
    known = Knowledge(6)
    known.doubt()
    known.doubt(np.arange(6, dtype=np.int32))
    assert len(known.holes(changes_of([(k, 400) for k in range(6)]), 10**9)) == 0
    assert (known.known_to == NEVER).all()
