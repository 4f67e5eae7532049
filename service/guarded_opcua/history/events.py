"""HistoryRead of events (Part 11, 6.4.2): what objects have reported, a page at a time."""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol, TypeVar

import numpy as np
from asyncua import ua

from guarded_opcua.binary.encoding import encode_structure, nanoseconds_given
from guarded_opcua.history.historian import EVER, Span
from guarded_opcua.monitoring.event_filter import Event, EventFilter

T = TypeVar("T")
MOST_EVENTS: Final = 500  # judged for one page: what a filter costs is paid page by page
MOST_FIELDS: Final = 10_000  # in one response, 20 µs each
MOST_BYTES: Final = 500_000  # of one page, the event that passes it included


@dataclass(frozen=True)
class PastEvent:
    """An event that was: its time (UTC ns), and what makes it when somebody wants it."""

    t: int
    event: Callable[[], Event]


class EventHistorian(Protocol):
    """Keeps what objects have reported."""

    def events(
        self, emitter: ua.NodeId, span: Span, skip: int, most: int
    ) -> Awaitable[Sequence[PastEvent]]:
        """Up to ``most`` events of an object within a span, but for the first ``skip``."""


class Turn(Protocol):
    """The running request's turn at the server."""

    async def breathe(self) -> None:
        """Let others go first if this request has lasted for long."""

    async def outside(self, slow: Awaitable[T]) -> T:
        """Wait for something slow without keeping the turn."""


@dataclass(frozen=True)
class PastEvents:
    """What of an object's events is still to be read.

    Attributes
    ----------
    node
        The object.
    filter
        Which of them, and what of each.
    span, skip
        Where to go on: so many events of the span have been read.
    page
        Most events in one answer, as the client wishes; 0: as many as go.
    left
        How many are wanted in all; None: the span says it.
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
    """What a request asks for; None if it says too little (two of start, end and number)."""
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
    """The next events, encoded, and what is left then: a page may be empty and have a next one."""
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
