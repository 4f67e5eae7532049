"""A timeout by a clock that may be slower than the machine's, or turned by hand."""

import asyncio
from collections.abc import Coroutine
from typing import Any, Final, TypeVar

from valvemap.clock import Clock

LOOK_S: Final = 0.02  # s of the machine's clock between two readings of the other

T = TypeVar("T")


async def within(seconds: float, clock: Clock, work: Coroutine[Any, Any, T]) -> T:
    """Return what ``work`` returns.

    Raises
    ------
    TimeoutError
        if it takes longer, in seconds of ``clock``; it is then cancelled.
    """
    until, task = clock.monotonic() + seconds, asyncio.ensure_future(work)
    try:
        while not task.done():
            if clock.monotonic() >= until:
                raise TimeoutError
            await asyncio.wait({task}, timeout=LOOK_S)
        return task.result()
    finally:
        if not task.done():
            task.cancel()
            await asyncio.wait({task})
