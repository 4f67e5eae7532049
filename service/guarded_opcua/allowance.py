"""What somebody may still ask for: so much per second, saved up to a limit."""

from guarded_opcua.clock import Clock


class Allowance:
    """An allowance that grows with time and is spent piece by piece.

    Examples
    --------
    >>> from guarded_opcua.clock import ManualClock
    >>> allowance = Allowance(ManualClock(), per_second=1.0, most=2.0)
    >>> [allowance.covers(1.0) for _ in range(3)]
    [True, True, False]
    """

    def __init__(self, clock: Clock, per_second: float, most: float) -> None:
        self._clock = clock
        self._per_second = per_second
        self._most = most
        self._left = most
        self._filled_at = clock.monotonic()

    def covers(self, cost: float) -> bool:
        """Whether so much is left; if so it is spent."""
        now = self._clock.monotonic()
        earned = (now - self._filled_at) * self._per_second
        self._left = min(self._most, self._left + earned)
        self._filled_at = now
        if self._left < cost:
            return False
        self._left -= cost
        return True

    def spend(self, cost: float) -> None:
        """Take off what was already done, into debt if need be."""
        self._left -= cost
