"""Alarms as conditions of Part 9."""

from asyncua import ua

from guarded_opcua import (
    Condition,
    ConditionClass,
    ConditionKey,
    ConditionKind,
    add_object,
)
from valvemap.opcua_results.information_model import ALARMS, ROOT
from valvemap.opcua_results.result_types import Place
from valvemap.pipeline.alarm_results import AlarmReport

CONDITION = "Condition"
_SERVER = ua.NodeId(ua.ObjectIds.Server)
_KIND = {
    "Changed": ConditionKind.OFF_NORMAL,
    "Extrapolated": ConditionKind.OFF_NORMAL,
    "LaneFailed": ConditionKind.OFF_NORMAL,
    "AxisFailed": ConditionKind.OFF_NORMAL,
    "MessagesRejected": ConditionKind.OFF_NORMAL,
    "Certificate": ConditionKind.BELOW_LIMIT,
}
_CATEGORY = {
    **dict.fromkeys(
        ("Changed", "Residual", "SensorLost", "SensorFrozen", "LagFound"),
        ConditionClass.MAINTENANCE,
    ),
    **dict.fromkeys(
        ("EdgeChanged", "LeakageChanged", "AirChanged", "FrictionChanged", "AxisSilent"),
        ConditionClass.MAINTENANCE,
    ),
    **dict.fromkeys(("Misfit", "Unexcited", "Extrapolated", "AxisMisfit"), ConditionClass.PROCESS),
}


async def add_condition(place: Place, parent: ua.NodeId, kind: ua.NodeId) -> ua.NodeId:
    """Add the condition of an alarm's folder."""
    return await add_object(
        place,
        parent,
        f"{parent.Identifier}.{CONDITION}",
        description="The same alarm as a condition of Part 9.",
        type_definition=kind,
    )


def facts_of(report: AlarmReport) -> tuple[object, ...]:
    """Return the fields of a report whose change is an event."""
    return (
        report.at,
        report.count,
        report.active,
        report.acked,
        report.confirmed,
        report.commented,
    )


def condition_of(key: ConditionKey, report: AlarmReport) -> Condition:
    """Return an alarm as a condition."""
    return Condition(
        key=key,
        active=report.active,
        acked=report.acked,
        confirmed=report.confirmed,
        severity=report.severity,
        message=report.text,
        coming=report.count,
        changed=report.at,
        begun=report.since,
        ended=report.ended,
        limit=report.limit,
        comment=report.comment,
        commented_by=report.commented_by,
        commented=report.commented,
    )


def condition_key(index: int, owner: str, alarm: str) -> ConditionKey:
    """Return the identity of an alarm's condition; ``index`` is the server's namespace."""
    source = ua.NodeId(owner, index)
    return ConditionKey(
        id=ua.NodeId(f"{owner}.{ALARMS}.{alarm}.{CONDITION}", index),
        name=alarm,
        kind=_KIND.get(alarm, ConditionKind.ABOVE_LIMIT),
        category=_CATEGORY.get(alarm, ConditionClass.SYSTEM),
        source=source,
        source_name=owner,
        emitters=(_SERVER, ua.NodeId(ROOT, index), source),
    )
