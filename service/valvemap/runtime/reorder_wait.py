"""How long samples wait in the reorder buffer, by valve, while their source is connected."""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times

LONGEST_TICK_S = 0.5  # s; the time by which a tick is longer does not count as waiting


class ReorderWait:
    """Finds the valves whose reorder buffer must be flushed.

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
    >>> wait = ReorderWait(2, 0.4, now=0.0)
    >>> here, waits = np.array([True, True]), np.array([True, False])
    >>> wait.due(0.3, here, waits), wait.due(0.6, here, waits)
    (array([], dtype=int64), array([0]))
    """

    def __init__(self, valves: int, limit_s: float, now: float) -> None:
        self._limit_s = limit_s
        self._held_s = np.zeros(valves)
        self._until = now

    def heard(self, valves: Times) -> None:
        """Note a sample of each of these valves."""
        self._held_s[valves] = 0.0

    def due(self, now: float, connected: NDArray[np.bool_], waits: NDArray[np.bool_]) -> Times:
        """Return the valves to flush; ``waits`` are those with something in the buffer (V,)."""
        passed, self._until = now - self._until, now
        if not connected.any():
            return np.empty(0, np.int64)
        self._held_s[connected] += min(passed, LONGEST_TICK_S)
        self._held_s[~waits] = 0.0
        return np.flatnonzero(connected & (self._held_s > self._limit_s))
