import asyncio
import time

import pytest

from service.opcua.hardened import turns as module
from service.opcua.hardened.turns import Account, Turns


class Processor:
    """Processor time and time of day, turned by hand."""

    def __init__(self):
        self.now = 0.0

    def work(self, seconds):
        self.now += seconds


@pytest.fixture
def processor(monkeypatch):
    made = Processor()

    class Clock:
        perf_counter = staticmethod(lambda: made.now)
        thread_time = staticmethod(lambda: made.now)

    monkeypatch.setattr(module, "time", Clock)
    return made


def rich():
    account = Account()
    account.credit, account.earned_until = 0.2, 0.0
    return account


async def test_one_request_runs_at_a_time_and_the_cheapest_is_next(processor):
    turns, served = Turns(), []
    flood, modest = rich(), rich()

    async def ask(account, name, cost):
        await turns.take(account)
        processor.work(cost)
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


@pytest.mark.usefixtures("processor")
async def test_who_has_spent_all_he_has_earned_comes_after_who_has_not():
    turns, served = Turns(), []
    spent, modest = Account(), rich()
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


@pytest.mark.usefixtures("processor")
async def test_who_asks_for_much_at_a_time_is_in_excess_whatever_he_has_earned():
    account = rich()
    for _ in range(3):
        account.charge(0.01)
    assert account.credit > 0.0
    assert account.in_excess


@pytest.mark.usefixtures("processor")
async def test_a_turn_that_is_waited_for_no_more_goes_to_the_next():
    turns = Turns()
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


@pytest.mark.usefixtures("processor")
async def test_a_turn_given_to_one_who_leaves_just_then_is_passed_on():
    turns = Turns()
    first, second, third = rich(), rich(), rich()
    await turns.take(first)
    leaving = asyncio.create_task(turns.take(second))
    waiting = asyncio.create_task(turns.take(third))
    await asyncio.sleep(0)
    turns.give(first)
    leaving.cancel()
    async with asyncio.timeout(1.0):
        await waiting


async def test_excess_is_paced_only_while_somebody_is_modest():
    turns = Turns()
    greedy = Account(credit=-10.0)

    async def busy(seconds):
        began, served = time.perf_counter(), 0
        while time.perf_counter() - began < 0.2:
            served += 1
            await turns.take(greedy)
            until = time.thread_time() + seconds
            while time.thread_time() < until:
                pass
            turns.give(greedy)
            await asyncio.sleep(0)
        return served

    alone = await busy(0.005)
    modest = rich()
    modest.earned_until = time.perf_counter()
    await turns.take(modest)
    turns.give(modest)
    beside = await busy(0.005)
    assert beside < 0.6 * alone
