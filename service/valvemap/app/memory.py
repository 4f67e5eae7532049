"""Returns free memory to the operating system."""

import asyncio
import ctypes
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Final

INTERVAL_S: Final = 60.0


@asynccontextmanager
async def giving_back(interval_s: float = INTERVAL_S) -> AsyncIterator[None]:
    """Return free memory to the system every ``interval_s``, in a thread.

    The C library retains free memory between blocks in use. With a thousand valves the temporary
    peaks add up rarely, so a process would grow for days, by a few MB per hour. Without
    ``malloc_trim`` (macOS, Windows, musl) this does nothing.
    """
    trim = trimming()
    task = None if trim is None else asyncio.create_task(_trim_often(trim, interval_s))
    try:
        yield
    finally:
        if task is not None:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task


def trimming() -> Callable[[], object] | None:
    """Return a function that calls the C library's ``malloc_trim``; None if it has none."""
    try:
        malloc_trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
    malloc_trim.argtypes = [ctypes.c_size_t]
    return lambda: malloc_trim(0)


async def _trim_often(trim: Callable[[], object], interval_s: float) -> None:
    while True:
        await asyncio.sleep(interval_s)
        await asyncio.to_thread(trim)
