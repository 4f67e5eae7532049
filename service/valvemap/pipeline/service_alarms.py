"""The alarms of the service itself, and the rule of each. Pure."""

from collections.abc import Mapping

from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.quantity_alarms import QuantityAlarms
from valvemap.vocabulary.service_alarms import OF_FLEET, OF_SERVE, ServiceAlarm

_RULES: Mapping[ServiceAlarm, AlarmRule] = {
    ServiceAlarm.CHECKPOINT: AlarmRule(limit=60.0, hysteresis=0.0, delay_s=0.0, severity=700),
    ServiceAlarm.CERTIFICATE: AlarmRule(limit=30.0, hysteresis=0.0, delay_s=0.0, severity=500),
    ServiceAlarm.LOAD: AlarmRule(limit=0.9, hysteresis=0.2, delay_s=30.0, severity=600),
    ServiceAlarm.MESSAGES_REJECTED: AlarmRule(limit=0.5, hysteresis=0.0, delay_s=0.0, severity=600),
    ServiceAlarm.HISTORY: AlarmRule(limit=10.0, hysteresis=0.0, delay_s=0.0, severity=500),
}
SERVICE_RULES = {alarm: _RULES[alarm] for alarm in OF_SERVE}
FLEET_RULES = {alarm: _RULES[alarm] for alarm in OF_FLEET}


class ServiceAlarms(QuantityAlarms[ServiceAlarm]):
    """The alarms of the service itself; the quantity of Certificate is the days left, negated.

    Parameters
    ----------
    rules
        The alarms that this service has, with the rule of each.

    Examples
    --------
    >>> alarms = ServiceAlarms()
    >>> alarms.note(1_800_000_000_000_000_000, {ServiceAlarm.CHECKPOINT: 90.0})
    >>> [report.name for report in alarms.reports() if report.active]
    ['Checkpoint']
    """

    def __init__(self, rules: Mapping[ServiceAlarm, AlarmRule] = SERVICE_RULES) -> None:
        super().__init__(rules, falls=(ServiceAlarm.CERTIFICATE,))
