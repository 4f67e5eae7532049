"""What a client of our servers reads of a node, from the values of its attributes."""

from dataclasses import dataclass
from math import isfinite
from typing import Any

from asyncua import ua

from valvemap.clock import utc_ns


@dataclass(frozen=True)
class Reading:
    """One value: None where there is none; ``code`` is its StatusCode, ``t`` source time, UTC ns.

    Arrays are lists, matrices lists of lists.
    """

    value: Any
    code: int
    t: int


@dataclass(frozen=True)
class Engineering:
    """Unit, range in it, and description of a variable; empty or None where not given."""

    unit: str = ""
    range: tuple[float, float] | None = None
    description: str = ""


@dataclass(frozen=True)
class Child:
    """A child node: its string identifier and whether it is a variable or a method."""

    id: str
    is_variable: bool
    is_method: bool


def reading(answer: ua.DataValue) -> Reading:
    """Return a value as plain Python; a text without its language."""
    value = answer.Value.Value if answer.Value is not None else None
    if isinstance(value, ua.LocalizedText):
        value = value.Text
    code = answer.StatusCode.value if answer.StatusCode is not None else 0
    time = answer.SourceTimestamp
    return Reading(value, int(code), 0 if time is None else utc_ns(time))


def engineering(information: object, span: object, text: ua.DataValue) -> Engineering:
    """Return unit, range and description from the properties and the attribute of a variable."""
    symbol = information.DisplayName.Text if isinstance(information, ua.EUInformation) else None
    bounds = (span.Low, span.High) if isinstance(span, ua.Range) else None
    given = None if text.Value is None else text.Value.Value
    return Engineering(
        symbol or "",
        bounds if bounds is not None and all(map(isfinite, bounds)) else None,
        (given.Text or "") if isinstance(given, ua.LocalizedText) else "",
    )


def is_permitted(level: ua.DataValue, executable: ua.DataValue) -> bool:
    """Return whether the user may write a variable, or call a method."""
    if executable.Value is not None and executable.Value.Value is not None:
        return bool(executable.Value.Value)
    bits = level.Value.Value if level.Value is not None else None
    return isinstance(bits, int) and bool(bits & ua.AccessLevel.CurrentWrite.mask)


def type_name(type_: ua.DataValue, rank: ua.DataValue, own: int) -> str | None:
    """Return the name of a scalar's built-in type; one of namespace ``own`` is an enumeration."""
    is_scalar = rank.Value is not None and rank.Value.Value == ua.ValueRank.Scalar
    node = type_.Value.Value if is_scalar and type_.Value is not None else None
    if isinstance(node, ua.NodeId) and node.NamespaceIndex == own:
        return "Int32"
    if not isinstance(node, ua.NodeId) or node.NamespaceIndex != 0:
        return None
    return ua.ObjectIdNames.get(node.Identifier)
