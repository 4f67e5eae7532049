import datetime as dt
import math

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary
from hypothesis import given
from hypothesis import strategies as st

from guarded_opcua.binary.encoding import (
    EARLIEST,
    LATEST,
    TICKS_1970,
    encode_data_changes,
    encode_data_value,
    encode_events,
    encode_message,
    encode_or_refuse,
    encode_publish_response,
    encode_republish_response,
    encode_results,
    encode_status_change,
    encode_variant,
    instant,
    nanoseconds,
    nanoseconds_given,
    ticks,
)

BOTH = ua.TimestampsToReturn.Both
DOUBLES = st.floats(allow_nan=False)
NUMBERS = {
    ua.VariantType.Boolean: st.booleans(),
    ua.VariantType.SByte: st.integers(-(2**7), 2**7 - 1),
    ua.VariantType.Byte: st.integers(0, 2**8 - 1),
    ua.VariantType.Int16: st.integers(-(2**15), 2**15 - 1),
    ua.VariantType.UInt16: st.integers(0, 2**16 - 1),
    ua.VariantType.Int32: st.integers(-(2**31), 2**31 - 1),
    ua.VariantType.UInt32: st.integers(0, 2**32 - 1),
    ua.VariantType.Int64: st.integers(-(2**63), 2**63 - 1),
    ua.VariantType.UInt64: st.integers(0, 2**64 - 1),
    ua.VariantType.Float: st.floats(width=32, allow_nan=False),
    ua.VariantType.Double: DOUBLES,
}


@st.composite
def variants(draw):
    kind = draw(st.sampled_from([*NUMBERS, ua.VariantType.String]))
    values = NUMBERS.get(kind, st.text(max_size=8))
    if draw(st.booleans()):
        return ua.Variant(draw(st.lists(values, max_size=6)), kind, is_array=True)
    return ua.Variant(draw(values), kind)


TIMES = st.one_of(st.none(), st.integers(0, 4 * 10**18).map(lambda n: instant(n // 1000 * 1000)))
CODES = st.sampled_from([0, 0x80000000, 0x40900000, 0x480])


@given(variants(), CODES, TIMES, TIMES)
def test_asyncua_reads_a_value_as_it_was_written(variant, code, source, server):
    value = ua.DataValue(variant, ua.StatusCode(code), source, server)
    read = ua_binary.struct_from_binary(ua.DataValue, Buffer(encode_data_value(value, BOTH)))
    assert read == value


@given(variants())
def test_a_variant_is_encoded_as_asyncua_would(variant):
    assert encode_variant(variant) == ua_binary.variant_to_binary(variant)


@pytest.mark.parametrize(
    ("stamps", "kept"),
    [
        (ua.TimestampsToReturn.Source, (True, False)),
        (ua.TimestampsToReturn.Server, (False, True)),
        (ua.TimestampsToReturn.Both, (True, True)),
        (ua.TimestampsToReturn.Neither, (False, False)),
    ],
)
def test_only_the_timestamps_asked_for_are_sent(stamps, kept):
    now = instant(1_700_000_000_000_000_000)
    value = ua.DataValue(ua.Variant(1.0), ua.StatusCode(), now, now)
    read = ua_binary.struct_from_binary(ua.DataValue, Buffer(encode_data_value(value, stamps)))
    assert (read.SourceTimestamp is not None, read.ServerTimestamp is not None) == kept


def test_a_nan_arrives_as_nan():
    value = ua.DataValue(ua.Variant(math.nan), ua.StatusCode(), instant(0), instant(0))
    read = ua_binary.struct_from_binary(ua.DataValue, Buffer(encode_data_value(value, BOTH)))
    assert math.isnan(read.Value.Value)


def test_times_keep_a_hundred_nanoseconds():
    moment = instant(1_700_000_000_123_456_789)
    assert ticks(moment) == TICKS_1970 + 17_000_000_001_234_567
    assert nanoseconds(moment) == 1_700_000_000_123_456_700
    assert moment == dt.datetime.fromtimestamp(1_700_000_000, dt.UTC).replace(microsecond=123_456)


def test_times_of_others_are_taken_to_the_microsecond():
    assert ticks(dt.datetime(1970, 1, 1, 0, 0, 0, 7, tzinfo=dt.UTC)) == TICKS_1970 + 70


def test_a_publish_response_is_read_by_asyncua():
    now = instant(1_700_000_000_000_000_000)
    value = ua.DataValue(ua.Variant(2.5), ua.StatusCode(), now, now)
    record = (77).to_bytes(4, "little") + encode_data_value(value, BOTH)
    message = encode_message(
        9,
        ticks(now),
        [
            encode_data_changes([record, record]),
            encode_events([(5, [ua.Variant("text"), ua.Variant(3)])]),
            encode_status_change(0x800A0000),
        ],
    )
    data = encode_publish_response(123, ticks(now), 4, (8, 9), 1, message, (0, 0x80000000))
    read = ua_binary.struct_from_binary(ua.PublishResponse, Buffer(data))
    assert read.ResponseHeader.RequestHandle == 123
    result = read.Parameters
    assert (result.SubscriptionId, result.AvailableSequenceNumbers) == (4, [8, 9])
    assert result.MoreNotifications
    assert [code.value for code in result.Results] == [0, 0x80000000]
    changes, events, ended = result.NotificationMessage.NotificationData
    assert [item.ClientHandle for item in changes.MonitoredItems] == [77, 77]
    assert changes.MonitoredItems[0].Value == value
    assert [field.Value for field in events.Events[0].EventFields] == ["text", 3]
    assert ended.Status.value == 0x800A0000


def test_read_and_republish_responses_are_read_by_asyncua():
    now = instant(1_700_000_000_000_000_000)
    value = ua.DataValue(ua.Variant(2.5), ua.StatusCode(), now, now)
    data = encode_results(634, 3, ticks(now), [encode_data_value(value, BOTH)])
    read = ua_binary.struct_from_binary(ua.ReadResponse, Buffer(data))
    assert read.Results == [value]
    message = encode_message(9, ticks(now), [])
    data = encode_republish_response(3, ticks(now), message)
    again = ua_binary.struct_from_binary(ua.RepublishResponse, Buffer(data))
    assert again.NotificationMessage.SequenceNumber == 9


WRONG = (
    ua.Variant("x", ua.VariantType.Double),
    ua.Variant(2**70, ua.VariantType.UInt64),
    ua.Variant("\ud800", ua.VariantType.String),
    ua.Variant(object(), ua.VariantType.ExtensionObject),
)


@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: wrong.VariantType.name)
def test_a_value_that_cannot_be_encoded_becomes_a_status(wrong):
    now = dt.datetime.now(dt.UTC)
    value = ua.DataValue(wrong, SourceTimestamp=now, ServerTimestamp=now)
    decoded = ua_binary.struct_from_binary(ua.DataValue, Buffer(encode_or_refuse(value, BOTH)))
    assert decoded.StatusCode.value == ua.StatusCodes.BadEncodingError
    assert decoded.Value is None or decoded.Value.Value is None


@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: wrong.VariantType.name)
def test_a_field_that_cannot_be_encoded_leaves_the_others_of_an_event(wrong):
    data = encode_events([(5, [wrong, ua.Variant(3)])])
    found = ua_binary.extensionobject_from_binary(Buffer(data)).Events[0].EventFields
    assert found[0].Value.value == ua.StatusCodes.BadEncodingError
    assert found[1].Value == 3


def test_a_value_that_is_not_there_is_encoded_as_none():
    now = dt.datetime.now(dt.UTC)
    value = ua.DataValue(None, SourceTimestamp=now, ServerTimestamp=now)
    decoded = ua_binary.struct_from_binary(ua.DataValue, Buffer(encode_data_value(value, BOTH)))
    assert decoded.StatusCode.is_good()


@pytest.mark.parametrize("year", [1, 1600, 1601, 1676, 1970, 2262, 2263, 9999])
def test_every_time_has_nanoseconds_that_int64_holds(year):
    moment = dt.datetime(year, 12, 31, 23, 59, 59, 999_999, dt.UTC)
    found = nanoseconds(moment)
    assert found - 1 > -(2**63)
    assert found + 1 < 2**63
    assert EARLIEST <= found <= LATEST
    assert nanoseconds(instant(found)) == found
    assert nanoseconds_given(moment) == (None if year < 1601 else found)
