"""The alarms of an axis: its findings, silence, and an error that has stopped it. Pure.

An alarm of a finding is active while the finding's probability is above the limit. It ends by
itself after a repair, or with a new reference. Time is the samples' time.
"""

from collections.abc import Mapping
from typing import Final

from valvemap.errors import CommandRejected
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.axis_ports import AxisResults
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.quantity_alarms import QuantityAlarms
from valvemap.vocabulary.axis_alarms import AxisAlarm
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import AxisStatus

ALARM_OF: Final[Mapping[FindingCode, AxisAlarm]] = {
    FindingCode.PA_CHANGE: AxisAlarm.EDGE_CHANGED,
    FindingCode.AT_CHANGE: AxisAlarm.EDGE_CHANGED,
    FindingCode.PB_CHANGE: AxisAlarm.EDGE_CHANGED,
    FindingCode.BT_CHANGE: AxisAlarm.EDGE_CHANGED,
    FindingCode.LEAKAGE_CHANGE: AxisAlarm.LEAKAGE_CHANGED,
    FindingCode.AIR: AxisAlarm.AIR_CHANGED,
    FindingCode.FRICTION: AxisAlarm.FRICTION_CHANGED,
    FindingCode.MISFIT: AxisAlarm.AXIS_MISFIT,
}
_FOUND: Final = frozenset(ALARM_OF.values())
_ACTIONS: Final = frozenset({"acknowledge", "confirm", "remark"})
AXIS_RULES: Final[Mapping[AxisAlarm, AlarmRule]] = {
    AxisAlarm.EDGE_CHANGED: AlarmRule(limit=0.8, hysteresis=0.3, delay_s=0.0, severity=600),
    AxisAlarm.LEAKAGE_CHANGED: AlarmRule(limit=0.8, hysteresis=0.3, delay_s=0.0, severity=500),
    AxisAlarm.AIR_CHANGED: AlarmRule(limit=0.8, hysteresis=0.3, delay_s=0.0, severity=400),
    AxisAlarm.FRICTION_CHANGED: AlarmRule(limit=0.8, hysteresis=0.3, delay_s=0.0, severity=400),
    AxisAlarm.AXIS_MISFIT: AlarmRule(limit=0.8, hysteresis=0.3, delay_s=0.0, severity=500),
    AxisAlarm.AXIS_SILENT: AlarmRule(limit=2.0, hysteresis=0.0, delay_s=0.0, severity=800),
    AxisAlarm.AXIS_FAILED: AlarmRule(limit=0.5, hysteresis=0.0, delay_s=0.0, severity=800),
}


class AxisAlarms(QuantityAlarms[AxisAlarm]):
    """The alarms of one axis.

    Examples
    --------
    >>> alarms = AxisAlarms()
    >>> alarms.note(1_800_000_000_000_000_000, {AxisAlarm.AXIS_SILENT: 12.0})
    >>> [report.text for report in alarms.reports() if report.active]
    ['No sample of the axis for 12.0 s (limit 2 s), since 2027-01-15 08:00:00 UTC. It may be: a \
sensor or its cable; the source or the network.']
    """

    def __init__(self) -> None:
        super().__init__(AXIS_RULES)

    def act(self, command: Command) -> None:
        """Acknowledge, confirm or comment an alarm.

        Raises
        ------
        CommandRejected
            if there is nothing to acknowledge or confirm.
        """
        name, remark = command.part, command.remark
        if remark is None or command.action not in _ACTIONS:
            raise CommandRejected(f"{command.valve}: {command.action} is no command of an alarm")
        if command.action == "remark":
            self.remark(name, remark)
            return
        act = self.acknowledge if command.action == "acknowledge" else self.confirm
        if not act(name, remark):
            raise CommandRejected(f"{command.valve}.{name}: there is nothing to {command.action}")

    def judge(self, results: AxisResults, now: int, silent_s: float) -> None:
        """Update with the newest results; ``now`` (UTC ns) is the time of silence and errors."""
        has_failed = results.status is AxisStatus.FAILED
        if has_failed:
            self.give_reason(AxisAlarm.AXIS_FAILED, results.sentence)
        self.note(now, {AxisAlarm.AXIS_SILENT: silent_s, AxisAlarm.AXIS_FAILED: float(has_failed)})
        worst = _worst(results.findings or ())
        for alarm, finding in worst.items():
            self.give_reason(alarm, finding.sentence)
        shares = {alarm: worst[alarm].probability if alarm in worst else 0.0 for alarm in _FOUND}
        self.note(results.t or now, shares)


def _worst(findings: tuple[Finding, ...]) -> dict[AxisAlarm, Finding]:
    """Return the likeliest finding of each alarm."""
    ranked = sorted(findings, key=lambda one: one.probability)
    return {ALARM_OF[one.code]: one for one in ranked if one.code in ALARM_OF}
