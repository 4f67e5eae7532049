"""Memory that was needed for a moment goes back to the system."""

import asyncio
import ctypes
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Final

INTERVAL_S: Final = 60.0


@asynccontextmanager
async def giving_back(interval_s: float = INTERVAL_S) -> AsyncIterator[None]:
    """Give free memory back every ``interval_s``, in a thread.

    The C library keeps what lies between pieces still in use. With a thousand valves the largest of
    the passing needs is a rare sum of many, so that a process would grow for days, by a few MB an
    hour. Where there is no such function (macOS, Windows, musl) nothing is done.
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
    """The C library's function that gives free memory back, None where it has none."""
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
