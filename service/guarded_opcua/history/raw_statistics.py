"""Statistics of the raw values in each interval, and for how long they were Good (Part 13)."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from guarded_opcua.history.intervals import Intervals, Rules
from guarded_opcua.history.line import BAD, UNCERTAIN

_Floats = NDArray[np.float64]
_Times = NDArray[np.int64]
_Codes32 = NDArray[np.uint32]


@dataclass
class Ends:
    """The first and the last of some values in each of n intervals; ``n`` 0 where there is none."""

    first_t: _Times
    first: _Floats
    first_code: _Codes32
    last_t: _Times
    last: _Floats
    last_code: _Codes32
    n: _Times

    @classmethod
    def none(cls, n: int) -> "Ends":
        """Return those of no values."""
        t, value, code = np.zeros(n, np.int64), np.zeros(n), np.zeros(n, np.uint32)
        return cls(t, value, code, t.copy(), value.copy(), code.copy(), t.copy())

    def take(self, edges: _Times, t: _Times, values: _Floats, codes: _Codes32) -> None:
        """Take the next values, at ascending times."""
        cuts = np.searchsorted(t, edges)
        touched = np.flatnonzero(np.diff(cuts))
        begins, ends = cuts[touched], cuts[touched + 1] - 1
        new = self.n[touched] == 0
        anew, at = touched[new], begins[new]
        self.first_t[anew], self.first[anew], self.first_code[anew] = t[at], values[at], codes[at]
        self.last_t[touched], self.last[touched] = t[ends], values[ends]
        self.last_code[touched] = codes[ends]
        self.n[touched] += ends - begins + 1


@dataclass
class RawStatistics:
    """Accumulates over chunks of raw values, in the order of the request.

    Attributes
    ----------
    all, good
        First and last of all values, and of the Good ones.
    mean, square
        Mean of the Good values, and the sum of squares about it.
    low, high
        The smallest and largest Good value, their times in ``low_t``, ``high_t``.
    low_again, high_again
        How often these were there.
    """

    intervals: Intervals
    all: Ends = field(init=False)
    good: Ends = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.intervals)
        self.all, self.good = Ends.none(n), Ends.none(n)
        self.mean, self.square = np.zeros((2, n))
        self.low, self.high = np.full(n, np.inf), np.full(n, -np.inf)
        self.low_t, self.high_t = np.zeros((2, n), np.int64)
        self.low_again, self.high_again = np.zeros((2, n), np.int64)

    def take(self, t: _Times, values: _Floats, codes: _Codes32) -> None:
        """Take the next values, at ascending times (N,)."""
        edges = self.intervals.edges
        self.all.take(edges, t, values, codes)
        good = codes < UNCERTAIN
        t, values, codes = t[good], values[good], codes[good]
        before = self.good.n.copy()
        self.good.take(edges, t, values, codes)
        cuts = np.searchsorted(t, edges)
        for k in np.flatnonzero(np.diff(cuts)).tolist():
            part = slice(cuts[k], cuts[k + 1])
            self._merge(k, int(before[k]), t[part], values[part])

    def _merge(self, k: int, n: int, t: _Times, values: _Floats) -> None:
        """Merge Good values into interval ``k``, which has ``n`` (Chan, Golub, LeVeque 1983)."""
        m, mean = len(values), float(values.mean())
        apart = mean - self.mean[k]
        self.mean[k] += apart * m / (n + m)
        self.square[k] += float(((values - mean) ** 2).sum()) + apart**2 * n * m / (n + m)
        for best, at, again, sign in (
            (self.low, self.low_t, self.low_again, -1.0),
            (self.high, self.high_t, self.high_again, 1.0),
        ):
            i = int(np.argmax(sign * values))
            if sign * values[i] > sign * best[k]:
                best[k], at[k], again[k] = values[i], t[i], 0
            again[k] += int(np.count_nonzero(values == best[k]))


class Durations:
    """For how long values were Good and Bad: each holds its status until the next value."""

    def __init__(self, intervals: Intervals, rules: Rules) -> None:
        self._intervals, self._rules = intervals, rules
        self._kinds = np.zeros((2, len(intervals)))  # Good, Bad; s
        self._last: tuple[int, int] | None = None  # time and status of the newest value

    def take(self, t: _Times, codes: _Codes32) -> None:
        """Take the next values, at ascending times (N,)."""
        if not len(t):
            return
        if self._last is not None:
            t, codes = np.append(self._last[0], t), np.append(self._last[1], codes)
        self._kinds += self._of(t, codes[:-1])
        self._last = int(t[-1]), int(codes[-1])

    def seconds(self) -> tuple[_Floats, _Floats]:
        """Return for how long values were Good, and Bad, in each interval (n,), s.

        The newest value holds until the end; before the first value nothing is known.
        """
        found = self._kinds
        if self._last is not None:
            t, code = self._last
            end = max(int(self._intervals.edges[-1]), t)
            found = found + self._of(np.array([t, end]), np.array([code]))
        return found[0], found[1]

    def _of(self, t: _Times, codes: NDArray[np.integer]) -> _Floats:
        """Return the durations of each kind in each interval, (2, n), s.

        ``codes`` (m,) hold from t[k] to t[k + 1]; ``t`` (m + 1,).
        """
        limit = UNCERTAIN if self._rules.treat_uncertain_as_bad else BAD
        since, edges = t - t[0], self._intervals.edges - t[0]
        rows = []
        for chosen in (codes < limit, codes >= limit):
            lengths = np.where(chosen, np.diff(t), 0) * 1e-9
            total = np.append(0.0, np.cumsum(lengths))
            rows.append(np.diff(np.interp(edges, since, total)))
        return np.stack(rows)
