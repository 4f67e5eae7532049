"""Encoder of values and notifications in OPC UA binary (Part 6, 5.2), optimised for numbers.

asyncua's generic encoder takes 13-15 µs per notification; this one takes about 1 µs for a number.
Times keep OPC UA's resolution of 100 ns; Python's ``datetime`` would truncate them to 1 µs.
"""

import datetime as dt
import struct
from collections.abc import Sequence

from asyncua import ua
from asyncua.ua import ua_binary

from guarded_opcua.logs import bounded_logger

TICKS_1970 = 116_444_736_000_000_000  # 100 ns from 1601 to 1970
LATEST = ((2**63 - 1) // 100 - 1) * 100  # UTC ns, year 2262; one tick below the int64 maximum
EARLIEST = -LATEST  # year 1677
_EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
VALUE, STATUS, SOURCE, SERVER = 1, 2, 4, 8  # mask bits of a DataValue
ARRAY = 0x80

_FORMATS = {
    ua.VariantType.Boolean: "?",
    ua.VariantType.SByte: "b",
    ua.VariantType.Byte: "B",
    ua.VariantType.Int16: "h",
    ua.VariantType.UInt16: "H",
    ua.VariantType.Int32: "i",
    ua.VariantType.UInt32: "I",
    ua.VariantType.Int64: "q",
    ua.VariantType.UInt64: "Q",
    ua.VariantType.Float: "f",
    ua.VariantType.Double: "d",
}
DTYPES = {kind: f"<{letter}" for kind, letter in _FORMATS.items()}
# Good value with both timestamps: mask, type, value, source time, server time
_PLAIN = {kind: struct.Struct(f"<BB{letter}qq") for kind, letter in _FORMATS.items()}
_PLAIN_MASK = VALUE | SOURCE | SERVER

HISTORY_DATA, HISTORY_EVENT = 658, 661
DATA_CHANGE = 811
EVENTS = 916
STATUS_CHANGE = 820
# measured, s, from queue to message: a number, an array element, asyncua's encoder
_PLAIN_S, _ELEMENT_S, _GENERIC_S = 8e-6, 0.05e-6, 25e-6
_NO_DIAGNOSTICS = b"\xff\xff\xff\xff"


_log = bounded_logger(__name__)
_BAD_ENCODING = int(ua.StatusCodes.BadEncodingError)
_UNENCODABLE = bytes((STATUS,)) + _BAD_ENCODING.to_bytes(4, "little")


class Instant(dt.datetime):
    """A time with OPC UA's full resolution: ``ticks`` of 100 ns since 1601."""

    ticks: int


def instant(nanoseconds: int) -> Instant:
    """Convert UTC ns since 1970 to a time.

    >>> instant(1_500).ticks - TICKS_1970
    15
    """
    moment = _EPOCH + dt.timedelta(microseconds=nanoseconds // 1000)
    made = Instant(
        moment.year,
        moment.month,
        moment.day,
        moment.hour,
        moment.minute,
        moment.second,
        moment.microsecond,
        dt.UTC,
    )
    made.ticks = ticks_of_ns(nanoseconds)
    return made


def ticks_of_ns(nanoseconds: int) -> int:
    """Convert UTC ns since 1970 to 100 ns since 1601."""
    return TICKS_1970 + nanoseconds // 100


def ticks(moment: dt.datetime) -> int:
    """Convert a time to 100 ns since 1601; exact for Instant, to 1 µs otherwise."""
    if type(moment) is Instant:
        return moment.ticks
    return ua.datetime_to_win_epoch(moment)


def nanoseconds(moment: dt.datetime) -> int:
    """Convert a time to UTC ns since 1970, clipped to the range of int64.

    >>> nanoseconds(dt.datetime.max) == LATEST
    True
    """
    return min(max((ticks(moment) - TICKS_1970) * 100, EARLIEST), LATEST)


def nanoseconds_given(moment: dt.datetime | None) -> int | None:
    """Convert an optional time to UTC ns; DateTime 0 means None."""
    return None if moment is None or ticks(moment) <= 0 else nanoseconds(moment)


def encoding_cost(value: ua.DataValue) -> float:
    """Estimate the processor time for encoding a value, s."""
    variant = value.Value
    if variant is None or variant.VariantType not in DTYPES:
        return _GENERIC_S
    return _PLAIN_S if not variant.is_array else _PLAIN_S + _ELEMENT_S * len(variant.Value or ())


def encode_or_refuse(value: ua.DataValue, stamps: ua.TimestampsToReturn) -> bytes:
    """Encode a DataValue; if that fails, encode BadEncodingError without a value."""
    try:
        return encode_data_value(value, stamps)
    except Exception:  # noqa: BLE001 - a bulkhead: the other values are sent
        _log.exception("a value cannot be encoded")
        return _UNENCODABLE


def encode_data_value(value: ua.DataValue, stamps: ua.TimestampsToReturn) -> bytes:
    """Encode a DataValue with the requested timestamps."""
    variant, status = value.Value, value.StatusCode
    code = status.value if status is not None else 0
    source, server = value.SourceTimestamp, value.ServerTimestamp
    if (
        code == 0
        and stamps == ua.TimestampsToReturn.Both
        and variant is not None
        and not variant.is_array
        and source is not None
        and server is not None
        and (packer := _PLAIN.get(variant.VariantType)) is not None
    ):
        return packer.pack(
            _PLAIN_MASK, variant.VariantType, variant.Value, ticks(source), ticks(server)
        )
    mask, parts = 0, [b""]
    if variant is not None and variant.VariantType != ua.VariantType.Null:
        mask |= VALUE
        parts.append(encode_variant(variant))
    if code:
        mask |= STATUS
        parts.append(code.to_bytes(4, "little"))
    if source is not None and stamps in _WITH_SOURCE:
        mask |= SOURCE
        parts.append(ticks(source).to_bytes(8, "little", signed=True))
    if server is not None and stamps in _WITH_SERVER:
        mask |= SERVER
        parts.append(ticks(server).to_bytes(8, "little", signed=True))
    parts[0] = bytes((mask,))
    return b"".join(parts)


_WITH_SOURCE = (ua.TimestampsToReturn.Source, ua.TimestampsToReturn.Both)
_WITH_SERVER = (ua.TimestampsToReturn.Server, ua.TimestampsToReturn.Both)


def encode_variant(variant: ua.Variant) -> bytes:
    """Encode a Variant; arrays of numbers by numpy."""
    letter = _FORMATS.get(variant.VariantType)
    if letter is not None and variant.is_array and variant.Dimensions is None:
        values = variant.Value or ()
        return struct.pack(
            f"<Bi{len(values)}{letter}", variant.VariantType | ARRAY, len(values), *values
        )
    return ua_binary.variant_to_binary(variant)


def encode_data_changes(pieces: Sequence[bytes], count: int | None = None) -> bytes:
    """Encode a DataChangeNotification of records: client handle, then value.

    ``count`` is their number if a piece holds more than one.
    """
    count = len(pieces) if count is None else count
    body = b"".join((count.to_bytes(4, "little"), *pieces, _NO_DIAGNOSTICS))
    return _extension_object(DATA_CHANGE, body)


def encode_events(events: Sequence[tuple[int, Sequence[ua.Variant]]]) -> bytes:
    """Encode an EventNotificationList of (client handle, fields).

    A field that cannot be encoded becomes the StatusCode BadEncodingError (Part 4, 7.22.3).
    """
    parts = [len(events).to_bytes(4, "little")]
    for handle, event_fields in events:
        parts.append(struct.pack("<Ii", handle, len(event_fields)))
        parts.extend(_field(field) for field in event_fields)
    return _extension_object(EVENTS, b"".join(parts))


def encode_status_change(code: int) -> bytes:
    """Encode a StatusChangeNotification without diagnostics."""
    return _extension_object(STATUS_CHANGE, code.to_bytes(4, "little") + b"\x00")


def encode_message(sequence: int, publish_time: int, notifications: Sequence[bytes]) -> bytes:
    """Encode a NotificationMessage; time in 100 ns since 1601."""
    head = struct.pack("<Iqi", sequence, publish_time, len(notifications))
    return b"".join((head, *notifications))


def encode_publish_response(
    request_handle: int,
    now: int,
    subscription: int,
    available: Sequence[int],
    more: bool,  # noqa: FBT001 - a field of the response
    message: bytes,
    results: Sequence[int],
) -> bytes:
    """Encode a PublishResponse around an encoded NotificationMessage."""
    return b"".join(
        (
            _response_head(829, request_handle, now),
            struct.pack(f"<Ii{len(available)}I?", subscription, len(available), *available, more),
            message,
            struct.pack(f"<i{len(results)}I", len(results), *results),
            _NO_DIAGNOSTICS,
        )
    )


def encode_republish_response(request_handle: int, now: int, message: bytes) -> bytes:
    """Encode a RepublishResponse around an encoded NotificationMessage."""
    return _response_head(835, request_handle, now) + message


def encode_results(type_id: int, request_handle: int, now: int, *results: Sequence[bytes]) -> bytes:
    """Encode a response with lists of encoded results, each without diagnostics.

    ``type_id`` is the numeric id of the response's binary encoding.
    """
    parts = [_response_head(type_id, request_handle, now)]
    for encoded in results:
        parts += (len(encoded).to_bytes(4, "little"), *encoded, _NO_DIAGNOSTICS)
    return b"".join(parts)


def encode_history_result(
    code: int,
    continuation: bytes | None = None,
    values: bytes | None = None,
    count: int = 0,
    of: int = HISTORY_DATA,
) -> bytes:
    """Encode a HistoryReadResult with ``count`` encoded values or events; None: no data."""
    point = b"\xff\xff\xff\xff"
    if continuation is not None:
        point = len(continuation).to_bytes(4, "little") + continuation
    data = b"\x00\x00\x00"
    if values is not None:
        data = _extension_object(of, count.to_bytes(4, "little") + values)
    return b"".join((code.to_bytes(4, "little"), point, data))


def encode_status(code: int) -> bytes:
    """Encode a StatusCode."""
    return code.to_bytes(4, "little")


def encode_structure(structure: object) -> bytes:
    """Encode any structure."""
    return bytes(ua_binary.struct_to_binary(structure))


def _field(variant: ua.Variant) -> bytes:
    try:
        return encode_variant(variant)
    except Exception:  # noqa: BLE001 - a bulkhead: the other fields and events are sent
        _log.exception("a field of an event cannot be encoded")
        return bytes((ua.VariantType.StatusCode,)) + encode_status(_BAD_ENCODING)


def _response_head(type_id: int, request_handle: int, now: int) -> bytes:
    # TypeId (four-byte), time, handle, Good, no diagnostics, no strings, no additional header
    return struct.pack("<BBHqIIBiBBB", 1, 0, type_id, now, request_handle, 0, 0, -1, 0, 0, 0)


def _extension_object(type_id: int, body: bytes) -> bytes:
    return struct.pack("<BBHBi", 1, 0, type_id, 1, len(body)) + body
