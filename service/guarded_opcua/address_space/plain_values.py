"""Values and arguments from peers, checked against their declarations."""

import math

from asyncua import ua

from guarded_opcua.address_space.declarations import Argument, Value, Variable

_FLOATS = {ua.VariantType.Double, ua.VariantType.Float}
_INTEGERS = {
    ua.VariantType.SByte: (-(2**7), 2**7 - 1),
    ua.VariantType.Byte: (0, 2**8 - 1),
    ua.VariantType.Int16: (-(2**15), 2**15 - 1),
    ua.VariantType.UInt16: (0, 2**16 - 1),
    ua.VariantType.Int32: (-(2**31), 2**31 - 1),
    ua.VariantType.UInt32: (0, 2**32 - 1),
    ua.VariantType.Int64: (-(2**63), 2**63 - 1),
    ua.VariantType.UInt64: (0, 2**64 - 1),
}


def check(expected: Argument | Variable, given: ua.Variant) -> int:
    """Check type, shape, finiteness and range of a peer's value; return a status code."""
    if given.VariantType != expected.type or bool(given.is_array) != expected.array:
        return ua.StatusCodes.BadTypeMismatch
    values = ua.flatten(given.Value) if expected.array else [given.Value]
    if values is None or (expected.type != ua.VariantType.String and None in values):
        return ua.StatusCodes.BadTypeMismatch
    if expected.or_nan:
        values = [value for value in values if not math.isnan(value)]
    if expected.type in _FLOATS and not all(math.isfinite(value) for value in values):
        return ua.StatusCodes.BadOutOfRange
    if expected.value_range is not None:
        low, high = expected.value_range
        if not all(low <= value <= high for value in values):
            return ua.StatusCodes.BadOutOfRange
    return ua.StatusCodes.Good


def plain(given: ua.Variant) -> Value:
    """Return the Python value of a variant."""
    return "" if given.Value is None and given.VariantType == ua.VariantType.String else given.Value


def as_variant(kind: ua.VariantType, value: Value, *, array: bool = False) -> ua.Variant:
    """Return a Variant of a Python or numpy value."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if array:
        return ua.Variant(list(value), kind, is_array=True)
    if kind in _INTEGERS:
        value = int(value)
    return ua.Variant(value, kind)
