"""How long each valve has waited for a sample, without the time for which this process stood."""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times

LONGEST_TICK_S = 0.5  # s; a tick counts as waiting for this long at most


class WaitingTime:
    """Finds the valves that have waited for longer than a limit.

    Parameters
    ----------
    valves
        Number of valves.
    limit_s
        Time after which a valve without a new sample is due.
    now
        Monotonic time, s.

    Examples
    --------
    >>> waiting = WaitingTime(2, 0.4, now=0.0)
    >>> here, waits = np.array([True, True]), np.array([True, False])
    >>> waiting.due(0.3, here, waits), waiting.due(0.6, here, waits)
    (array([], dtype=int64), array([0]))
    """

    def __init__(self, valves: int, limit_s: float, now: float) -> None:
        self._limit_s = limit_s
        self._waited_s = np.zeros(valves)
        self._until = now

    def heard(self, valves: Times) -> None:
        """Note a sample of each of these valves."""
        self._waited_s[valves] = 0.0

    def due(self, now: float, counts: NDArray[np.bool_], waits: NDArray[np.bool_]) -> Times:
        """Return the valves that are due (V,).

        ``counts`` are those whose time counts, e.g. with a connection, ``waits`` those that wait at
        all, e.g. with something in the reorder buffer.
        """
        passed, self._until = now - self._until, now
        if not np.count_nonzero(waits):
            self._waited_s[:] = 0.0
            return _NONE
        self._waited_s[counts] += min(passed, LONGEST_TICK_S)
        self._waited_s[~waits] = 0.0
        return (counts & (self._waited_s > self._limit_s)).nonzero()[0]


_NONE = np.zeros(0, np.int64)
