"""Aggregates of a variable's history per interval (OPC UA Part 13).

Raw values are processed in chunks, so that memory depends on the number of intervals, not of
values. Time has the direction of the request: in a backward request all times are negated, and an
interval begins at its later end.
"""

from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guarded_opcua.history.aggregate_kinds import (
    CALCULATED,
    INFO_TYPE,
    MULTI_VALUE,
    PARTIAL,
    Aggregate,
)
from guarded_opcua.history.aggregates_of_raw import OF_RAW, OfRaw
from guarded_opcua.history.historian import Cells, Records
from guarded_opcua.history.intervals import Intervals, Rules
from guarded_opcua.history.line import BAD, INTERPOLATED, NO_DATA, SUB_NORMAL, UNCERTAIN, Line
from guarded_opcua.history.raw_statistics import Durations, RawStatistics

_Floats = NDArray[np.float64]
_Times = NDArray[np.int64]
_Codes32 = NDArray[np.uint32]

_ANY_BIT: Final = CALCULATED | INTERPOLATED | PARTIAL | MULTI_VALUE


_INTERPOLATED: Final = (Aggregate.INTERPOLATIVE, Aggregate.TIME_AVERAGE, Aggregate.TOTAL)
DURATIONS: Final = {  # Good or Bad; in percent of the interval, or in ms
    Aggregate.DURATION_GOOD: (0, False),
    Aggregate.DURATION_BAD: (1, False),
    Aggregate.PERCENT_GOOD: (0, True),
    Aggregate.PERCENT_BAD: (1, True),
}


class Aggregation:
    """One aggregate of one variable over the given intervals.

    ``stepped``: between two values the variable holds the earlier one; otherwise interpolate
    linearly.

    Examples
    --------
    >>> intervals, _ = Intervals.of(0, 4, 2, most=9)
    >>> average = Aggregation(Aggregate.AVERAGE, intervals, Rules(), stepped=False)
    >>> t, good = np.arange(5), np.zeros(5, np.uint32)
    >>> average.take(Records(np.array([1.0, 3.0, 4.0, 8.0, 0.0]), good, t, t))
    >>> average.records().values
    array([2., 6.])
    """

    def __init__(
        self, aggregate: Aggregate, intervals: Intervals, rules: Rules, *, stepped: bool
    ) -> None:
        self._aggregate = aggregate
        self._intervals = intervals
        self._rules = rules
        self._line = Line(intervals, rules, stepped=stepped)
        n = len(intervals)
        self._good, self._bad, self._uncertain = np.zeros((3, n), np.int64)
        self._sum = np.zeros(n)
        sign = -1.0 if aggregate is Aggregate.MINIMUM else 1.0
        self._extreme = _Extreme(n, sign)
        self._first: int | None = None  # signed time of the first and last value
        self._last: int | None = None

    @cached_property
    def _raw(self) -> RawStatistics:
        return RawStatistics(self._intervals)

    @cached_property
    def _durations(self) -> Durations:
        return Durations(self._intervals, self._rules)

    def take(self, records: Records) -> None:
        """Process the next values, in the order of the request.

        Values before the first interval and after the last are bounding values.
        """
        if not len(records):
            return
        t = self._intervals.sign * records.source
        if self._first is None:
            self._first = int(t[0])
        self._last = int(t[-1])
        values = records.values.astype(np.float64)
        if self._aggregate in _INTERPOLATED:
            self._line.take(t, values, records.codes)
        elif self._aggregate in DURATIONS:
            self._durations.take(t, records.codes)
        elif self._aggregate in OF_RAW:
            self._raw.take(t, values, records.codes)
        bad = records.codes >= BAD
        doubtful = ~bad & (records.codes >= UNCERTAIN)
        good = ~bad & ~doubtful
        edges = self._intervals.edges
        self._bad += np.diff(np.searchsorted(t[bad], edges))
        self._uncertain += np.diff(np.searchsorted(t[doubtful], edges))
        t, values = t[good], values[good]
        cuts = np.searchsorted(t, edges)
        self._good += np.diff(cuts)
        touched = np.flatnonzero(np.diff(cuts))
        if not len(touched):
            return
        begins = t[cuts[touched]] == edges[touched]
        starts, values = cuts[touched] - cuts[0], values[cuts[0] : cuts[-1]]
        if self._aggregate is Aggregate.AVERAGE:
            self._sum[touched] += np.add.reduceat(values, starts)
        elif self._aggregate in (Aggregate.MINIMUM, Aggregate.MAXIMUM):
            self._extreme.take(touched, values, starts, begins)

    def take_cells(self, cells: Cells) -> None:
        """Process cells of a forward request, each inside an interval; of Good values alone."""
        if not len(cells):
            return
        edges = self._intervals.edges
        number = np.searchsorted(edges, cells.t, side="right") - 1
        n = len(self._intervals)
        self._bad += _added(number, cells.values - cells.good - cells.uncertain, n)
        self._uncertain += _added(number, cells.uncertain, n)
        self._good += _added(number, cells.good, n)
        if self._aggregate is Aggregate.AVERAGE:
            self._sum += np.bincount(number, weights=cells.total, minlength=n)
        elif self._aggregate in (Aggregate.MINIMUM, Aggregate.MAXIMUM):
            starts = cells.t == edges[number]
            self._extreme.take_cells(number, cells, starts)

    def take_extent(self, first: int, last: int) -> None:
        """Note the first and last time of all values of the variable, in a forward request."""
        self._first = first if self._first is None else min(first, self._first)
        self._last = last if self._last is None else max(last, self._last)

    def records(self) -> Records:
        """Return the aggregate of each interval, with the interval's start as timestamp.

        START, END and the extremes at their actual times have the times of those values.
        """
        t = self._intervals.edges[:-1]
        if self._aggregate in OF_RAW:
            values, codes, t = OF_RAW[self._aggregate](
                OfRaw(
                    self._raw,
                    starts=t,
                    doubtful=self._bad + self._uncertain > 0,
                    partial=self._partial(),
                    by_values=self._by_values(none=NO_DATA),
                )
            )
        elif self._aggregate in DURATIONS:
            values, codes = self._duration()
        else:
            values, codes = self._of_line_or_cells()
        bits = (codes & _ANY_BIT) > 0
        codes = np.where(bits, codes | INFO_TYPE, codes).astype(np.uint32)
        t = self._intervals.sign * t
        return Records(values, codes, t, t)

    def _of_line_or_cells(self) -> tuple[_Floats, _Codes32]:
        compute = {
            Aggregate.INTERPOLATIVE: self._interpolative,
            Aggregate.AVERAGE: self._average,
            Aggregate.TIME_AVERAGE: self._time_average,
            **dict.fromkeys((Aggregate.MINIMUM, Aggregate.MAXIMUM), self._extremes),
            Aggregate.COUNT: self._count,
            Aggregate.TOTAL: self._total,
        }[self._aggregate]
        return compute()

    def _duration(self) -> tuple[_Floats, _Codes32]:
        kind, in_percent = DURATIONS[self._aggregate]
        seconds = self._durations.seconds()[kind]
        share = 1e-9 * np.diff(self._intervals.edges)
        values = 100.0 * seconds / share if in_percent else 1e3 * seconds
        codes = np.where(self._outside(), NO_DATA, CALCULATED | self._partial())
        return values, codes.astype(np.uint32)

    def _total(self) -> tuple[_Floats, _Codes32]:
        """Return the time average times the length of the interval, in s."""
        values, codes = self._time_average()
        return values * np.diff(self._intervals.edges) * 1e-9, codes

    def _interpolative(self) -> tuple[_Floats, _Codes32]:
        values, codes, _ = self._line.bounds()
        return values[:-1], codes[:-1]

    def _average(self) -> tuple[_Floats, _Codes32]:
        values = self._sum / np.maximum(self._good, 1)
        return values, self._by_values(none=NO_DATA)

    def _count(self) -> tuple[_Floats, _Codes32]:
        return self._good.astype(np.float64), self._by_values(none=None)

    def _time_average(self) -> tuple[_Floats, _Codes32]:
        _, codes, area = self._line.bounds()
        known = self._line.known()
        values = np.divide(np.diff(area), known, out=np.zeros(len(known)), where=known > 0)
        doubtful = (self._bad + self._uncertain > 0) | self._line.skipped()
        found = np.where(doubtful, SUB_NORMAL, 0) | CALCULATED | self._partial()
        codes = np.where(known > 0, found, NO_DATA).astype(np.uint32)
        return values, codes

    def _extremes(self) -> tuple[_Floats, _Codes32]:
        extreme = self._extreme
        doubtful = self._bad + self._uncertain > 0
        raw = extreme.at_start & ~doubtful
        bits = np.where(raw, 0, CALCULATED) | np.where(extreme.count > 1, MULTI_VALUE, 0)
        found = np.where(doubtful, SUB_NORMAL, 0) | bits | self._partial()
        return extreme.values(), np.where(self._good > 0, found, NO_DATA).astype(np.uint32)

    def _by_values(self, none: int | None) -> _Codes32:
        """Return the status by the shares of Bad and Good values (Part 13, 5.3.3.2.1)."""
        total = self._good + self._bad + self._uncertain
        bad = self._bad + (self._uncertain if self._rules.treat_uncertain_as_bad else 0)
        share = 100.0 / np.maximum(total, 1)
        codes = np.where(share * self._good >= self._rules.percent_good, 0, SUB_NORMAL)
        codes = np.where(total == 0, 0, codes) | CALCULATED | self._partial()
        codes = np.where((total > 0) & (share * bad >= self._rules.percent_bad), BAD, codes)
        if none is not None:
            codes = np.where(self._good == 0, none, codes)
        return np.where(self._outside(), NO_DATA, codes).astype(np.uint32)

    def _outside(self) -> NDArray[np.bool_]:
        """Return which intervals lie before the first value or after the last."""
        edges = self._intervals.edges
        if self._first is None or self._last is None:
            return np.ones(len(self._intervals), np.bool_)
        return (edges[1:] <= self._first) | (edges[:-1] > self._last)

    def _partial(self) -> NDArray[np.int64]:
        """Return the Partial bit of intervals that are truncated or not covered by values."""
        edges = self._intervals.edges
        first = edges[0] if self._first is None else self._first
        last = edges[-1] if self._last is None else self._last
        partial = (edges[:-1] < first) | (edges[1:] > last + 1)
        partial[-1] |= self._intervals.truncated
        return np.where(partial, PARTIAL, 0)


def _added(number: _Times, counts: _Times, n: int) -> _Times:
    """Return the sum of counts (m,) for each of n intervals; ``number`` (m,) is each one's."""
    return np.bincount(number, weights=counts, minlength=n).astype(np.int64)


class _Extreme:
    """Maximum of each interval; minimum with ``sign`` -1."""

    def __init__(self, n: int, sign: float) -> None:
        self._sign = sign
        self._best = np.full(n, -np.inf)
        self.count = np.zeros(n, np.int64)
        self.at_start = np.zeros(n, np.bool_)

    def take(
        self, touched: _Times, values: _Floats, starts: _Times, begins: NDArray[np.bool_]
    ) -> None:
        """Process values; those of interval ``touched[k]`` begin at index ``starts[k]``.

        ``begins[k]``: the first of them lies exactly at the start of the interval.
        """
        values = self._sign * values
        best = np.maximum.reduceat(values, starts)
        own = np.repeat(best, np.diff(np.append(starts, len(values))))
        count = np.add.reduceat((values == own).astype(np.int64), starts)
        self._merge(touched, best, count, begins & (values[starts] == best))

    def take_cells(self, number: _Times, cells: Cells, starts: NDArray[np.bool_]) -> None:
        """Process cells; cell ``k`` is in interval ``number[k]``, at its start if ``starts[k]``."""
        is_low = self._sign < 0
        has = cells.good > 0
        values = self._sign * (cells.low if is_low else cells.high)[has]
        again = (cells.low_again if is_low else cells.high_again)[has]
        first = (cells.low_first if is_low else cells.high_first)[has] & starts[has]
        number = number[has]
        if not len(number):
            return
        places = np.flatnonzero(np.diff(number, prepend=-1))
        best = np.maximum.reduceat(values, places)
        is_best = values == np.repeat(best, np.diff(np.append(places, len(values))))
        count = np.add.reduceat(np.where(is_best, 1 + again, 0), places)
        self._merge(number[places], best, count, np.logical_or.reduceat(is_best & first, places))

    def _merge(
        self, touched: _Times, best: _Floats, count: _Times, at_start: NDArray[np.bool_]
    ) -> None:
        larger, as_large = best > self._best[touched], best == self._best[touched]
        anew, too = touched[larger], touched[as_large]
        self._best[anew], self.count[anew] = best[larger], count[larger]
        self.at_start[anew] = at_start[larger]
        self.count[too] += count[as_large]
        self.at_start[too] |= at_start[as_large]

    def values(self) -> _Floats:
        return np.where(np.isfinite(self._best), self._sign * self._best, 0.0)
