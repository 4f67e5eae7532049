"""The alarms of a valve, and the rule of each. Pure.

=============  ======================================================  =========================
alarm          quantity                                                default limit
=============  ======================================================  =========================
Changed        size of a detected change of the flow                   0.25 % of the flow's range
Residual       residuals, relative to their usual size at these cells  2.5
Misfit         residuals of a structure that does not fit              1 % of the flow's range
SensorLost     time without a usable sample                            2 s
SensorFrozen   time that a sensor's value is constant, others move     10 s
Unexcited      time without informative inputs                         a day
Extrapolated   the answer to the standing demand is extrapolated       yes
SamplesLost    share of recent samples that were lost                  1 %
LagFound       estimated lag of a signal                               0.1 s
LaneFailed     estimators that stopped at an unexpected error          0.5
=============  ======================================================  =========================

An alarm becomes active when its limit was exceeded for ``delay_s``, and inactive when the quantity
falls below the limit less the hysteresis. A change stays active until an operator acknowledges it.
"""

from collections.abc import Mapping
from enum import IntEnum

from valvemap.pipeline.alarm_states import AlarmRule

DAY_S = 86_400.0


class Alarm(IntEnum):
    """Alarms of a valve."""

    CHANGED = 0
    RESIDUAL = 1
    MISFIT = 2
    SENSOR_LOST = 3
    SENSOR_FROZEN = 4
    UNEXCITED = 5
    EXTRAPOLATED = 6
    SAMPLES_LOST = 7
    LAG_FOUND = 8
    LANE_FAILED = 9

    @property
    def title(self) -> str:
        """Name in configuration and node ids."""
        return "".join(part.capitalize() for part in self.name.split("_"))


ALARM_NAMES = tuple(alarm.title for alarm in Alarm)


RULES: Mapping[Alarm, AlarmRule] = {
    Alarm.CHANGED: AlarmRule(limit=0.25, hysteresis=0.0, delay_s=0.0, severity=600),
    Alarm.RESIDUAL: AlarmRule(limit=2.5, hysteresis=0.8, delay_s=2.0, severity=500),
    Alarm.MISFIT: AlarmRule(limit=1.0, hysteresis=0.3, delay_s=60.0, severity=300),
    Alarm.SENSOR_LOST: AlarmRule(limit=2.0, hysteresis=0.0, delay_s=0.0, severity=800),
    Alarm.SENSOR_FROZEN: AlarmRule(limit=10.0, hysteresis=0.0, delay_s=0.0, severity=700),
    Alarm.UNEXCITED: AlarmRule(limit=DAY_S, hysteresis=0.0, delay_s=0.0, severity=100),
    Alarm.EXTRAPOLATED: AlarmRule(limit=0.5, hysteresis=0.0, delay_s=5.0, severity=300),
    Alarm.SAMPLES_LOST: AlarmRule(limit=1.0, hysteresis=0.5, delay_s=0.0, severity=400),
    Alarm.LAG_FOUND: AlarmRule(limit=0.1, hysteresis=0.02, delay_s=0.0, severity=300),
    Alarm.LANE_FAILED: AlarmRule(limit=0.5, hysteresis=0.0, delay_s=0.0, severity=800),
}
