"""Commissioning: drives a valve through its range so that its map is known within a minute. Pure.

Every step takes what is seen and returns what to write now. All commands pass
:func:`~valvemap.pipeline.commission_limits.bounded`; a heartbeat is written as long as the valve is
led, and the source takes the valve back when it stops.

::

    IDLE ─start─▶ CHECKING ─▶ SWEEPING ─sweep_s─▶ REFINING ─accurate, most_s─▶ RETURNING ─▶ DONE
                     │           │ ▲ good again     │                         ▲       │
                     ▼           ▼ │                ▼                         │       ▼
                  REFUSED      PAUSED (safe U, or handed back) ──abort, outage┘    ABORTED
"""

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Final

from valvemap.pipeline.commission_limits import MOST_STEP_S, Limits, Point, bounded
from valvemap.pipeline.commission_plan import Plan, sweep
from valvemap.vocabulary.commission import Phase

HEARTBEAT_S: Final = 0.08  # s; shortest interval between heartbeats
MOST_HEARTBEAT: Final = 2**32 - 1  # UInt32; 0 hands the valve back
AGAIN_S: Final = 0.5  # s of good samples before a paused run continues
ARRIVED_U, ARRIVED_LOAD = 0.2, 1.0  # %, bar; distance at which a point counts as reached
STILL_U: Final = 1.0  # %; change of U during the checks that shows another writer
STUCK_SPAN: Final = 0.6  # share of the range of U without a change of the opening: stuck
STUCK_CHANGE: Final = 0.08  # 1; change of Q/√Δp, share of the largest, below which it is none
DROP_TO_JUDGE: Final = 10.0  # bar; the opening is judged above it
UNKNOWN: Final = Point()
HELD_OFF_S: Final = 0.1  # s without a violation until the schedule is followed again


class Reason(Enum):
    """Cause of a pause, an end or a limited command; the value is a sentence."""

    NONE = ""
    ACCURATE = "the requested accuracy is reached"
    TIME_UP = "the time is up"
    OPERATOR = "the operator aborted"
    OPERATOR_GONE = "no sign of the operator's terminal"
    SOURCE_LOST = "the source is not connected"
    STALE = "samples are too old"
    BAD_SAMPLE = "samples are Bad, or not numbers"
    NOT_TAKEN = "the source refuses commands"
    PRESSURE = "a pressure is above the limit for an abort"
    LIMIT = "pressure or flow is beyond its limit: U retreats"
    NOT_FOLLOWED = "the measured U does not follow the command"
    STUCK = "the flow does not follow U"
    OUTAGE = "the pause lasted too long"
    FEED_FORWARD = "feed-forward is armed: disarm it first"
    OTHER_WRITER = "U moves before the first command: it has another writer"
    U_OUTSIDE = "the measured U is outside the permitted range"
    P_ORDER = "p1 is below p2 although U is open: p1 and p2 may be exchanged"
    LIMIT_BEFORE = "pressure or flow is beyond its limit before the first command"


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
    operator_s
        Largest age of the operator's sign.
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
    outage_s: float = 60.0
    opening: float = 0.0
    follow_s: float = 0.5
    follow_percent: float = 3.0
    has_heartbeat: bool = True


@dataclass(frozen=True)
class Seen:
    """What a step knows: the newest sample (%, bar, l/min), its age (s), and the map's state.

    ``error`` is the map's standard deviation (RMS, l/min); ``route`` the next points to visit, with
    a number that changes with each new route.
    """

    connected: bool = True
    age_s: float = math.inf
    good: bool = True
    U: float = math.nan
    p1: float = math.nan
    p2: float = math.nan
    Q: float = math.nan
    operator_age_s: float = 0.0
    abort: bool = False
    feed_forward: bool = False
    error: float = math.nan
    route: tuple[Point, ...] = ()
    route_number: int = 0


@dataclass(frozen=True)
class Watch:
    """Memory of the checks: commands of the last `follow_s`, extremes of U and of Q/√Δp."""

    commands: tuple[tuple[float, float], ...] = ()  # t, U
    U: tuple[float, float] = (math.inf, -math.inf)
    opening: tuple[float, float] = (math.inf, -math.inf)
    most: float = 0.0


@dataclass(frozen=True)
class CommissionState:
    """State of a run.

    ``at`` is the last command that the source accepted, unknown while the valve is not led;
    ``elapsed`` the time of sweep and refinement (s), which pauses do not count into; ``since`` the
    start of the phase, ``stepped`` the time of the last step.
    """

    phase: Phase = Phase.IDLE
    reason: Reason = Reason.NONE
    at: Point = UNKNOWN
    accepted: float = -math.inf
    stepped: float = -math.inf
    since: float = -math.inf
    elapsed: float = 0.0
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
    def is_led(self) -> bool:
        """Whether a command of this run is in effect."""
        return self.at.is_known


@dataclass(frozen=True)
class Command:
    """What to write now: U (%), the load's set point (bar), a heartbeat; None: not written."""

    U: float | None = None
    load: float | None = None
    heartbeat: int | None = None


def start(state: CommissionState, now: float) -> CommissionState:
    """Start a run, or continue an interrupted one at its ``elapsed`` time."""
    return CommissionState(
        Phase.CHECKING, since=now, stepped=now, elapsed=state.elapsed, heartbeat=state.heartbeat
    )


def step(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Return the next state and what to write at ``now`` (s, monotonic); then call `written`.

    Call it with every batch of samples, and at least every 0.05 s.

    Examples
    --------
    >>> settings = Settings(check_s=0.0)
    >>> seen = Seen(age_s=0.0, U=0.0, p1=100.0, p2=50.0, Q=0.0)
    >>> state = start(CommissionState(), 0.0)
    >>> state, command = step(settings, state, seen, 0.02)
    >>> state.phase.name, command.U  # begins where the valve is
    ('SWEEPING', 0.0)
    """
    if state.phase.is_over or state.phase is Phase.IDLE:
        return state, Command()
    passed = min(max(now - state.stepped, 0.0), MOST_STEP_S)
    state = _noted(settings, replace(state, stepped=now), seen, now)
    if state.phase is Phase.CHECKING:
        return _checked(settings, state, seen, now)
    reason = _ending(settings, state, seen, now)
    if reason is not Reason.NONE and state.phase is not Phase.RETURNING:
        state = _enter(state, Phase.RETURNING, reason, now, Phase.ABORTED)
    if state.phase is Phase.RETURNING:
        return _returned(settings, state, seen, now)
    return _driven(settings, state, seen, now, passed)


def written(
    state: CommissionState, command: Command, now: float, *, refused: bool = False
) -> CommissionState:
    """Return the state after the source's response to ``command`` at ``now`` (s)."""
    if refused:
        return replace(state, refused_since=min(state.refused_since, now))
    if command.heartbeat:
        state = replace(state, heartbeat=command.heartbeat, beaten=now)
    if command.U is None:
        return state
    load = state.at.load if command.load is None else command.load
    watch = replace(state.watch, commands=(*state.watch.commands, (now, command.U)))
    return replace(
        state, at=Point(command.U, load), accepted=now, refused_since=math.inf, watch=watch
    )


def lost(state: CommissionState, now: float) -> CommissionState:
    """Return the state after a write without a response: what is in effect is not known."""
    state = replace(state, at=UNKNOWN, beaten=-math.inf, good_since=math.inf)
    if state.phase in {Phase.SWEEPING, Phase.REFINING}:
        return _enter(state, Phase.PAUSED, Reason.SOURCE_LOST, now)
    return state


def in_words(settings: Settings, state: CommissionState, seen: Seen) -> str:
    """Return the progress as a line for the operator."""
    left = max(settings.plan.most_s - state.elapsed, 0.0)
    parts = [state.phase.sentence]
    if state.reason is not Reason.NONE:
        parts.append(state.reason.value)
    if not state.phase.is_over:
        parts.append(f"{state.elapsed:.0f} s, at most {left:.0f} s left")
    if not math.isnan(seen.error):
        wanted = f" (wanted {settings.accuracy:.2g})" if settings.accuracy else ""
        parts.append(f"map ± {1.96 * seen.error:.2g} l/min{wanted}")
    if state.is_led:
        parts.append(f"U {state.at.U:.1f} %")
    return "; ".join(parts)


def _noted(settings: Settings, state: CommissionState, seen: Seen, now: float) -> CommissionState:
    """Update what the checks remember."""
    fault = _fault(settings, seen)
    good_since = math.inf if fault is not Reason.NONE else min(state.good_since, now)
    watch = state.watch
    older = sum(now - t > settings.follow_s for t, _ in watch.commands)
    watch = replace(watch, commands=watch.commands[max(older - 1, 0) :])  # one from before stays
    drop = seen.p1 - seen.p2
    if fault is Reason.NONE and abs(drop) > DROP_TO_JUDGE:
        opening = seen.Q / math.sqrt(abs(drop))
        watch = replace(
            watch,
            U=(min(watch.U[0], seen.U), max(watch.U[1], seen.U)),
            opening=(min(watch.opening[0], opening), max(watch.opening[1], opening)),
            most=max(watch.most, abs(opening)),
        )
    beyond = now if fault is Reason.NONE and _is_beyond(settings.limits, seen) else state.beyond
    return replace(state, good_since=good_since, watch=watch, beyond=beyond)


def _fault(settings: Settings, seen: Seen) -> Reason:
    """Return why the newest sample cannot be used, or NONE."""
    if not seen.connected:
        return Reason.SOURCE_LOST
    if not seen.age_s <= settings.max_age_s:
        return Reason.STALE
    finite = all(math.isfinite(x) for x in (seen.U, seen.p1, seen.p2, seen.Q))
    return Reason.NONE if seen.good and finite else Reason.BAD_SAMPLE


def _is_beyond(limits: Limits, seen: Seen) -> bool:
    pairs = (seen.p1, limits.p1_range), (seen.p2, limits.p2_range), (seen.Q, limits.Q_range)
    return any(not low <= x <= high for x, (low, high) in pairs)


def _checked(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Judge signals before the first command."""
    low, high = settings.limits.U_range
    moved = state.watch.U[1] - state.watch.U[0] > STILL_U
    fault = _fault(settings, seen)
    against = fault is Reason.NONE and seen.p1 < seen.p2 - 1.0 and seen.Q > 0.0
    for reason, holds in (
        (Reason.OPERATOR, seen.abort),
        (Reason.OPERATOR_GONE, seen.operator_age_s > settings.operator_s),
        (Reason.FEED_FORWARD, seen.feed_forward),
        (Reason.OTHER_WRITER, moved),
        (Reason.U_OUTSIDE, fault is Reason.NONE and not low <= seen.U <= high),
        (Reason.P_ORDER, against),
        (Reason.LIMIT_BEFORE, state.beyond == now),
        (fault, now - state.since > settings.check_s + settings.outage_s),
    ):
        if holds:
            return _enter(state, Phase.REFUSED, reason, now), Command()
    if now - state.good_since < settings.check_s:
        return replace(state, reason=fault), Command()
    return _begun(settings, state, seen, now)


def _begun(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Lead the valve from where it is: the first command is the measured U."""
    limits = settings.limits
    low, high = limits.U_range
    if not low <= seen.U <= high:
        return _enter(state, Phase.PAUSED, Reason.U_OUTSIDE, now), Command()
    has_load = limits.load_range is not None
    load = min(max(seen.p2, limits.load_range[0]), limits.load_range[1]) if has_load else math.nan  # type: ignore[index]
    phase = Phase.REFINING if state.elapsed >= settings.plan.sweep_s else Phase.SWEEPING
    state = replace(_enter(state, phase, Reason.NONE, now), watch=Watch(most=state.watch.most))
    return state, _beat(settings, state, Command(seen.U, load if has_load else None), now)


def _ending(settings: Settings, state: CommissionState, seen: Seen, now: float) -> Reason:
    """Return why the run ends early, or NONE."""
    high = settings.limits.p_most
    fresh = _fault(settings, seen) is Reason.NONE
    for reason, holds in (
        (Reason.OPERATOR, seen.abort),
        (Reason.OPERATOR_GONE, seen.operator_age_s > settings.operator_s),
        (Reason.PRESSURE, fresh and max(seen.p1, seen.p2) > high),
        (Reason.NOT_FOLLOWED, fresh and state.is_led and not _follows(settings, state, seen, now)),
        (Reason.STUCK, fresh and _is_stuck(settings, state)),
        (Reason.NOT_TAKEN, now - state.refused_since > settings.follow_s),
        (Reason.OUTAGE, state.phase is Phase.PAUSED and now - state.since > settings.outage_s),
    ):
        if holds:
            return reason
    return Reason.NONE


def _follows(settings: Settings, state: CommissionState, seen: Seen, now: float) -> bool:
    """Whether the measured U is near a command of the last `follow_s`."""
    commands = state.watch.commands
    if not commands or now - commands[0][0] < settings.follow_s:
        return True
    near = [U for _, U in commands]
    return min(near) - settings.follow_percent <= seen.U <= max(near) + settings.follow_percent


def _is_stuck(settings: Settings, state: CommissionState) -> bool:
    watch = state.watch
    if watch.U[1] - watch.U[0] < STUCK_SPAN * settings.limits.U_span:
        return False
    most = max(watch.most, settings.opening)
    return watch.opening[1] - watch.opening[0] < STUCK_CHANGE * most


def _returned(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Move to the safe point, then hand the valve back."""
    if not (state.is_led and seen.connected):
        beat = 0 if seen.connected and math.isfinite(state.beaten) else None
        over = _enter(state, state.ends_in, state.reason, now)
        return replace(over, at=UNKNOWN, beaten=-math.inf), Command(heartbeat=beat)
    limits = settings.limits
    safe = _safe(limits, state.at)
    if (
        state.at.near(safe, 0.0, 0.0)
        or now - state.since > limits.safe_within_s + settings.follow_s
    ):
        beat = 0 if math.isfinite(state.beaten) else None
        over = _enter(state, state.ends_in, state.reason, now)
        return replace(over, at=UNKNOWN, beaten=-math.inf), Command(heartbeat=beat)
    return state, _towards(settings, state, safe, now)


def _driven(
    settings: Settings, state: CommissionState, seen: Seen, now: float, passed: float
) -> tuple[CommissionState, Command]:
    """Sweep, refine, retreat from a limit, or pause."""
    fault = _fault(settings, seen)
    if fault is Reason.SOURCE_LOST:  # the source's own watchdog acts
        return replace(lost(state, now), refused_since=math.inf), Command()
    if fault is not Reason.NONE or state.phase is Phase.PAUSED:
        return _paused(settings, state, seen, now)
    if not state.is_led:  # the first command was refused
        return state, _begun(settings, state, seen, now)[1]
    return _swept(settings, replace(state, elapsed=state.elapsed + passed), seen, now)


def _paused(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Go to the safe point while the valve is led; continue after `AGAIN_S` of good samples."""
    if state.phase is not Phase.PAUSED:
        state = _enter(state, Phase.PAUSED, _fault(settings, seen), now)
    elif now - state.good_since >= AGAIN_S:
        return _begun(settings, state, seen, now)
    return state, _towards(settings, state, _safe(settings.limits, state.at), now)


def _swept(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Follow the schedule at its pace; retreat from limits; end when accurate, or in time."""
    accurate = state.phase is Phase.REFINING and seen.error <= settings.accuracy
    if accurate or state.elapsed >= settings.plan.most_s:
        reason = Reason.ACCURATE if accurate else Reason.TIME_UP
        return _returned(settings, _enter(state, Phase.RETURNING, reason, now), seen, now)
    if state.phase is Phase.SWEEPING and state.elapsed >= settings.plan.sweep_s:
        state = _enter(state, Phase.REFINING, Reason.NONE, now)
    state, target = _target(settings, _past_half_turn(settings, state), seen)
    retreats = now - state.beyond < HELD_OFF_S
    state = replace(state, reason=Reason.LIMIT if retreats else Reason.NONE)
    if retreats:
        target = _safe(settings.limits, state.at)
    pace = settings.plan.pace(settings.limits)
    slow = replace(settings.limits, slew_percent_per_s=pace.U, load_slew_bar_per_s=pace.load)
    target = bounded(slow, state.at, target, now - state.accepted)
    return state, _towards(settings, state, target, now)


def _past_half_turn(settings: Settings, state: CommissionState) -> CommissionState:
    """Forget the extremes once U has covered enough of its range with a changing opening."""
    watch = state.watch
    if watch.U[1] - watch.U[0] < STUCK_SPAN * settings.limits.U_span:
        return state
    return replace(state, watch=Watch(commands=watch.commands, most=watch.most))


def _target(
    settings: Settings, state: CommissionState, seen: Seen
) -> tuple[CommissionState, Point]:
    """Return the point to go to: of the triangles, or of the newest route."""
    triangles = sweep(settings.plan, settings.limits, state.elapsed)
    if state.phase is Phase.SWEEPING:
        return state, triangles
    left = state.route
    if left and state.at.near(left[0], ARRIVED_U, ARRIVED_LOAD):
        left = left[1:]
    if not left and seen.route_number != state.route_number:  # a route is followed to its end
        left = seen.route
        state = replace(state, route_number=seen.route_number)
    return replace(state, route=left), left[0] if left else triangles


def _towards(settings: Settings, state: CommissionState, target: Point, now: float) -> Command:
    """Return the command of one step towards ``target``: each is made here, or is as measured."""
    if not state.is_led:
        return Command()
    to = bounded(settings.limits, state.at, target, now - state.accepted)
    load = None if math.isnan(to.load) else to.load
    return _beat(settings, state, Command(to.U, load), now)


def _beat(settings: Settings, state: CommissionState, command: Command, now: float) -> Command:
    if not settings.has_heartbeat or now - state.beaten < HEARTBEAT_S:
        return command
    return replace(command, heartbeat=state.heartbeat % MOST_HEARTBEAT + 1)


def _safe(limits: Limits, at: Point) -> Point:
    return Point(limits.safe_U, math.nan if math.isnan(at.load) else limits.safe_load)


def _enter(
    state: CommissionState, phase: Phase, reason: Reason, now: float, ends_in: Phase = Phase.DONE
) -> CommissionState:
    return replace(state, phase=phase, reason=reason, since=now, ends_in=ends_in)
