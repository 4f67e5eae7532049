"""What is patched in asyncua, and that nothing is allocated before it is believed."""

import contextlib
import inspect
import struct
import subprocess
import sys
import time
import tracemalloc
from importlib.metadata import version

import pytest
from asyncua import ua
from asyncua.common.connection import SecureConnection
from asyncua.common.utils import Buffer
from asyncua.server.address_space import AddressSpace, AttributeValue
from asyncua.ua import ua_binary
from hypothesis import given
from hypothesis import strategies as st

from service.hardened.binary import seams

seams.install()

PATCHED = """
from asyncua.ua import ua_binary as b
import hashlib, inspect
for name in (
    "_create_uatype_array_deserializer",
    "_create_list_deserializer",
    "variant_from_binary",
    "extensionobject_from_binary",
    "_create_uatype_deserializer",
    "_create_type_deserializer",
    "_create_dataclass_deserializer",
    "_Bytes",
    "_String",
):
    source = inspect.getsource(inspect.unwrap(getattr(b, name)))
    print(name, hashlib.sha256(source.encode()).hexdigest()[:16])
"""
KNOWN = {
    "_create_uatype_array_deserializer": "6f780984bfe171bb",
    "_create_list_deserializer": "ea68c12936f3ddf5",
    "variant_from_binary": "6f5e95888458c5e3",
    "extensionobject_from_binary": "1fd0586b9b477539",
    "_create_uatype_deserializer": "9ac44f054325393b",
    "_create_type_deserializer": "8fc1cd567154b33e",
    "_create_dataclass_deserializer": "df2090ec842f79de",
    "_Bytes": "b770e1acbb1735d0",
    "_String": "0a20da7b3db59bcd",
}


def limits(**changes):
    return seams.Budget(
        **{
            "elements": 1_000,
            "array_length": 10_000,
            "string_bytes": 4_096,
            "nesting": 16,
            **changes,
        }
    )


def variant(data, **changes):
    with seams.decoding(limits(**changes)):
        return ua_binary.variant_from_binary(Buffer(data))


def test_asyncua_is_the_version_whose_seams_were_read():
    assert version("asyncua") == "2.1.0", "read the changes of asyncua, then raise this"


def test_what_is_patched_is_what_was_read():
    found = subprocess.run(
        [sys.executable, "-c", PATCHED], capture_output=True, text=True, check=True
    ).stdout.split()
    assert dict(zip(found[::2], found[1::2], strict=True)) == KNOWN


def test_the_private_things_that_are_used_are_there():
    channel = SecureConnection.__init__.__code__.co_names
    assert {"_policies", "_limits", "security_policy"} <= set(channel)
    assert list(inspect.signature(SecureConnection.select_policy).parameters) == [
        "self",
        "uri",
        "peer_certificate",
        "mode",
    ]
    assert list(inspect.signature(SecureConnection.open).parameters) == ["self", "params", "server"]
    assert AddressSpace()._nodes == {}
    assert AttributeValue(ua.DataValue()).datachange_callbacks == {}


def test_every_decoder_goes_through_the_patch():
    array = ua_binary._create_type_deserializer(list[ua.NodeId], type(None))
    assert array.__module__ == seams.__name__
    structures = ua_binary._create_type_deserializer(list[ua.ReadValueId], type(None))
    assert structures.__module__ == seams.__name__
    assert ua_binary._create_uatype_deserializer(ua.VariantType.Variant) is (
        ua_binary.variant_from_binary
    )


@given(st.binary(max_size=200))
def test_any_bytes_are_a_variant_or_an_error_and_cost_little(data):
    with contextlib.suppress(ua.UaError, ValueError, TypeError, struct.error, OverflowError):
        variant(data)


@pytest.mark.parametrize("kind", list(ua.VariantType))
def test_a_huge_declared_length_costs_nothing(kind):
    data = bytes((kind | 0x80,)) + struct.pack("<i", 2**31 - 1) + bytes(64)
    tracemalloc.start()
    began = time.perf_counter()
    with pytest.raises(ua.UaStatusCodeError):
        variant(data)
    assert time.perf_counter() - began < 0.1
    assert tracemalloc.get_traced_memory()[1] < 100_000
    tracemalloc.stop()


@pytest.mark.parametrize("length", [-2, -(2**31)])
def test_a_negative_length_is_refused(length):
    for data in (
        bytes((ua.VariantType.Double | 0x80,)) + struct.pack("<i", length) + bytes(64),
        bytes((ua.VariantType.String,)) + struct.pack("<i", length) + bytes(64),
        bytes((ua.VariantType.ByteString,)) + struct.pack("<i", length) + bytes(64),
    ):
        with pytest.raises(seams.Malformed):
            variant(data)


def test_nesting_ends():
    def nested(depth):
        data = bytes((ua.VariantType.Double,)) + struct.pack("<d", 1.0)
        for _ in range(depth):
            data = bytes((ua.VariantType.Variant | 0x80,)) + struct.pack("<i", 1) + data
        return data

    assert variant(nested(10)).is_array
    with pytest.raises(seams.TooMuch):
        variant(nested(1_000))


def test_elements_are_counted_over_all_arrays_of_a_message():
    strings = struct.pack("<i", 600) + struct.pack("<i", -1) * 600
    one = bytes((ua.VariantType.String | 0x80,)) + strings
    assert len(variant(one).Value) == 600
    two = bytes((ua.VariantType.Variant | 0x80,)) + struct.pack("<i", 2) + one + one
    with pytest.raises(seams.TooMuch):
        variant(two)


def test_dimensions_must_fit_the_array():
    array = bytes((ua.VariantType.Int32 | 0xC0,)) + struct.pack("<i6i", 6, *range(6))
    assert variant(array + struct.pack("<iii", 2, 2, 3)).Value == [[0, 1, 2], [3, 4, 5]]
    for dimensions in ([2, 2], [-2, -3], [2**20, 2**20], [3, 3]):
        with pytest.raises(seams.Malformed):
            variant(array + struct.pack(f"<i{len(dimensions)}i", len(dimensions), *dimensions))


def test_long_strings_and_arrays_are_refused():
    text = b"x" * 5_000
    with pytest.raises(seams.TooMuch):
        variant(bytes((ua.VariantType.String,)) + struct.pack("<i", len(text)) + text)
    doubles = bytes((ua.VariantType.Double | 0x80,)) + struct.pack("<i", 20_000) + bytes(160_000)
    with pytest.raises(seams.TooMuch):
        variant(doubles)


def test_outside_of_a_message_of_a_peer_nothing_is_limited():
    data = bytes((ua.VariantType.Double | 0x80,)) + struct.pack("<i", 20_000) + bytes(160_000)
    assert len(ua_binary.variant_from_binary(Buffer(data)).Value) == 20_000


VALUES = st.one_of(
    st.lists(st.floats(allow_nan=False), max_size=5).map(
        lambda v: ua.Variant(v, ua.VariantType.Double, is_array=True)
    ),
    st.lists(st.text(max_size=5), max_size=5).map(
        lambda v: ua.Variant(v, ua.VariantType.String, is_array=True)
    ),
    st.text(max_size=10).map(ua.Variant),
    st.just(ua.Variant([[1, 2], [3, 4]], ua.VariantType.Int32)),
    st.just(ua.Variant(ua.Range(1.0, 2.0), ua.VariantType.ExtensionObject)),
    st.just(ua.Variant(ua.NodeId("V.U", 2))),
)


@given(VALUES)
def test_what_keeps_within_the_limits_is_decoded_as_before(value):
    assert variant(ua_binary.variant_to_binary(value)) == value


def test_what_cannot_be_decoded_is_a_status_code():
    with pytest.raises(seams.Malformed):
        seams.decode(ua.ReadParameters, Buffer(b"\x00" * 7), limits())
