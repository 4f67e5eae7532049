import struct
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary
from hypothesis import given
from hypothesis import strategies as st

from valvemap.opcua_source.decoding import decode_publish_response, decode_republish_response
from valvemap.opcua_source.timestamps import EPOCH_TICKS, ns_from_ticks, ticks_from_ns
from valvemap.opcua_source.wire import DecodeError

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
NUMERIC = {
    ua.VariantType.Boolean: "<?",
    ua.VariantType.SByte: "<b",
    ua.VariantType.Byte: "<B",
    ua.VariantType.Int16: "<h",
    ua.VariantType.UInt16: "<H",
    ua.VariantType.Int32: "<i",
    ua.VariantType.UInt32: "<I",
    ua.VariantType.Int64: "<q",
    ua.VariantType.UInt64: "<Q",
    ua.VariantType.Float: "<f",
    ua.VariantType.Double: "<d",
}
INTEGERS = {
    ua.VariantType.SByte: (-(2**7), 2**7 - 1),
    ua.VariantType.Byte: (0, 2**8 - 1),
    ua.VariantType.Int16: (-(2**15), 2**15 - 1),
    ua.VariantType.UInt16: (0, 2**16 - 1),
    ua.VariantType.Int32: (-(2**31), 2**31 - 1),
    ua.VariantType.UInt32: (0, 2**32 - 1),
    ua.VariantType.Int64: (-(2**63), 2**63 - 1),
    ua.VariantType.UInt64: (0, 2**64 - 1),
}
ANY_DOUBLE = st.floats(allow_nan=True, allow_infinity=True)

numbers = st.one_of(
    st.booleans().map(lambda v: ua.Variant(v, ua.VariantType.Boolean)),
    ANY_DOUBLE.map(lambda v: ua.Variant(v, ua.VariantType.Double)),
    st.floats(width=32).map(lambda v: ua.Variant(v, ua.VariantType.Float)),
    *(
        st.integers(low, high).map(lambda v, kind=kind: ua.Variant(v, kind))
        for kind, (low, high) in INTEGERS.items()
    ),
)
others = st.one_of(
    st.just(ua.Variant(None, ua.VariantType.Null)),
    st.text(max_size=5).map(lambda v: ua.Variant(v, ua.VariantType.String)),
    st.just(ua.Variant(None, ua.VariantType.String)),
    st.binary(max_size=5).map(lambda v: ua.Variant(v, ua.VariantType.ByteString)),
    st.uuids().map(lambda v: ua.Variant(v, ua.VariantType.Guid)),
    st.just(ua.Variant(datetime(2024, 1, 1, tzinfo=UTC), ua.VariantType.DateTime)),
    st.just(ua.Variant(ua.StatusCode(5), ua.VariantType.StatusCode)),
    st.just(ua.Variant(ua.NodeId("x", 2), ua.VariantType.NodeId)),
    st.just(ua.Variant(ua.QualifiedName("x", 2), ua.VariantType.QualifiedName)),
    st.just(ua.Variant(ua.LocalizedText("x", "en"), ua.VariantType.LocalizedText)),
    st.just(ua.Variant(ua.Range(1, 2), ua.VariantType.ExtensionObject)),
    st.just(ua.Variant(ua.DataValue(ua.Variant(1.0)), ua.VariantType.DataValue)),
    st.lists(ANY_DOUBLE, max_size=4).map(
        lambda v: ua.Variant(v, ua.VariantType.Double, is_array=True)
    ),
    st.lists(st.text(max_size=3), max_size=4).map(
        lambda v: ua.Variant(v, ua.VariantType.String, is_array=True)
    ),
    st.just(ua.Variant([[1, 2], [3, 4]], ua.VariantType.Int16)),
    st.just(ua.Variant([ua.Variant(1.0), ua.Variant(None)], ua.VariantType.Variant)),
)
times = st.one_of(
    st.none(),
    st.integers(-(10**15), 4 * 10**15).map(lambda us: EPOCH + timedelta(microseconds=us)),
)


@st.composite
def data_values(draw):
    value = ua.DataValue(draw(st.one_of(numbers, numbers, numbers, others)))
    code = draw(st.one_of(st.none(), st.integers(0, 2**32 - 1)))
    value.StatusCode = None if code is None else ua.StatusCode(code)
    value.SourceTimestamp = draw(times)
    value.ServerTimestamp = draw(times)
    if draw(st.integers(0, 9)) == 0:
        value.Value = None
    return value


notifications = st.lists(
    st.builds(
        ua.MonitoredItemNotification, ClientHandle=st.integers(0, 2**31 - 1), Value=data_values()
    ),
    max_size=40,
)


def response_with(*bodies, sequence=7, more=False, publish_time=EPOCH):
    response = ua.PublishResponse()
    response.Parameters.SubscriptionId = 3
    response.Parameters.AvailableSequenceNumbers = [sequence]
    response.Parameters.MoreNotifications = more
    response.Parameters.NotificationMessage.SequenceNumber = sequence
    response.Parameters.NotificationMessage.PublishTime = publish_time
    response.Parameters.NotificationMessage.NotificationData = list(bodies)
    response.Parameters.Results = [ua.StatusCode()]
    return ua_binary.struct_to_binary(response)


def data_change(records, count):
    body = struct.pack("<i", count) + records + struct.pack("<i", -1)
    return ua.ExtensionObject(
        TypeId=ua.NodeId(ua.ObjectIds.DataChangeNotification_Encoding_DefaultBinary), Body=body
    )


def decoded(records, count, **kwargs):
    return decode_publish_response(response_with(data_change(records, count), **kwargs)).message


def generic(data):
    """What asyncua's own decoder says of the same bytes: (handle, value, status, time)."""
    response = ua_binary.struct_from_binary(ua.PublishResponse, Buffer(data))
    message = response.Parameters.NotificationMessage
    for notification in message.NotificationData:
        for item in notification.MonitoredItems:
            value = item.Value.Value
            numeric = value is not None and value.VariantType in NUMERIC and not value.is_array
            time = item.Value.SourceTimestamp or item.Value.ServerTimestamp or message.PublishTime
            yield (
                item.ClientHandle,
                float(value.Value) if numeric else np.nan,
                item.Value.StatusCode.value if item.Value.StatusCode is not None else 0,
                (time.replace(tzinfo=UTC) - EPOCH) // timedelta(microseconds=1) * 1000,
            )


@given(st.lists(notifications, max_size=3))
def test_arrays_equal_the_generic_decoder_on_messages_of_every_kind(batches):
    data = response_with(*(ua.DataChangeNotification(MonitoredItems=batch) for batch in batches))
    changes = decode_publish_response(data).message.changes
    expected = list(generic(data))
    assert len(changes) == len(expected) == sum(len(batch) for batch in batches)
    if expected:
        handles, values, codes, ns = zip(*expected, strict=True)
        assert changes.item.tolist() == list(handles)
        np.testing.assert_array_equal(changes.value, np.array(values))
        assert changes.status.tolist() == list(codes)
        assert changes.source_time.tolist() == list(ns)
    assert changes.item.dtype == np.int32
    assert changes.value.dtype == np.float64
    assert changes.status.dtype == np.uint32
    assert changes.source_time.dtype == np.int64


@pytest.mark.parametrize("kind", [*NUMERIC, ua.VariantType.String])
def test_every_mask_with_every_type_is_read_in_the_order_of_the_standard(kind):
    for mask in range(64):
        is_read_in_the_order_of_the_standard(mask, kind)


def is_read_in_the_order_of_the_standard(mask, kind):
    value = 1 if kind == ua.VariantType.Boolean else 42
    body = (
        struct.pack("<i", 2) + b"ab" if kind not in NUMERIC else struct.pack(NUMERIC[kind], value)
    )
    record = struct.pack("<IB", 5, mask)
    source, server = EPOCH_TICKS + 11, EPOCH_TICKS + 22
    record += bytes([kind.value]) + body if mask & 1 else b""
    record += struct.pack("<I", 0x40000000) if mask & 2 else b""
    record += struct.pack("<q", source) if mask & 4 else b""
    record += struct.pack("<H", 300) if mask & 16 else b""  # picoseconds follow their time
    record += struct.pack("<q", server) if mask & 8 else b""
    record += struct.pack("<H", 500) if mask & 32 else b""
    message = decoded(record * 3, 3, publish_time=EPOCH + timedelta(seconds=1))
    changes = message.changes
    assert changes.item.tolist() == [5, 5, 5]
    if mask & 1 and kind in NUMERIC:
        assert changes.value.tolist() == [value] * 3
    else:
        assert np.isnan(changes.value).all()
    assert message.not_numeric == (3 if mask & 1 and kind not in NUMERIC else 0)
    assert changes.status.tolist() == [0x40000000 if mask & 2 else 0] * 3
    if mask & 4:
        expected = 1100 + (3 if mask & 16 else 0)
    elif mask & 8:
        expected = 2200 + (5 if mask & 32 else 0)
    else:
        expected = 10**9
    assert changes.source_time.tolist() == [expected] * 3


def test_times_are_exact_to_the_last_hundred_nanoseconds():
    record = struct.pack("<IBBdqq", 0, 0x0D, 11, 1.0, EPOCH_TICKS + 17_000_000_000_000_001, 0)
    assert decoded(record, 1).changes.source_time.tolist() == [1_700_000_000_000_000_100]


def test_a_missing_source_time_is_the_servers_and_zero_means_missing():
    record = struct.pack("<IBBdqq", 0, 0x0D, 11, 1.0, 0, EPOCH_TICKS + 5)
    assert decoded(record, 1).changes.source_time.tolist() == [500]


EDGE = (2**63 - 1) // 100 + EPOCH_TICKS  # of int64 ns


@pytest.mark.parametrize(
    "ticks", [-(2**63), -1, 1, *range(EDGE - 3, EDGE + 3), EPOCH_TICKS, 2**63 - 1]
)
@pytest.mark.parametrize("picoseconds", [0, 99, 100, 9_999, 10_000, 65_535])
def test_times_beyond_int64_nanoseconds_are_clipped_not_wrapped(ticks, picoseconds):
    time = struct.pack("<qH", ticks, picoseconds)
    number = struct.pack("<IBBd", 0, 0x15, 11, 1.0) + time
    structure = struct.pack("<IBBBBHB", 0, 0x15, 22, 1, 0, 1, 0) + time  # the other path
    (fast,), (slow,) = (decoded(r, 1).changes.source_time.tolist() for r in (number, structure))
    assert fast == slow == ns_from_ticks(ticks, picoseconds)
    assert (fast > 0) == (ticks > EPOCH_TICKS or (ticks == EPOCH_TICKS and picoseconds >= 100))


def test_more_picoseconds_than_a_tick_has_count_as_the_most():
    assert ns_from_ticks(EPOCH_TICKS, 65_535) == ns_from_ticks(EPOCH_TICKS, 9_999) == 99


@given(st.integers(-(2**60), 2**60))
def test_ticks_and_nanoseconds_agree_both_ways(ns):
    assert ns - 100 < ns_from_ticks(ticks_from_ns(ns)) <= ns


def test_reserved_bits_of_a_mask_are_an_error_not_a_guess():
    for bit in (0x40, 0x80):
        with pytest.raises(DecodeError, match="reserved"):
            decoded(struct.pack("<IBBd", 0, 1 | bit, 11, 1.0), 1)


def test_overflow_bits_are_counted_and_kept():
    codes = [0x480, 0x80, 0x400, 0x80000480, 0xC80, 0]
    records = b"".join(struct.pack("<IBBdI", 0, 3, 11, 1.0, code) for code in codes)
    message = decoded(records, len(codes))
    assert message.overflows == 2
    assert message.changes.status.tolist() == codes


def test_a_keep_alive_has_nothing_in_it():
    response = decode_publish_response(response_with(sequence=9))
    assert response.message.keep_alive
    assert response.message.sequence_number == 9
    assert len(response.message.changes) == 0


def test_what_stands_around_the_changes_is_read_too():
    data = response_with(data_change(b"", 0), sequence=4, more=True)
    response = decode_publish_response(data)
    assert (response.subscription_id, response.available, response.more) == (3, (4,), True)
    assert response.acknowledged == (0,)
    assert not response.message.keep_alive


def test_a_change_of_the_subscriptions_status_is_handed_on():
    ended = ua.StatusChangeNotification(Status=ua.StatusCode(ua.StatusCodes.BadTimeout))
    message = decode_publish_response(response_with(ended)).message
    assert message.status_change == ua.StatusCodes.BadTimeout


def test_events_are_passed_over():
    events = ua.EventNotificationList(Events=[ua.EventFieldList(1, [ua.Variant(1.0)])])
    record = struct.pack("<IBBd", 1, 1, 11, 2.0)
    message = decode_publish_response(response_with(events, data_change(record, 1))).message
    assert message.changes.value.tolist() == [2.0]


def test_a_republished_message_reads_like_a_published_one():
    response = ua.RepublishResponse()
    response.NotificationMessage.SequenceNumber = 12
    record = struct.pack("<IBBd", 1, 1, 11, 2.0)
    response.NotificationMessage.NotificationData = [data_change(record, 1)]
    message = decode_republish_response(ua_binary.struct_to_binary(response))
    assert message.sequence_number == 12
    assert message.changes.value.tolist() == [2.0]


def test_another_message_is_refused():
    with pytest.raises(DecodeError, match="type 397"):
        decode_publish_response(ua_binary.struct_to_binary(ua.ServiceFault()))


def test_more_records_than_bytes_are_refused_before_memory_is_taken():
    with pytest.raises(DecodeError):
        decoded(b"", 2**31 - 1)


@given(notifications)
def test_a_message_cut_short_is_refused_wherever_it_was_cut(batch):
    data = response_with(ua.DataChangeNotification(MonitoredItems=batch))
    for length in range(0, len(data), 7):
        with pytest.raises(DecodeError):
            decode_publish_response(data[:length])


@given(notifications, st.data())
def test_damaged_bytes_give_arrays_or_a_decode_error_and_nothing_else(batch, damage):
    data = bytearray(response_with(ua.DataChangeNotification(MonitoredItems=batch)))
    for _ in range(damage.draw(st.integers(1, 8))):
        data[damage.draw(st.integers(0, len(data) - 1))] = damage.draw(st.integers(0, 255))
    try:
        message = decode_publish_response(bytes(data)).message
    except DecodeError:
        return
    assert len(message.changes.value) == len(message.changes.source_time)
