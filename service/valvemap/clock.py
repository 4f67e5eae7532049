"""The only place that reads the time; tests replace it by another clock."""

import time
from datetime import UTC, datetime
from typing import Final, Protocol

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


class Clock(Protocol):
    """Tells the time of day and a time that never jumps."""

    def now(self) -> int:
        """UTC in ns since 1970."""

    def monotonic(self) -> float:
        """Seconds since some instant, never running back."""


def utc_ns(moment: datetime) -> int:
    """Nanoseconds since 1970 of a date; one without a zone is meant as UTC.

    >>> utc_ns(datetime(1970, 1, 2, 0, 0, 0, 1))
    86400000001000
    """
    known = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    since = known - _EPOCH
    return (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1_000


def thread_seconds() -> float:
    """Seconds of processor time that the calling thread has used."""
    return time.thread_time()


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
