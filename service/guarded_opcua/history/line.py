"""Interpolation of a variable at the edges of intervals, and its integral between them."""

from typing import Final

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua.history.intervals import Intervals, Rules

_Floats = NDArray[np.float64]
_Times = NDArray[np.int64]
_Codes32 = NDArray[np.uint32]

BAD, UNCERTAIN = 0x8000_0000, 0x4000_0000
INTERPOLATED = 0x2
SUB_NORMAL: Final = int(ua.StatusCodes.UncertainDataSubNormal)
NO_DATA: Final = int(ua.StatusCodes.BadNoData)


class Line:
    """Interpolates the usable values at each edge, and integrates them between the edges."""

    def __init__(self, intervals: Intervals, rules: Rules, *, stepped: bool) -> None:
        self._edges = intervals.edges
        self._backwards = intervals.backwards
        self._rules = rules
        self._stepped = stepped
        n = len(self._edges)
        self._t0 = int(self._edges[0])
        self._values, self._area = np.zeros((2, n))
        self._codes = np.full(n, NO_DATA, np.uint32)
        self._done = 0  # number of evaluated edges
        self._skips = np.zeros(n - 1, np.bool_)
        self._last: tuple[_Times, _Floats, _Codes32, _Times] | None = None  # the last two usable
        self._seen = 0  # number of values processed
        self._sum = 0.0  # integral up to the last usable value
        self._began: int | None = None
        self._newest = 0.0  # value at `_began`, backwards

    def take(self, t: _Times, values: _Floats, codes: _Codes32) -> None:
        """Process the next values, at ascending times (N,)."""
        limit = UNCERTAIN if self._rules.treat_uncertain_as_bad else BAD
        chosen = np.flatnonzero(codes < limit)
        number, self._seen = chosen + self._seen, self._seen + len(t)
        t, values, codes = t[chosen], values[chosen], codes[chosen]
        if not len(t):
            return
        if self._last is not None:
            t_0, value, code, number_0 = self._last
            t, values = np.append(t_0[-1:], t), np.append(value[-1:], values)
            codes, number = np.append(code[-1:], codes), np.append(number_0[-1:], number)
        elif self._began is None:
            self._began, self._newest = int(t[0]), float(values[0])
            self._done = int(np.searchsorted(self._edges, t[0], side="left"))
        s = (t - self._t0) * 1e-9
        held = self._held(values[:-1], values[1:], (values[:-1] + values[1:]) / 2.0)
        area = self._sum + np.concatenate([[0.0], np.cumsum(np.diff(s) * held)])
        self._pass_edges(t, values, codes, number, area)
        self._note_skips(t, number)
        self._sum = float(area[-1])
        self._last = t[-2:], values[-2:], codes[-2:], number[-2:]

    def _held(self, before: _Floats, after: _Floats, line: _Floats) -> _Floats:
        """Return the value between two samples: the earlier one if stepped, else interpolated."""
        if not self._stepped:
            return line
        return after if self._backwards else before

    def _pass_edges(
        self, t: _Times, values: _Floats, codes: _Codes32, number: _Times, area: _Floats
    ) -> None:
        """Evaluate the edges up to the last value."""
        stop = int(np.searchsorted(self._edges, t[-1], side="right"))
        if stop <= self._done:
            return
        rows = slice(self._done, stop)
        edges = self._edges[rows]
        i = np.searchsorted(t, edges, side="left")  # index of the value at or after the edge
        exact = t[i] == edges
        a = np.where(exact, i, i - 1)
        width = np.maximum(t[i] - t[a], 1)
        share = (edges - t[a]) / width
        line = values[a] + share * (values[i] - values[a])
        between = np.where(exact, values[i], self._held(values[a], values[i], line))
        whole = (codes[a] < UNCERTAIN) & (codes[i] < UNCERTAIN) & (number[i] - number[a] <= 1)
        drawn = np.where(whole, 0, SUB_NORMAL) | INTERPOLATED
        self._values[rows] = between
        self._codes[rows] = np.where(exact, codes[i], drawn)
        mean = self._held(values[a], values[i], (values[a] + between) / 2.0)
        self._area[rows] = area[a] + (edges - t[a]) * 1e-9 * mean
        self._done = stop

    def _note_skips(self, t: _Times, number: _Times) -> None:
        """Mark the intervals in which unusable values were skipped."""
        for k in np.flatnonzero(np.diff(number) > 1):
            first = np.searchsorted(self._edges, t[k], side="right") - 1
            last = np.searchsorted(self._edges, t[k + 1], side="left")
            self._skips[max(int(first), 0) : int(last)] = True

    def bounds(self) -> tuple[_Floats, _Codes32, _Floats]:
        """Return value, status and integral at each edge."""
        values, codes, area = self._values.copy(), self._codes.copy(), self._area.copy()
        if self._last is None:
            return values, codes, area
        t, last, _, _ = self._last
        ahead = slice(self._done, len(self._edges))
        began = 0 if self._began is None else int(np.searchsorted(self._edges, self._began))
        area[ahead], area[:began] = self._sum, 0.0
        if self._backwards:  # these edges are later than the newest value
            values[:began], codes[:began] = self._newest, SUB_NORMAL | INTERPOLATED
            return values, codes, area
        slope = 0.0
        if self._rules.sloped and len(t) > 1:
            slope = (last[-1] - last[-2]) / (t[-1] - t[-2])
        values[ahead] = last[-1] + slope * (self._edges[ahead] - t[-1])
        codes[ahead] = SUB_NORMAL | INTERPOLATED
        return values, codes, area

    def known(self) -> _Floats:
        """Return the covered duration of each interval, s."""
        if self._last is None or self._began is None:
            return np.zeros(len(self._edges) - 1)
        low = np.maximum(self._edges[:-1], self._began)
        high = np.minimum(self._edges[1:], self._last[0][-1])
        return np.maximum(high - low, 0) * 1e-9

    def skipped(self) -> NDArray[np.bool_]:
        """Return the intervals in which unusable values were skipped."""
        return self._skips
