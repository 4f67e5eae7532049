"""Blocking work in a daemon thread, which does not delay the end of the process."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from threading import Thread
from typing import TypeVar

T = TypeVar("T")


def in_daemon_thread(work: Callable[[], T]) -> "asyncio.Future[T]":
    """Run blocking work; the future gets its result, unless the loop was closed before."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[T] = loop.create_future()

    def settle(settled: Callable[[], None]) -> None:
        if not done.done():
            settled()

    def run() -> None:
        try:
            found = work()
        except Exception as error:  # noqa: BLE001 - it is raised where the future is awaited
            failure = error
            call = lambda: done.set_exception(failure)  # noqa: E731
        else:
            call = lambda: done.set_result(found)  # noqa: E731
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(settle, call)

    Thread(target=run, daemon=True).start()
    return done


async def unless_stopped(stop: asyncio.Event, work: Awaitable[object]) -> bool:
    """Wait for work, or for ``stop``; return whether the work is done. Its errors are raised."""
    working, stopped = asyncio.ensure_future(work), asyncio.create_task(stop.wait())
    try:
        await asyncio.wait((working, stopped), return_when=asyncio.FIRST_COMPLETED)
    finally:
        stopped.cancel()
    if not working.done():
        working.cancel()
        return False
    working.result()
    return True
