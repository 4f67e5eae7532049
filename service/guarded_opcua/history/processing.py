"""HistoryRead of aggregates, and at given times (Part 11, 6.4.4 and 6.4.5)."""

import math
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass

import numpy as np
from asyncua import ua

from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.binary.encoding import DTYPES
from guarded_opcua.history.aggregates import Aggregate, Aggregation
from guarded_opcua.history.historian import EVER, Records, Span, joined
from guarded_opcua.history.intervals import Intervals, Rules

Raw = Callable[[Span, int, int], Awaitable[Records]]

_Codes = ua.StatusCodes
_PIECE = 50_000  # raw values per chunk: 10 ms
_BOUNDS = 100  # values searched for a usable bound on each side of the intervals
_SAME_TYPE = Aggregate.MINIMUM, Aggregate.MAXIMUM


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


async def aggregated(
    asked: Processed, variable: Variable, raw: Raw, most: int
) -> tuple[Records, int | None]:
    """Return the first ``most`` intervals, and the start of the next one."""
    intervals, rest = Intervals.of(asked.start, asked.end, asked.width, most)
    found = Aggregation(asked.aggregate, intervals, asked.rules, stepped=is_stepped(variable))
    for part in (_before(intervals), _inside(intervals), _behind(intervals)):
        async for records in _pieces(raw, *part):
            found.take(records)
    return found.records(), rest


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
