"""A clock whose timers run by themselves and whose hands a test may turn."""

from guarded_opcua import SystemClock


class TurnedClock(SystemClock):
    """The time of day stands unless it is turned; timers run as always, from where it was put."""

    def __init__(self, start):
        self._now = start
        self._ahead = 0.0

    def now(self):
        return self._now + round(self._ahead * 1e9)

    def monotonic(self):
        return super().monotonic() + self._ahead

    def call_at(self, when, callback):
        return super().call_at(when - self._ahead, callback)

    def advance(self, seconds):
        self._ahead += seconds
