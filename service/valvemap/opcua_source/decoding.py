"""PublishResponse, RepublishResponse and HistoryReadResponse: bytes → arrays.

OPC UA Part 4, 5.13.5, 5.13.6 and 7.26; Part 11. The records of their notifications are read by
:mod:`valvemap.opcua_source.records`. Nothing here does I/O.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.opcua_source.elements import COMPOUND, Compounds, Element, with_elements
from valvemap.opcua_source.members import Member
from valvemap.opcua_source.records import Records, read_records
from valvemap.opcua_source.timestamps import ns_from_ticks
from valvemap.opcua_source.wire import DecodeError, Reader
from valvemap.pipeline.data_changes import DataChanges

_PUBLISH_RESPONSE = 829
_REPUBLISH_RESPONSE = 835
_HISTORY_READ_RESPONSE = 667
_HISTORY_DATA = 658
_DATA_CHANGE_NOTIFICATION = 811
_STATUS_CHANGE_NOTIFICATION = 820

_SMALLEST_RESULT = 11  # bytes of a HistoryReadResult: status, no continuation point, nothing
_NO_TIME = -(2**63)
_NO_KINDS = np.empty(0, np.uint8)


@dataclass(frozen=True)
class Message:
    """One NotificationMessage.

    Attributes
    ----------
    sequence_number : int
        Number of this message; of the *next* one if this is a keep-alive.
    publish_time : int
        PublishTime of the server, UTC ns.
    changes : DataChanges
        ``item`` is the client handle as sent. The time is the SourceTimestamp, else the
        ServerTimestamp, else ``publish_time``.
    keep_alive : bool
        Whether the message has no notifications.
    status_change : int or None
        StatusCode of the subscription, if it changed.
    overflows : int
        Changes marked with the Overflow bit: the server's queue was full and dropped some.
    not_numeric : int
        Changes whose value is not a numeric scalar.
    kind : uint8
        Built-in type of each change's value, (N,); 0: no value; 254: an array or a
        structure; 255: none of these.
    compounds : Compounds or None
        The values that are arrays or structures, if any.
    """

    sequence_number: int
    publish_time: int
    changes: DataChanges
    keep_alive: bool
    status_change: int | None
    overflows: int
    not_numeric: int
    kind: NDArray[np.uint8]
    compounds: Compounds | None = None


@dataclass(frozen=True)
class PublishResponse:
    """A decoded PublishResponse; ``acknowledged`` are the StatusCodes of our acknowledgements."""

    service_result: int
    subscription_id: int
    available: tuple[int, ...]
    more: bool
    message: Message
    acknowledged: tuple[int, ...]


def decode_publish_response(data: bytes) -> PublishResponse:
    """Decode the body of a PublishResponse message, from its TypeId on.

    Raises
    ------
    DecodeError
        if it is truncated, or not a PublishResponse.
    """
    reader = Reader(data)
    service_result = _enter_response(reader, _PUBLISH_RESPONSE)
    subscription_id = reader.u4()
    available = reader.u4_array()
    more = reader.u1() != 0
    message = _message(reader)
    acknowledged = reader.u4_array()
    for _ in reader.one_by_one(1):
        reader.skip_diagnostic_info()
    return PublishResponse(service_result, subscription_id, available, more, message, acknowledged)


def decode_data_changes(body: bytes) -> DataChanges:
    r"""Decode the body of one DataChangeNotification (Part 4, 7.25.2); times are UTC ns.

    Raises
    ------
    DecodeError
        if the bytes are not such a notification.

    Examples
    --------
    >>> len(decode_data_changes(bytes(4) + b"\\xff" * 4))
    0
    """
    return read_records(Reader(body), 0).changes


def decode_republish_response(data: bytes) -> Message:
    """Decode the body of a RepublishResponse message, from its TypeId on.

    Raises
    ------
    DecodeError
        if it is truncated, or not a RepublishResponse.
    """
    reader = Reader(data)
    _enter_response(reader, _REPUBLISH_RESPONSE)
    return _message(reader)


@dataclass(frozen=True)
class HistoryPiece:
    """Past changes of one variable: ``status`` of the read, and ``point``, to continue it."""

    status: int
    point: bytes
    changes: DataChanges


def decode_history_response(
    data: bytes, items: Sequence[int], places: Sequence[int | Member | None] = ()
) -> list[HistoryPiece]:
    """Decode the body of a HistoryReadResponse, from its TypeId on.

    ``items`` are the requested items, ``places`` those in their arrays or structures. A value
    without a timestamp gets the earliest representable time.

    Raises
    ------
    DecodeError
        if it is truncated, not a HistoryReadResponse, or has another number of variables.
    UaStatusCodeError
        if the ServiceResult is not Good.
    """
    reader = Reader(data)
    ua.StatusCode(_enter_response(reader, _HISTORY_READ_RESPONSE)).check()
    results = reader.one_by_one(_SMALLEST_RESULT)
    if len(results) != len(items):
        raise DecodeError(f"{len(results)} histories for {len(items)} variables")
    pieces = []
    for item, place in zip(items, places or [None] * len(items), strict=True):
        status, size = reader.u4(), max(reader.i4(), 0)
        start = reader.skip(size)
        point = reader.data[start : start + size]
        kind, body = reader.extension_object()
        changes = DataChanges.empty()
        if kind == _HISTORY_DATA:
            batch = read_records(body, _NO_TIME, handle=0)
            changes = batch.changes
            if place is not None and len(batch.places):
                compounds = Compounds(data, np.flatnonzero(batch.kind == COMPOUND), batch.places)
                changes, _ = with_elements(
                    changes, batch.kind, compounds, {0: (Element(0, place),)}
                )
        pieces.append(HistoryPiece(status, point, replace(changes, item=_all(item, changes))))
    return pieces


def _all(item: int, changes: DataChanges) -> NDArray[np.int32]:
    return np.full(len(changes), item, np.int32)


def _enter_response(reader: Reader, expected: int) -> int:
    """Read TypeId and ResponseHeader; return the ServiceResult."""
    kind = reader.node_id()
    if kind != expected:
        raise DecodeError(f"message of type {kind}, expected {expected}")
    reader.skip(12)  # Timestamp, RequestHandle
    service_result = reader.u4()
    reader.skip_diagnostic_info()
    for _ in reader.one_by_one(4):
        reader.skip_string()
    reader.extension_object()
    return service_result


def _message(reader: Reader) -> Message:
    sequence_number = reader.u4()
    publish_time = ns_from_ticks(reader.i8())
    batches: list[Records] = []
    status_change = None
    notifications = reader.one_by_one(3)
    for _ in notifications:
        kind, body = reader.extension_object()
        if kind == _DATA_CHANGE_NOTIFICATION:
            batches.append(read_records(body, publish_time))
        elif kind == _STATUS_CHANGE_NOTIFICATION:
            status_change = body.u4()
    return Message(
        sequence_number=sequence_number,
        publish_time=publish_time,
        changes=(
            batches[0].changes
            if len(batches) == 1
            else DataChanges.concatenate([batch.changes for batch in batches])
        ),
        keep_alive=len(notifications) == 0,
        status_change=status_change,
        overflows=sum(batch.overflows for batch in batches),
        not_numeric=sum(batch.not_numeric for batch in batches),
        kind=np.concatenate([batch.kind for batch in batches] or [_NO_KINDS]),
        compounds=_joined(reader.data, batches),
    )


def _joined(data: bytes, batches: Sequence[Records]) -> Compounds | None:
    """Return the values with parts, by row of the message; None if there are none."""
    if not any(len(batch.places) for batch in batches):
        return None
    rows = np.concatenate(
        [
            np.flatnonzero(batch.kind == COMPOUND) + begins
            for batch, begins in zip(
                batches, np.cumsum([0, *(len(batch.kind) for batch in batches)]), strict=False
            )
        ]
    )
    return Compounds(data, rows, np.concatenate([batch.places for batch in batches]))
