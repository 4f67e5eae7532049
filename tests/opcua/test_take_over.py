"""What a line that is cut costs: nothing, as long as the source holds what was not heard."""

import asyncio
import time

import pytest
import pytest_asyncio

from guarded_opcua import Role, UserStore
from support.stream import NumberedServer, until, watching
from support.users import CHEAP

pytestmark = [pytest.mark.waits, pytest.mark.asyncio(loop_scope="module")]

SOON_S = 9.0  # after the line is back data are there again


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    plant = await NumberedServer.create(users=users)
    async with plant.server:
        yield plant, password


async def all_of_it(served, collector):
    """Wait for what has been published by now; nothing of it is missing or comes twice."""
    target = served[0].written
    await until(lambda: collector.numbers[-1] >= target)
    first, last = collector.numbers[0], collector.numbers[-1]
    assert sorted(set(collector.numbers)) == list(range(first, last + 1))
    assert collector.counters.keys() <= {"aligned"}


@pytest.mark.parametrize("named", [False, True], ids=["anonymous", "named"])
async def test_a_cut_line_costs_nothing_and_data_are_soon_there_again(served, named):
    async with watching(served, named=named) as (proxy, _, collector):
        await proxy.cut_for(1.5)
        back = time.monotonic()
        await until(lambda: collector.arrived[-1] > back)
        assert collector.arrived[-1] - back < SOON_S
        await all_of_it(served, collector)


async def test_a_line_that_flaps_costs_nothing(served):
    async with watching(served) as (proxy, _, collector):
        for _ in range(10):
            proxy.cut()
            await asyncio.sleep(0.3)
        await all_of_it(served, collector)


async def test_a_line_that_stalls_is_noticed_and_costs_nothing(served):
    async with watching(served) as (proxy, source, collector):
        proxy.stall()
        began = time.monotonic()
        await until(lambda: source.is_held)
        assert time.monotonic() - began < 6.0  # noticed after 5 s at most; one for the loop
        proxy.flow()
        proxy.cut()
        await all_of_it(served, collector)


async def test_a_session_that_is_gone_leaves_its_subscription_to_the_same_user(served):
    async with watching(served, named=True) as (proxy, source, collector):
        proxy.refuses = True
        proxy.cut()
        await until(lambda: source.is_held)
        source._ticket = None  # the service was restarted: nothing but the position is known
        await asyncio.sleep(1.0)
        proxy.refuses = False
        await all_of_it(served, collector)


async def test_queues_hold_a_minute_of_what_comes(served):
    async with watching(served, rate_hz=150) as (_, source, _):
        await until(
            lambda: min(i.queue_size for i in source._subscription.watched.items) >= 60 * 150
        )


@pytest.mark.soak
@pytest.mark.timeout(400)
@pytest.mark.parametrize("seconds", [5.0, 20.0, 45.0])
async def test_long_cuts_cost_nothing(served, seconds):
    async with watching(served) as (proxy, source, collector):
        await until(lambda: min(i.queue_size for i in source._subscription.watched.items) > 1_000)
        await proxy.cut_for(seconds)
        back = time.monotonic()
        await until(lambda: collector.arrived[-1] > back)
        assert collector.arrived[-1] - back < SOON_S
        await all_of_it(served, collector)


@pytest.mark.soak
@pytest.mark.timeout(400)
async def test_a_long_stall_costs_nothing(served):
    async with watching(served) as (proxy, source, collector):
        await until(lambda: min(i.queue_size for i in source._subscription.watched.items) > 1_000)
        proxy.stall()
        await asyncio.sleep(20.0)
        proxy.flow()
        await all_of_it(served, collector)
