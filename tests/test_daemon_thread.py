"""Blocking work in a daemon thread: its result, its error, and a stop that does not wait for it."""

import asyncio
from threading import Event

import pytest

from valvemap.daemon_thread import in_daemon_thread, unless_stopped


async def test_work_is_awaited_with_its_result_or_its_error():
    assert await in_daemon_thread(lambda: 5) == 5
    with pytest.raises(ZeroDivisionError):
        await in_daemon_thread(lambda: 1 // 0)


async def test_work_is_waited_for_unless_it_is_stopped():
    stop, go = asyncio.Event(), Event()
    assert await unless_stopped(stop, in_daemon_thread(lambda: None))
    with pytest.raises(ZeroDivisionError):
        await unless_stopped(stop, in_daemon_thread(lambda: 1 // 0))
    stop.set()
    assert not await unless_stopped(stop, in_daemon_thread(go.wait))
    go.set()
