"""Token buckets."""

from collections import OrderedDict

from guarded_opcua.admission import address_of
from valvemap.clock import Clock, SystemClock

_CLOCK = SystemClock()


class TokenBucket:
    """``rate`` tokens a second, up to ``burst`` tokens.

    >>> bucket = TokenBucket(rate=1.0, burst=2.0)
    >>> bucket.take(), bucket.take(), bucket.take()
    (True, True, False)
    """

    def __init__(self, rate: float, burst: float, clock: Clock = _CLOCK) -> None:
        self._rate, self._burst, self._clock = rate, burst, clock
        self._tokens, self._then = burst, clock.monotonic()

    def take(self, number: float = 1.0) -> bool:
        """Take this number of tokens; return False if there are fewer."""
        now = self._clock.monotonic()
        self._tokens = min(self._burst, self._tokens + self._rate * (now - self._then))
        self._then = now
        if self._tokens < number:
            return False
        self._tokens -= number
        return True


class Buckets:
    """One bucket for each address; beyond ``most``, the least recently used are dropped."""

    def __init__(self, rate: float, burst: float, clock: Clock = _CLOCK, most: int = 1_000) -> None:
        self._rate, self._burst, self._clock, self._most = rate, burst, clock, most
        self._of: OrderedDict[str, TokenBucket] = OrderedDict()

    def take(self, host: str) -> bool:
        """Take one token of a host's address."""
        address = address_of(host)
        bucket = self._of.pop(address, None) or TokenBucket(self._rate, self._burst, self._clock)
        self._of[address] = bucket
        if len(self._of) > self._most:
            self._of.popitem(last=False)
        return bucket.take()
