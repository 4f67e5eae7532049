"""The only place that reads the time; tests put a clock of their own in its stead."""

import time
from typing import Protocol


class Clock(Protocol):
    """Tells the time of day and a time that never jumps."""

    def now(self) -> int:
        """UTC in ns since 1970."""

    def monotonic(self) -> float:
        """Seconds since some instant, never running back."""


class SystemClock:
    """The machine's clock."""

    def now(self) -> int:
        """UTC in ns since 1970."""
        return time.time_ns()

    def monotonic(self) -> float:
        """Seconds since some instant, never running back."""
        return time.monotonic()


class ManualClock:
    """A clock that a test turns by hand.

    >>> clock = ManualClock(start=1_000_000_000)
    >>> clock.advance(1.5)
    >>> clock.now(), clock.monotonic()
    (2500000000, 1.5)
    """

    def __init__(self, start: int = 0) -> None:
        self._start = start
        self._elapsed = 0.0

    def advance(self, seconds: float) -> None:
        """Turn the clock forward."""
        self._elapsed += seconds

    def now(self) -> int:
        """UTC in ns since 1970."""
        return self._start + round(self._elapsed * 1e9)

    def monotonic(self) -> float:
        """Seconds since the clock was made."""
        return self._elapsed
