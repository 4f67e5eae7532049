"""How a valve stands, in one word and one sentence: worst first. Pure."""

from dataclasses import dataclass
from enum import IntEnum

STALE_AFTER_S = 3.0  # without a new sample; three looks of the page
CHANGE_SHOWN_S = 600.0  # a change of the valve stays on top for ten minutes


class Severity(IntEnum):
    """How much a valve needs somebody."""

    GOOD = 0
    NOTE = 1
    WARNING = 2
    ALARM = 3


class Reason(IntEnum):
    """Why a valve stands as it does; a higher number is worse."""

    OK = 0
    FROZEN = 1
    EXTRAPOLATING = 2
    UNEXCITED = 3
    WARMING_UP = 4
    MISFIT = 5
    HELD = 6
    CHANGED = 7
    REJECTED = 8
    STALE = 9
    SENSOR_FAILURE = 10
    NO_SAMPLES = 11
    UNREADABLE = 12
    FAILED = 13

    @property
    def severity(self) -> Severity:
        """How bad that is."""
        return _SEVERITIES[self]

    @property
    def sentence(self) -> str:
        """What it means, for who looks at the page."""
        return _SENTENCES[self]


_SEVERITIES = {
    Reason.OK: Severity.GOOD,
    Reason.FROZEN: Severity.NOTE,
    Reason.EXTRAPOLATING: Severity.NOTE,
    Reason.UNEXCITED: Severity.NOTE,
    Reason.WARMING_UP: Severity.NOTE,
    Reason.MISFIT: Severity.WARNING,
    Reason.HELD: Severity.WARNING,
    Reason.CHANGED: Severity.WARNING,
    Reason.REJECTED: Severity.WARNING,
    Reason.STALE: Severity.ALARM,
    Reason.SENSOR_FAILURE: Severity.ALARM,
    Reason.NO_SAMPLES: Severity.ALARM,
    Reason.UNREADABLE: Severity.ALARM,
    Reason.FAILED: Severity.ALARM,
}
_SENTENCES = {
    Reason.OK: "Identified, and following.",
    Reason.FROZEN: "Adaptation is switched off: the map is kept as it is.",
    Reason.EXTRAPOLATING: "The valve works where nothing was measured before.",
    Reason.UNEXCITED: "The signals hold still; what they do not show is kept.",
    Reason.WARMING_UP: "Too few samples yet to know the whole map.",
    Reason.MISFIT: "The structure cannot follow this valve everywhere.",
    Reason.HELD: "An update would have left the range of numbers; the map is kept.",
    Reason.CHANGED: "The valve changed abruptly.",
    Reason.REJECTED: "The newest samples are of bad quality and were not used.",
    Reason.STALE: "No new sample arrives.",
    Reason.SENSOR_FAILURE: "A sensor has failed.",
    Reason.NO_SAMPLES: "There is no connection to the valve's signals.",
    Reason.UNREADABLE: "The service does not show this valve any more.",
    Reason.FAILED: "The estimator stopped at an unexpected error; Reset starts it again.",
}

_WARMING_UP, _UNEXCITED, _REJECTED, _FROZEN, _HELD, _EXTRAPOLATING, _FAILED = range(1, 8)  # Status
_BY_STATUS = {
    _WARMING_UP: Reason.WARMING_UP,
    _UNEXCITED: Reason.UNEXCITED,
    _REJECTED: Reason.REJECTED,
    _FROZEN: Reason.FROZEN,
    _HELD: Reason.HELD,
    _EXTRAPOLATING: Reason.EXTRAPOLATING,
    _FAILED: Reason.FAILED,
}
_MISFIT = 2  # Adaptation
_BAD = 0x8000_0000
_BAD_WAITING_FOR_INITIAL_DATA = 0x8032_0000
_BAD_SENSOR_FAILURE = 0x808C_0000
_BAD_NO_COMMUNICATION = 0x8031_0000


@dataclass(frozen=True)
class Standing:
    """What is seen of one valve.

    Attributes
    ----------
    code
        StatusCode of the flow that its estimator predicts.
    status
        What the estimator did with the newest sample (`Status` of the service).
    silent_s
        Time without a new sample.
    changed_s
        Time since the valve changed abruptly; infinite if it never did.
    adaptation
        What the estimator makes of its residuals, where it says so.
    """

    code: int
    status: int
    silent_s: float
    changed_s: float = float("inf")
    adaptation: int = 0


def judge(seen: Standing) -> Reason:
    """Say how a valve stands: the worst that there is to say.

    >>> judge(Standing(code=0, status=0, silent_s=0.1))
    <Reason.OK: 0>
    >>> judge(Standing(code=0, status=2, silent_s=60.0)).severity
    <Severity.ALARM: 3>
    """
    reasons = [_by_code(seen.code), _BY_STATUS.get(seen.status, Reason.OK)]
    if seen.silent_s > STALE_AFTER_S and seen.code != _BAD_WAITING_FOR_INITIAL_DATA:
        reasons.append(Reason.STALE)
    if seen.changed_s <= CHANGE_SHOWN_S:
        reasons.append(Reason.CHANGED)
    if seen.adaptation == _MISFIT:
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
