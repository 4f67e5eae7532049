"""Texts of alarms: the measured value, its beginning, and possible causes. Pure."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum

from valvemap.vocabulary.axis_alarms import AxisAlarm
from valvemap.vocabulary.service_alarms import ServiceAlarm
from valvemap.vocabulary.signals import MEASURED

HOUR_S = 3_600.0


class Cause(IntEnum):
    """Possible cause of residuals; causes that the signals cannot distinguish are one."""

    NONE = 0
    EDGE = 1
    METER = 2
    SIGNAL = 3
    LAG = 4
    OIL = 5

    @property
    def words(self) -> str:
        """Name of the cause in texts."""
        return _WORDS[self]


_WORDS = {
    Cause.NONE: "",
    Cause.EDGE: "the valve's edge (damaged or worn)",
    Cause.METER: "the flow meter (scale or offset)",
    Cause.SIGNAL: "U, p1 or p2 (offset, or frozen)",
    Cause.LAG: "a lag (of the flow meter, or of U's effect)",
    Cause.OIL: "the oil (another temperature or viscosity)",
}


@dataclass(frozen=True)
class Measured:
    """Data of an alarm's text.

    Attributes
    ----------
    value, limit : float
        The largest value during the alarm, and the alarm's limit.
    detail : float
        Another value, depending on the alarm.
    causes
        Numbers of :class:`Cause`.
    since : int
        Start of the last activation, UTC ns; 0: never.
    reason : str
        Why a lane stopped, or why the newest message was rejected.
    """

    value: float
    limit: float
    detail: float = 0.0
    causes: tuple[int, ...] = ()
    since: int = 0
    reason: str = ""


def text_of(name: str, measured: Measured) -> str:
    """Return the text of an alarm; empty before its first activation.

    >>> text_of("Changed", Measured(2.0, 0.25, -4.1, (1, 2, 0), 1_800_000_000_000_000_000))
    "The flow changed by -4.1 l/min, since 2027-01-15 08:00:00 UTC. It may be: the valve's edge \
(damaged or worn); the flow meter (scale or offset)."
    """
    if measured.since == 0:
        return ""
    said, others = _TEXTS[name]
    moment = datetime.fromtimestamp(measured.since // 1_000_000_000, UTC)
    since = f"{moment:%Y-%m-%d %H:%M:%S} UTC"
    causes = [Cause(c).words for c in measured.causes if c] or list(others)
    may_be = f" It may be: {'; '.join(causes)}." if causes else ""
    return f"{said(measured)}, since {since}.{may_be}"


def possible_causes(name: str) -> tuple[str, ...]:
    """Return the causes that the text of an alarm names unless its data exclude them.

    >>> possible_causes("Unexcited")
    ('a machine at standstill', 'a valve that is never moved')
    """
    return _TEXTS[name][1]


def _duration(seconds: float) -> str:
    if not seconds < float("inf"):
        return "ever"
    return f"{seconds:.1f} s" if seconds < HOUR_S else f"{seconds / HOUR_S:.1f} h"


def _changed(m: Measured) -> str:
    return f"The flow changed by {m.detail:+.3g} l/min"


def _residual(m: Measured) -> str:
    return (
        f"Residuals, averaged over 16 samples, up to {m.value:.3g} times their usual size "
        f"(limit {m.limit:g}); their root mean square was {m.detail:.3g} l/min"
    )


def _misfit(m: Measured) -> str:
    return (
        f"The structure misses the flow by up to {m.value:.3g} % of its range, always at the same "
        f"places (limit {m.limit:g} %)"
    )


def _lost(m: Measured) -> str:
    if not m.value < float("inf"):
        return f"No usable sample has arrived{': ' + m.reason if m.reason else ''}"
    said = f": {m.reason}" if m.reason else ""
    return f"No usable sample for {_duration(m.value)} (limit {m.limit:g} s){said}"


def _frozen(m: Measured) -> str:
    return (
        f"{MEASURED[int(m.detail)]} was constant to the last digit for {_duration(m.value)} while "
        f"other signals varied (limit {m.limit:g} s)"
    )


def _unexcited(m: Measured) -> str:
    return f"Nothing was learnt for {_duration(m.value)}: the inputs are constant"


def _extrapolated(_: Measured) -> str:
    return "The present demand is outside the measured region"


def _samples_lost(m: Measured) -> str:
    return f"Up to {m.value:.3g} % of the samples of a minute were lost (limit {m.limit:g} %)"


def _lag(m: Measured) -> str:
    return f"A signal lags by {m.value:.3g} s (limit {m.limit:g} s)"


def _lane_failed(m: Measured) -> str:
    stopped = f"{m.value:.0f} estimator{'s' * (m.value != 1.0)} stopped"
    return f"{stopped} at an unexpected error ({m.reason or 'unknown'}); Reset starts again"


def _checkpoint(m: Measured) -> str:
    if math.isinf(m.value):
        return "The state file was removed or replaced while in use; all states are saved again"
    return f"States were not saved for {_duration(m.value)} (limit {m.limit:g} s)"


def _certificate(m: Measured) -> str:
    return f"The service's certificate is valid for {-m.value:.0f} more days (limit {m.limit:g})"


def _load(m: Measured) -> str:
    return f"The service works {100.0 * m.value:.0f} % of the time (limit {100.0 * m.limit:g} %)"


def _history(m: Measured) -> str:
    if math.isinf(m.value):
        return "Rows of the history were lost; History.Lost is their number"
    return f"The history was not saved for {_duration(m.value)} (limit {m.limit:g} s); rows wait"


def _rejected(m: Measured) -> str:
    """The reason is foreign text: it is bounded and escaped by the caller."""
    count = f"{m.value:.0f} message{'s were' if m.value != 1.0 else ' was'}"
    return f"{count} rejected ({m.reason or 'the reason is unknown'})"


def _found(m: Measured) -> str:
    """The reason is the finding's sentence."""
    return f"{m.reason or 'The axis has changed.'} Found with a probability of up to {m.value:.2f}"


def _silent(m: Measured) -> str:
    return f"No sample of the axis for {_duration(m.value)} (limit {m.limit:g} s)"


def _axis_failed(m: Measured) -> str:
    return f"The axis stopped at an unexpected error ({m.reason or 'unknown'})"


ALARM_DESCRIPTIONS = {
    "Changed": "The flow at the same U and pressure drop changed abruptly; the alarm stays active "
    "until it is acknowledged.",
    "Residual": "Residuals are larger than usual at the same U and pressure drop.",
    "Misfit": "The form of the map (its structure) does not fit the valve; the valve need "
    "not have changed.",
    "SensorLost": "No usable sample arrives.",
    "SensorFrozen": "A sensor's value is constant while others vary.",
    "Unexcited": "Nothing was learnt for a long time.",
    "Extrapolated": "The present demand is outside the measured region.",
    "SamplesLost": "Samples are lost on their way.",
    "LagFound": "A signal lags behind the others.",
    "LaneFailed": "An estimator stopped at an unexpected error.",
    **{alarm.label: alarm.sentence for alarm in ServiceAlarm},
    **{alarm.label: alarm.sentence for alarm in AxisAlarm},
}
_TEXTS: dict[str, tuple[Callable[[Measured], str], tuple[str, ...]]] = {
    "Changed": (_changed, (Cause.EDGE.words, Cause.METER.words, Cause.SIGNAL.words)),
    "Residual": (_residual, (Cause.EDGE.words, Cause.METER.words, Cause.SIGNAL.words)),
    "Misfit": (
        _misfit,
        ("a valve whose shape the estimator's structure cannot represent", Cause.SIGNAL.words),
    ),
    "SensorLost": (
        _lost,
        ("a sensor or its cable", "the source or the network", "a gate that refuses the values"),
    ),
    "SensorFrozen": (
        _frozen,
        ("a dead sensor", "a source that repeats its last value", "a coarse resolution"),
    ),
    "Unexcited": (_unexcited, ("a machine at standstill", "a valve that is never moved")),
    "Extrapolated": (
        _extrapolated,
        ("a demand outside the operating points of the machine until now", "a map that was reset"),
    ),
    "SamplesLost": (
        _samples_lost,
        ("a queue of the source that is too short", "the network", "a source that pauses"),
    ),
    "LagFound": (
        _lag,
        ("a filter of the flow meter", "the valve's own dynamics", "time stamps made too late"),
    ),
    "LaneFailed": (_lane_failed, ()),
    "Checkpoint": (
        _checkpoint,
        ("a full disk", "a disk that is too slow", "missing rights", "a removed file"),
    ),
    "Certificate": (_certificate, ()),
    "Load": (_load, ("too many valves or clients", "other work on this machine")),
    "History": (
        _history,
        ("a full disk", "missing rights", "a damaged file", "a clock that steps"),
    ),
    "MessagesRejected": (
        _rejected,
        (
            "a sender of another version or with another catalogue",
            "another program that writes to the fleet's topics",
            "damage to the state topic",
        ),
    ),
    "EdgeChanged": (
        _found,
        ("a damaged or worn edge", "dirt in the valve", "pressure sensors at its ports"),
    ),
    "LeakageChanged": (_found, ("the piston's seal", "a valve between the lines", "warmer oil")),
    "FrictionChanged": (
        _found,
        ("a worn or swollen seal", "a dry or bent guide", "a side load"),
    ),
    "AirChanged": (_found, ("air drawn in by the pump", "a line that was opened", "other hoses")),
    "AxisMisfit": (
        _found,
        ("the sensors of position and pressures", "play or friction of the spool"),
    ),
    "AxisSilent": (_silent, ("a sensor or its cable", "the source or the network")),
    "AxisFailed": (_axis_failed, ()),
}
