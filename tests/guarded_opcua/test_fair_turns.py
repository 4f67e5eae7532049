import asyncio

import pytest

from guarded_opcua.clock import ManualClock
from guarded_opcua.transport.fair_turns import Cost, FairTurns


@pytest.fixture
def clock():
    return ManualClock()


def rich():
    account = Cost()
    account.credit, account.earned_until = 0.2, 0.0
    return account


async def test_one_request_runs_at_a_time_and_the_cheapest_is_next(clock):
    turns, served = FairTurns(clock), []
    flood, modest = rich(), rich()

    async def ask(account, name, cost):
        await turns.take(account)
        clock.work(cost)
        served.append(name)
        turns.give(account)

    await turns.take(rich())
    waiting = [asyncio.create_task(ask(flood, "flood", 0.001)) for _ in range(5)]
    await asyncio.sleep(0)
    waiting.append(asyncio.create_task(ask(modest, "modest", 0.0001)))
    await asyncio.sleep(0)
    assert served == []
    turns.give(flood)
    await asyncio.gather(*waiting)
    assert served.index("modest") <= 5
    assert len(served) == 6


async def test_who_has_spent_all_he_has_earned_comes_after_who_has_not(clock):
    turns, served = FairTurns(clock), []
    spent, modest = Cost(), rich()
    spent.credit = -1.0

    async def ask(account, name):
        await turns.take(account)
        served.append(name)
        turns.give(account)

    holder = rich()
    await turns.take(holder)
    tasks = [asyncio.create_task(ask(spent, "spent")), asyncio.create_task(ask(modest, "modest"))]
    await asyncio.sleep(0)
    turns.give(holder)
    await asyncio.gather(*tasks)
    assert served == ["modest", "spent"]


async def test_who_asks_for_much_at_a_time_is_in_excess_whatever_he_has_earned(clock):
    account = rich()
    for _ in range(3):
        account.charge(0.01)
    assert account.credit > 0.0
    assert account.in_excess


async def test_a_turn_that_is_waited_for_no_more_goes_to_the_next(clock):
    turns = FairTurns(clock)
    first, second, third = rich(), rich(), rich()
    await turns.take(first)
    given_up = asyncio.create_task(turns.take(second))
    waiting = asyncio.create_task(turns.take(third))
    await asyncio.sleep(0)
    given_up.cancel()
    turns.give(first)
    await waiting
    turns.give(third)
    await turns.take(first)


async def test_a_turn_given_to_one_who_leaves_just_then_is_passed_on(clock):
    turns = FairTurns(clock)
    first, second, third = rich(), rich(), rich()
    await turns.take(first)
    leaving = asyncio.create_task(turns.take(second))
    waiting = asyncio.create_task(turns.take(third))
    await asyncio.sleep(0)
    turns.give(first)
    leaving.cancel()
    async with asyncio.timeout(1.0):
        await waiting


async def test_excess_is_paced_only_while_somebody_is_modest(clock):
    turns = FairTurns(clock)
    greedy = Cost(credit=-10.0)

    async def busy(seconds):
        began, served = clock.monotonic(), 0
        while clock.monotonic() - began < 0.2:
            turn = asyncio.create_task(turns.take(greedy))
            await asyncio.sleep(0)
            while not turn.done():
                clock.advance(0.001)
                await asyncio.sleep(0)
            clock.work(seconds)
            turns.give(greedy)
            served += 1
        return served

    alone = await busy(0.005)
    modest = rich()
    modest.earned_until = clock.monotonic()
    await turns.take(modest)
    turns.give(modest)
    beside = await busy(0.005)
    assert beside < 0.6 * alone
