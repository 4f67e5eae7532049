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
from dataclasses import replace
from typing import Final

from valvemap.pipeline.commission_guard import (
    STALLED_S,
    ending,
    has_stalled,
    noted,
    past_half_turn,
    refusal,
    waits_for,
)
from valvemap.pipeline.commission_limits import MOST_STEP_S, Limits, Point, bounded
from valvemap.pipeline.commission_plan import sweep
from valvemap.pipeline.commission_state import (
    UNKNOWN,
    Command,
    CommissionState,
    Reason,
    Seen,
    Settings,
)
from valvemap.pipeline.commission_words import evidence
from valvemap.vocabulary.commission import Phase

HEARTBEAT_S: Final = 0.08  # s; shortest interval between heartbeats
MOST_HEARTBEAT: Final = 2**32 - 1  # UInt32; 0 hands the valve back
AGAIN_S: Final = 0.5  # s of good samples before a paused run continues
ARRIVED_U, ARRIVED_LOAD = 0.2, 1.0  # %, bar; distance at which a point is reached
HELD_OFF_S: Final = 0.1  # s without a violation until the schedule is followed again


def start(state: CommissionState, now: float) -> CommissionState:
    """Start a run, or continue an interrupted one at its ``elapsed`` time."""
    return CommissionState(
        Phase.CHECKING,
        since=now,
        stepped=now,
        elapsed=state.elapsed,
        swept=state.elapsed,
        heartbeat=state.heartbeat,
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
    state = noted(settings, replace(state, stepped=now), seen, now)
    if has_stalled(settings, state, now):
        state = replace(lost(state, now, Reason.STALLED), refused_since=math.inf)
    if state.phase is Phase.CHECKING:
        return _checked(settings, state, seen, now)
    reason = ending(settings, state, seen, now)
    if reason is not Reason.NONE and state.phase is not Phase.RETURNING:
        state = _enter(state, Phase.RETURNING, reason, now, Phase.ABORTED)
        state = replace(state, evidence=evidence(settings.limits, reason, seen))
    if state.phase is Phase.RETURNING:
        return _returned(settings, state, seen, now)
    return _driven(settings, state, seen, now, passed)


def written(
    state: CommissionState, command: Command, now: float, *, refused: bool = False
) -> CommissionState:
    """Return the state after the source took ``command`` at ``now`` (s).

    ``command`` is the part that was taken; ``refused`` says that there was another. A heartbeat may
    have come as early as it was sent, and the next one as late as its response: the run pauses
    where the source may have taken the valve back between them.
    """
    paused = now - state.beaten > STALLED_S and math.isfinite(state.beaten)
    if command.heartbeat:
        state = replace(state, heartbeat=command.heartbeat, beaten=state.stepped)
    if command.heartbeat and paused:
        return lost(state, now, Reason.STALLED)
    if refused:
        state = replace(state, refused_since=min(state.refused_since, now))
    elif command.U is not None:
        state = replace(state, refused_since=math.inf)
    if command.load is not None:
        state = replace(state, at=Point(state.at.U, command.load), accepted=now)
    if command.U is None:
        return state
    commands = state.watch.commands.wrote(state.stepped, now, command.U)
    watch = replace(state.watch, commands=commands)
    return replace(state, at=Point(command.U, state.at.load), accepted=now, watch=watch)


def lost(
    state: CommissionState, now: float, reason: Reason = Reason.SOURCE_LOST
) -> CommissionState:
    """Return the state after a write without a response: the value in effect is unknown."""
    state = replace(state, at=UNKNOWN, beaten=-math.inf, good_since=math.inf)
    if state.phase in {Phase.SWEEPING, Phase.REFINING}:
        return _enter(state, Phase.PAUSED, reason, now)
    return state


def _checked(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Judge signals before the first command."""
    reason = refusal(settings, state, seen, now)
    if reason is not Reason.NONE:
        state = _enter(state, Phase.REFUSED, reason, now)
        return replace(state, evidence=evidence(settings.limits, reason, seen)), Command()
    if now - state.good_since < settings.check_s:
        return _because(state, waits_for(settings, state, seen)), Command()
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
    state = _enter(state, phase, Reason.NONE, now)
    state = replace(state, watch=state.watch.begun_anew(), owed=0.0)
    return state, _beat(settings, state, Command(seen.U, load if has_load else None), now)


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
    found = waits_for(settings, state, seen)
    if found is Reason.SOURCE_LOST:  # the source's own watchdog acts
        return replace(lost(state, now), refused_since=math.inf), Command()
    if found is not Reason.NONE or state.phase is Phase.PAUSED:
        return _paused(settings, state, seen, now)
    lacks_load = settings.limits.load_range is not None and math.isnan(state.at.load)
    if not state.is_led or lacks_load:  # the first command was refused, or a part of it
        return state, _begun(settings, state, seen, now)[1]
    return _swept(settings, replace(state, elapsed=state.elapsed + passed), seen, now, passed)


def _paused(
    settings: Settings, state: CommissionState, seen: Seen, now: float
) -> tuple[CommissionState, Command]:
    """Go to the safe point while the valve is led; continue after `AGAIN_S` of good samples."""
    if state.phase is not Phase.PAUSED:
        state = _enter(state, Phase.PAUSED, waits_for(settings, state, seen), now)
    elif now - state.good_since >= AGAIN_S:
        return _begun(settings, state, seen, now)
    return state, _towards(settings, state, _safe(settings.limits, state.at), now)


def _swept(
    settings: Settings, state: CommissionState, seen: Seen, now: float, passed: float
) -> tuple[CommissionState, Command]:
    """Follow the schedule at its pace; retreat from limits; end when accurate, or in time.

    The pace counts from the last move. Slew counts from the last command that was accepted, as it
    may have come into force as late as that; where it is the narrower, the triangles wait for U.
    """
    accurate = state.phase is Phase.REFINING and seen.error <= settings.accuracy
    if accurate or state.elapsed >= settings.plan.most_s:
        reason = Reason.ACCURATE if accurate else Reason.TIME_UP
        return _returned(settings, _enter(state, Phase.RETURNING, reason, now), seen, now)
    if state.phase is Phase.SWEEPING and state.elapsed >= settings.plan.sweep_s:
        state = _enter(state, Phase.REFINING, Reason.NONE, now)
    limits, plan = settings.limits, settings.plan
    owed = min(state.owed + passed, MOST_STEP_S)
    ahead, since = plan.ahead(limits), now - state.accepted
    moves = min(owed, max(ahead, 1.0) * since)
    state = replace(state, swept=state.swept + min(moves, ahead * since), owed=owed - moves)
    state, target = _target(settings, past_half_turn(settings, state), seen)
    retreats = now - state.beyond < HELD_OFF_S
    state = _because(state, Reason.LIMIT if retreats else Reason.NONE)
    if retreats:
        values = evidence(limits, Reason.LIMIT, seen) or state.evidence
        state = replace(state, evidence=values)
        target = _safe(limits, state.at)
    pace = plan.pace(limits)
    slow = replace(limits, slew_percent_per_s=pace.U, load_slew_bar_per_s=pace.load)
    target = bounded(slow, state.at, target, moves)
    return state, _towards(settings, state, target, now)


def _target(
    settings: Settings, state: CommissionState, seen: Seen
) -> tuple[CommissionState, Point]:
    """Return the point to go to: of the triangles, or of the newest route."""
    triangles = sweep(settings.plan, settings.limits, state.swept)
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
    in_force = state.at.near(to, 0.0, 0.0) and math.isinf(state.refused_since)
    if in_force and settings.has_heartbeat:  # a write would only delay the next one
        return _beat(settings, state, Command(), now)
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
    return replace(_because(state, reason), phase=phase, since=now, ends_in=ends_in)


def _because(state: CommissionState, reason: Reason) -> CommissionState:
    """Return the state with a reason; the evidence of another one is dropped."""
    return replace(state, reason=reason, evidence=state.evidence if reason is state.reason else "")
