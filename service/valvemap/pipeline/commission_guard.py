"""Guards of a commissioning run: what refuses, pauses, limits and ends it. Pure."""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.pipeline.commission_answer import STANDS, Answers, standing
from valvemap.pipeline.commission_follow import STEP_BACK_NS
from valvemap.pipeline.commission_limits import Limits
from valvemap.pipeline.commission_state import CommissionState, Reason, Seen, Settings
from valvemap.vocabulary.commission import Phase
from valvemap.vocabulary.statuses import Quality

STILL_U: Final = 1.0  # %; change of U during the checks that shows another writer
STUCK_SPAN: Final = 0.6  # share of the range of U without a change of the opening: stuck
STUCK_CHANGE: Final = 0.08  # 1; change of Q/√Δp, share of the largest, below which it is none
STALLED_S: Final = 0.4  # s without a heartbeat, after which the source may have the valve
DROP_TO_JUDGE: Final = 10.0  # bar; the opening is judged above it


def noted(settings: Settings, state: CommissionState, seen: Seen, now: float) -> CommissionState:
    """Update what the checks remember."""
    usable = fault(settings, seen) is Reason.NONE
    watch = state.watch
    if len(seen.came):
        commands = watch.commands.heard(int(seen.came.t[-1]), now).since(settings.follow_s)
        if usable and state.is_led:
            commands = commands.showed(seen.U, settings.follow_percent)
        watch = replace(watch, commands=commands)
    may_move = waits_for(settings, replace(state, watch=watch), seen) is Reason.NONE
    good_since = min(state.good_since, now) if may_move else math.inf
    drop = seen.p1 - seen.p2
    if usable:
        answers = _answers(watch.answers, seen, settings.limits.U_span)
        watch = replace(watch, answers=answers)
    if usable and abs(drop) > DROP_TO_JUDGE:
        opening = seen.Q / math.sqrt(abs(drop))
        spool = watch.answers.spools[-1] if watch.answers.spools else seen.U  # the slowest
        watch = replace(
            watch,
            U=(min(watch.U[0], seen.U), max(watch.U[1], seen.U)),
            spool=(min(watch.spool[0], spool), max(watch.spool[1], spool)),
            opening=(min(watch.opening[0], opening), max(watch.opening[1], opening)),
            most=max(watch.most, abs(opening)),
        )
    beyond = now if usable and _is_beyond(settings.limits, seen) else state.beyond
    return replace(state, good_since=good_since, watch=watch, beyond=beyond)


def fault(settings: Settings, seen: Seen) -> Reason:
    """Return why the newest sample cannot be used, or NONE."""
    if not seen.connected:
        return Reason.SOURCE_LOST
    if not seen.age_s <= settings.max_age_s:
        return Reason.STALE
    finite = all(math.isfinite(x) for x in (seen.U, seen.p1, seen.p2, seen.Q))
    return Reason.NONE if seen.good and finite else Reason.BAD_SAMPLE


def waits_for(settings: Settings, state: CommissionState, seen: Seen) -> Reason:
    """Return why U does not move now: of samples, operator, or the measured U; or NONE."""
    found = fault(settings, seen)
    if found is not Reason.NONE:
        return found
    if seen.operator_late_s > settings.operator_late_s:
        return Reason.OPERATOR_LATE
    commands = state.watch.commands
    usual_s = commands.usual_s(settings.follow_s, settings.limits.U_span)
    is_late = not commands.are_followed(seen.U, usual_s, settings.follow_percent)
    return Reason.U_LATE if state.is_led and is_late else Reason.NONE


def refusal(settings: Settings, state: CommissionState, seen: Seen, now: float) -> Reason:
    """Return why a run does not begin, or NONE."""
    low, high = settings.limits.U_range
    moved = state.watch.U[1] - state.watch.U[0] > STILL_U
    found = fault(settings, seen)
    usable = found is Reason.NONE
    for reason, holds in (
        (Reason.OPERATOR, seen.abort),
        (Reason.OPERATOR_GONE, seen.operator_age_s > settings.operator_s),
        (Reason.FEED_FORWARD, seen.feed_forward),
        (Reason.OTHER_WRITER, moved),
        (Reason.U_OUTSIDE, usable and not low <= seen.U <= high),
        (Reason.P_ORDER, usable and seen.p1 < seen.p2 - 1.0 and seen.Q > 0.0),
        (Reason.LIMIT_BEFORE, state.beyond == now),
        (
            waits_for(settings, state, seen),
            now - state.since > settings.check_s + settings.outage_s,
        ),
    ):
        if holds:
            return reason
    return Reason.NONE


def ending(settings: Settings, state: CommissionState, seen: Seen, now: float) -> Reason:
    """Return why the run ends early, or NONE."""
    high = settings.limits.p_most
    fresh = fault(settings, seen) is Reason.NONE
    for reason, holds in (
        (Reason.OPERATOR, seen.abort),
        (Reason.OPERATOR_GONE, seen.operator_age_s > settings.operator_s),
        (Reason.PRESSURE, fresh and max(seen.p1, seen.p2) > high),
        (Reason.NOT_FOLLOWED, fresh and state.is_led and not _follows(settings, state, seen)),
        (Reason.STUCK, fresh and _is_stuck(settings, state)),
        (Reason.NOT_TAKEN, now - state.refused_since > settings.follow_s),
        (Reason.OUTAGE, state.phase is Phase.PAUSED and now - state.since > settings.outage_s),
    ):
        if holds:
            return reason
    return Reason.NONE


def has_stalled(settings: Settings, state: CommissionState, now: float) -> bool:
    """Whether the last heartbeat is so old that the source may have taken the valve back."""
    return settings.has_heartbeat and state.is_led and now - state.beaten > STALLED_S


def past_half_turn(settings: Settings, state: CommissionState) -> CommissionState:
    """Drop the extremes once the spool has covered enough with a changing opening."""
    watch = state.watch
    if watch.spool[1] - watch.spool[0] < STUCK_SPAN * settings.limits.U_span:
        return state
    return replace(state, watch=watch.without_extremes())


def _answers(answers: Answers, seen: Seen, span: float) -> Answers:
    """Return the memory with the samples; after a step back of the source's clock, theirs alone."""
    good = seen.came[seen.came.quality == Quality.GOOD]
    good = good[np.isfinite(good.U) & np.isfinite(good.Q) & (np.abs(good.dp) > DROP_TO_JUDGE)]
    if len(good) and good.t[-1] < answers.t - STEP_BACK_NS:
        answers = answers.begun_anew()
    s = np.sqrt(np.abs(good.dp))
    columns = (good.t, good.U, good.Q / s, s)
    for t, U, opening, root in zip(*(x.tolist() for x in columns), strict=True):
        answers = answers.after(t, U, opening, root, span, seen.expected)
    return answers


def _is_beyond(limits: Limits, seen: Seen) -> bool:
    pairs = (seen.p1, limits.p1_range), (seen.p2, limits.p2_range), (seen.Q, limits.Q_range)
    return any(not low <= x <= high for x, (low, high) in pairs)


def _follows(settings: Settings, state: CommissionState, seen: Seen) -> bool:
    """Whether the newest U is near a command of its own time."""
    commands = state.watch.commands
    return commands.are_followed(seen.U, settings.follow_s, settings.follow_percent)


def _is_stuck(settings: Settings, state: CommissionState) -> bool:
    """Whether the flow stands: by the map, and where it is not known yet, over most of U."""
    watch = state.watch
    if standing(watch.answers) > STANDS:
        return True
    if watch.spool[1] - watch.spool[0] < STUCK_SPAN * settings.limits.U_span:
        return False
    most = max(watch.most, settings.opening)
    return watch.opening[1] - watch.opening[0] < STUCK_CHANGE * most
