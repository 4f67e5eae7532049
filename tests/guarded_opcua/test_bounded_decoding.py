"""Our decoder gives what asyncua's gives, and nothing is allocated before it is believed."""

import contextlib
import random
import statistics
import struct
import time
import tracemalloc
from datetime import UTC, datetime
from uuid import UUID

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary
from hypothesis import given, settings
from hypothesis import strategies as st

from guarded_opcua.binary.bounded_decoding import (
    Budget,
    Malformed,
    Reader,
    TooMuch,
    decode,
    decode_slowly,
)
from support.mutations import mutated
from support.mutations import requests as corpus
from support.structures import requests, structures, variants

AMPLE = Budget(elements=100_000, array_length=100_000, string_bytes=100_000, nesting=32)
TIGHT = {"elements": 1_000, "array_length": 10_000, "string_bytes": 4_096, "nesting": 16}
IS_ARRAY, IS_MATRIX = 0x80, 0xC0


def variant(data, **changes):
    return decode(ua.Variant, Reader(data, Budget(**{**TIGHT, **changes})))


def ints(*numbers):
    return struct.pack(f"<{len(numbers)}i", *numbers)


async def at_once():
    """Let nobody go first."""


def without_waiting(coroutine):
    with pytest.raises(StopIteration) as ended:
        coroutine.send(None)
    return ended.value.value


@pytest.mark.parametrize("kind", requests(), ids=lambda kind: kind.__name__)
@settings(max_examples=15)
@given(data=st.data())
def test_a_request_is_decoded_to_what_asyncua_decodes(kind, data):
    encoded = ua_binary.struct_to_binary(data.draw(structures(kind)))
    theirs = ua_binary.struct_from_binary(kind, Buffer(encoded))
    reader = Reader(encoded, AMPLE)
    ours = decode(kind, reader)
    assert repr(ours) == repr(theirs)
    assert reader.left == 0


@settings(max_examples=300)
@given(variants())
def test_a_variant_is_decoded_to_what_asyncua_decodes(value):
    encoded = ua_binary.variant_to_binary(value)
    assert repr(decode(ua.Variant, Reader(encoded, AMPLE))) == repr(
        ua_binary.variant_from_binary(Buffer(encoded))
    )


@pytest.mark.parametrize(
    "kind",
    [ua.ReadParameters, ua.BrowseNextParameters, ua.PublishParameters, ua.CreateSessionParameters],
)
@given(data=st.data())
def test_slowly_gives_the_same(kind, data):
    encoded = ua_binary.struct_to_binary(data.draw(structures(kind)))
    slowly = without_waiting(decode_slowly(kind, Reader(encoded, AMPLE), at_once))
    assert repr(slowly) == repr(decode(kind, Reader(encoded, AMPLE)))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (
            ua.Variant([[[], [], []], [[], [], []]], ua.VariantType.UInt32),
            [[[], [], []], [[], [], []]],
        ),
        (ua.Variant([1, 2, 3, 4, 5, 6], Dimensions=[2, 3]), [[1, 2, 3], [4, 5, 6]]),
        (ua.Variant([[], []], ua.VariantType.Double), [[], []]),
        (ua.Variant([], ua.VariantType.Double, [0, 3], is_array=True), []),
        (ua.Variant([1.0, 2.0], ua.VariantType.Double, [2], is_array=True), [1.0, 2.0]),
    ],
)
def test_a_matrix_has_its_shape(value, expected):
    found = variant(ua_binary.variant_to_binary(value))
    assert (found.Value, found.Dimensions) == (expected, value.Dimensions)
    assert found.is_array


def test_picoseconds_stand_behind_their_timestamps():
    source, server = 116_444_736_000_000_000, 116_444_736_010_000_000
    data = struct.pack("<BBdqHqH", 0x3D, 11, 1.5, source, 7, server, 8)
    found = decode(ua.DataValue, Reader(data, AMPLE))
    assert (found.SourcePicoseconds, found.ServerPicoseconds) == (7, 8)
    assert found.SourceTimestamp == datetime(1970, 1, 1, tzinfo=UTC)
    assert found.ServerTimestamp == datetime(1970, 1, 1, 0, 0, 1, tzinfo=UTC)


def test_an_inner_diagnostic_info_is_one():
    data = bytes((0x4C,)) + ints(4, 5) + bytes((0x01,)) + ints(6)
    found = decode(ua.DiagnosticInfo, Reader(data, AMPLE))
    assert (found.Locale, found.LocalizedText) == (4, 5)
    assert found.InnerDiagnosticInfo == ua.DiagnosticInfo(SymbolicId=6)


def test_a_null_string_names_no_node():
    data = bytes((3,)) + struct.pack("<Hi", 0, -1)
    assert decode(ua.NodeId, Reader(data, AMPLE)).is_null()


def test_a_guid_is_read_in_its_order():
    data = bytes.fromhex("0100000002000300") + bytes(range(4, 12))
    found = decode(ua.Guid, Reader(data, AMPLE))
    assert found == UUID("00000001-0002-0003-0405-060708090a0b")


@pytest.mark.parametrize(
    "data",
    [
        bytes((ua.VariantType.Variant, ua.VariantType.Null)),
        bytes((ua.VariantType.Int32 | 0x40,)) + ints(1),
        bytes((ua.VariantType.Null | IS_ARRAY,)) + ints(1) + bytes(8),
        bytes((40,)) + ints(0),
        bytes((ua.VariantType.ExtensionObject, 0, 1, 2)) + ints(0),
        bytes((ua.VariantType.ExtensionObject, 1, 0)) + struct.pack("<HB", 886, 0),
        bytes((ua.VariantType.Double | IS_MATRIX,)) + ints(-1, 2, 2, 2),
        b"",
    ],
    ids=["variant", "matrix", "nulls", "type", "xml", "no body", "null matrix", "nothing"],
)
def test_what_part_6_does_not_know_is_refused(data):
    with pytest.raises(Malformed):
        variant(data)


def test_an_extension_object_ends_where_it_says():
    ranged = bytes((1, 0)) + struct.pack("<HBi2d", 886, 1, 15, 1.0, 2.0)
    with pytest.raises(Malformed):
        variant(bytes((ua.VariantType.ExtensionObject,)) + ranged)
    longer = bytes((1, 0)) + struct.pack("<HBi2dH", 886, 1, 18, 1.0, 2.0, 7)
    array = bytes((ua.VariantType.ExtensionObject | IS_ARRAY,)) + ints(2) + longer + longer
    assert variant(array).Value == [ua.Range(1.0, 2.0)] * 2


@given(st.binary(max_size=200))
def test_any_bytes_are_a_variant_or_one_of_two_errors(data):
    with contextlib.suppress(Malformed, TooMuch):
        variant(data)


@pytest.mark.parametrize("kind", range(32))
def test_a_huge_declared_length_costs_nothing(kind):
    data = bytes((kind | IS_ARRAY,)) + ints(2**31 - 1) + bytes(64)
    tracemalloc.start()
    began = time.perf_counter()
    with pytest.raises((Malformed, TooMuch)):
        variant(data)
    assert time.perf_counter() - began < 0.1
    assert tracemalloc.get_traced_memory()[1] < 100_000
    tracemalloc.stop()


@pytest.mark.parametrize("dimensions", [(2**20, 2**10, 0), (2**31 - 1, 0), (20_000, 0)])
def test_rows_without_elements_cost_nothing(dimensions):
    data = bytes((ua.VariantType.Double | IS_MATRIX,)) + ints(0, len(dimensions), *dimensions)
    with pytest.raises(TooMuch):
        variant(data)


@pytest.mark.parametrize("length", [-2, -(2**31)])
def test_a_negative_length_is_refused(length):
    for kind in (
        ua.VariantType.Double | IS_ARRAY,
        ua.VariantType.LocalizedText | IS_ARRAY,
        ua.VariantType.Null | IS_ARRAY,
        ua.VariantType.String,
        ua.VariantType.ByteString,
    ):
        with pytest.raises(Malformed):
            variant(bytes((kind,)) + ints(length) + bytes(64))


def nested_variants(depth):
    data = bytes((ua.VariantType.Double,)) + struct.pack("<d", 1.0)
    for _ in range(depth):
        data = bytes((ua.VariantType.Variant | IS_ARRAY,)) + ints(1) + data
    return data


def nested_data_values(depth):
    return bytes((ua.VariantType.DataValue, 0x01)) * depth + b"\0"


def nested_diagnostics(depth):
    return bytes((ua.VariantType.DiagnosticInfo,)) + b"\x40" * depth + b"\0"


def nested_extensions(depth):
    data = b"\0"
    for _ in range(depth):  # LiteralOperand
        body = bytes((ua.VariantType.ExtensionObject,)) + data
        data = bytes((1, 0)) + struct.pack("<HBi", 597, 1, len(body)) + body
    return bytes((ua.VariantType.ExtensionObject,)) + (data if depth else b"\0\0\0")


@pytest.mark.parametrize(
    "nested", [nested_variants, nested_data_values, nested_diagnostics, nested_extensions]
)
def test_nesting_ends(nested):
    with contextlib.suppress(Malformed):
        variant(nested(10))
    with pytest.raises(TooMuch):
        variant(nested(1_000))


def test_elements_are_counted_over_all_arrays_of_a_message():
    one = bytes((ua.VariantType.String | IS_ARRAY,)) + ints(600) + ints(-1) * 600
    assert len(variant(one).Value) == 600
    with pytest.raises(TooMuch):
        variant(bytes((ua.VariantType.Variant | IS_ARRAY,)) + ints(2) + one + one)


def test_dimensions_must_fit_the_array():
    array = bytes((ua.VariantType.Int32 | IS_MATRIX,)) + ints(6, *range(6))
    assert variant(array + ints(2, 2, 3)).Value == [[0, 1, 2], [3, 4, 5]]
    for dimensions in ([2, 2], [-2, -3], [2**20, 2**20], [3, 3], [1] * 9 + [6]):
        with pytest.raises(Malformed):
            variant(array + ints(len(dimensions), *dimensions))


def test_long_strings_and_arrays_are_refused():
    with pytest.raises(TooMuch):
        variant(bytes((ua.VariantType.String,)) + ints(5_000) + b"x" * 5_000)
    with pytest.raises(TooMuch):
        variant(bytes((ua.VariantType.Double | IS_ARRAY,)) + ints(20_000) + bytes(160_000))


def test_combinations_of_flags_are_not_kept():
    kind = ua.AttributeWriteMask
    before = len(kind._value2member_map_)
    for number in (0, 1, 3, 5, 2**21 + 1, 2**31):
        found = decode(kind, Reader(struct.pack("<I", number), AMPLE))
        assert found == number
        assert isinstance(found, kind)
    assert len(kind._value2member_map_) == before


def broken(seed):
    """Return the type and the bytes of a request, broken."""
    dice = random.Random(seed)
    make = dice.choice(corpus(ua.NodeId("U", 2)))
    request = make(ua.NodeId(bytes(32), 0, ua.NodeIdType.ByteString))
    return type(request), mutated(bytearray(ua_binary.struct_to_binary(request)), dice)


def decoded(kind, data):
    with contextlib.suppress(Malformed, TooMuch):
        decode(kind, Reader(data, Budget(5_000, 100_000, 65_536, 16)))


def test_broken_requests_raise_two_errors_and_end_soon():
    slowest = 0.0
    for seed in range(5_000):
        kind, data = broken(seed)
        began = time.thread_time()
        decoded(kind, data)
        slowest = max(slowest, time.thread_time() - began)
    assert slowest < 0.1


def test_broken_requests_cost_no_more_memory_than_their_bytes_justify():
    tracemalloc.start()
    for seed in range(5_000, 5_300):
        kind, data = broken(seed)
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        decoded(kind, data)
        assert tracemalloc.get_traced_memory()[1] - before < 100_000 + 100 * len(data), seed
    tracemalloc.stop()


@pytest.mark.soak
def test_many_broken_requests_raise_two_errors():
    for seed in range(10_000, 300_000):
        decoded(*broken(seed))


def large(kind, **fields):
    request = kind()
    request.RequestHeader.AuthenticationToken = ua.NodeId(bytes(32), 0, ua.NodeIdType.ByteString)
    for name, value in fields.items():
        setattr(request.Parameters, name, value)
    return request


VALUE = ua.ReadValueId(ua.NodeId("valve.17.U", 2), ua.AttributeIds.Value)
FILTER = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, 1, 0.5)
ITEM = ua.MonitoredItemCreateRequest(
    VALUE, ua.MonitoringMode.Reporting, ua.MonitoringParameters(1, 0.0, FILTER, 10)
)
ACKNOWLEDGED = [ua.SubscriptionAcknowledgement(1, 2)]


@pytest.mark.parametrize(
    ("request_", "times"),
    [
        (large(ua.ReadRequest, NodesToRead=[VALUE] * 1_000), 1),
        (large(ua.CreateMonitoredItemsRequest, ItemsToCreate=[ITEM] * 1_000), 1),
        (large(ua.PublishRequest, SubscriptionAcknowledgements=ACKNOWLEDGED), 300),
    ],
    ids=["read", "create", "publish"],
)
def test_it_is_faster_than_asyncua(request_, times):
    data, kind = ua_binary.struct_to_binary(request_), type(request_)

    def seconds(decode_):
        began = time.thread_time()
        for _ in range(times):
            decode_()
        return time.thread_time() - began

    ratios = [
        seconds(lambda: decode(kind, Reader(data, AMPLE)))
        / seconds(lambda: ua_binary.struct_from_binary(kind, Buffer(data)))
        for _ in range(7)
    ]
    assert statistics.median(ratios) < 0.8
