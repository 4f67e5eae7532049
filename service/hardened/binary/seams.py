"""The one place where asyncua's decoder is patched: nothing is allocated before it is believed.

asyncua 2.1.0 takes the lengths in a packet at their word and nests without end. The functions
below replace the four builders that all its decoding goes through. They change nothing for a
packet that keeps within :class:`Budget`, and outside of :func:`decoding` only impossible lengths
are refused, so that clients in the same process decode what they always did.

``tests/hardened/test_seams.py`` fails if asyncua changes what is patched here.
"""

import contextlib
import functools
import typing
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary

_Codes = ua.StatusCodes
_UNBOUNDED = 2**62
Decoder = Callable[[Any], Any]


@dataclass
class Budget:
    """What one message may still cost.

    Attributes
    ----------
    elements
        Elements of arrays that are decoded one by one.
    array_length, string_bytes
        Longest array of numbers, longest string.
    nesting
        Deepest nesting of variants and extension objects.
    """

    elements: int = _UNBOUNDED
    array_length: int = _UNBOUNDED
    string_bytes: int = _UNBOUNDED
    nesting: int = 100


_unlimited = Budget()
_budget = _unlimited


class TooMuch(ua.uaerrors.UaStatusCodeError):
    """A packet asks for more than it may cost."""

    def __init__(self) -> None:
        super().__init__(_Codes.BadEncodingLimitsExceeded)


class Malformed(ua.uaerrors.UaStatusCodeError):
    """A packet cannot be what it says it is."""

    def __init__(self) -> None:
        super().__init__(_Codes.BadDecodingError)


@contextlib.contextmanager
def decoding(budget: Budget) -> Iterator[None]:
    """Decode one message within a budget (decoding is synchronous, so one is enough)."""
    global _budget  # noqa: PLW0603 - the decoder's functions have no other way to know
    _budget = budget
    try:
        yield
    finally:
        _budget = _unlimited


def decode(kind: type, body: Buffer, budget: Budget) -> Any:  # noqa: ANN401 - of that kind
    """Decode a structure within a budget; whatever goes wrong is a status code.

    Raises
    ------
    UaStatusCodeError
        BadDecodingError or BadEncodingLimitsExceeded.
    """
    with decoding(budget):
        try:
            return ua_binary.struct_from_binary(kind, body)
        except (TooMuch, Malformed):
            raise
        except Exception as error:  # a wrong packet makes the decoder raise anything
            raise Malformed from error


async def decode_slowly(
    kind: type, body: Buffer, budget: Budget, breathe: Callable[[], Awaitable[None]]
) -> Any:  # noqa: ANN401 - of that kind
    """Decode a structure that ends with an array, letting others go first between its elements.

    Raises
    ------
    UaStatusCodeError
        BadDecodingError or BadEncodingLimitsExceeded.
    """
    head, last = _split(kind)
    if last is None:
        return decode(kind, body, budget)
    name, element = last
    try:
        with decoding(budget):
            values = {field: read(body) for field, read in head}
            length = max(_length(body, 1, budget.array_length), 0)
            _spend(length)
        elements = []
        for _ in range(length):
            with decoding(budget):
                elements.append(element(body))
            await breathe()
        return kind(**values, **{name: elements})
    except (TooMuch, Malformed):
        raise
    except Exception as error:  # a wrong packet makes the decoder raise anything
        raise Malformed from error


@functools.cache
def _split(kind: type) -> tuple[list[tuple[str, Decoder]], tuple[str, Decoder] | None]:
    """Decoders of all fields but the last, and of the elements of the last one if it is a list."""
    hints = ua_binary.get_safe_type_hints(kind, {"ua": ua})
    *head, last = [(field.name, hints[field.name]) for field in fields(kind)]
    if not (typing.get_origin(last[1]) is list and is_dataclass(typing.get_args(last[1])[0])):
        return [], None
    read = ua_binary._create_type_deserializer  # noqa: SLF001
    decoders = [(name, read(hint, kind)) for name, hint in head]
    return decoders, (last[0], read(typing.get_args(last[1])[0], type(None)))


@contextlib.contextmanager
def _deeper() -> Iterator[None]:
    budget = _budget
    if budget.nesting <= 0:
        raise TooMuch
    budget.nesting -= 1
    try:
        yield
    finally:
        budget.nesting += 1


def _length(data: Buffer, least: int, most: int) -> int:
    """Read an array's length and check it against the bytes that are there."""
    length = int(ua_binary.Primitives.Int32.unpack(data))
    if length < -1 or length * least > len(data):
        raise Malformed
    if length > most:
        raise TooMuch
    return length


def _spend(elements: int) -> None:
    budget = _budget
    if elements > budget.elements:
        raise TooMuch
    budget.elements -= elements


@functools.cache
def _uatype_array_deserializer(vtype: ua.VariantType) -> Decoder:
    primitive = getattr(ua_binary.Primitives1, vtype.name, None)
    if primitive is not None:

        def numbers(data: Buffer) -> list[Any] | None:
            length = _length(data, primitive.size, _budget.array_length)
            return None if length == -1 else list(primitive.unpack_array(data, length))

        return numbers
    if vtype == ua.VariantType.Null:

        def nothing(data: Buffer) -> list[Any] | None:
            length = _length(data, 1, 0)
            return None if length == -1 else []

        return nothing
    element = ua_binary._create_uatype_deserializer(vtype)  # noqa: SLF001

    def elements(data: Buffer) -> list[Any] | None:
        length = _length(data, 1, _budget.array_length)
        if length == -1:
            return None
        _spend(length)
        return [element(data) for _ in range(length)]

    return elements


@functools.cache
def _list_deserializer(uatype: Any) -> Decoder:  # noqa: ANN401 - any type of asyncua's
    element: Decoder | None = None

    def elements(data: Buffer) -> list[Any]:
        nonlocal element
        length = max(_length(data, 1, _budget.array_length), 0)
        _spend(length)
        if element is None:
            element = ua_binary._create_type_deserializer(uatype, type(None))  # noqa: SLF001
        return [element(data) for _ in range(length)]

    return elements


def _variant_from_binary(data: Buffer) -> ua.Variant:
    with _deeper():
        encoding = ord(data.read(1))
        kind = ua.datatype_to_varianttype(encoding & 0x3F)
        is_array, is_matrix = bool(encoding & 0x80), bool(encoding & 0x40)
        if is_matrix and not is_array:
            raise Malformed
        if not is_array:
            return ua.Variant(ua_binary.unpack_uatype(kind, data), kind, is_array=False)
        values = ua_binary.unpack_uatype_array(kind, data)
        if not is_matrix:
            return ua.Variant(values, kind, is_array=True)
        dimensions = ua_binary.unpack_uatype_array(ua.VariantType.Int32, data) or []
        return ua.Variant(_shaped(values, dimensions), kind, dimensions, is_array=True)


def _shaped(values: list[Any] | None, dimensions: list[int]) -> list[Any] | None:
    if values is None:
        return None
    if not dimensions:
        return values
    if len(dimensions) > 8 or any(length < 0 for length in dimensions):
        raise Malformed
    size = 1
    for length in dimensions:
        size *= length
    if size != len(values):
        raise Malformed  # Part 6, 5.2.2.16
    for length in reversed(dimensions[1:]):
        values = [values[at : at + length] for at in range(0, len(values), max(length, 1))]
    return values


def _extension_object_from_binary(data: Buffer) -> Any:  # noqa: ANN401 - any structure
    with _deeper():
        return _ORIGINAL_EXTENSION_OBJECT(data)


class _Bytes(ua_binary._Bytes):  # noqa: SLF001
    @staticmethod
    def unpack(data: Buffer) -> bytes | None:
        length = _length(data, 1, _budget.string_bytes)
        return None if length == -1 else data.read(length)


class _String(ua_binary._String):  # noqa: SLF001
    @staticmethod
    def unpack(data: Buffer) -> str | None:
        content = _Bytes.unpack(data)
        return (
            None
            if content is None
            else content.decode(ua_binary.get_string_encoding(), errors="surrogateescape")
        )


_ORIGINAL_EXTENSION_OBJECT: Decoder = ua_binary.extensionobject_from_binary


def install() -> None:
    """Patch asyncua's decoder; calling it again changes nothing."""
    if ua_binary.variant_from_binary is _variant_from_binary:
        return
    primitives = ua_binary.Primitives
    primitives.String = primitives.CharArray = _String()
    primitives.Bytes = primitives.ByteString = _Bytes()
    ua_binary.variant_from_binary = _variant_from_binary
    ua_binary.extensionobject_from_binary = _extension_object_from_binary
    ua_binary._create_uatype_array_deserializer = _uatype_array_deserializer  # noqa: SLF001
    ua_binary._create_list_deserializer = _list_deserializer  # noqa: SLF001
    for cache in (
        ua_binary._create_uatype_deserializer,  # noqa: SLF001
        ua_binary._create_type_deserializer,  # noqa: SLF001
        ua_binary._create_dataclass_deserializer,  # noqa: SLF001
    ):
        cache.cache_clear()
