"""State of a valve as a reason and a sentence; the most severe reason wins. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from valvemap.vocabulary.health import DeviceHealth
from valvemap.vocabulary.statuses import Adaptation, AxisStatus, Described, InverseStatus, Status

STALE_AFTER_S = 3.0  # s; maximum age of the newest sample: three rounds of the page
CHANGE_SHOWN_S = 600.0  # s; how long an abrupt change stays the valve's reason


class Severity(IntEnum):
    """Severity of a valve's state."""

    GOOD = 0
    NOTE = 1
    WARNING = 2
    ALARM = 3


class Reason(Described):
    """Reason of a valve's state, ordered by severity."""

    OK = 0, "ok", "Identified, and following."
    FROZEN = 1, "adaptation off", "Adaptation is switched off: the map is kept as it is."
    EXTRAPOLATING = 2, "extrapolating", "The valve works where nothing was measured before."
    UNEXCITED = 3, "not excited", "The signals hold still; the map is kept as it is."
    WARMING_UP = 4, "warming up", "Too few samples yet to know the whole map."
    MAINTENANCE = 5, "needs inspection", "An alarm is active: it works, but needs inspection."
    OFF_SPEC = 6, "out of specification", "An alarm is active: it deviates, or extrapolates."
    MISFIT = 7, "misfit", "The structure cannot follow this valve everywhere."
    HELD = 8, "held", "An update would have left the range of numbers; the map is kept."
    CHANGED = 9, "valve changed", "The valve changed abruptly."
    REJECTED = 10, "samples rejected", "The newest samples are of bad quality and were not used."
    FAULTY = 11, "failure", "An alarm is active: the valve's output cannot be used."
    STALE = 12, "no new samples", "No new sample arrives."
    SENSOR_FAILURE = 13, "sensor failed", "A sensor has failed."
    NO_SAMPLES = 14, "signals lost", "There is no connection to the valve's signals."
    UNREADABLE = 15, "unreadable", "The service does not publish this valve any more."
    FAILED = 16, "failed", "The estimator stopped at an unexpected error; Reset starts it again."

    @property
    def severity(self) -> Severity:
        """Severity of the reason."""
        return _SEVERITIES[self]

    @property
    def is_old(self) -> bool:
        """Whether the valve's values are not of now, or none."""
        return self >= Reason.STALE


_SEVERITIES = {
    Reason.OK: Severity.GOOD,
    Reason.FROZEN: Severity.NOTE,
    Reason.EXTRAPOLATING: Severity.NOTE,
    Reason.UNEXCITED: Severity.NOTE,
    Reason.WARMING_UP: Severity.NOTE,
    Reason.MAINTENANCE: Severity.WARNING,
    Reason.OFF_SPEC: Severity.WARNING,
    Reason.MISFIT: Severity.WARNING,
    Reason.HELD: Severity.WARNING,
    Reason.CHANGED: Severity.WARNING,
    Reason.REJECTED: Severity.WARNING,
    Reason.FAULTY: Severity.ALARM,
    Reason.STALE: Severity.ALARM,
    Reason.SENSOR_FAILURE: Severity.ALARM,
    Reason.NO_SAMPLES: Severity.ALARM,
    Reason.UNREADABLE: Severity.ALARM,
    Reason.FAILED: Severity.ALARM,
}
INVERSE_SEVERITIES = {
    InverseStatus.OK: Severity.GOOD,
    InverseStatus.ABOVE_REACH: Severity.WARNING,
    InverseStatus.BELOW_REACH: Severity.WARNING,
    InverseStatus.NOT_MONOTONE: Severity.ALARM,
    InverseStatus.UNIDENTIFIED: Severity.NOTE,
    InverseStatus.NOT_FINITE: Severity.NOTE,
    InverseStatus.OUTSIDE: Severity.WARNING,
    InverseStatus.EXTRAPOLATING: Severity.WARNING,
    InverseStatus.UNCERTAIN: Severity.WARNING,
}
AXIS_SEVERITIES = {  # the others are warnings
    AxisStatus.OK: Severity.GOOD,
    AxisStatus.TOO_SHORT: Severity.NOTE,
    AxisStatus.FAILED: Severity.ALARM,
}

_BY_STATUS: Mapping[int, Reason] = {
    Status.WARMING_UP: Reason.WARMING_UP,
    Status.UNEXCITED: Reason.UNEXCITED,
    Status.REJECTED: Reason.REJECTED,
    Status.FROZEN: Reason.FROZEN,
    Status.HELD: Reason.HELD,
    Status.EXTRAPOLATING: Reason.EXTRAPOLATING,
    Status.FAILED: Reason.FAILED,
    Status.UNRELIABLE: Reason.MISFIT,
}
STATUS_SEVERITIES = {status: _BY_STATUS.get(status, Reason.OK).severity for status in Status}
_BY_HEALTH: Mapping[int, Reason] = {
    DeviceHealth.MAINTENANCE_REQUIRED: Reason.MAINTENANCE,
    DeviceHealth.OFF_SPEC: Reason.OFF_SPEC,
    DeviceHealth.FAILURE: Reason.FAULTY,
}
_BAD = 0x8000_0000
_BAD_WAITING_FOR_INITIAL_DATA = 0x8032_0000
_BAD_SENSOR_FAILURE = 0x808C_0000
_BAD_NO_COMMUNICATION = 0x8031_0000


@dataclass(frozen=True)
class Standing:
    """Observations of one valve that determine its state.

    Attributes
    ----------
    code
        StatusCode of the predicted flow.
    status
        The estimator's `Status` at the newest sample.
    silent_s
        Age of the newest sample.
    changed_s
        Time since the last abrupt change; infinite if there was none.
    adaptation
        The estimator's assessment of its residuals (Adaptation); 0 if it has none.
    health
        DeviceHealth, from the active alarms; 0 if the service publishes none.
    """

    code: int
    status: int
    silent_s: float
    changed_s: float = float("inf")
    adaptation: int = 0
    health: int = 0


def judge(seen: Standing) -> Reason:
    """Return the most severe reason that applies.

    >>> judge(Standing(code=0, status=0, silent_s=0.1))
    <Reason.OK: 0>
    >>> judge(Standing(code=0, status=2, silent_s=60.0)).severity
    <Severity.ALARM: 3>
    """
    reasons = [
        _by_code(seen.code),
        _BY_STATUS.get(seen.status, Reason.OK),
        _BY_HEALTH.get(seen.health, Reason.OK),
    ]
    if seen.silent_s > STALE_AFTER_S and seen.code != _BAD_WAITING_FOR_INITIAL_DATA:
        reasons.append(Reason.STALE)
    if seen.changed_s <= CHANGE_SHOWN_S:
        reasons.append(Reason.CHANGED)
    if seen.adaptation == Adaptation.MISFIT:
        reasons.append(Reason.MISFIT)
    return max(reasons)


def _by_code(code: int) -> Reason:
    if code < _BAD:
        return Reason.OK
    if code == _BAD_WAITING_FOR_INITIAL_DATA:
        return Reason.WARMING_UP
    if code == _BAD_SENSOR_FAILURE:
        return Reason.SENSOR_FAILURE
    return Reason.NO_SAMPLES if code == _BAD_NO_COMMUNICATION else Reason.UNREADABLE
