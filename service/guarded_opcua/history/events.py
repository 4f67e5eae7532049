"""HistoryRead of the events of objects (Part 11, 6.4.2), page by page."""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from asyncua import ua

from guarded_opcua.binary.encoding import encode_structure, nanoseconds_given
from guarded_opcua.history.historian import EVER, Span
from guarded_opcua.monitoring.event_filter import EventFilter
from guarded_opcua.monitoring.events import Event
from guarded_opcua.turn import Turn

MOST_EVENTS: Final = 500  # events filtered per page; bounds the cost of a request
MOST_FIELDS: Final = 10_000  # fields in one response, 20 µs each
MOST_BYTES: Final = 500_000  # bytes of one page, plus at most one event


@dataclass(frozen=True)
class PastEvent:
    """A stored event: its time (UTC ns), and a function that creates the event on demand."""

    t: int
    event: Callable[[], Event]


class EventHistorian(Protocol):
    """Stores the events of objects."""

    def events(
        self, emitter: ua.NodeId, span: Span, skip: int, most: int
    ) -> Awaitable[Sequence[PastEvent]]:
        """Return up to ``most`` events of an object within a span, without the first ``skip``."""


@dataclass(frozen=True)
class PastEvents:
    """A request for an object's events, and the state of its continuation.

    Attributes
    ----------
    node
        The object.
    filter
        Filter and selected fields.
    span, skip
        Span still to be read, and the number of its events to skip.
    page
        Maximum number of events per response, requested by the client; 0: no maximum.
    left
        Number of events still to be returned; None: all of the span.
    """

    node: ua.NodeId
    filter: EventFilter
    span: Span
    skip: int = 0
    page: int = 0
    left: int | None = None


def past_events(
    node: ua.NodeId, details: ua.ReadEventDetails, filter_: EventFilter
) -> PastEvents | None:
    """Parse a request; None unless two of start, end and number are given."""
    start, end = nanoseconds_given(details.StartTime), nanoseconds_given(details.EndTime)
    n = details.NumValuesPerNode
    if start is None and end is None:
        return None
    if start is None or end is None:
        if not n:
            return None
        span = Span(EVER[0], end, backwards=True) if end is not None else Span(start or 0, EVER[1])
        return PastEvents(node, filter_, span, left=n)
    if start <= end:
        return PastEvents(node, filter_, Span(start, max(end - 1, start)), page=n)
    return PastEvents(node, filter_, Span(end + 1, start, backwards=True), page=n)


async def page_of_events(
    rest: PastEvents, historian: EventHistorian, turn: Turn, most: int
) -> tuple[Sequence[bytes], PastEvents | None]:
    """Return the next events, encoded, and the continuation, even after an empty page."""
    wanted = min(
        max(min(most, MOST_FIELDS) // max(len(rest.filter), 1), 1),
        rest.page or MOST_EVENTS,
        MOST_EVENTS if rest.left is None else rest.left,
    )
    some = historian.events(rest.node, rest.span, rest.skip, MOST_EVENTS + 1)
    found = await turn.outside(some)
    encoded: list[bytes] = []
    judged = size = 0
    for past in found[:MOST_EVENTS]:
        await turn.breathe()
        event = past.event()
        judged += 1
        if rest.filter.passes(event):
            fields = ua.HistoryEventFieldList(EventFields=rest.filter.select(event))
            encoded.append(encode_structure(fields))
            size += len(encoded[-1])
        if len(encoded) >= wanted or size > MOST_BYTES:
            break
    left = None if rest.left is None else rest.left - len(encoded)
    if judged == len(found) or left == 0:
        return encoded, None
    times = np.array([past.t for past in found[:judged]])
    span, skip = rest.span.behind(rest.skip, times)
    return encoded, replace(rest, span=span, skip=skip, left=left)
