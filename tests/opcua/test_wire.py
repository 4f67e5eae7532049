import struct

import pytest
from asyncua import ua
from asyncua.ua import ua_binary

from valvemap.opcua_source.wire import MAX_DEPTH, DecodeError, Reader

VARIANTS = [
    ua.Variant(None, ua.VariantType.Null),
    ua.Variant(Value=True, VariantType=ua.VariantType.Boolean),
    ua.Variant(-3, ua.VariantType.SByte),
    ua.Variant(3, ua.VariantType.Byte),
    ua.Variant(-3000, ua.VariantType.Int16),
    ua.Variant(3000, ua.VariantType.UInt16),
    ua.Variant(-(2**31), ua.VariantType.Int32),
    ua.Variant(2**32 - 1, ua.VariantType.UInt32),
    ua.Variant(-(2**63), ua.VariantType.Int64),
    ua.Variant(2**64 - 1, ua.VariantType.UInt64),
    ua.Variant(0.5, ua.VariantType.Float),
    ua.Variant(0.1, ua.VariantType.Double),
    ua.Variant("flow", ua.VariantType.String),
    ua.Variant(None, ua.VariantType.String),
    ua.Variant(b"\x00\x01", ua.VariantType.ByteString),
    ua.Variant(ua.StatusCode(0x80000000), ua.VariantType.StatusCode),
    ua.Variant(ua.QualifiedName("Q", 2), ua.VariantType.QualifiedName),
    ua.Variant(ua.LocalizedText("Durchfluss", "de"), ua.VariantType.LocalizedText),
    ua.Variant(ua.NodeId(7), ua.VariantType.NodeId),
    ua.Variant(ua.NodeId(7000, 1), ua.VariantType.NodeId),
    ua.Variant(ua.NodeId(70_000, 3), ua.VariantType.NodeId),
    ua.Variant(ua.NodeId("V1.Q", 2), ua.VariantType.NodeId),
    ua.Variant(ua.NodeId(b"\x01\x02", 2, ua.NodeIdType.ByteString), ua.VariantType.NodeId),
    ua.Variant(ua.ExpandedNodeId("x", 2, ua.NodeIdType.String, "urn:a", 3)),
    ua.Variant(ua.Range(0, 1), ua.VariantType.ExtensionObject),
    ua.Variant(ua.DataValue(ua.Variant(1.0)), ua.VariantType.DataValue),
    ua.Variant(ua.DiagnosticInfo(SymbolicId=1), ua.VariantType.DiagnosticInfo),
    ua.Variant([1.0, 2.0], ua.VariantType.Double),
    ua.Variant([], ua.VariantType.Double, is_array=True),
    ua.Variant([True, False], ua.VariantType.Boolean),
    ua.Variant(["a", None, "c"], ua.VariantType.String),
    ua.Variant([[1, 2, 3], [4, 5, 6]], ua.VariantType.Int32),
    ua.Variant([ua.Variant(1.0), ua.Variant("x")], ua.VariantType.Variant),
    ua.Variant([ua.LocalizedText("a")], ua.VariantType.LocalizedText),
]


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_every_variant_is_passed_over_to_its_last_byte(variant):
    data = ua_binary.variant_to_binary(variant)
    reader = Reader(data + b"\xaa")
    reader.skip_variant()
    assert reader.u1() == 0xAA


@pytest.mark.parametrize("variant", VARIANTS[1:], ids=str)
def test_a_variant_cut_short_is_noticed_wherever_it_was_cut(variant):
    data = ua_binary.variant_to_binary(variant)
    for length in range(len(data)):
        with pytest.raises(DecodeError):
            Reader(data[:length]).skip_variant()


def test_an_xml_element_travels_like_a_string():
    reader = Reader(b"\x10\x04\x00\x00\x00<a/>\xaa")
    reader.skip_variant()
    assert reader.u1() == 0xAA


def test_a_length_is_believed_only_as_far_as_there_are_bytes():
    for kind in (0x80 | 11, 0x80 | 12, 0x80 | 24, 12):
        with pytest.raises(DecodeError):
            Reader(bytes([kind]) + struct.pack("<i", 2**31 - 1)).skip_variant()


def test_an_array_of_a_billion_nulls_costs_nothing():
    reader = Reader(bytes([0x80]) + struct.pack("<i", 10**9))
    reader.skip_variant()
    assert reader.at_end


def test_nesting_ends_somewhere():
    deep = b"\x98\x01\x00\x00\x00" * (MAX_DEPTH + 2) + b"\x01\x01"
    with pytest.raises(DecodeError, match="nested deeper"):
        Reader(deep).skip_variant()
    with pytest.raises(DecodeError, match="nested deeper"):
        Reader(b"\x40" * 1000).skip_diagnostic_info()


def test_unknown_encodings_are_refused():
    with pytest.raises(DecodeError, match="NodeId"):
        Reader(b"\x07\x00\x00").node_id()
    with pytest.raises(DecodeError, match="ExtensionObject"):
        Reader(b"\x00\x01\x09").extension_object()


def test_only_numbers_of_namespace_0_name_a_message():
    assert Reader(ua_binary.nodeid_to_binary(ua.NodeId(829))).node_id() == 829
    assert Reader(ua_binary.nodeid_to_binary(ua.NodeId(829, 1))).node_id() is None
    assert Reader(ua_binary.nodeid_to_binary(ua.NodeId("829"))).node_id() is None
