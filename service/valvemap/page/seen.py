"""What the page itself has seen, where the service keeps no history. Bounded; pure."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

_LONGEST = 3_600  # rows of a valve: an hour at one a second
_MOST_NUMBERS = 2_000_000  # of all valves, 4 bytes each
_FEWEST = 60


class Seen:
    """The newest rows of one valve, in a ring.

    Parameters
    ----------
    names
        Of the columns.
    valves
        Number of valves, which share the memory.

    Examples
    --------
    >>> seen = Seen(("Signals.Q",), 1)
    >>> for second in range(2, 6):
    ...     seen.add(second * 1_000_000_000, {"Signals.Q": float(second)})
    >>> seen.bucketed("Signals.Q", 2_000_000_000, 2_000_000_000, 2)[0].tolist()
    [2.5, 4.5]
    """

    def __init__(self, names: Sequence[str], valves: int) -> None:
        share = _MOST_NUMBERS // max(len(names) * valves, 1)
        self._rows = max(min(_LONGEST, share), _FEWEST)
        self._columns = {name: k for k, name in enumerate(names)}
        self._t = np.zeros(self._rows, np.int64)
        self._values = np.full((len(names), self._rows), np.nan, np.float32)
        self._next = self._count = 0

    @property
    def since(self) -> int:
        """Time of the oldest row, UTC ns; 0: there is none."""
        return int(self._t[(self._next - self._count) % self._rows]) if self._count else 0

    def add(self, t: int, row: Mapping[str, float]) -> None:
        """Add a row of time ``t``, UTC ns, unless it is the last one again."""
        if self._count and t == self._t[self._next - 1]:
            return
        self._t[self._next] = t
        for name, k in self._columns.items():
            self._values[k, self._next] = row.get(name, np.nan)
        self._next = (self._next + 1) % self._rows
        self._count = min(self._count + 1, self._rows)

    def bucketed(self, name: str, start: int, step: int, n: int) -> NDArray[np.float32]:
        """Return mean, least and largest value of ``n`` intervals from ``start``, (3, n)."""
        found = np.full((3, n), np.nan, np.float32)
        column = self._columns.get(name)
        if column is None:
            return found
        values, places = self._values[column], (self._t - start) // step
        good = (self._t > 0) & np.isfinite(values) & (places >= 0) & (places < n)
        at, values = places[good].astype(np.intp), values[good]
        counts = np.bincount(at, minlength=n)
        any_ = counts > 0
        sums = np.bincount(at, weights=values, minlength=n)
        low, high = np.full(n, np.inf), np.full(n, -np.inf)
        np.minimum.at(low, at, values)
        np.maximum.at(high, at, values)
        found[0, any_] = sums[any_] / counts[any_]
        found[1, any_], found[2, any_] = low[any_], high[any_]
        return found
