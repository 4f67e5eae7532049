"""Decoder of messages from peers within a budget; it creates asyncua's objects.

It differs from asyncua's decoder where that reads beyond its input or deviates from Part 6:

* lengths are limited by the available bytes, nesting and elements by the budget; combinations of
  flags are not cached;
* the number of a matrix's elements must match its dimensions (5.2.2.16); a Variant contains another
  Variant only in an array; types 26-31 are ByteStrings, higher ones are refused;
* the index of a QualifiedName is unsigned (5.2.2.13), picoseconds follow their timestamp
  (5.2.2.17), an inner DiagnosticInfo is not an ExtensionObject (5.2.2.12), an ExtensionObject in
  XML is refused;
* a NodeId with a null string equals one with an empty string (Part 3, 8.2.4).
"""

from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from asyncua import ua

from guarded_opcua.binary.bounded_reader import Budget, Decoder, Malformed, Reader, TooMuch
from guarded_opcua.binary.built_in_types import (
    NUMBERS,
    byte,
    date_time,
    diagnostic_info,
    guid,
    localized_text,
    node_id,
    number,
    numbers,
    qualified_name,
    string,
    uint16,
    uint32,
)
from guarded_opcua.binary.structures import Decoders, Length, array, array_at_end

__all__ = ["Budget", "Malformed", "Reader", "TooMuch", "decode", "decode_slowly"]

_MOST_DIMENSIONS = 8  # bounds the recursion when a value is printed or copied
_IS_ARRAY, _HAS_DIMENSIONS, _KIND = 0x80, 0x40, 0x3F  # of a Variant's first byte
_NO_BODY, _BINARY_BODY = 0, 1  # of an ExtensionObject
_RESERVED = range(26, 32)  # Variant types that are ByteStrings


def decode(kind: type, reader: Reader) -> Any:  # noqa: ANN401 - of that kind
    r"""Decode a value of one of asyncua's types; every failure raises a status code.

    Raises
    ------
    UaStatusCodeError
        Malformed (BadDecodingError) or TooMuch (BadEncodingLimitsExceeded).

    Examples
    --------
    >>> decode(ua.QualifiedName, Reader(b"\2\0\1\0\0\0U", Budget(10, 10, 10, 4)))
    QualifiedName(NamespaceIndex=2, Name='U')
    """
    try:
        return _decoders.of(kind)(reader)
    except (TooMuch, Malformed):
        raise
    except Exception as error:  # asyncua's constructors raise any exception on invalid input
        raise Malformed from error


async def decode_slowly(kind: type, reader: Reader, breathe: Callable[[], Awaitable[None]]) -> Any:  # noqa: ANN401 - of that kind
    """Decode a structure that ends with an array; await ``breathe`` after each element.

    Raises
    ------
    UaStatusCodeError
        Malformed (BadDecodingError) or TooMuch (BadEncodingLimitsExceeded).
    """
    split = array_at_end(kind)
    if split is None:
        return decode(kind, reader)
    head, last, element = split
    values = {name: decode(hint, reader) for name, hint in head.items()}
    elements = []
    for _ in range(decode(Length, reader)):
        elements.append(decode(element, reader))
        await breathe()
    return kind(**values, **{last: elements})


def _data_value(reader: Reader) -> ua.DataValue:
    mask = byte(reader)
    return ua.DataValue(
        _variant(reader) if mask & 0x01 else ua.Variant(),
        ua.StatusCode(uint32(reader)) if mask & 0x02 else ua.StatusCode(),
        date_time(reader) if mask & 0x04 else None,
        SourcePicoseconds=uint16(reader) if mask & 0x10 else None,
        ServerTimestamp=date_time(reader) if mask & 0x08 else None,
        ServerPicoseconds=uint16(reader) if mask & 0x20 else None,
    )


def _variant(reader: Reader) -> ua.Variant:
    encoding = byte(reader)
    kind, read, read_array = _VARIANTS[encoding & _KIND]
    variant: ua.Variant = object.__new__(ua.Variant)  # its constructor would guess the type
    variant.VariantType, variant.Dimensions = kind, None
    if encoding & _IS_ARRAY:
        variant.is_array = True
        variant.Value = read_array(reader)
        if encoding & _HAS_DIMENSIONS:
            variant.Dimensions = _dimensions(reader) or None
            variant.Value = _shaped(reader, variant.Value, variant.Dimensions or ())
        return variant
    if encoding & _HAS_DIMENSIONS:
        raise Malformed
    variant.is_array = False
    variant.Value = read(reader)
    return variant


def _shaped(
    reader: Reader, values: list[Any] | None, dimensions: Sequence[int]
) -> list[Any] | None:
    """Reshape an array to nested lists."""
    if not dimensions:
        return values
    if len(dimensions) > _MOST_DIMENSIONS or min(dimensions) < 0:
        raise Malformed
    rows, size = [], 1  # per level, from the outermost
    for length in dimensions:
        size *= length
        rows.append(size)
    if size != len(values or ()):
        raise Malformed
    if values is None:
        return None
    reader.spend_rows(sum(rows[:-1]))
    cut: list[Any] = values
    for length, count in zip(dimensions[:0:-1], rows[-2::-1], strict=True):
        cut = [cut[row * length : (row + 1) * length] for row in range(count)]
    return cut


def _extension_object(reader: Reader) -> Any:  # noqa: ANN401 - any structure
    reader.nest()
    type_id, encoding = node_id(reader), byte(reader)
    kind = ua.extension_objects_by_typeid.get(type_id)
    if encoding == _BINARY_BODY:
        outer = reader.enter()
        if not type_id.Identifier:
            value = ua.ExtensionObject()
        elif kind is None:
            value = ua.ExtensionObject(type_id, reader.data[reader.at : reader.end])
        else:
            value = _decoders.of(kind)(reader)
        reader.leave(outer)
    elif encoding == _NO_BODY and kind is None:
        value = ua.ExtensionObject(type_id) if type_id.Identifier else ua.ExtensionObject()
    else:
        raise Malformed
    reader.unnest()
    return value


def _nothing(_: Reader) -> None:
    return None


def _no_elements(reader: Reader) -> list[Any] | None:
    """Read an array of Nulls; only an empty one is accepted, since Nulls take no bytes."""
    length = reader.length(1)
    if length > 0:
        raise Malformed
    return None if length == -1 else []


def _refused(_: Reader) -> None:
    raise Malformed


_dimensions = numbers(NUMBERS["Int32"])
_decoders = Decoders(
    {name: number(form) for name, form in NUMBERS.items()}
    | {
        "String": string,
        "CharArray": string,
        "Bytes": Reader.byte_string,
        "ByteString": Reader.byte_string,
        "DateTime": date_time,
        "Guid": guid,
        "NodeId": node_id,
        "ExpandedNodeId": node_id,
        "QualifiedName": qualified_name,
        "LocalizedText": localized_text,
        "ExtensionObject": _extension_object,
        "DataValue": _data_value,
        "Variant": _variant,
        "DiagnosticInfo": diagnostic_info,
    },
    of_derived=_extension_object,
)


def _of_variants(kind: int) -> tuple[Any, Decoder, Decoder]:
    """Return a Variant's type, and the decoders of one value and of an array of them."""
    if kind in _RESERVED:
        return ua.VariantTypeCustom(kind), Reader.byte_string, _decoders.array_of(ua.ByteString)
    if kind >= _RESERVED.stop:
        return None, _refused, _refused
    type_ = ua.VariantType(kind)
    if type_ == ua.VariantType.Null:
        return type_, _nothing, _no_elements
    python = getattr(ua, type_.name)
    if type_ in {ua.VariantType.Variant, ua.VariantType.DataValue}:
        deeper = _decoders.deeper(python)
        one = _refused if type_ == ua.VariantType.Variant else deeper
        return type_, one, array(deeper, may_be_null=True)
    return type_, _decoders.of(python), _decoders.array_of(python)


_VARIANTS = [_of_variants(kind) for kind in range(_KIND + 1)]
