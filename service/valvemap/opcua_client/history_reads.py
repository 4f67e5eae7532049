"""HistoryRead at our own servers: aggregates of variables, and past events (Part 11, 6.4)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from asyncua import ua

from guarded_opcua.binary.encoding import instant
from valvemap.clock import utc_ns
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.responses import Senseless, decode_response

AGGREGATES: Final = {
    "Average": ua.ObjectIds.AggregateFunction_Average,
    "Minimum": ua.ObjectIds.AggregateFunction_Minimum,
    "Maximum": ua.ObjectIds.AggregateFunction_Maximum,
}
_MOST_PAGES: Final = 200  # responses read for one request; a server may return empty ones
_BAD: Final = 0x8000_0000


@dataclass(frozen=True)
class Course:
    """One aggregate of one variable at equal intervals.

    Attributes
    ----------
    code
        StatusCode of the read: Bad if the variable has no history.
    times, values, codes
        Start of each interval (UTC ns), its value (NaN: none) and its StatusCode.
    """

    code: int
    times: Sequence[int]
    values: Sequence[float]
    codes: Sequence[int]


async def read_aggregates(
    connection: Connection,
    asked: Sequence[tuple[ua.NodeId, str]],
    span: tuple[int, int],
    every_ns: int,
) -> list[Course]:
    """Read aggregates (names of `AGGREGATES`) of variables; ``span`` in UTC ns, its end excluded.

    Raises
    ------
    UaStatusCodeError, Senseless
    """
    details = ua.ReadProcessedDetails(
        StartTime=instant(span[0]),
        EndTime=instant(span[1]),
        ProcessingInterval=every_ns * 1e-6,
        AggregateType=[ua.NodeId(AGGREGATES[kind]) for _, kind in asked],
        AggregateConfiguration=ua.AggregateConfiguration(),
    )
    return [_course(*found) for found in await _read(connection, details, [n for n, _ in asked])]


async def read_events(
    connection: Connection,
    node: ua.NodeId,
    wanted: ua.EventFilter,
    span: tuple[int, int],
    most: int,
) -> list[list[Any]]:
    """Read the selected fields of the newest events of a span, the newest first.

    Raises
    ------
    UaStatusCodeError, Senseless
        UaStatusCodeError also if the node has no history of events.
    """
    details = ua.ReadEventDetails(
        NumValuesPerNode=most,
        StartTime=instant(span[1]),  # later than the end: backwards
        EndTime=instant(span[0]),
        Filter=wanted,
    )
    ((code, pieces),) = await _read(connection, details, [node], most)
    ua.StatusCode(code).check()
    events = [event for piece in pieces for event in piece.Events or ()]
    return [[field.Value for field in event.EventFields] for event in events[:most]]


async def _read(
    connection: Connection, details: object, nodes: Sequence[ua.NodeId], most: int = 0
) -> list[tuple[int, list[Any]]]:
    """Return the StatusCode and all pieces of each node; ``most`` events are enough."""
    found: list[tuple[int, list[Any]]] = [(0, []) for _ in nodes]
    waiting = {k: ua.HistoryReadValueId(NodeId=node) for k, node in enumerate(nodes)}
    for page in range(_MOST_PAGES):
        results = await _request(connection, details, list(waiting.values()))
        if len(results) != len(waiting):
            raise Senseless(f"{len(results)} histories of {len(waiting)} variables")
        for (k, value), result in zip(list(waiting.items()), results, strict=True):
            code, pieces = result.StatusCode.value, found[k][1]
            if isinstance(result.HistoryData, ua.HistoryData | ua.HistoryEvent):
                pieces.append(result.HistoryData)
            found[k] = (code, pieces)
            read = sum(len(getattr(piece, "Events", None) or ()) for piece in pieces)
            is_over = not result.ContinuationPoint or code >= _BAD
            if is_over or (most and read >= most) or page == _MOST_PAGES - 1:
                del waiting[k]
                if not is_over:
                    value.ContinuationPoint = result.ContinuationPoint
                    await _request(connection, details, [value], release=True)
            else:
                value.ContinuationPoint = result.ContinuationPoint
        if not waiting:
            break
    return found


async def _request(
    connection: Connection,
    details: object,
    nodes: list[ua.HistoryReadValueId],
    *,
    release: bool = False,
) -> list[ua.HistoryReadResult]:
    request = ua.HistoryReadRequest()
    request.Parameters.HistoryReadDetails = details
    request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
    request.Parameters.ReleaseContinuationPoints = release
    request.Parameters.NodesToRead = nodes
    body = await connection.session.request(request)
    return decode_response(ua.HistoryReadResponse, body).Results or []


def _course(code: int, pieces: Sequence[Any]) -> Course:
    read = [value for piece in pieces for value in piece.DataValues or ()]
    return Course(
        code=code,
        times=[0 if v.SourceTimestamp is None else utc_ns(v.SourceTimestamp) for v in read],
        values=[_number(v) for v in read],
        codes=[0 if v.StatusCode is None else int(v.StatusCode.value) for v in read],
    )


def _number(value: ua.DataValue) -> float:
    held = None if value.Value is None else value.Value.Value
    return float(held) if isinstance(held, int | float) else math.nan
