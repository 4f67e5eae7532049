"""Decoders of the built-in types without structures (Part 6, 5.2.2)."""

import struct
from datetime import datetime
from typing import Any
from uuid import UUID

from asyncua import ua

from guarded_opcua.binary.bounded_reader import Decoder, Reader

_KIND, _HAS_URI, _HAS_SERVER = 0x3F, 0x80, 0x40  # of a NodeId's first byte
_GUID_BYTES = 16
_TICKS = struct.Struct("<q").unpack_from

NUMBERS = {
    "Boolean": "?",
    "SByte": "b",
    "Byte": "B",
    "Char": "B",
    "Int16": "h",
    "UInt16": "H",
    "Int32": "i",
    "UInt32": "I",
    "Int64": "q",
    "UInt64": "Q",
    "Float": "f",
    "Double": "d",
}
""":mod:`struct` formats by type name."""


def number(form: str) -> Decoder:
    """Return the decoder of a number, by its ``struct`` format."""
    layout = struct.Struct(f"<{form}")
    unpack, size = layout.unpack_from, layout.size

    def read(reader: Reader) -> Any:  # noqa: ANN401 - bool, int or float
        at = reader.at
        reader.at = at + size
        return unpack(reader.data, at)[0]

    return read


def numbers(form: str) -> Decoder:
    """Return the decoder of an array of numbers."""
    size = struct.calcsize(f"<{form}")

    def read(reader: Reader) -> list[Any] | None:
        length = reader.length(size)
        if length == -1:
            return None
        at = reader.at
        reader.at = at + size * length
        return list(struct.unpack_from(f"<{length}{form}", reader.data, at))

    return read


def string(reader: Reader) -> str | None:
    """Read a String; invalid UTF-8 is kept by surrogate escapes, as in asyncua."""
    content = reader.byte_string()
    return None if content is None else content.decode("utf-8", "surrogateescape")


def date_time(reader: Reader) -> datetime:
    """Read a DateTime."""
    at = reader.at
    reader.at = at + 8
    return ua.win_epoch_to_datetime(_TICKS(reader.data, at)[0])


def guid(reader: Reader) -> UUID:
    """Read a Guid."""
    at = reader.at
    reader.at = stop = at + _GUID_BYTES
    return UUID(bytes_le=reader.data[at:stop])


def qualified_name(reader: Reader) -> ua.QualifiedName:
    """Read a QualifiedName."""
    index = uint16(reader)
    return ua.QualifiedName(string(reader), index)


def localized_text(reader: Reader) -> ua.LocalizedText:
    """Read a LocalizedText."""
    mask = byte(reader)
    locale = string(reader) if mask & 0x01 else None
    return ua.LocalizedText(string(reader) if mask & 0x02 else None, locale)


def diagnostic_info(reader: Reader) -> ua.DiagnosticInfo:
    """Read a DiagnosticInfo."""
    mask, info = byte(reader), ua.DiagnosticInfo()
    for bit, name in ((1, "SymbolicId"), (2, "NamespaceURI"), (8, "Locale"), (4, "LocalizedText")):
        if mask & bit:
            setattr(info, name, int32(reader))
    info.AdditionalInfo = string(reader) if mask & 0x10 else None
    info.InnerStatusCode = ua.StatusCode(uint32(reader)) if mask & 0x20 else None
    if mask & 0x40:
        reader.nest()
        info.InnerDiagnosticInfo = diagnostic_info(reader)
        reader.unnest()
    return info


def node_id(reader: Reader) -> ua.NodeId:
    """Read a NodeId or an ExpandedNodeId."""
    encoding = byte(reader)
    kind, layout, identifier_of = _NODE_IDS[encoding & _KIND]
    namespace = layout(reader) if layout is not None else 0
    identifier = identifier_of(reader)
    if encoding & (_HAS_URI | _HAS_SERVER):
        uri = string(reader) if encoding & _HAS_URI else None
        server = uint32(reader) if encoding & _HAS_SERVER else None
        if uri is not None or server is not None:
            return ua.ExpandedNodeId(identifier, namespace, kind, uri, server)
    node: ua.NodeId = object.__new__(ua.NodeId)  # skips the checks of the constructor
    node.Identifier, node.NamespaceIndex, node.NodeIdType = identifier, namespace, kind
    return node


byte, uint16, uint32, int32 = number("B"), number("H"), number("I"), number("i")
_NODE_IDS: tuple[tuple[ua.NodeIdType, Decoder | None, Decoder], ...] = (
    (ua.NodeIdType.TwoByte, None, byte),
    (ua.NodeIdType.FourByte, byte, uint16),
    (ua.NodeIdType.Numeric, uint16, uint32),
    (ua.NodeIdType.String, uint16, lambda reader: string(reader) or ""),
    (ua.NodeIdType.Guid, uint16, guid),
    (ua.NodeIdType.ByteString, uint16, lambda reader: reader.byte_string() or b""),
)
