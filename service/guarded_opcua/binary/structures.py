"""Decoders of structures, created once per type from asyncua's annotations (Part 6, 5.2.5-5.2.8).

Optional fields have the order of the bits of the mask before them, as in asyncua.
"""

import functools
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum, IntFlag
from types import NoneType, UnionType
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.ua import ua_binary

from guarded_opcua.binary.bounded_reader import Decoder, Reader
from guarded_opcua.binary.built_in_types import NUMBERS, number, numbers

_MASK = "Encoding"  # asyncua's name of the mask of optional fields


class Length:
    """Marker type: the length of an array whose elements are decoded one by one."""


class Decoders:
    """Creates and caches the decoders.

    Parameters
    ----------
    built_in
        Decoders of the built-in types, by name.
    of_derived
        Decoder of a structure or a subtype of it.
    """

    def __init__(self, built_in: Mapping[str, Decoder], of_derived: Decoder) -> None:
        self._built_in = built_in
        self._of_derived = of_derived
        self._made: dict[Any, Decoder] = {Length: _length}

    def of(self, hint: Any) -> Decoder:  # noqa: ANN401 - a type annotation
        """Return the decoder of a type annotation."""
        found = self._made.get(hint)
        if found is None:
            self._made[hint] = self.deeper(hint)  # until it is created, as types may be recursive
            found = self._made[hint] = self._make(hint)
        return found

    def deeper(self, hint: Any) -> Decoder:  # noqa: ANN401 - a type annotation
        """Return a decoder that adds one level of nesting."""

        def read(reader: Reader) -> Any:  # noqa: ANN401 - of that type
            reader.nest()
            value = self.of(hint)(reader)
            reader.unnest()
            return value

        return read

    def array_of(self, hint: Any) -> Decoder:  # noqa: ANN401 - a type annotation
        """Return the decoder of an array."""
        name = getattr(hint, "__name__", "")
        if name in NUMBERS:
            return numbers(NUMBERS[name])
        # asyncua decodes a null array to None for built-in types, else to []
        return array(self.of(hint), may_be_null=hasattr(ua.VariantType, name))

    def _make(self, hint: Any) -> Decoder:  # noqa: ANN401 - a type annotation
        if typing.get_origin(hint) is list:
            return self.array_of(typing.get_args(hint)[0])
        if not isinstance(hint, type):
            return self._of_derived
        known = self._built_in.get(hint.__name__)
        if known is not None:
            return known
        if issubclass(hint, Enum):
            return _flags(hint) if issubclass(hint, IntFlag) else _enumeration(hint)
        if issubclass(hint, ua.UaUnion):
            return self._union(hint)
        return self._structure(hint)

    def _structure(self, kind: type) -> Decoder:
        known = [(field, self.of(field.hint)) for field in _fields(kind)]
        if kind.__dataclass_params__.init and all(field.is_plain for field, _ in known):  # type: ignore[attr-defined]
            readers = [read for _, read in known]
            return lambda reader: kind(*[read(reader) for read in readers])

        def read_what_is_there(reader: Reader) -> Any:  # noqa: ANN401 - of that kind
            values, mask = {}, 0
            for field, read in known:
                if field.name == _MASK:
                    mask = read(reader)
                elif not field.bit or mask & field.bit:
                    values[field.name] = read(reader)
            return kind(**values)

        return read_what_is_there

    def _union(self, kind: type) -> Decoder:
        choose = self.of(next(field.hint for field in _fields(kind) if field.name == _MASK))
        choices = [self.of(choice) for choice in kind._union_types]  # type: ignore[attr-defined]  # noqa: SLF001

        def read(reader: Reader) -> Any:  # noqa: ANN401 - of that kind
            union = kind()
            union.Encoding = chosen = choose(reader)
            union.Value = choices[chosen - 1](reader) if 0 < chosen <= len(choices) else None
            return union

        return read


class _Field(NamedTuple):
    name: str
    hint: Any
    bit: int  # mask bit; 0: not optional
    is_plain: bool  # not optional, and a positional parameter of the constructor


@functools.cache
def array_at_end(kind: type) -> tuple[dict[str, Any], str, type] | None:
    """Return the annotations of all fields except the last, and the last's name and element type.

    None if the structure does not end with an array of structures.
    """
    *head, last = _fields(kind)
    element = typing.get_args(last.hint)[0] if typing.get_origin(last.hint) is list else None
    if not isinstance(element, type) or not is_dataclass(element):
        return None
    if not all(field.is_plain for field in (*head, last)):
        return None
    return {field.name: field.hint for field in head}, last.name, element


def array(element: Decoder, *, may_be_null: bool) -> Decoder:
    """Return the decoder of an array, from that of its elements."""

    def read(reader: Reader) -> list[Any] | None:
        length = _length(reader)
        if length == -1:
            return None if may_be_null else []
        return [element(reader) for _ in range(length)]

    return read


def _length(reader: Reader) -> int:
    length = reader.length(1)
    reader.spend(max(length, 0))
    return length


def _fields(kind: type) -> list[_Field]:
    hints = ua_binary.get_safe_type_hints(kind, {"ua": ua})
    found, bit = [], 1
    for field in fields(kind):
        hint = hints[field.name]
        is_union = typing.get_origin(hint) in {UnionType, typing.Union}
        if is_union and NoneType in typing.get_args(hint):
            found.append(_Field(field.name, typing.get_args(hint)[0], bit, is_plain=False))
            bit <<= 1
        else:
            is_plain = field.init and not field.kw_only and field.name != _MASK
            found.append(_Field(field.name, hint, 0, is_plain))
    return found


def _enumeration(kind: type[Enum]) -> Decoder:
    value = number(NUMBERS["Int32"])
    return lambda reader: kind(value(reader))


def _flags(kind: type[IntFlag]) -> Decoder:
    width = kind.datatype() if hasattr(kind, "datatype") else "UInt32"
    value, members = (
        number(NUMBERS[width]),
        {int(member): member for member in kind.__members__.values()},
    )

    def read(reader: Reader) -> IntFlag:
        found = value(reader)
        if found in members:
            return members[found]
        flags = int.__new__(kind, found)  # the class would cache each combination
        flags._name_, flags._value_ = None, found
        return flags

    return read
