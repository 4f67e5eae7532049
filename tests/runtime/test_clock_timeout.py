"""A timeout counts the seconds of the clock that is given."""

import asyncio

import pytest

from valvemap.clock import ManualClock
from valvemap.errors import SourceLost
from valvemap.runtime.clock_timeout import within


async def after(looks, outcome):
    for _ in range(looks):
        await asyncio.sleep(0)
    if isinstance(outcome, Exception):
        raise outcome
    return outcome


async def test_what_comes_in_time_is_returned_and_errors_pass():
    assert await within(0.3, ManualClock(), after(3, "taken")) == "taken"
    with pytest.raises(SourceLost):
        await within(0.3, ManualClock(), after(3, SourceLost("cut")))


async def test_it_waits_as_long_as_the_clock_stands_and_cancels_afterwards():
    clock, never = ManualClock(), asyncio.Event()
    waits = asyncio.ensure_future(within(0.3, clock, never.wait()))
    await asyncio.sleep(0.05)
    clock.advance(0.29)
    await asyncio.sleep(0.05)
    assert not waits.done()
    clock.advance(0.02)
    with pytest.raises(TimeoutError):
        await waits


async def test_who_is_cancelled_takes_the_work_along():
    began, ended = asyncio.Event(), asyncio.Event()

    async def work():
        began.set()
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()

    waits = asyncio.ensure_future(within(1.0, ManualClock(), work()))
    await began.wait()
    waits.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waits
    assert ended.is_set()
