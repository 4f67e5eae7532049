"""Log-ins are tried one at a time: known users first, strangers by turns of their addresses."""

import asyncio

import pytest

from valvemap.errors import CommandRejected
from valvemap.page.turns import Turns


class Queue:
    """Log-ins that wait for their turn, and note when it came."""

    def __init__(self):
        self.turns, self.came, self.open = Turns(), [], asyncio.Event()

    async def try_one(self, name, address, *, is_known=False):
        async with self.turns.turn(address, is_known=is_known):
            self.came.append(name)
            await self.open.wait()

    async def join(self, name, address, *, is_known=False):
        task = asyncio.create_task(self.try_one(name, address, is_known=is_known))
        await asyncio.sleep(0)
        return task


async def test_a_known_user_comes_first_and_addresses_take_turns():
    queue = Queue()
    tasks = [await queue.join("a1", "A")]
    tasks += [await queue.join(name, name[0].upper()) for name in ("a2", "a3", "b1", "b2", "c1")]
    tasks.append(await queue.join("known", "A", is_known=True))
    queue.open.set()
    await asyncio.gather(*tasks)
    assert queue.came == ["a1", "known", "a2", "b1", "c1", "a3", "b2"]


async def test_an_address_that_tries_too_often_is_refused_and_others_wait():
    queue = Queue()
    tasks = [await queue.join("first", "A")]
    tasks += [await queue.join(f"a{n}", "A") for n in range(5)]
    with pytest.raises(CommandRejected, match="wait"):
        await queue.try_one("one more", "A")
    tasks.append(await queue.join("b", "B"))
    queue.open.set()
    await asyncio.gather(*tasks)
    assert queue.came[2] == "b"


async def test_what_waits_is_bounded_whatever_the_number_of_addresses():
    queue = Queue()
    tasks = [await queue.join(f"n{n}", f"address {n}") for n in range(61)]
    with pytest.raises(CommandRejected):
        await queue.try_one("one more", "elsewhere")
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_log_in_that_is_given_up_loses_no_turn():
    queue = Queue()
    first, second, third = [await queue.join(name, "A") for name in ("a1", "a2", "a3")]
    second.cancel()
    first.cancel()
    queue.open.set()
    await asyncio.gather(first, second, third, return_exceptions=True)
    assert queue.came == ["a1", "a3"]
    await queue.try_one("later", "B")
