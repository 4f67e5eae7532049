"""Token buckets: a steady rate and a burst."""

from collections import OrderedDict

from guarded_opcua.admission import address_of
from valvemap.clock import Clock, SystemClock

_CLOCK = SystemClock()


class TokenBucket:
    """So many a second, and a burst.

    >>> bucket = TokenBucket(rate=1.0, burst=2.0)
    >>> bucket.take(), bucket.take(), bucket.take()
    (True, True, False)
    """

    def __init__(self, rate: float, burst: float, clock: Clock = _CLOCK) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._tokens, self._then = burst, clock.monotonic()

    def take(self, number: float = 1.0) -> bool:
        """Take this number of tokens, if there are as many."""
        now = self._clock.monotonic()
        self._tokens = min(self._burst, self._tokens + self._rate * (now - self._then))
        self._then = now
        if self._tokens < number:
            return False
        self._tokens -= number
        return True


class Buckets:
    """A bucket for each address; those that were not heard of for longest are forgotten."""

    def __init__(self, rate: float, burst: float, clock: Clock = _CLOCK, most: int = 1_000) -> None:
        self._rate, self._burst, self._clock, self._most = rate, burst, clock, most
        self._of: OrderedDict[str, TokenBucket] = OrderedDict()

    def take(self, host: str) -> bool:
        """Take one token of that host's address."""
        address = address_of(host)
        bucket = self._of.pop(address, None) or TokenBucket(self._rate, self._burst, self._clock)
        self._of[address] = bucket
        if len(self._of) > self._most:
            self._of.popitem(last=False)
        return bucket.take()
