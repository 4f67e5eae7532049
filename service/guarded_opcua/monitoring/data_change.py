"""DataChangeFilters: triggers and deadbands (Part 4, 7.22.2; Part 8, 6.2)."""

import math
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.ua import uaprotocol_auto

from guarded_opcua.binary.encoding import ticks

DataChangeFilter = uaprotocol_auto.DataChangeFilter  # the class that the decoder creates
_NUMBERS = {
    ua.VariantType.SByte,
    ua.VariantType.Byte,
    ua.VariantType.Int16,
    ua.VariantType.UInt16,
    ua.VariantType.Int32,
    ua.VariantType.UInt32,
    ua.VariantType.Int64,
    ua.VariantType.UInt64,
    ua.VariantType.Float,
    ua.VariantType.Double,
}


@dataclass(frozen=True)
class ChangeRule:
    """Rule for reporting a change; ``deadband`` is absolute, 0 = none."""

    trigger: ua.DataChangeTrigger = ua.DataChangeTrigger.StatusValue
    deadband: float = 0.0

    def is_change(self, reported: ua.DataValue | None, value: ua.DataValue) -> bool:
        """Return whether a value differs from the last reported one."""
        if reported is None or _code(reported) != _code(value):
            return True
        if self.trigger == ua.DataChangeTrigger.Status:
            return False
        if self.trigger == ua.DataChangeTrigger.StatusValueTimestamp and _source(
            reported
        ) != _source(value):
            return True
        old, new = reported.Value, value.Value
        if old.VariantType != new.VariantType or old.is_array != new.is_array:
            return True
        if self.deadband > 0.0:
            return _exceeds(old.Value, new.Value, self.deadband)
        return not _same(old.Value, new.Value)


class FilterRefused(Exception):  # noqa: N818 - it is an answer
    """A filter was refused, with the status code ``code``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def change_rule(wanted: object, kind: ua.VariantType | None, span: float | None) -> ChangeRule:
    """Return the change rule of a monitored item's filter.

    Parameters
    ----------
    wanted
        The peer's filter, or None.
    kind
        Type of the node's value, None if it is not a value.
    span
        Length of the node's EURange, None if it has none.

    Raises
    ------
    FilterRefused
    """
    codes = ua.StatusCodes
    if wanted is None or (isinstance(wanted, ua.ExtensionObject) and wanted.Body is None):
        return ChangeRule()
    if not isinstance(wanted, DataChangeFilter):
        unknown = isinstance(wanted, ua.EventFilter)
        raise FilterRefused(
            codes.BadFilterNotAllowed if unknown else codes.BadMonitoredItemFilterUnsupported
        )
    if wanted.DeadbandType == ua.DeadbandType.None_:
        return ChangeRule(wanted.Trigger)
    if kind is None or kind not in _NUMBERS:
        raise FilterRefused(codes.BadFilterNotAllowed)
    size = wanted.DeadbandValue
    if wanted.DeadbandType == ua.DeadbandType.Absolute:
        if not (math.isfinite(size) and size >= 0.0):
            raise FilterRefused(codes.BadDeadbandFilterInvalid)
        return ChangeRule(wanted.Trigger, size)
    if wanted.DeadbandType == ua.DeadbandType.Percent:
        if span is None:
            raise FilterRefused(codes.BadMonitoredItemFilterUnsupported)
        if not 0.0 <= size <= 100.0:
            raise FilterRefused(codes.BadDeadbandFilterInvalid)
        return ChangeRule(wanted.Trigger, size / 100.0 * span)
    raise FilterRefused(codes.BadDeadbandFilterInvalid)


def _code(value: ua.DataValue) -> int:
    return value.StatusCode.value if value.StatusCode is not None else 0


def _source(value: ua.DataValue) -> int | None:
    return None if value.SourceTimestamp is None else ticks(value.SourceTimestamp)


def _same(old: Any, new: Any) -> bool:  # noqa: ANN401 - any value of OPC UA
    if old == new:
        return True
    if isinstance(old, float) and isinstance(new, float):
        return math.isnan(old) and math.isnan(new)
    if isinstance(old, list | tuple) and isinstance(new, list | tuple):
        return len(old) == len(new) and all(map(_same, old, new))
    return False


def _exceeds(old: Any, new: Any, deadband: float) -> bool:  # noqa: ANN401
    if isinstance(old, list | tuple):
        if len(old) != len(new):
            return True
        return any(_exceeds(a, b, deadband) for a, b in zip(old, new, strict=True))
    if old is None or new is None:
        return old is not new
    difference = abs(new - old)
    if math.isnan(difference):
        return not _same(old, new)
    return bool(difference > deadband)
