"""Walk through OPC UA binary data (Part 6, 5.2): bounded, strict, without building objects.

Lengths are checked against the bytes available, nesting against :data:`MAX_DEPTH`.
"""

import struct
from dataclasses import dataclass

MAX_DEPTH = 16
"""Limit on the nesting of Variants, DataValues and DiagnosticInfos."""

MAX_ELEMENTS = 50_000
"""Limit on the elements of a message walked one by one (2 to 5 µs each); numbers are not."""

_U2 = struct.Struct("<H")
_U4 = struct.Struct("<I")
_I4 = struct.Struct("<i")
_I8 = struct.Struct("<q")

NUMERIC_FORMATS = {
    1: struct.Struct("<?"),
    2: struct.Struct("<b"),
    3: struct.Struct("<B"),
    4: struct.Struct("<h"),
    5: struct.Struct("<H"),
    6: struct.Struct("<i"),
    7: struct.Struct("<I"),
    8: struct.Struct("<q"),
    9: struct.Struct("<Q"),
    10: struct.Struct("<f"),
    11: struct.Struct("<d"),
}
"""Built-in types that are numbers: Boolean, SByte … UInt64, Float, Double."""

EXTENSION_OBJECT = 22
"""The built-in type of structures."""

FIXED_SIZES = {kind: form.size for kind, form in NUMERIC_FORMATS.items()} | {
    0: 0,  # Null
    13: 8,  # DateTime
    14: 16,  # Guid
    19: 4,  # StatusCode
}
"""Built-in types of a fixed size, in bytes."""

_IS_ARRAY = 0x80
_HAS_DIMENSIONS = 0x40
_KIND = 0x3F


class DecodeError(ValueError):
    """The bytes are not a valid OPC UA binary message."""


@dataclass
class _Walked:
    """The number of elements of a message walked one by one, and the limit on it."""

    elements: int = 0
    most: int = MAX_ELEMENTS


class Reader:
    """A position in a buffer; every read checks the remaining size.

    Examples
    --------
    >>> reader = Reader(bytes([1, 0, 0, 0, 0xFF]))
    >>> reader.u4(), reader.u1(), reader.at_end
    (1, 255, True)
    """

    def __init__(self, data: bytes, most: int = MAX_ELEMENTS) -> None:
        self.data = data
        self.position = 0
        self.stop = len(data)
        self._walked = _Walked(most=most)

    def part(self, start: int, stop: int) -> "Reader":
        """Return a reader of the bytes from ``start`` to ``stop``; it shares the element count."""
        part = Reader(self.data)
        part.position, part.stop, part._walked = start, stop, self._walked
        return part

    @property
    def at_end(self) -> bool:
        """Whether all bytes are read."""
        return self.position == self.stop

    def skip(self, size: int) -> int:
        """Advance by ``size`` bytes and return the previous position."""
        before = self.position
        if size < 0 or size > self.stop - before:
            raise DecodeError(
                f"{size} bytes wanted at byte {before}, {self.stop - before} are left"
            )
        self.position = before + size
        return before

    def u1(self) -> int:
        """Read a Byte."""
        return self.data[self.skip(1)]

    def u2(self) -> int:
        """Read a UInt16."""
        return int(_U2.unpack_from(self.data, self.skip(2))[0])

    def u4(self) -> int:
        """Read a UInt32."""
        return int(_U4.unpack_from(self.data, self.skip(4))[0])

    def i4(self) -> int:
        """Read an Int32."""
        return int(_I4.unpack_from(self.data, self.skip(4))[0])

    def i8(self) -> int:
        """Read an Int64."""
        return int(_I8.unpack_from(self.data, self.skip(8))[0])

    def count(self, smallest: int) -> int:
        """Read the length of an array whose elements take at least ``smallest`` bytes."""
        count = self.i4()
        if count * smallest > self.stop - self.position:
            raise DecodeError(f"an array of {count} elements exceeds the rest of the message")
        return max(count, 0)

    def spend(self, elements: int) -> None:
        """Count elements that are walked one by one."""
        self._walked.elements += elements
        if self._walked.elements > self._walked.most:
            raise DecodeError(f"more than {self._walked.most} elements that are no numbers")

    def one_by_one(self, smallest: int) -> range:
        """Read the length of an array, like :meth:`count`, whose elements are walked."""
        count = self.count(smallest)
        self.spend(count)
        return range(count)

    def u4_array(self) -> tuple[int, ...]:
        """Read UInt32[]."""
        count = self.count(4)
        return struct.unpack_from(f"<{count}I", self.data, self.skip(4 * count))

    def skip_string(self) -> None:
        """Skip a String, ByteString or XmlElement."""
        self.skip(max(self.i4(), 0))

    def skip_diagnostic_info(self, depth: int = 0) -> None:
        """Skip a DiagnosticInfo."""
        _check_depth(depth)
        mask = self.u1()
        for bit in (0x01, 0x02, 0x04, 0x08):
            if mask & bit:
                self.skip(4)
        if mask & 0x10:
            self.skip_string()
        if mask & 0x20:
            self.skip(4)
        if mask & 0x40:
            self.skip_diagnostic_info(depth + 1)

    def node_id(self) -> int | None:
        """Read a NodeId or ExpandedNodeId; return its number in namespace 0, else None."""
        encoding = self.u1()
        number, namespace = None, 0
        match encoding & 0x3F:
            case 0:
                number = self.u1()
            case 1:
                namespace, number = self.u1(), self.u2()
            case 2:
                namespace, number = self.u2(), self.u4()
            case 3 | 5:
                self.skip(2)
                self.skip_string()
            case 4:
                self.skip(18)
            case _:
                raise DecodeError(f"NodeId encoding {encoding:#x} is unknown")
        if encoding & 0x80:
            self.skip_string()
        if encoding & 0x40:
            self.skip(4)
        return number if namespace == 0 and encoding < 0x40 else None

    def extension_object(self) -> tuple[int | None, "Reader"]:
        """Read an ExtensionObject; return its type and a reader of its body, and skip the body."""
        kind = self.node_id()
        encoding = self.u1()
        if encoding == 0:
            return kind, self.part(self.position, self.position)
        if encoding not in {1, 2}:
            raise DecodeError(f"ExtensionObject encoding {encoding} is unknown")
        size = max(self.i4(), 0)
        start = self.skip(size)
        return (kind if encoding == 1 else None), self.part(start, start + size)

    def skip_variant(self, depth: int = 0) -> None:
        """Skip a Variant of any type."""
        encoding = self.u1()
        self.skip_variant_body(encoding, depth)

    def skip_variant_body(self, encoding: int, depth: int = 0) -> None:
        """Skip a Variant after its encoding byte."""
        _check_depth(depth)
        kind = encoding & _KIND
        if not encoding & _IS_ARRAY:
            self.skip_element(kind, depth)
            return
        size = FIXED_SIZES.get(kind)
        if size is None:
            for _ in self.one_by_one(1):
                self.skip_element(kind, depth)
        else:
            self.skip(size * self.count(size))
        if encoding & _HAS_DIMENSIONS:
            self.skip(4 * self.count(4))

    def skip_element(self, kind: int, depth: int = 0) -> None:  # noqa: C901 - one arm per type
        """Skip one value of a built-in type."""
        match kind:
            case 17 | 18:
                self.node_id()
            case 20:
                self.skip(2)
                self.skip_string()
            case 21:
                mask = self.u1()
                for bit in (0x01, 0x02):
                    if mask & bit:
                        self.skip_string()
            case 22:
                self.extension_object()
            case 23:
                self.skip_data_value(depth + 1)
            case 24:
                self.skip_variant(depth + 1)
            case 25:
                self.skip_diagnostic_info(depth + 1)
            case _ if kind in FIXED_SIZES:
                self.skip(FIXED_SIZES[kind])
            case _:  # String, ByteString, XmlElement, and 26-31, encoded as ByteString
                self.skip_string()

    def skip_data_value(self, depth: int = 0) -> None:
        """Skip a DataValue."""
        _check_depth(depth)
        mask = self.u1()
        if mask & 0x01:
            self.skip_variant(depth + 1)
        for bit, size in ((0x02, 4), (0x04, 8), (0x10, 2), (0x08, 8), (0x20, 2)):
            if mask & bit:
                self.skip(size)


def _check_depth(depth: int) -> None:
    if depth > MAX_DEPTH:
        raise DecodeError(f"values are nested deeper than {MAX_DEPTH}")
