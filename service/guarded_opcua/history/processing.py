"""HistoryRead of aggregates, and at given times (Part 11, 6.4.4 and 6.4.5)."""

import math
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from asyncua import ua

from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.binary.encoding import DTYPES
from guarded_opcua.history.aggregate_kinds import Aggregate
from guarded_opcua.history.aggregates import Aggregation
from guarded_opcua.history.historian import EVER, Cells, Records, Span, joined
from guarded_opcua.history.intervals import Intervals, Rules

Raw = Callable[[Span, int, int], Awaitable[Records]]
Summary = Callable[[int, int, int], Awaitable[Cells | None]]

_Codes = ua.StatusCodes
_PIECE = 50_000  # raw values per chunk: 10 ms
_BOUNDS = 100  # values searched for a usable bound on each side of the intervals
_SUMMED = Aggregate.AVERAGE, Aggregate.MINIMUM, Aggregate.MAXIMUM, Aggregate.COUNT
_SAME_TYPE = (
    *(Aggregate.MINIMUM, Aggregate.MAXIMUM, Aggregate.START, Aggregate.END),
    *(Aggregate.MINIMUM_ACTUAL_TIME, Aggregate.MAXIMUM_ACTUAL_TIME),
)


@dataclass(frozen=True)
class Processed:
    """Aggregates still to be read, from ``start`` to ``end``, UTC ns, in intervals of ``width`` ns.

    A width of 0 means a single interval.
    """

    node: ua.NodeId
    aggregate: Aggregate
    rules: Rules
    start: int
    end: int
    width: int


@dataclass(frozen=True)
class AtTimes:
    """A request for a variable's values at given times, UTC ns."""

    node: ua.NodeId
    times: Sequence[int]


def processed(
    node: ua.NodeId, details: ua.ReadProcessedDetails, number: int, span: tuple[int, int] | None
) -> Processed | int:
    """Parse a request for its node ``number``; return a status code if it is invalid."""
    if span is None or span[0] == span[1]:
        return int(_Codes.BadInvalidArgument)
    milliseconds = details.ProcessingInterval
    if not 0.0 <= milliseconds < math.inf or 0.0 < milliseconds * 1e6 < 1.0:
        return int(_Codes.BadInvalidArgument)
    kind = details.AggregateType[number]
    if kind.NamespaceIndex or kind.Identifier not in tuple(Aggregate):
        return int(_Codes.BadAggregateNotSupported)
    try:
        rules = _rules(details.AggregateConfiguration)
    except ValueError:
        return int(_Codes.BadAggregateConfigurationRejected)
    width = min(round(milliseconds * 1e6), abs(span[1] - span[0]))
    return Processed(node, Aggregate(kind.Identifier), rules, *span, width)


def type_of(aggregate: Aggregate, variable: Variable) -> ua.VariantType:
    """Return the type of an aggregate's values."""
    if aggregate is Aggregate.COUNT:
        return ua.VariantType.UInt32
    return variable.type if aggregate in _SAME_TYPE else ua.VariantType.Double


@dataclass(frozen=True)
class Summarised:
    """The summaries of a variable: widths of its cells, ascending, ns, and how they are read."""

    widths: Sequence[int]
    cells: Summary


async def aggregated(
    asked: Processed, variable: Variable, raw: Raw, most: int, summarised: Summarised | None = None
) -> tuple[Records, int | None]:
    """Return the first ``most`` intervals, and the start of the next one.

    Intervals whose edges are those of cells are computed from cells, if there are any. An interval
    with values that are deleted, of which only cells remain, is otherwise BadDataUnavailable.
    """
    intervals, rest = Intervals.of(asked.start, asked.end, asked.width, most)
    found = Aggregation(asked.aggregate, intervals, asked.rules, stepped=is_stepped(variable))
    if summarised is not None and asked.aggregate in _SUMMED:
        gone = await _from_cells(found, intervals, raw, summarised)
        if gone is not None:
            return _without(found.records(), gone), rest
    deleted = _Deleted(intervals, await _cells_over(intervals, summarised))
    for part in (_before(intervals), _inside(intervals), _behind(intervals)):
        async for records in _pieces(raw, *part):
            found.take(records)
            deleted.note(records)
    return _without(found.records(), await deleted.intervals(raw)), rest


def _without(found: Records, gone: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Records:
    codes = np.where(gone, np.uint32(_Codes.BadDataUnavailable), found.codes)
    return replace(found, codes=codes.astype(np.uint32))


async def _from_cells(
    found: Aggregation, intervals: Intervals, raw: Raw, summarised: Summarised
) -> np.ndarray[tuple[int], np.dtype[np.bool_]] | None:
    """Compute intervals from cells; return which need deleted values, None if no cells fit.

    The first and the last edge may be inside a cell: its values are read.
    """
    if intervals.backwards:
        return None
    first, last = int(intervals.edges[0]), int(intervals.edges[-1])
    for width in reversed(summarised.widths):
        low, high = first + -first % width, last - last % width
        if low < high and not (intervals.edges[1:-1] % width).any():
            break
    else:
        return None
    cells = await summarised.cells(first - first % width, last + -last % width, width)
    if cells is None:
        return None
    found.take_cells(cells.between(low, high))
    gone = np.zeros(len(intervals), np.bool_)
    for place, cell in ((0, low - width), (-1, high)):
        start, stop = max(cell, first), min(cell + width, last)
        if start >= stop or cell in range(low, high):
            continue
        values = 0
        async for records in _pieces(raw, Span(cell, cell + width - 1), 0, False):  # noqa: FBT003
            values += len(records)
            found.take(records[slice(*np.searchsorted(records.source, [start, stop]).tolist())])
        gone[place] |= values < int(cells.between(cell, cell + width).values.sum())
    found.take_extent(*cells.extent)
    return gone


async def _cells_over(intervals: Intervals, summarised: Summarised | None) -> Cells | None:
    """Return cells that cover all intervals, to compare their values with those that are read."""
    if summarised is None:
        return None
    low, high = sorted(intervals.sign * int(intervals.edges[k]) for k in (0, -1))
    width = summarised.widths[-1]  # kept for the longest
    return await summarised.cells(low - low % width, high + 1 + -(high + 1) % width, width)


class _Deleted:
    """Finds the intervals with values that are deleted: their cells have more than were read."""

    def __init__(self, intervals: Intervals, cells: Cells | None) -> None:
        self._intervals = intervals
        self._cells = cells
        self._read = np.zeros(0 if cells is None else len(cells), np.int64)

    def note(self, records: Records) -> None:
        """Note values that were read, also those outside the intervals."""
        if self._cells is None or not len(records) or not len(self._cells):
            return
        cell = np.searchsorted(self._cells.t, records.source, side="right") - 1
        inside = (cell >= 0) & (records.source < self._cells.t[cell] + self._cells.width)
        self._read += np.bincount(cell[inside], minlength=len(self._read))

    async def intervals(self, raw: Raw) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Return which intervals have deleted values (n,)."""
        n, cells = len(self._intervals), self._cells
        if cells is None or not (self._read < cells.values).any():
            return np.zeros(n, np.bool_)
        short = np.flatnonzero(self._read < cells.values)
        for k in {int(short[0]), int(short[-1])}:  # the bounds may be in the midst of these
            start, values = int(cells.t[k]), 0
            span = Span(start, start + cells.width - 1)
            async for records in _pieces(raw, span, 0, False):  # noqa: FBT003
                values += len(records)
            self._read[k] = values
        short = short[self._read[short] < cells.values[short]]
        edges, sign = self._intervals.edges, self._intervals.sign
        ends = np.sort([sign * cells.t[short], sign * (cells.t[short] + cells.width - 1)], axis=0)
        low, high = np.clip(np.searchsorted(edges, ends, side="right") - 1, 0, n - 1)
        change = np.bincount(low, minlength=n + 1) - np.bincount(high + 1, minlength=n + 1)
        return np.asarray(np.cumsum(change)[:n] > 0)


async def at_times(times: Sequence[int], variable: Variable, raw: Raw) -> Records:
    """Return a variable's values at given times, UTC ns: written or interpolated."""
    parts = []
    for t in times:
        intervals, _ = Intervals.of(t, t + 1, 0, most=1)
        found = Aggregation(
            Aggregate.INTERPOLATIVE, intervals, Rules(), stepped=is_stepped(variable)
        )
        before = await raw(Span(EVER[0], t, backwards=True), 0, _BOUNDS)
        found.take(before[::-1])
        found.take(await raw(Span(t + 1, EVER[1]), 0, _BOUNDS))
        parts.append(found.records())
    return joined(parts)


def is_stepped(variable: Variable) -> bool:
    """Return whether a variable holds its value until the next one; integers do."""
    return np.dtype(DTYPES[variable.type]).kind != "f"


def _before(intervals: Intervals) -> tuple[Span, int, bool]:
    first = intervals.sign * int(intervals.edges[0])
    if intervals.backwards:
        return Span(first + 1, EVER[1]), _BOUNDS, True
    return Span(EVER[0], first - 1, backwards=True), _BOUNDS, True


def _inside(intervals: Intervals) -> tuple[Span, int, bool]:
    first, last = (intervals.sign * int(intervals.edges[k]) for k in (0, -1))
    if intervals.backwards:
        return Span(last, first, backwards=True), 0, False
    return Span(first, last), 0, False


def _behind(intervals: Intervals) -> tuple[Span, int, bool]:
    last = intervals.sign * int(intervals.edges[-1])
    if intervals.backwards:
        return Span(EVER[0], last - 1, backwards=True), _BOUNDS, False
    return Span(last + 1, EVER[1]), _BOUNDS, False


async def _pieces(raw: Raw, span: Span, most: int, reverse: bool) -> AsyncIterator[Records]:  # noqa: FBT001
    """Yield the records of a span in chunks; with ``most`` > 0, one chunk of at most that many."""
    if most:
        found = await raw(span, 0, most)
        yield found[::-1] if reverse else found
        return
    skip = 0
    while True:
        found = await raw(span, skip, _PIECE)
        yield found
        if len(found) < _PIECE:
            return
        span, skip = span.behind(skip, found.source)


def _rules(given: ua.AggregateConfiguration) -> Rules:
    if given.UseServerCapabilitiesDefaults:
        return Rules()
    return Rules(
        given.TreatUncertainAsBad,
        given.PercentDataBad,
        given.PercentDataGood,
        given.UseSlopedExtrapolation,
    )
