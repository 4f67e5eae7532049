"""HistoryRead (Part 11, 6.4), page by page: raw values, aggregates, at given times, events."""

import secrets
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.declarations import Variable
from guarded_opcua.binary.encoding import (
    DTYPES,
    HISTORY_DATA,
    HISTORY_EVENT,
    TICKS_1970,
    encode_history_result,
)
from guarded_opcua.binary.encoding import nanoseconds_given as _time
from guarded_opcua.binary.records import Form, encode_records
from guarded_opcua.history.events import (
    EventHistorian,
    PastEvents,
    page_of_events,
    past_events,
)
from guarded_opcua.history.historian import (
    EVER,
    Cells,
    Historian,
    Records,
    Span,
    Summarising,
    joined,
)
from guarded_opcua.history.processing import (
    AtTimes,
    Processed,
    Raw,
    Summarised,
    aggregated,
    at_times,
    processed,
    type_of,
)
from guarded_opcua.monitoring.event_filter import EventFilter, EventFilterRefused
from guarded_opcua.settings import Limits
from guarded_opcua.turn import Turn

_Codes = ua.StatusCodes
MOST_TIMES = 1_000  # times of one variable in one request; each is a lookup
_BAD = 0x8000_0000


@dataclass(frozen=True)
class Rest:
    """A request for a variable's raw values, and the state of its continuation.

    Attributes
    ----------
    node
        The variable.
    span, skip
        Span still to be read, and the number of its records to skip.
    page
        Maximum number of values per response, requested by the client; 0: no maximum.
    left
        Number of values still to be returned; None: all of the span.
    lead, tail
        Times of requested bounding values, UTC ns.
    """

    node: ua.NodeId
    span: Span
    skip: int = 0
    page: int = 0
    left: int | None = None
    lead: int | None = None
    tail: int | None = None


Rests = OrderedDict[bytes, Rest | Processed | PastEvents]


class Histories:
    """The histories of a server's variables and events."""

    def __init__(self, limits: Limits, nodes: AddressSpace) -> None:
        self._limits = limits
        self._nodes = nodes
        self._kept: dict[ua.NodeId, tuple[Variable, Historian]] = {}
        self._events: dict[ua.NodeId, EventHistorian] = {}

    def add(self, variable: Variable, historian: Historian) -> None:
        """Register the historian of a variable."""
        self._kept[variable.id] = variable, historian

    def add_events(self, emitter: ua.NodeId, historian: EventHistorian) -> None:
        """Register the historian of an object's events."""
        self._events[emitter] = historian

    async def read(
        self, params: ua.HistoryReadParameters, number: int, rests: Rests, turn: Turn
    ) -> bytes:
        """Read node ``number`` of a request; return an encoded HistoryReadResult.

        ``rests`` are the continuation points of the session, where the remaining request is stored.
        """
        most = max(self._limits.history_values // len(params.NodesToRead), 1)
        rest = self._wanted(params, number, rests, most)
        if isinstance(rest, int):
            return encode_history_result(rest)
        if isinstance(rest, PastEvents):
            encoded, following = await page_of_events(rest, self._events[rest.node], turn, most)
            return self._answered(HISTORY_EVENT, encoded, len(encoded), following, rests)
        variable, historian = self._kept[rest.node]
        kind = variable.type

        async def raw(span: Span, skip: int, count: int) -> Records:
            await turn.breathe()
            found = historian.raw(variable.id, span, skip, count)
            return found if isinstance(found, Records) else await turn.outside(found)

        more: Rest | Processed | None
        if isinstance(rest, Processed):
            kind = type_of(rest.aggregate, variable)
            summarised = None
            if isinstance(historian, Summarising):
                summarised = _summarised(historian, variable.id, turn)
            found, start = await aggregated(rest, variable, raw, most, summarised)
            more = None if start is None else replace(rest, start=start)
        elif isinstance(rest, AtTimes):
            found, more = await at_times(rest.times, variable, raw), None
        else:
            most = min(most, rest.page or most, most if rest.left is None else rest.left)
            found, more = await _page(rest, most, raw, kind)
        data, _ = _encoded(kind, found, params.TimestampsToReturn)
        return self._answered(HISTORY_DATA, [data], len(found), more, rests)

    def _answered(
        self,
        of: int,
        data: Sequence[bytes],
        count: int,
        more: Rest | Processed | PastEvents | None,
        rests: Rests,
    ) -> bytes:
        point = None
        if more is not None:
            if len(rests) >= self._limits.history_continuation_points:
                return encode_history_result(_Codes.BadNoContinuationPoints)
            point = secrets.token_bytes(16)
            rests[point] = more
        code = _Codes.Good if count or more is not None else _Codes.GoodNoData
        return encode_history_result(code, point, b"".join(data), count, of)

    def release(self, wanted: ua.HistoryReadValueId, rests: Rests) -> bytes:
        """Release a continuation point."""
        known = rests.pop(wanted.ContinuationPoint or b"", None) is not None
        return encode_history_result(_Codes.Good if known else _Codes.BadContinuationPointInvalid)

    def _wanted(  # noqa: C901, PLR0911 - one per reason
        self, params: ua.HistoryReadParameters, number: int, rests: Rests, most: int
    ) -> Rest | Processed | PastEvents | AtTimes | int:
        """Return the parsed request, or a status code if it is invalid."""
        wanted = params.NodesToRead[number]
        if wanted.ContinuationPoint:
            rest = rests.get(wanted.ContinuationPoint)
            if rest is None or rest.node != wanted.NodeId:
                return _Codes.BadContinuationPointInvalid
            return rests.pop(wanted.ContinuationPoint)
        details = params.HistoryReadDetails
        if wanted.NodeId not in self._nodes:  # the lookup creates lazy nodes
            return _Codes.BadNodeIdUnknown
        if isinstance(details, ua.ReadEventDetails):
            return self._wanted_events(wanted.NodeId, details)
        if wanted.NodeId not in self._kept:
            return _Codes.BadHistoryOperationUnsupported
        if wanted.IndexRange:
            return _Codes.BadIndexRangeNoData
        if wanted.DataEncoding is not None and wanted.DataEncoding.Name:
            return _Codes.BadDataEncodingInvalid
        if isinstance(details, ua.ReadProcessedDetails):
            start, end = _time(details.StartTime), _time(details.EndTime)
            span = None if start is None or end is None else (start, end)
            return processed(wanted.NodeId, details, number, span)
        if isinstance(details, ua.ReadAtTimeDetails):
            times = [_time(moment) for moment in details.ReqTimes]
            if not times or len(times) > min(most, MOST_TIMES) or None in times:
                return (
                    _Codes.BadInvalidArgument if len(times) <= most else _Codes.BadTooManyOperations
                )
            return AtTimes(wanted.NodeId, [t for t in times if t is not None])
        if not isinstance(details, ua.ReadRawModifiedDetails) or details.IsReadModified:
            return _Codes.BadHistoryOperationUnsupported
        return _beginning(wanted.NodeId, details) or _Codes.BadHistoryOperationInvalid

    def _wanted_events(self, node: ua.NodeId, details: ua.ReadEventDetails) -> PastEvents | int:
        if node not in self._events:
            return _Codes.BadHistoryOperationUnsupported
        try:
            filter_ = EventFilter(self._nodes, details.Filter)
        except EventFilterRefused:
            return _Codes.BadEventFilterInvalid
        return past_events(node, details, filter_) or _Codes.BadHistoryOperationInvalid


def _summarised(historian: Summarising, variable: ua.NodeId, turn: Turn) -> Summarised:
    async def cells(low: int, high: int, width: int) -> Cells | None:
        await turn.breathe()
        return await turn.outside(historian.cells(variable, low, high, width))

    return Summarised(historian.widths, cells)


async def _page(
    rest: Rest, most: int, raw: Raw, kind: ua.VariantType
) -> tuple[Records, Rest | None]:
    """Return the next values, and the continuation."""
    found = await raw(rest.span, rest.skip, most + 1)
    more = None
    if len(found) > most:
        found = found[:most]
        more = _behind(rest, found)
    parts = [found]
    if rest.lead is not None and not (len(found) and found.source[0] == rest.lead):
        parts.insert(0, await _bound(rest.lead, raw, kind, rest.span, lead=True))
    if rest.tail is not None and more is None:
        parts.append(await _bound(rest.tail, raw, kind, rest.span, lead=False))
    return joined(parts), more


async def _bound(at: int, raw: Raw, kind: ua.VariantType, span: Span, *, lead: bool) -> Records:
    """Return the bounding value of a span, at a time or the nearest one outside."""
    older = span.backwards != lead
    near = await raw(Span(EVER[0], at, backwards=True) if older else Span(at, EVER[1]), 0, 1)
    if len(near):
        return near
    none = np.array([at])
    code = np.array([_Codes.BadBoundNotFound], np.uint32)
    return Records(np.zeros(1, DTYPES[kind]), code, none, none)


def _beginning(node: ua.NodeId, details: ua.ReadRawModifiedDetails) -> Rest | None:
    """Parse a request; None unless two of start, end and number are given."""
    start, end = _time(details.StartTime), _time(details.EndTime)
    n, bounds = details.NumValuesPerNode, bool(details.ReturnBounds)
    if start is None or end is None:
        if not n or start is end:
            return None
        if start is not None:
            return Rest(node, Span(start, EVER[1]), left=n, lead=start if bounds else None)
        assert end is not None  # noqa: S101 - one of the two is there
        back = Span(EVER[0], end, backwards=True)
        return Rest(node, back, left=n, lead=end if bounds else None)
    if start == end:
        return Rest(node, Span(start, start), page=n)
    span = Span(start, end - 1) if start < end else Span(end + 1, start, backwards=True)
    lead, tail = (start, end) if bounds else (None, None)
    return Rest(node, span, page=n, lead=lead, tail=tail)


def _behind(rest: Rest, read: Records) -> Rest | None:
    """Return the remaining request after a partial read; None if it is complete."""
    left = None if rest.left is None else rest.left - len(read)
    if left == 0:
        return None
    span, skip = rest.span.behind(rest.skip, read.source)
    return replace(rest, span=span, skip=skip, left=left, lead=None)


def _encoded(
    kind: ua.VariantType, found: Records, stamps: ua.TimestampsToReturn
) -> tuple[bytes, Any]:
    return encode_records(
        Form(kind, DTYPES[kind], None, handle=False),
        int(stamps),
        {
            "value": np.asarray(found.values).astype(DTYPES[kind])[:, None],
            "status": found.codes,
            "has": found.codes < _BAD,
            "source": found.source // 100 + TICKS_1970,
            "server": found.server // 100 + TICKS_1970,
        },
    )
