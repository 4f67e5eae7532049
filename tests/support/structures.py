"""Random values of asyncua's types, for properties that hold for whatever a peer may send."""

import functools
import typing
from dataclasses import fields, is_dataclass
from enum import Enum
from types import NoneType, UnionType

from asyncua import ua
from asyncua.ua import ua_binary
from hypothesis import strategies as st

_INTEGERS = {
    "SByte": (-(2**7), 2**7 - 1),
    "Byte": (0, 2**8 - 1),
    "Int16": (-(2**15), 2**15 - 1),
    "UInt16": (0, 2**16 - 1),
    "Int32": (-(2**31), 2**31 - 1),
    "UInt32": (0, 2**32 - 1),
    "Int64": (-(2**63), 2**63 - 1),
    "UInt64": (0, 2**64 - 1),
}
_texts = st.none() | st.text(max_size=8)
_bytes = st.none() | st.binary(max_size=8)
_indices = st.integers(0, 2**16 - 1)
_codes = st.builds(ua.StatusCode, st.integers(0, 2**32 - 1))
_node_ids = st.one_of(
    st.builds(ua.NodeId, st.integers(0, 2**8 - 1)),
    st.builds(ua.NodeId, st.integers(0, 2**16 - 1), st.integers(0, 2**8 - 1)),
    st.builds(ua.NodeId, st.integers(0, 2**32 - 1), _indices),
    st.builds(ua.NodeId, st.text(max_size=8) | st.binary(max_size=8) | st.uuids(), _indices),
)
_expanded = st.builds(
    lambda node, uri, server: ua.ExpandedNodeId(
        node.Identifier, node.NamespaceIndex, node.NodeIdType, uri, server
    ),
    _node_ids,
    st.text(min_size=1, max_size=8),
    st.integers(1, 2**32 - 1),
)
_simple = {
    **{name: st.integers(*limits) for name, limits in _INTEGERS.items()},
    "Boolean": st.booleans(),
    "Float": st.floats(width=32),
    "Double": st.floats(),
    "String": _texts,
    "CharArray": _texts,
    "ByteString": _bytes,
    "DateTime": st.integers(1, 2 * 10**18).map(ua.win_epoch_to_datetime),
    "Guid": st.uuids(),
    "NodeId": _node_ids,
    "ExpandedNodeId": _node_ids | _expanded,
    "StatusCode": _codes,
    "QualifiedName": st.builds(ua.QualifiedName, _texts, st.integers(0, 2**15 - 1)),
    "LocalizedText": st.builds(ua.LocalizedText, _texts, _texts),
    "DiagnosticInfo": st.builds(
        ua.DiagnosticInfo,
        SymbolicId=st.none() | st.integers(0, 9),
        NamespaceURI=st.none() | st.integers(0, 9),
        AdditionalInfo=_texts,
        InnerStatusCode=st.none() | _codes,
    ),
}
_VARIANT = ua.VariantType.Variant
_OF_VARIANTS = sorted(set(_simple) - {"CharArray"})
_DEEPEST = 4
_EXTENSIONS = (
    ua.AnonymousIdentityToken,
    ua.UserNameIdentityToken,
    ua.X509IdentityToken,
    ua.DataChangeFilter,
    ua.EventFilter,
    ua.AggregateFilter,
    ua.LiteralOperand,
    ua.ElementOperand,
    ua.SimpleAttributeOperand,
    ua.ReadRawModifiedDetails,
    ua.ReadProcessedDetails,
    ua.ReadEventDetails,
    ua.UpdateDataDetails,
    ua.Range,
    ua.EUInformation,
    ua.Argument,
)


def requests():
    """List the types of all requests."""
    return [
        kind
        for name, kind in sorted(vars(ua).items())
        if name.endswith("Request") and is_dataclass(kind) and hasattr(kind(), "RequestHeader")
    ]


@st.composite
def structures(draw, kind, depth=0):
    """Draw a structure."""
    hints = _hints(kind)
    return kind(**{name: _value(draw, hint, depth) for name, hint in hints.items()})


@st.composite
def variants(draw, depth=0):
    """Draw a variant: one value, an array, a matrix."""
    if depth < _DEEPEST and draw(st.booleans()):
        return ua.Variant(draw(st.lists(variants(depth + 1), max_size=2)), _VARIANT, is_array=True)
    name = draw(st.sampled_from(_OF_VARIANTS))
    kind, value = ua.VariantType[name], _simple[name]
    match draw(st.sampled_from(("one", "array", "matrix"))):
        case "one":
            return ua.Variant(draw(value), kind)
        case "array":
            return ua.Variant(draw(st.lists(value, max_size=3)), kind, is_array=True)
    rows, columns = draw(st.integers(1, 3)), draw(st.integers(0, 3))
    row = st.lists(value, min_size=columns, max_size=columns)
    return ua.Variant(draw(st.lists(row, min_size=rows, max_size=rows)), kind)


@st.composite
def extension_objects(draw, depth=0):
    """Draw an extension object: none, an unknown one, a known one."""
    kinds = _EXTENSIONS if depth < _DEEPEST else ()
    kind = draw(st.sampled_from((None, ua.ExtensionObject, *kinds)))
    if kind is None:
        return ua.ExtensionObject()
    if kind is ua.ExtensionObject:
        return ua.ExtensionObject(ua.NodeId("x", 7), draw(st.binary(max_size=9)))
    return draw(structures(kind, depth + 1))


@st.composite
def data_values(draw, depth=0):
    """Draw a data value, without picoseconds: asyncua has them elsewhere."""
    time = st.none() | _simple["DateTime"]
    return ua.DataValue(draw(variants(depth + 1)), draw(_codes), draw(time), draw(time))


def _value(draw, hint, depth):
    origin = typing.get_origin(hint)
    if origin in {UnionType, typing.Union}:
        inner = next(part for part in typing.get_args(hint) if part is not NoneType)
        return _value(draw, inner, depth) if draw(st.booleans()) else None
    if origin is list:
        element = typing.get_args(hint)[0]
        return [_value(draw, element, depth) for _ in range(draw(st.integers(0, 2)))]
    return draw(_strategy(hint, depth))


def _strategy(hint, depth):
    if not isinstance(hint, type):  # a structure or one derived from it
        return extension_objects(depth + 1)
    if hint.__name__ in _simple:
        return _simple[hint.__name__]
    if issubclass(hint, Enum):
        return st.sampled_from(list(hint))
    compound = {
        ua.ExtensionObject: extension_objects,
        ua.Variant: variants,
        ua.DataValue: data_values,
    }.get(hint)
    return structures(hint, depth + 1) if compound is None else compound(depth + 1)


@functools.cache
def _hints(kind):
    hints = ua_binary.get_safe_type_hints(kind, {"ua": ua})
    names = [field.name for field in fields(kind) if field.init]
    return {name: hints[name] for name in names if name not in {"TypeId", "Encoding"}}
