"""What a commissioning run knows and remembers: settings, samples, state, commands. Pure."""

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from valvemap.model.samples import Samples
from valvemap.pipeline.commission_answer import Answers, Expected
from valvemap.pipeline.commission_follow import Commands
from valvemap.pipeline.commission_limits import Limits, Point
from valvemap.pipeline.commission_plan import Plan
from valvemap.vocabulary.commission import Phase

UNKNOWN: Final = Point()


class Reason(Enum):
    """Cause of a pause, an end or a limited command; the value is a sentence."""

    NONE = ""
    ACCURATE = "the requested accuracy is reached"
    TIME_UP = "the time is up"
    OPERATOR = "the operator aborted"
    OPERATOR_GONE = "no sign of the operator's terminal"
    OPERATOR_LATE = "the operator's sign is late"
    SOURCE_LOST = "the source is not connected"
    STALLED = "the heartbeat paused: the source may have taken the valve back"
    STALE = "samples are too old"
    BAD_SAMPLE = "samples are Bad, or not numbers"
    NOT_TAKEN = "the source refuses commands"
    PRESSURE = "a pressure is above the limit for an abort"
    LIMIT = "pressure or flow is beyond its limit: U retreats"
    NOT_FOLLOWED = "the measured U does not follow the command"
    U_LATE = "the measured U is later behind its command than before"
    STUCK = "the flow does not follow U"
    OUTAGE = "the pause lasted too long"
    FEED_FORWARD = "feed-forward is armed: disarm it first"
    OTHER_WRITER = "U moves before the first command: it has another writer"
    U_OUTSIDE = "the measured U is outside the permitted range"
    P_ORDER = "p1 is below p2 although U is open: p1 and p2 may be exchanged"
    LIMIT_BEFORE = "pressure or flow is beyond its limit"


@dataclass(frozen=True)
class Settings:
    """Settings of a run: limits, plan, and times in s.

    Attributes
    ----------
    accuracy
        Standard deviation of the map over its range (RMS, l/min) that ends the run; 0: none does.
    max_age_s
        Largest age of a sample, by its arrival.
    check_s
        Time of good samples before the first command.
    operator_s, operator_late_s
        Largest age of the operator's sign, which ends the run; the delay of a sign that pauses it.
    outage_s
        Longest pause.
    opening
        Q/√Δp of the valve at full signal, l/min/√bar, by its nominal ranges; 0: not known.
    follow_s, follow_percent
        Longest delay of U behind its command, and the distance that is accepted beyond it.
    has_heartbeat
        Whether the source watches a heartbeat.
    """

    limits: Limits = field(default_factory=Limits)
    plan: Plan = field(default_factory=Plan)
    accuracy: float = 0.0
    max_age_s: float = 0.15
    check_s: float = 1.0
    operator_s: float = 1.0
    operator_late_s: float = 0.1
    outage_s: float = 60.0
    opening: float = 0.0
    follow_s: float = 0.5
    follow_percent: float = 3.0
    has_heartbeat: bool = True


@dataclass(frozen=True)
class Seen:
    """What a step knows: the newest sample (%, bar, l/min), its age (s), and the map's state.

    ``came`` are the samples since the last step.
    ``error`` is the map's standard deviation (RMS, l/min); ``expected`` what the map predicts;
    ``route`` the next points to visit, with a number that changes with each new route.
    """

    connected: bool = True
    age_s: float = math.inf
    good: bool = True
    U: float = math.nan
    p1: float = math.nan
    p2: float = math.nan
    Q: float = math.nan
    came: Samples = field(default_factory=Samples.empty)
    operator_age_s: float = 0.0
    operator_late_s: float = 0.0
    abort: bool = False
    feed_forward: bool = False
    error: float = math.nan
    expected: Expected | None = None
    route: tuple[Point, ...] = ()
    route_number: int = 0


@dataclass(frozen=True)
class Watch:
    """Memory of the checks: newest commands and answers, extremes of U and of Q/√Δp.

    ``spool`` are those of U behind the largest play and lag that a spool may have.
    """

    commands: Commands = field(default_factory=Commands)
    U: tuple[float, float] = (math.inf, -math.inf)
    spool: tuple[float, float] = (math.inf, -math.inf)
    opening: tuple[float, float] = (math.inf, -math.inf)
    most: float = 0.0
    answers: Answers = field(default_factory=Answers)

    def begun_anew(self) -> "Watch":
        """Return it without what was seen before a pause; what it knows of map and clock stays."""
        commands = self.commands.begun_anew()
        return Watch(commands, most=self.most, answers=self.answers.begun_anew())

    def without_extremes(self) -> "Watch":
        """Return it with the extremes to be seen anew."""
        return Watch(self.commands, most=self.most, answers=self.answers)


@dataclass(frozen=True)
class CommissionState:
    """State of a run.

    ``evidence`` are the values that ``reason`` comes of;
    ``at`` is the last command that the source accepted, unknown while the valve is not led;
    ``elapsed`` the time of sweep and refinement (s), which pauses do not count into; ``swept`` that
    of the triangles (s), which wait for U by ``owed`` (s); ``since`` the start of the phase,
    ``stepped`` the time of the last step.
    """

    phase: Phase = Phase.IDLE
    reason: Reason = Reason.NONE
    evidence: str = ""
    at: Point = UNKNOWN
    accepted: float = -math.inf
    stepped: float = -math.inf
    since: float = -math.inf
    elapsed: float = 0.0
    swept: float = 0.0
    owed: float = 0.0
    ends_in: Phase = Phase.DONE
    heartbeat: int = 0
    beaten: float = -math.inf
    good_since: float = math.inf
    beyond: float = -math.inf  # time of the last violation of a limit
    refused_since: float = math.inf
    route: tuple[Point, ...] = ()  # points still to be visited
    route_number: int = 0
    watch: Watch = field(default_factory=Watch)

    @property
    def why(self) -> str:
        """The reason with its evidence; empty without one."""
        return ": ".join(filter(None, (self.reason.value, self.evidence)))

    @property
    def is_led(self) -> bool:
        """Whether a command of this run is in effect."""
        return self.at.is_known


@dataclass(frozen=True)
class Command:
    """What to write now: U (%), the load's set point (bar), a heartbeat; None: not written."""

    U: float | None = None
    load: float | None = None
    heartbeat: int | None = None
