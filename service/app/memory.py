"""Memory that was needed for a moment goes back to the system."""

import asyncio
import ctypes
from collections.abc import Callable
from typing import Final

INTERVAL_S: Final = 60.0


async def give_back(interval_s: float = INTERVAL_S) -> None:
    """Give free memory back every ``interval_s``, in a thread, until cancelled.

    The C library keeps what lies between pieces still in use. With a thousand valves the largest of
    the passing needs is a rare sum of many, so that a process would grow for days, by a few MB an
    hour. Where there is no such function (macOS, Windows, musl) nothing is done.
    """
    trim = trimming()
    while trim is not None:
        await asyncio.sleep(interval_s)
        await asyncio.to_thread(trim)


def trimming() -> Callable[[], object] | None:
    """The C library's function that gives free memory back, None where it has none."""
    try:
        malloc_trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None
    malloc_trim.argtypes = [ctypes.c_size_t]
    return lambda: malloc_trim(0)
