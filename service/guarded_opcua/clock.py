"""The only module of the server that reads a clock or sets a timer; tests inject a manual clock."""

import asyncio
import heapq
import itertools
import time
from collections.abc import Callable
from typing import Protocol


class Timer(Protocol):
    """A scheduled callback."""

    def cancel(self) -> None:
        """Cancel the callback; no effect if it has run."""


class Clock(Protocol):
    """Reads the time of day, the monotonic time and the processor time; sets timers."""

    def now(self) -> int:
        """Return UTC in ns since 1970."""

    def monotonic(self) -> float:
        """Return the monotonic time, s."""

    def processor(self) -> float:
        """Return the processor time that this thread has used, s."""

    def call_at(self, when: float, callback: Callable[[], object]) -> Timer:
        """Call back once :meth:`monotonic` reaches ``when``; immediately if it is in the past."""

    async def sleep(self, seconds: float) -> None:
        """Wait for that time, s."""


class SystemClock:
    """The machine's clock, and the timers of the running event loop."""

    def now(self) -> int:
        """Return UTC in ns since 1970."""
        return time.time_ns()

    def monotonic(self) -> float:
        """Return the monotonic time, s."""
        return time.monotonic()

    def processor(self) -> float:
        """Return the processor time that this thread has used, s."""
        return time.thread_time()

    def call_at(self, when: float, callback: Callable[[], object]) -> Timer:
        """Call back once :meth:`monotonic` reaches ``when``; immediately if it is in the past."""
        loop = asyncio.get_running_loop()
        return loop.call_later(when - time.monotonic(), callback)

    async def sleep(self, seconds: float) -> None:
        """Wait for that time, s."""
        await asyncio.sleep(seconds)


class ManualClock:
    """A clock that tests advance; timers that become due run during the advance.

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
        """Advance the clock, and run the timers that become due."""
        end = self._elapsed + seconds
        while self._timers and self._timers[0][0] <= end:
            when, _, timer = heapq.heappop(self._timers)
            self._elapsed = max(self._elapsed, when)
            timer.run()
        self._elapsed = end

    def work(self, seconds: float) -> None:
        """Advance the clock and the processor time together."""
        self._work += seconds
        self.advance(seconds)

    def now(self) -> int:
        """Return UTC in ns since 1970."""
        return self._start + round(self._elapsed * 1e9)

    def monotonic(self) -> float:
        """Return the time since the clock was created, s."""
        return self._elapsed

    def processor(self) -> float:
        """Return the simulated processor time, s."""
        return self._work

    def call_at(self, when: float, callback: Callable[[], object]) -> Timer:
        """Call back when the clock is advanced past ``when``."""
        timer = _ManualTimer(callback)
        heapq.heappush(self._timers, (when, next(self._order), timer))
        return timer

    async def sleep(self, seconds: float) -> None:
        """Wait until the clock has been advanced by that time, s."""
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
