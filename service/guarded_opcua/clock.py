"""The only place of the server that reads a clock or sets a timer; tests turn one by hand."""

import asyncio
import heapq
import itertools
import time
from collections.abc import Callable
from typing import Protocol


class Timer(Protocol):
    """What was set for later."""

    def cancel(self) -> None:
        """Let it not happen; safe if it has happened."""


class Clock(Protocol):
    """Reads the time of day, a time that never jumps, and what the processor has done."""

    def now(self) -> int:
        """UTC in ns since 1970."""

    def monotonic(self) -> float:
        """Seconds since some instant, never running back."""

    def processor(self) -> float:
        """Processor time that this thread has used, s."""

    def call_at(self, when: float, callback: Callable[[], object]) -> Timer:
        """Call back once :meth:`monotonic` is ``when``; at once if that is over."""

    async def sleep(self, seconds: float) -> None:
        """Wait."""


class SystemClock:
    """The machine's clock, and the timers of the running event loop."""

    def now(self) -> int:
        """UTC in ns since 1970."""
        return time.time_ns()

    def monotonic(self) -> float:
        """Seconds since some instant, never running back."""
        return time.monotonic()

    def processor(self) -> float:
        """Processor time that this thread has used, s."""
        return time.thread_time()

    def call_at(self, when: float, callback: Callable[[], object]) -> Timer:
        """Call back once :meth:`monotonic` is ``when``; at once if that is over."""
        loop = asyncio.get_running_loop()
        return loop.call_later(when - time.monotonic(), callback)

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await asyncio.sleep(seconds)


class ManualClock:
    """A clock that a test turns by hand; timers that are due run while it is turned.

    >>> clock = ManualClock(start=1_000_000_000)
    >>> _ = clock.call_at(1.0, lambda: print("at", clock.monotonic()))
    >>> clock.advance(1.5)
    at 1.0
    >>> clock.now(), clock.monotonic()
    (2500000000, 1.5)
    """

    def __init__(self, start: int = 0) -> None:
        self._start = start
        self._elapsed = 0.0
        self._work = 0.0
        self._order = itertools.count()
        self._timers: list[tuple[float, int, _ManualTimer]] = []

    def advance(self, seconds: float) -> None:
        """Turn the clock forward."""
        end = self._elapsed + seconds
        while self._timers and self._timers[0][0] <= end:
            when, _, timer = heapq.heappop(self._timers)
            self._elapsed = max(self._elapsed, when)
            timer.run()
        self._elapsed = end

    def work(self, seconds: float) -> None:
        """Turn the clock forward as if the processor had worked all that time."""
        self._work += seconds
        self.advance(seconds)

    def now(self) -> int:
        """UTC in ns since 1970."""
        return self._start + round(self._elapsed * 1e9)

    def monotonic(self) -> float:
        """Seconds since the clock was made."""
        return self._elapsed

    def processor(self) -> float:
        """Seconds that were worked."""
        return self._work

    def call_at(self, when: float, callback: Callable[[], object]) -> Timer:
        """Call back while the clock is turned past ``when``."""
        timer = _ManualTimer(callback)
        heapq.heappush(self._timers, (when, next(self._order), timer))
        return timer

    async def sleep(self, seconds: float) -> None:
        """Wait until the clock has been turned so far."""
        over = asyncio.Event()
        timer = self.call_at(self._elapsed + seconds, over.set)
        try:
            await over.wait()
        finally:
            timer.cancel()


class _ManualTimer:
    def __init__(self, callback: Callable[[], object]) -> None:
        self._callback: Callable[[], object] | None = callback

    def run(self) -> None:
        if self._callback is not None:
            self._callback()

    def cancel(self) -> None:
        self._callback = None
