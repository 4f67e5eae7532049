"""Play-out buffer: spreads results received in batches evenly over time. Pure."""

from collections import deque
from collections.abc import Iterable
from typing import Generic, TypeVar

T = TypeVar("T")

_MOST = 100  # results; beyond that, the oldest are dropped


class PlayOut(Generic[T]):
    """Results of a batch, spread evenly until the next batch is expected.

    Parameters
    ----------
    every_s
        Time between two batches.
    tick_s
        Time between two calls of :meth:`due`.

    Examples
    --------
    >>> results = PlayOut(every_s=0.5, tick_s=0.1)
    >>> results.come("abcde", now=10.0)
    >>> [results.due(10.0 + 0.1 * k) for k in range(6)]
    [['a'], ['b'], ['c'], ['d'], ['e'], []]
    """

    def __init__(self, every_s: float, tick_s: float) -> None:
        self._every_s, self._tick_s = every_s, tick_s
        self._waiting: deque[T] = deque(maxlen=_MOST)
        self._until = 0.0

    def come(self, results: Iterable[T], now: float) -> None:
        """Add a batch received at ``now``, s."""
        self._waiting.extend(results)
        self._until = now + self._every_s

    def due(self, now: float) -> list[T]:
        """Return the results due at ``now``, s: equal shares, and the rest at the last call."""
        looks = max(1, round((self._until - now) / self._tick_s))
        share = -(-len(self._waiting) // looks)
        return [self._waiting.popleft() for _ in range(share)]
