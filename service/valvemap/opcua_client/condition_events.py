"""Events of conditions (Part 9): the selected fields and their meaning."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final

from asyncua import ua

from valvemap.clock import utc_ns

_CONDITION: Final = ua.NodeId(ua.ObjectIds.ConditionType)
_FIELDS: Final = (
    *("EventId", "EventType", "SourceName", "Time", "Message", "Severity", "ConditionName"),
    *("Retain", "ActiveState/Id", "AckedState/Id", "ConfirmedState/Id"),
    "ActiveState/TransitionTime",
    *("Comment", "ClientUserId"),
)


@dataclass(frozen=True)
class ConditionChange:
    """The state of an alarm after a change.

    Attributes
    ----------
    t
        Time of the change, UTC ns.
    turned
        Time at which it became active, or inactive, UTC ns; 0: unknown.
    source, name
        The valve (or ``Service``), and the alarm's name.
    text
        Measured values, since when, possible causes.
    severity
        1 … 1,000.
    active, acked, confirmed, retain
        The states of Part 9; a condition that is not retained needs no action.
    comment, user
        The newest comment and its author; empty if there is none.
    event
        EventId.
    """

    t: int
    turned: int
    source: str
    name: str
    text: str
    severity: int
    active: bool
    acked: bool
    confirmed: bool
    retain: bool
    comment: str
    user: str
    event: bytes


def condition_filter() -> ua.EventFilter:
    """Return the filter that selects conditions, with the fields of `condition_of`."""
    of_type = ua.ContentFilterElement(
        FilterOperator=ua.FilterOperator.OfType,
        FilterOperands=[ua.LiteralOperand(Value=ua.Variant(_CONDITION))],
    )
    return ua.EventFilter(
        SelectClauses=[_operand(path) for path in _FIELDS],
        WhereClause=ua.ContentFilter(Elements=[of_type]),
    )


def condition_of(values: Sequence[Any]) -> ConditionChange | None:
    """Read an event's fields; None if it is not a condition's."""
    if len(values) != len(_FIELDS):
        return None
    said = dict(zip(_FIELDS, values, strict=True))
    turned = said["ActiveState/TransitionTime"]
    name, event, time = said["ConditionName"], said["EventId"], said["Time"]
    if not isinstance(name, str) or not isinstance(event, bytes) or time is None:
        return None
    return ConditionChange(
        t=utc_ns(time),
        turned=utc_ns(turned) if isinstance(turned, datetime) else 0,
        source=_text(said["SourceName"]),
        name=name,
        text=_text(said["Message"]),
        severity=int(said["Severity"] or 0),
        active=bool(said["ActiveState/Id"]),
        acked=bool(said["AckedState/Id"]),
        confirmed=bool(said["ConfirmedState/Id"]),
        retain=bool(said["Retain"]),
        comment=_text(said["Comment"]),
        user=_text(said["ClientUserId"]),
        event=event,
    )


def _operand(path: str) -> ua.SimpleAttributeOperand:
    return ua.SimpleAttributeOperand(
        TypeDefinitionId=_CONDITION,
        BrowsePath=[ua.QualifiedName(part, 0) for part in path.split("/")],
        AttributeId=ua.AttributeIds.Value,
    )


def _text(value: object) -> str:
    if isinstance(value, ua.LocalizedText):
        value = value.Text
    return value if isinstance(value, str) else ""
