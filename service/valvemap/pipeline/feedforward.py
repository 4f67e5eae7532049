"""Guarded feed-forward: whether the answer to a demand is written to its valve. Pure.

Once armed, the service leads the valve. The first command is the measured U; the next ones follow
the answer, within range and slew. While the answer may not be written, the configured fallback
applies. A heartbeat is written as long as the valve is led; if it stops, or is 0, the source takes
the valve back.

::

                 armed, fresh sample              a reason, fallback = hand_back
    not led  ───────────────────────────▶  led  ───────────────────────────────▶  not led
                write U as measured               or disarmed, or writes refused
"""

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Self, assert_never

from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import InverseStatus, Status

MOST_STEP_S: Final = 0.2  # s; longest interval for which one command may slew
HEARTBEAT_S: Final = 0.08  # s; shortest interval: with steps every 0.1 s, at least five a second
STALLED_S: Final = 0.4  # s without a heartbeat, after which the source may have dropped the command
RETRY_S: Final = 0.08  # s until a refused command is repeated; steps are every 0.1 s
GIVE_UP_S: Final = 0.2  # s of refusals until the fallback applies: 0.5 s later the source's own
RESTART_S: Final = 2.0  # s after a hand-back because of refusals, until the valve is led again
MOST_HEARTBEAT: Final = 2**32 - 1  # UInt32; 0 hands the valve back


class Fallback(Enum):
    """Action while the answer may not be written."""

    HOLD = "hold"
    RAMP = "ramp"
    HAND_BACK = "hand_back"


@dataclass(frozen=True)
class FeedForward:
    """Settings of one valve's feed-forward.

    Attributes
    ----------
    U_range : (float, float)
        Range of commands, %.
    slew_percent_per_s : float
        Largest rate of change of commands.
    fallback : Fallback
        HOLD repeats the last command, RAMP moves to ``fallback_U`` (%) at the slew, HAND_BACK
        writes nothing and stops the heartbeat.
    max_age_s : float
        Largest age of a sample: since its arrival, and by the clocks of source and service.
    max_width_percent : float
        Largest width of the answer's 95 % interval.
    has_heartbeat : bool
        Whether the source monitors a heartbeat.
    leads : bool
        Whether the demand is advanced by the delay of the spool, where that is identified.
    """

    U_range: tuple[float, float] = (0.0, 100.0)
    slew_percent_per_s: float = 100.0
    fallback: Fallback = Fallback.HOLD
    fallback_U: float = 0.0
    max_age_s: float = 0.5
    max_width_percent: float = 10.0
    has_heartbeat: bool = False
    leads: bool = False


@dataclass(frozen=True)
class Situation:
    """Inputs of one step.

    ``U`` (%) is that of the newest sample, ``age_s`` its age, ``map`` the estimator's status of it;
    ``required_U``, ``width`` (both %) and ``answer`` are the answer to the demand.
    """

    armed: bool
    connected: bool
    age_s: float = math.inf
    U: float = math.nan
    map: Status = Status.WARMING_UP
    required_U: float = math.nan
    width: float = math.nan
    answer: InverseStatus = InverseStatus.NOT_FINITE


@dataclass(frozen=True)
class Refusals:
    """Times of the first and the last refusal in an unbroken series; s."""

    since: float = math.inf
    last: float = -math.inf

    def lasted(self, now: float) -> float:
        """Duration of the series, s; -inf without one."""
        return now - self.since

    def again(self, now: float) -> Self:
        """Return the series extended by a refusal at ``now``."""
        return replace(self, since=min(self.since, now), last=now)


@dataclass(frozen=True)
class FeedForwardState:
    """State of one valve's feed-forward.

    ``U`` (%) is the command that the source has accepted, NaN while the valve is not led; ``t``
    when it was last valid; ``heartbeat`` the last accepted one, ``beaten`` its time.
    """

    status: FeedForwardStatus = FeedForwardStatus.DISARMED
    U: float = math.nan
    t: float = -math.inf
    heartbeat: int = 0
    beaten: float = -math.inf
    refused_U: Refusals = Refusals()
    refused_heartbeat: Refusals = Refusals()

    @property
    def is_led(self) -> bool:
        """Whether a command of the service is in effect."""
        return not math.isnan(self.U)

    def has_stalled(self, now: float) -> bool:
        """Whether the last heartbeat is so old that the source may have taken the valve back."""
        return math.isfinite(self.beaten) and now - self.beaten > STALLED_S

    def since_refusal(self, now: float) -> float:
        """Time since the last refusal, s."""
        return now - max(self.refused_U.last, self.refused_heartbeat.last)


@dataclass(frozen=True)
class Command:
    """Values to write now, ``U`` (%) before ``heartbeat``; None: not written."""

    U: float | None = None
    heartbeat: int | None = None


def decide(
    settings: FeedForward, state: FeedForwardState, situation: Situation, now: float
) -> tuple[FeedForwardState, Command]:
    """Decide what to write at ``now`` (s); pass the outcome to :func:`written`.

    Call it with every batch of samples, and at least every 0.1 s.

    Examples
    --------
    >>> settings = FeedForward(slew_percent_per_s=10.0)
    >>> good = Situation(True, True, 0.0, 40.0, Status.OK, 60.0, 1.0, InverseStatus.OK)
    >>> state, command = decide(settings, FeedForwardState(), good, now=0.0)
    >>> command.U  # begins where the valve is
    40.0
    >>> state = written(state, command, 0.0)
    >>> state, command = decide(settings, state, good, now=0.1)
    >>> command.U, state.status.name
    (41.0, 'WRITING')
    """
    reason = _reason(settings, situation)
    if not (situation.armed and situation.connected):
        fresh = replace(state, refused_U=Refusals(), refused_heartbeat=Refusals())
        return _handed_back(fresh, reason, connected=situation.connected)
    given_up = max(state.refused_U.lasted(now), state.refused_heartbeat.lasted(now)) >= GIVE_UP_S
    status = FeedForwardStatus.REFUSED if given_up else reason
    writes = reason is FeedForwardStatus.WRITING
    if state.has_stalled(now):
        state = replace(state, U=math.nan, beaten=-math.inf)
    if not state.is_led:
        pause = RESTART_S if given_up and settings.fallback is not Fallback.HOLD else RETRY_S
        waits = state.since_refusal(now) < pause
        blind = reason in {FeedForwardStatus.STALE, FeedForwardStatus.BAD_SAMPLE}
        leads = writes or settings.fallback is not Fallback.HAND_BACK
        begins = leads and not (waits or blind)
        U = _clipped(situation.U, settings.U_range) if begins else None
        return replace(state, status=status), Command(U)
    match settings.fallback:
        case Fallback.HAND_BACK if given_up or not writes:
            return _handed_back(state, status, connected=True)
        case Fallback.RAMP if given_up:  # a refused command makes a ramp impossible
            return _handed_back(state, status, connected=True)
        case Fallback.RAMP:
            otherwise = settings.fallback_U
        case Fallback.HOLD | Fallback.HAND_BACK:
            otherwise = state.U
        case _:
            assert_never(settings.fallback)
    target = situation.required_U if writes else otherwise
    return _led(settings, replace(state, status=status), target, now)


def written(
    state: FeedForwardState,
    command: Command,
    now: float,
    *,
    U_refused: bool = False,
    heartbeat_refused: bool = False,
) -> FeedForwardState:
    """Return the state after the source's response to ``command`` at ``now`` (s)."""
    if command.U is not None:
        if U_refused:
            state = replace(state, refused_U=state.refused_U.again(now))
        else:
            heartbeat = state.refused_heartbeat if state.is_led else Refusals()
            state = replace(
                state, U=command.U, t=now, refused_U=Refusals(), refused_heartbeat=heartbeat
            )
    if command.heartbeat:
        if heartbeat_refused:
            state = replace(state, refused_heartbeat=state.refused_heartbeat.again(now))
        else:
            n = command.heartbeat
            state = replace(state, heartbeat=n, beaten=now, refused_heartbeat=Refusals())
    return state


def _led(
    settings: FeedForward, state: FeedForwardState, target: float, now: float
) -> tuple[FeedForwardState, Command]:
    """Move one step towards ``target``, with a heartbeat if it is due."""
    most = settings.slew_percent_per_s * min(now - state.t, MOST_STEP_S)
    U = _clipped(target, (state.U - most, state.U + most))
    U = _clipped(U, settings.U_range)
    command = Command()
    if U == state.U:
        state = replace(state, t=now)
    elif now - state.refused_U.last >= RETRY_S:
        command = Command(U)
    due = min(now - state.beaten - HEARTBEAT_S, now - state.refused_heartbeat.last - RETRY_S) >= 0
    if settings.has_heartbeat and due:
        command = replace(command, heartbeat=state.heartbeat % MOST_HEARTBEAT + 1)
    return state, command


def _handed_back(
    state: FeedForwardState, status: FeedForwardStatus, *, connected: bool
) -> tuple[FeedForwardState, Command]:
    """Hand the valve back to the source, at once (heartbeat 0) if a heartbeat was written."""
    says = connected and math.isfinite(state.beaten)
    after = replace(state, status=status, U=math.nan, beaten=-math.inf)
    return after, Command(heartbeat=0 if says else None)


def _clipped(U: float, bounds: tuple[float, float]) -> float:
    return min(max(U, bounds[0]), bounds[1])


def _reason(settings: FeedForward, situation: Situation) -> FeedForwardStatus:
    """Return WRITING, or the first reason not to write."""
    low, high = settings.U_range
    bad = situation.map is Status.REJECTED or not math.isfinite(situation.U)
    of_answer = _OF_ANSWER[situation.answer]
    for reason, holds in (
        (FeedForwardStatus.DISARMED, not situation.armed),
        (FeedForwardStatus.SOURCE_LOST, not situation.connected),
        (FeedForwardStatus.STALE, not situation.age_s <= settings.max_age_s),
        (FeedForwardStatus.BAD_SAMPLE, bad),
        (FeedForwardStatus.MAP_NOT_GOOD, situation.map in _MAP_NOT_GOOD),
        (FeedForwardStatus.EXTRAPOLATED, situation.map is Status.EXTRAPOLATING),
        (of_answer, of_answer is not FeedForwardStatus.WRITING),
        (FeedForwardStatus.OUT_OF_RANGE, not low <= situation.required_U <= high),
        (FeedForwardStatus.TOO_UNSURE, not situation.width <= settings.max_width_percent),
    ):
        if holds:
            return reason
    return FeedForwardStatus.WRITING


_MAP_NOT_GOOD = {
    Status.WARMING_UP,
    Status.HELD,
    Status.FAILED,
    Status.UNRELIABLE,
}  # UNEXCITED is good: it only means a constant flow
_OF_ANSWER = {
    InverseStatus.OK: FeedForwardStatus.WRITING,
    InverseStatus.BELOW_REACH: FeedForwardStatus.WRITING,  # a demand of no flow closes the valve
    InverseStatus.ABOVE_REACH: FeedForwardStatus.ABOVE_REACH,
    InverseStatus.NOT_MONOTONE: FeedForwardStatus.MAP_NOT_GOOD,
    InverseStatus.UNIDENTIFIED: FeedForwardStatus.MAP_NOT_GOOD,
    InverseStatus.NOT_FINITE: FeedForwardStatus.NO_DEMAND,
    InverseStatus.OUTSIDE: FeedForwardStatus.EXTRAPOLATED,
    InverseStatus.EXTRAPOLATING: FeedForwardStatus.EXTRAPOLATED,
    InverseStatus.UNCERTAIN: FeedForwardStatus.WRITING,  # the width of U's interval has a limit
}
