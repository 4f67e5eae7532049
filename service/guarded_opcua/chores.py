"""Background work in short slices on the event loop."""

from collections import deque
from collections.abc import Callable, Iterator

from guarded_opcua.clock import Clock

_SLICE_S = 0.002  # s of processor time; bounds the delay of requests
_PAUSE_S = 0.004  # s between two slices; background work uses at most a third of the processor

Charge = Callable[[float], None]


class Chores:
    """Runs long work in slices and charges each slice to the connection that it serves.

    Examples
    --------
    >>> from guarded_opcua.clock import ManualClock
    >>> clock = ManualClock()
    >>> def steps():
    ...     for step in "abc":
    ...         clock.work(0.0015)
    ...         done.append(step)
    ...         yield
    >>> chores, done = Chores(clock), []
    >>> chores.add(steps(), lambda cost: None)
    >>> clock.advance(0.003)
    >>> done
    ['a', 'b']
    >>> clock.advance(0.01)
    >>> done
    ['a', 'b', 'c']
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._waiting: deque[tuple[Iterator[None], Charge]] = deque()
        self._under_way = False

    def add(self, steps: Iterator[None], charge: Charge) -> None:
        """Schedule the steps of an iterator; ``charge`` is called with their processor time, s."""
        self._waiting.append((steps, charge))
        self._wake(0.0)

    def finish(self) -> None:
        """Run all remaining steps now."""
        while self._waiting:
            steps, _ = self._waiting.popleft()
            deque(steps, maxlen=0)

    def _wake(self, pause: float) -> None:
        if not self._under_way and self._waiting:
            self._under_way = True
            self._clock.call_at(self._clock.monotonic() + pause, self._run)

    def _run(self) -> None:
        try:
            self._work()
        finally:
            self._under_way = False  # last, so that work added by a step waits for the pause too
            self._wake(_PAUSE_S)

    def _work(self) -> None:
        began = now = self._clock.processor()
        while self._waiting and now - began < _SLICE_S:
            steps, charge = self._waiting[0]
            since = now
            done = False
            while not done and now - began < _SLICE_S:
                done = next(steps, self) is self
                now = self._clock.processor()
            charge(now - since)
            if done:
                self._waiting.popleft()
