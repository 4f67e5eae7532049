"""PublishResponse bytes → arrays (OPC UA Part 4, 5.13.5 and 7.26; Part 6, 5.2).

A DataChangeNotification is a list of records: ClientHandle (u4), DataValue mask (u1), Variant
encoding (u1), value, then status (u4), source time (i8, then picoseconds u2) and server time
(i8, then u2), each only if the mask has its bit. Records differ in size, so one compiled loop
walks them, checks every mask and type byte, and decodes all numeric scalars; strings and arrays
become NaN, but the places of arrays are kept (:mod:`valvemap.opcua_source.elements`). Other types
(e.g. structures) are skipped by :mod:`valvemap.opcua_source.wire` and become NaN, too; the loop
then continues with the next record.

Nothing here does I/O.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from asyncua import ua
from numba import njit
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import kept
from valvemap.opcua_source.elements import ARRAY, NO_NUMBER, Arrays, with_elements
from valvemap.opcua_source.wire import FIXED_SIZES, NUMERIC_FORMATS, DecodeError, Reader
from valvemap.pipeline.data_changes import DataChanges

__all__ = [
    "EPOCH_TICKS",
    "DecodeError",
    "HistoryPiece",
    "Message",
    "PublishResponse",
    "decode_history_response",
    "decode_publish_response",
    "decode_republish_response",
    "ns_from_ticks",
    "overflown",
    "ticks_from_ns",
]

EPOCH_TICKS = 116_444_736_000_000_000
"""1970-01-01 as an OPC UA DateTime: units of 100 ns since 1601-01-01."""

_PUBLISH_RESPONSE = 829
_REPUBLISH_RESPONSE = 835
_HISTORY_READ_RESPONSE = 667
_HISTORY_DATA = 658
_DATA_CHANGE_NOTIFICATION = 811
_STATUS_CHANGE_NOTIFICATION = 820

# limits of int64 ns, picoseconds included: one tick less than 2**63 ns, years 1677 to 2262
_MOST_TICKS = (2**63 - 1) // 100 - 1
_MAX_TICKS = EPOCH_TICKS + _MOST_TICKS
_MIN_TICKS = EPOCH_TICKS - _MOST_TICKS
_MOST_PICOSECONDS = 9_999  # units of 10 ps; larger values are read as this one (Part 6, 5.2.2.17)
_OVERFLOW_MASK = 0x0C80  # InfoType (bits 10 and 11) and Overflow (bit 7)
_OVERFLOW = 0x0480  # InfoType = DataValue, Overflow
_HANDLE = 4  # bytes of the client handle before a value
_MOST_RECORDS = 600_000  # records with a Double in the largest message
_ELEMENTS_PER_RECORD = 4  # cost of skipping a record, in walked elements
_RESERVED = 0xC0  # bits of a DataValue mask
_SMALLEST_RESULT = 11  # bytes of a HistoryReadResult: status, no continuation point, nothing
_NO_TIME = -(2**63)
_NO_NUMBER, _ARRAY = NO_NUMBER, ARRAY  # as the compiled loop knows them
_HAS_DIMENSIONS, _IS_ARRAY = 0x40, 0x80  # bits of a Variant's encoding byte
_OF_KIND = 0x3F


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
        Built-in type of each change's value, (N,); 0: no value; 254: an array; 255: neither a
        number nor an array.
    arrays : Arrays or None
        The values that are arrays, if any.
    """

    sequence_number: int
    publish_time: int
    changes: DataChanges
    keep_alive: bool
    status_change: int | None
    overflows: int
    not_numeric: int
    kind: NDArray[np.uint8]
    arrays: Arrays | None = None


@dataclass(frozen=True)
class PublishResponse:
    """A decoded PublishResponse; ``acknowledged`` are the StatusCodes of our acknowledgements."""

    service_result: int
    subscription_id: int
    available: tuple[int, ...]
    more: bool
    message: Message
    acknowledged: tuple[int, ...]


def ns_from_ticks(ticks: int, picoseconds: int = 0) -> int:
    """UTC ns of an OPC UA DateTime (100 ns since 1601) and its picoseconds (units of 10 ps).

    Exact; times outside int64 are clipped to the earliest or latest representable time.

    >>> ns_from_ticks(EPOCH_TICKS + 1), ns_from_ticks(EPOCH_TICKS, 1_234)
    (100, 12)
    """
    whole = min(max(ticks, _MIN_TICKS), _MAX_TICKS) - EPOCH_TICKS
    return whole * 100 + min(picoseconds, _MOST_PICOSECONDS) // 100


def ticks_from_ns(ns: int) -> int:
    """OPC UA DateTime (100 ns since 1601) of UTC ns, rounded down.

    >>> ticks_from_ns(199) - EPOCH_TICKS
    1
    """
    return ns // 100 + EPOCH_TICKS


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
    return _data_changes(Reader(body), 0).changes


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
    data: bytes, items: Sequence[int], elements: Sequence[int | None] = ()
) -> list[HistoryPiece]:
    """Decode the body of a HistoryReadResponse, from its TypeId on.

    ``items`` are the requested items, ``elements`` those of their arrays. A value without a
    timestamp gets the earliest representable time.

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
    for item, element in zip(items, elements or [None] * len(items), strict=True):
        status, size = reader.u4(), max(reader.i4(), 0)
        start = reader.skip(size)
        point = reader.data[start : start + size]
        kind, body = reader.extension_object()
        changes = DataChanges.empty()
        if kind == _HISTORY_DATA:
            batch = _data_changes(body, _NO_TIME, handle=0)
            changes = batch.changes
            if element is not None and len(batch.places):
                arrays = Arrays(data, np.flatnonzero(batch.kind == _ARRAY), batch.places)
                changes, _ = with_elements(changes, batch.kind, arrays, {0: element})
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
    batches: list[_Batch] = []
    status_change = None
    notifications = reader.one_by_one(3)
    for _ in notifications:
        kind, body = reader.extension_object()
        if kind == _DATA_CHANGE_NOTIFICATION:
            batches.append(_data_changes(body, publish_time))
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
        arrays=_joined(reader.data, batches),
    )


def _joined(data: bytes, batches: Sequence["_Batch"]) -> Arrays | None:
    """Return the arrays of all batches, by row of the message; None if there are none."""
    if not any(len(batch.places) for batch in batches):
        return None
    rows = np.concatenate(
        [
            np.flatnonzero(batch.kind == _ARRAY) + begins
            for batch, begins in zip(
                batches, np.cumsum([0, *(len(batch.kind) for batch in batches)]), strict=False
            )
        ]
    )
    return Arrays(data, rows, np.concatenate([batch.places for batch in batches]))


@dataclass(frozen=True)
class _Batch:
    changes: DataChanges
    overflows: int
    not_numeric: int
    kind: NDArray[np.uint8]
    places: NDArray[np.int64]  # of its arrays, in order


_NO_KINDS = np.empty(0, np.uint8)


def _data_changes(reader: Reader, publish_time: int, handle: int = _HANDLE) -> _Batch:
    n = reader.count(handle + 1)
    if n > _MOST_RECORDS:
        raise DecodeError(f"{n} changes in one message, at most {_MOST_RECORDS} are read")
    raw = np.frombuffer(reader.data, np.uint8)
    item = np.zeros(n, np.int32)
    bits = np.empty(n, np.uint64)
    kind = np.empty(n, np.uint8)
    status = np.empty(n, np.uint32)
    time = np.empty(n, np.int64)
    columns = (item, bits, kind, status, time)
    row = 0
    while True:
        at = reader.position
        row, position = _scan(raw, at, reader.stop, row, publish_time, handle, *columns)
        reader.position = position
        if row == n:
            break
        reader.spend(_ELEMENTS_PER_RECORD)
        _pass_over(reader, row, publish_time, handle, *columns)
        row += 1
    places = bits[kind == _ARRAY].astype(np.int64)
    return _Batch(
        DataChanges(item=item, value=_values(bits, kind), status=status, source_time=time),
        overflows=int(np.count_nonzero(overflown(status))),
        not_numeric=int(np.count_nonzero(kind >= _ARRAY)),
        kind=kind,
        places=places,
    )


def _pass_over(
    reader: Reader,
    row: int,
    publish_time: int,
    handle: int,
    item: NDArray[np.int32],
    bits: NDArray[np.uint64],
    kind: NDArray[np.uint8],
    status: NDArray[np.uint32],
    time: NDArray[np.int64],
) -> None:
    """Decode status and time of one record of another type; its value becomes NaN."""
    if handle:
        item[row] = np.uint32(reader.u4()).view(np.int32)
    mask = reader.u1()
    if mask & _RESERVED:
        raise DecodeError(f"DataValue mask {mask:#x} has reserved bits")
    bits[row], kind[row] = 0, 0
    if mask & 0x01:
        place = reader.position
        encoding = reader.u1()
        reader.skip_variant_body(encoding)
        kind[row] = 0 if encoding == 0 else _NO_NUMBER
        if encoding & _IS_ARRAY and encoding & _OF_KIND in NUMERIC_FORMATS:
            bits[row], kind[row] = place, _ARRAY
    status[row] = reader.u4() if mask & 0x02 else 0
    source = reader.i8() if mask & 0x04 else 0
    source_picoseconds = reader.u2() if mask & 0x10 else 0
    server = reader.i8() if mask & 0x08 else 0
    server_picoseconds = reader.u2() if mask & 0x20 else 0
    if source:
        time[row] = ns_from_ticks(source, source_picoseconds)
    elif server:
        time[row] = ns_from_ticks(server, server_picoseconds)
    else:
        time[row] = publish_time


_SIZES = np.zeros(256, np.int64)  # bytes of a value, by its Variant encoding byte
_ELEMENTS = np.zeros(256, np.int64)  # bytes of an element, for types with an Int32 length
for _kind, _size in FIXED_SIZES.items():
    _SIZES[_kind] = _size
    _ELEMENTS[_kind | 0x80] = _size
_ELEMENTS[[12, 15, 16]] = 1  # String, ByteString, XmlElement
_NUMERIC = np.zeros(256, np.bool_)
_NUMERIC[[0, *NUMERIC_FORMATS]] = True


def _values(bits: NDArray[np.uint64], kind: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the values as float64; integers beyond 2**53 are rounded."""
    values = bits.view(np.float64)
    present = np.bincount(kind, minlength=256).nonzero()[0]
    for number in present.tolist():
        if number == 11:
            continue
        rows = kind == number
        chosen = bits[rows]
        match number:
            case 10:
                values[rows] = chosen.astype(np.uint32).view(np.float32)
            case 2 | 4 | 6 | 8:
                values[rows] = chosen.view(np.int64)
            case 1 | 3 | 5 | 7 | 9:
                values[rows] = chosen
            case _:
                values[rows] = np.nan
    return values


def overflown(status: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return which changes have the Overflow bit: the server dropped earlier ones."""
    return (status & _OVERFLOW_MASK) == _OVERFLOW


@njit(cache=True, inline="always")
def _u4(raw: NDArray[np.uint8], at: int) -> np.uint64:
    return (
        np.uint64(raw[at])
        | np.uint64(raw[at + 1]) << np.uint64(8)
        | np.uint64(raw[at + 2]) << np.uint64(16)
        | np.uint64(raw[at + 3]) << np.uint64(24)
    )


@njit(cache=True, inline="always")
def _i8(raw: NDArray[np.uint8], at: int) -> np.int64:
    return np.int64(_u4(raw, at) | _u4(raw, at + 4) << np.uint64(32))


@kept
@njit(cache=True)
def _scan(  # noqa: C901, PLR0912, PLR0915 - one compiled loop
    raw: NDArray[np.uint8],
    position: int,
    stop: int,
    row: int,
    publish_time: int,
    handle: int,
    item: NDArray[np.int32],
    bits: NDArray[np.uint64],
    kind: NDArray[np.uint8],
    status: NDArray[np.uint32],
    time: NDArray[np.int64],
) -> tuple[int, int]:
    """Decode records until all rows are filled, or one is of an unknown type or truncated.

    Each value is preceded by ``handle`` bytes.

    Returns the next row and the position of its record.
    """
    n = len(item)
    while row < n:
        at = position + handle
        if stop - at < 1:
            break
        mask = raw[at]
        if mask & _RESERVED:
            break
        at += 1
        number = np.uint8(0)
        size = 0
        if mask & 0x01:
            if stop - at < 1:
                break
            number = raw[at]
            at += 1
            size = _SIZES[number]
            if _ELEMENTS[number] > 0:
                if stop - at < 4:
                    break
                size = 4 + max(np.int64(np.int32(_u4(raw, at))), 0) * _ELEMENTS[number]
            elif size == 0 and number != 0:
                break
            if not _NUMERIC[number]:
                number = np.uint8(_ARRAY if number & _IS_ARRAY else _NO_NUMBER)
        tail = size
        if mask & 0x02:
            tail += 4
        if mask & 0x04:
            tail += 8
        if mask & 0x10:
            tail += 2
        if mask & 0x08:
            tail += 8
        if mask & 0x20:
            tail += 2
        if stop - at < tail:
            break
        if number == _NO_NUMBER:
            bits[row] = np.uint64(0)
        elif number == _ARRAY:
            bits[row] = np.uint64(at - 1)
        elif size == 8:
            bits[row] = np.uint64(_i8(raw, at))
        elif size == 4:
            value = _u4(raw, at)
            bits[row] = np.uint64(np.int32(value)) if number == 6 else value
        elif size == 2:
            value = np.uint64(raw[at]) | np.uint64(raw[at + 1]) << np.uint64(8)
            bits[row] = np.uint64(np.int16(value)) if number == 4 else value
        elif number == 1:
            bits[row] = np.uint64(raw[at] != 0)
        elif size == 1:
            value = np.uint64(raw[at])
            bits[row] = np.uint64(np.int8(value)) if number == 2 else value
        else:
            bits[row] = np.uint64(0)
        at += size
        if handle > 0:
            item[row] = np.int32(_u4(raw, position))
        kind[row] = number
        if mask & 0x02:
            status[row] = np.uint32(_u4(raw, at))
            at += 4
        else:
            status[row] = np.uint32(0)
        ticks = np.int64(0)
        picoseconds = np.int64(0)
        if mask & 0x04:
            ticks = _i8(raw, at)
            at += 8
        if mask & 0x10:
            if ticks != 0:
                picoseconds = np.int64(raw[at]) | np.int64(raw[at + 1]) << 8
            at += 2
        if mask & 0x08:
            if ticks == 0:
                ticks = _i8(raw, at)
                if mask & 0x20 and ticks != 0:
                    picoseconds = np.int64(raw[at + 8]) | np.int64(raw[at + 9]) << 8
            at += 8
        if mask & 0x20:
            at += 2
        if ticks == 0:
            time[row] = publish_time
        else:
            # as ns_from_ticks, which compiled code cannot call
            ticks = min(max(ticks, np.int64(_MIN_TICKS)), np.int64(_MAX_TICKS))
            picoseconds = min(picoseconds, np.int64(_MOST_PICOSECONDS))
            time[row] = (ticks - EPOCH_TICKS) * 100 + picoseconds // 100
        position = at
        row += 1
    return row, position
