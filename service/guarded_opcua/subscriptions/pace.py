"""Time slices of publishing; requests are answered between two slices."""

from collections import deque
from collections.abc import Callable

from guarded_opcua.clock import Clock

_STRETCH_S = 0.005  # s of processor time per slice, all subscriptions together


class Pace:
    """Limits the time of publishing before the event loop handles other work.

    Examples
    --------
    >>> from guarded_opcua.clock import ManualClock
    >>> clock = ManualClock()
    >>> pace = Pace(clock)
    >>> pace.may_go_on()
    True
    >>> clock.work(0.006)  # the timer that begins a new stretch runs in between
    >>> pace.may_go_on()
    True
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._began: float | None = None
        self._waiting: deque[Callable[[], None]] = deque()

    def may_go_on(self) -> bool:
        """Return whether this slice has time left."""
        now = self._clock.processor()
        if self._began is None:
            self._began = now
            self._clock.call_at(0.0, self._begin)
        return now - self._began < _STRETCH_S

    def later(self, go_on: Callable[[], None]) -> None:
        """Call back in a later slice, after the callbacks that wait already."""
        self._waiting.append(go_on)

    def _begin(self) -> None:
        self._began = None
        for _ in range(len(self._waiting)):
            if not self.may_go_on():
                return
            self._waiting.popleft()()
