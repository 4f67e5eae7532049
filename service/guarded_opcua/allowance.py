"""A token bucket: a rate per second with a bounded burst."""

from guarded_opcua.clock import Clock


class Allowance:
    """A token bucket with a refill rate of ``per_second`` and a capacity of ``most``.

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
        """Return whether the bucket covers the cost; if so, subtract it."""
        now = self._clock.monotonic()
        earned = (now - self._filled_at) * self._per_second
        self._left = min(self._most, self._left + earned)
        self._filled_at = now
        if self._left < cost:
            return False
        self._left -= cost
        return True

    def spend(self, cost: float) -> None:
        """Subtract a cost that was already incurred; the balance may become negative."""
        self._left -= cost
