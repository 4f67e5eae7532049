"""Values as Sparkplug metrics: data type, quality, timestamp. Pure."""

import math
from dataclasses import dataclass
from datetime import datetime
from enum import IntEnum
from typing import Any, Final

from valvemap.clock import utc_ns
from valvemap.sparkplug.schema import DataType, Payload
from valvemap.vocabulary.commands import Action

GOOD: Final = 0
BAD_NO_COMMUNICATION: Final = 0x8031_0000
OVERFLOW: Final = 0x480  # StatusCode bits: the service dropped values before this one
_OLDEST_MS: Final = 0  # ms; DateTime is unsigned, but OPC UA's minimum is negative


class Quality(IntEnum):
    """Values of the property Quality (chapter 6.4.16)."""

    BAD = 0
    GOOD = 192
    STALE = 500


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a birth says of a metric beside its value; empty or None where not given."""

    unit: str = ""
    range: tuple[float, float] | None = None
    description: str = ""


@dataclass(frozen=True, slots=True)
class Tag:
    """A metric: its device (None: the edge node), name, data type and alias.

    ``id`` is the identifier of the variable behind it; ``action`` the command that a client gives
    by writing the metric, if the configuration allows it.
    """

    id: str
    device: str | None
    name: str
    kind: DataType
    alias: int
    meaning: Meaning = Meaning()
    action: Action | None = None


@dataclass(frozen=True, slots=True)
class Value:
    """Value of a variable, its StatusCode and source time (UTC ns)."""

    value: Any
    code: int
    t: int


def quality_of(code: int) -> Quality:
    """Map a StatusCode: Good to GOOD, Uncertain to STALE, Bad to BAD.

    >>> quality_of(0), quality_of(0x40000000), quality_of(0x80000000)
    (<Quality.GOOD: 192>, <Quality.STALE: 500>, <Quality.BAD: 0>)
    """
    return (Quality.GOOD, Quality.STALE, Quality.BAD, Quality.BAD)[code >> 30]


def alike(a: Value, b: Value) -> bool:
    """Whether two values are equal apart from their time."""
    same = a.value == b.value or (a.value != a.value and b.value != b.value)
    return bool(same) and a.code == b.code


def add_birth(container: Any, tag: Tag, value: Value) -> None:  # noqa: ANN401 - a Payload
    """Add a metric to a BIRTH: name, alias, data type, current value, unit, range, description.

    The properties have the names that Ignition takes over into its tags.
    """
    metric = _add(container, tag, value)
    metric.name = tag.name
    _add_unit(metric.properties, tag.meaning)
    _add_range(metric.properties, tag.meaning)
    _add_description(metric.properties, tag.meaning)


def add_member(container: Any, tag: Tag, value: Value) -> None:  # noqa: ANN401 - a template
    """Add a member to a template's instance in a BIRTH; the definition describes it."""
    metric = _add(container, tag, value)
    metric.name = tag.name
    _add_unit(metric.properties, tag.meaning)
    _add_range(metric.properties, tag.meaning)


def add_declaration(container: Any, tag: Tag, t: int) -> None:  # noqa: ANN401 - a template
    """Add a member to a template's definition: name, data type, unit, description; no value."""
    metric = container.metrics.add(name=tag.name, datatype=tag.kind, timestamp=_ms(t), is_null=True)
    _add_unit(metric.properties, tag.meaning)
    _add_description(metric.properties, tag.meaning)


def add_template(payload: Any, t: int, **identity: Any) -> Any:  # noqa: ANN401
    """Add a metric that is a template, of this name or alias; return the template to fill."""
    metric = payload.metrics.add(datatype=DataType.TEMPLATE, timestamp=_ms(t), **identity)
    return metric.template_value


def add_data(container: Any, tag: Tag, value: Value, *, historical: bool) -> None:  # noqa: ANN401
    """Add a metric to a DATA message or to an instance in it: its alias and new value."""
    metric = _add(container, tag, value)
    if historical:
        metric.is_historical = True


def add_plain(payload: Any, name: str, kind: DataType, value: object, t: int) -> None:  # noqa: ANN401
    """Add a metric that the specification defines; it has no alias."""
    metric = payload.metrics.add(name=name, datatype=kind, timestamp=_ms(t))
    _set(metric, kind, value)


def flag_in(data: bytes, name: str) -> bool:
    """Whether a command sets the Boolean metric of this name to true.

    Raises
    ------
    DecodeError
        if ``data`` is not a payload.
    """
    payload = Payload.FromString(data)
    return any(one.name == name and one.boolean_value for one in payload.metrics)


def _add(container: Any, tag: Tag, value: Value) -> Any:  # noqa: ANN401
    # The data type is optional in DATA, but Cirrus Link's library needs it to decode the value
    metric = container.metrics.add(alias=tag.alias, timestamp=_ms(value.t), datatype=tag.kind)
    quality = quality_of(value.code)
    if quality is Quality.BAD or not _set(metric, tag.kind, value.value):
        metric.is_null = True
    properties = metric.properties
    _add_property(properties, "Quality", DataType.INT32, quality)
    if value.code != GOOD:
        _add_property(properties, "StatusCode", DataType.UINT32, value.code)
    return metric


def _add_unit(properties: Any, meaning: Meaning) -> None:  # noqa: ANN401
    if meaning.unit:
        _add_property(properties, "engUnit", DataType.STRING, meaning.unit)


def _add_range(properties: Any, meaning: Meaning) -> None:  # noqa: ANN401
    if meaning.range is not None:
        for key, bound in zip(("engLow", "engHigh"), meaning.range, strict=True):
            _add_property(properties, key, DataType.DOUBLE, bound)


def _add_description(properties: Any, meaning: Meaning) -> None:  # noqa: ANN401
    if meaning.description:
        _add_property(properties, "documentation", DataType.STRING, meaning.description)


def _add_property(properties: Any, key: str, kind: DataType, value: object) -> None:  # noqa: ANN401
    properties.keys.append(key)
    _set(properties.values.add(type=kind), kind, value)


def _set(message: Any, kind: DataType, value: Any) -> bool:  # noqa: ANN401
    """Set a value; return whether there is one: NaN is null."""
    match kind:
        case _ if value is None:
            return False
        case DataType.DOUBLE | DataType.FLOAT:
            if math.isnan(value):
                return False
            if kind is DataType.DOUBLE:
                message.double_value = value
            else:
                message.float_value = value
        case DataType.BOOLEAN:
            message.boolean_value = value
        case DataType.STRING:
            message.string_value = value
        case DataType.DATE_TIME:
            ms = _ms(utc_ns(value) if isinstance(value, datetime) else value)
            if ms <= _OLDEST_MS:
                return False
            message.long_value = ms
        case DataType.INT64 | DataType.UINT64:
            message.long_value = value & 0xFFFF_FFFF_FFFF_FFFF  # two's complement
        case _:
            message.int_value = value & 0xFFFF_FFFF
    return True


def _ms(t: int) -> int:
    return max(t // 1_000_000, _OLDEST_MS)
