"""The state machine of feed-forward: hand-computed cases, and what holds whatever comes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvemap.pipeline.feedforward import (
    GIVE_UP_S,
    RESTART_S,
    Command,
    Fallback,
    FeedForward,
    FeedForwardState,
    Situation,
    decide,
    written,
)
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.statuses import InverseStatus, Status

GOOD = Situation(
    armed=True,
    connected=True,
    age_s=0.1,
    U=40.0,
    map=Status.OK,
    required_U=60.0,
    width=1.0,
    answer=InverseStatus.OK,
)
HOLD = FeedForward(U_range=(10.0, 90.0), slew_percent_per_s=20.0, has_heartbeat=True)
RAMP = replace(HOLD, fallback=Fallback.RAMP, fallback_U=15.0)
HAND_BACK = replace(HOLD, fallback=Fallback.HAND_BACK)


def step(settings, state, situation, now, **refused):
    """Decide, and have the source answer at once."""
    state, command = decide(settings, state, situation, now)
    return written(state, command, now, **refused), command


def run(settings, situation, times, state=None, **refused):
    """Ask at several times; return the last state and the commands."""
    state, commands = state or FeedForwardState(), []
    for now in times:
        state, command = step(settings, state, situation, now, **refused)
        commands.append(command)
    return state, commands


def at_target(settings):
    """Led to 60 % after 10 s."""
    state, commands = run(settings, GOOD, np.arange(0.0, 10.0, 0.1))
    assert commands[-1].U is None
    assert state.U == 60.0
    return state


def test_the_command_begins_where_the_valve_is_and_goes_at_the_slew():
    state, commands = run(HOLD, GOOD, [0.0, 0.1, 0.2, 0.3])
    assert [c.U for c in commands] == pytest.approx([40.0, 42.0, 44.0, 46.0])
    assert [c.heartbeat for c in commands] == [None, 1, 2, 3]
    assert state.status is FeedForwardStatus.WRITING


def test_after_a_long_pause_it_goes_no_further_than_in_a_fifth_of_a_second():
    _, commands = run(HOLD, GOOD, [0.0, 30.0])
    assert pytest.approx(40.0 + 0.2 * 20.0) == commands[-1].U


def test_a_demand_that_changes_after_a_long_calm_is_not_answered_by_a_jump():
    state = at_target(HOLD)
    _, (command,) = run(HOLD, replace(GOOD, required_U=20.0), [10.0], state)
    assert pytest.approx(60.0 - 0.1 * 20.0) == command.U


def test_a_valve_outside_the_range_is_led_from_the_nearest_end():
    _, (command,) = run(HOLD, replace(GOOD, U=3.0), [0.0])
    assert command == Command(10.0)


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"age_s": 0.51}, FeedForwardStatus.STALE),
        ({"age_s": math.nan}, FeedForwardStatus.STALE),
        ({"map": Status.REJECTED}, FeedForwardStatus.BAD_SAMPLE),
        ({"U": math.nan}, FeedForwardStatus.BAD_SAMPLE),
        ({"map": Status.WARMING_UP}, FeedForwardStatus.MAP_NOT_GOOD),
        ({"map": Status.HELD}, FeedForwardStatus.MAP_NOT_GOOD),
        ({"map": Status.EXTRAPOLATING}, FeedForwardStatus.EXTRAPOLATED),
        ({"answer": InverseStatus.ABOVE_REACH}, FeedForwardStatus.ABOVE_REACH),
        ({"answer": InverseStatus.NOT_MONOTONE}, FeedForwardStatus.MAP_NOT_GOOD),
        ({"answer": InverseStatus.UNIDENTIFIED}, FeedForwardStatus.MAP_NOT_GOOD),
        ({"answer": InverseStatus.NOT_FINITE}, FeedForwardStatus.NO_DEMAND),
        ({"answer": InverseStatus.OUTSIDE}, FeedForwardStatus.EXTRAPOLATED),
        ({"answer": InverseStatus.EXTRAPOLATING}, FeedForwardStatus.EXTRAPOLATED),
        ({"required_U": 91.0}, FeedForwardStatus.OUT_OF_RANGE),
        ({"required_U": math.nan}, FeedForwardStatus.OUT_OF_RANGE),
        ({"width": 10.1}, FeedForwardStatus.TOO_UNSURE),
        ({"width": math.nan}, FeedForwardStatus.TOO_UNSURE),
    ],
)
def test_each_reason_is_named_and_the_fallback_acts_at_once(change, status):
    bad = replace(GOOD, **{"required_U": 80.0, **change})
    times = [10.0, 10.1, 10.2]
    state, commands = run(HOLD, bad, times, at_target(HOLD))
    assert state.status is status
    assert [c.U for c in commands] == [None] * 3  # holds 60 %
    assert all(c.heartbeat for c in commands)
    _, commands = run(RAMP, bad, times, at_target(RAMP))
    assert [c.U for c in commands] == pytest.approx([58.0, 56.0, 54.0])
    state, commands = run(HAND_BACK, bad, times, at_target(HAND_BACK))
    assert commands == [Command(heartbeat=0), Command(), Command()]
    assert state.status is status


def test_every_answer_and_every_status_has_its_reason():
    for answer in InverseStatus:
        for status in Status:
            state, _ = decide(
                HOLD, FeedForwardState(), replace(GOOD, answer=answer, map=status), 0.0
            )
            good = (
                {InverseStatus.OK, InverseStatus.BELOW_REACH, InverseStatus.UNCERTAIN},
                {
                    Status.OK,
                    Status.FROZEN,
                    Status.UNEXCITED,
                },
            )
            writes = answer in good[0] and status in good[1]
            assert (state.status is FeedForwardStatus.WRITING) == writes
    assert all(status.sentence for status in FeedForwardStatus)


def test_who_demands_less_than_the_closed_valve_passes_gets_it_closed():
    wide = replace(HOLD, U_range=(0.0, 100.0))
    closing = replace(GOOD, required_U=0.0, answer=InverseStatus.BELOW_REACH)
    state, _ = run(wide, closing, np.arange(0.0, 5.0, 0.1))
    assert state.U == 0.0


def test_what_was_handed_back_is_taken_again_where_the_valve_is_by_then():
    state, _ = run(HAND_BACK, replace(GOOD, age_s=1.0), [10.0], at_target(HAND_BACK))
    _, commands = run(HAND_BACK, replace(GOOD, U=12.0), [10.1, 10.2], state)
    assert commands[0] == Command(12.0)
    assert pytest.approx(14.0) == commands[1].U
    assert commands[1].heartbeat > state.heartbeat


def test_after_a_standstill_of_ours_the_valve_is_led_from_where_it_is_by_then():
    state = at_target(HOLD)
    assert not state.has_stalled(10.2)
    _, commands = run(HOLD, replace(GOOD, U=12.0), [10.5, 10.6], state)
    assert commands[0] == Command(12.0)  # the source's watchdog may have acted: 60 % is no more
    assert commands[1].heartbeat == state.heartbeat + 1


def test_armed_without_a_demand_the_valve_is_held_where_it_is():
    waiting = replace(GOOD, answer=InverseStatus.NOT_FINITE, required_U=math.nan, width=math.nan)
    _, commands = run(HOLD, waiting, [0.0, 0.1, 0.2])
    assert commands == [Command(40.0), Command(heartbeat=1), Command(heartbeat=2)]


@pytest.mark.parametrize("change", [{"age_s": 9.0}, {"map": Status.REJECTED}])
def test_without_knowing_where_the_valve_is_nothing_begins(change):
    _, commands = run(HOLD, replace(GOOD, **change), [0.0, 0.1])
    assert commands == [Command(), Command()]


def test_disarming_hands_back_at_once_and_arming_begins_anew():
    state, commands = run(HOLD, replace(GOOD, armed=False), [10.0, 10.1], at_target(HOLD))
    assert commands == [Command(heartbeat=0), Command()]
    assert state.status is FeedForwardStatus.DISARMED
    _, (command,) = run(HOLD, GOOD, [10.2], state)
    assert command == Command(40.0)


def test_without_a_connection_nothing_is_written():
    state, commands = run(HOLD, replace(GOOD, connected=False), [10.0], at_target(HOLD))
    assert commands == [Command()]
    assert state.status is FeedForwardStatus.SOURCE_LOST


def test_a_refused_command_is_repeated_and_goes_on_from_what_the_source_has():
    state, commands = run(
        HOLD, replace(GOOD, required_U=80.0), [10.0, 10.05, 10.1], at_target(HOLD), U_refused=True
    )
    assert [c.U for c in commands] == pytest.approx([62.0, None, 64.0])
    assert state.U == 60.0
    state, command = step(HOLD, state, replace(GOOD, required_U=80.0), 10.2)
    assert pytest.approx(64.0) == command.U
    assert state.U == command.U


def test_refused_for_long_a_held_valve_stays_led_and_others_are_handed_back():
    up = replace(GOOD, required_U=80.0)
    times = np.arange(10.0, 10.55, 0.1)
    state, commands = run(HOLD, up, times, at_target(HOLD), U_refused=True)
    assert state.status is FeedForwardStatus.REFUSED
    assert all(c.U is not None and c.heartbeat for c in commands)
    for ground in (RAMP, HAND_BACK):
        state, commands = run(ground, up, times, at_target(ground), U_refused=True)
        assert state.status is FeedForwardStatus.REFUSED
        first = [c.heartbeat for c in commands].index(0)
        assert times[first] - times[0] <= GIVE_UP_S + 0.1
        assert commands[first + 1 :] == [Command()] * (len(times) - first - 1)
        _, commands = run(ground, up, [10.4 + RESTART_S, 10.5 + RESTART_S], state)
        assert commands[0] == Command(40.0)
        assert commands[1].heartbeat


def test_a_refused_heartbeat_counts_like_a_refused_command():
    state, commands = run(
        RAMP, GOOD, np.arange(10.0, 10.55, 0.1), at_target(RAMP), heartbeat_refused=True
    )
    assert state.status is FeedForwardStatus.REFUSED
    assert commands[-1] == Command()


def test_a_heartbeat_never_is_zero():
    state = replace(at_target(HOLD), heartbeat=2**32 - 1)
    _, (command,) = run(HOLD, GOOD, [10.0], state)
    assert command.heartbeat == 1


def test_a_source_without_a_heartbeat_is_written_none():
    bare = replace(HOLD, has_heartbeat=False)
    state, commands = run(bare, GOOD, [0.0, 0.1, 0.2])
    assert all(c.heartbeat is None for c in commands)
    _, (command,) = run(bare, replace(GOOD, armed=False), [0.3], state)
    assert command == Command()


def test_asked_every_tenth_of_a_second_the_heart_beats_five_times_a_second():
    for interval in (0.001, 0.017, 0.05, 0.079, 0.1):
        _, commands = run(HOLD, GOOD, np.arange(0.0, 3.0, interval))
        assert sum(c.heartbeat is not None for c in commands) >= 5 * 2.8


numbers = st.one_of(st.floats(-20.0, 120.0), st.sampled_from([math.nan, math.inf, -math.inf]))
situations = st.builds(
    Situation,
    armed=st.sampled_from([True] * 9 + [False]),
    connected=st.sampled_from([True] * 9 + [False]),
    age_s=st.one_of(st.floats(0.0, 0.5), st.floats(-1.0, 5.0), st.just(math.nan)),
    U=numbers,
    map=st.sampled_from([Status.OK] * 6 + list(Status)),
    required_U=numbers,
    width=st.one_of(st.floats(0.0, 10.0), numbers),
    answer=st.sampled_from([InverseStatus.OK] * 8 + list(InverseStatus)),
)
moments = st.tuples(
    situations,
    st.floats(0.0, 0.3),  # until it is asked
    st.floats(0.0, 0.1),  # until the source has answered
    st.sampled_from([False] * 5 + [True]),
    st.sampled_from([False] * 5 + [True]),
)


@settings(max_examples=300)
@given(
    st.sampled_from([HOLD, RAMP, HAND_BACK]),
    st.lists(moments, min_size=1, max_size=60),
)
def test_whatever_comes_range_and_slew_are_never_left_and_the_fallback_acts_at_once(ground, course):
    state, now, taken = FeedForwardState(), 0.0, None
    low, high = ground.U_range
    for situation, pause, delay, U_refused, heartbeat_refused in course:
        now += pause
        before = state
        state, command = decide(ground, before, situation, now)
        if command.U is not None:
            assert low <= command.U <= high
            assert situation.armed
            assert situation.connected
        begins = not before.is_led or before.has_stalled(now)
        if not begins and command.U is not None:  # as the source sees it, whenever it answered
            U, at = taken
            assert abs(command.U - U) <= ground.slew_percent_per_s * (now - at) + 1e-9
        if state.status is not FeedForwardStatus.WRITING and not begins:
            match ground.fallback:
                case Fallback.HAND_BACK:
                    assert not state.is_led
                    assert not command.heartbeat
                case Fallback.RAMP if command.U is not None:
                    assert abs(command.U - 15.0) <= abs(before.U - 15.0)
                case Fallback.HOLD if state.status is not FeedForwardStatus.REFUSED:
                    assert command.U is None
        now += delay
        state = written(
            state, command, now, U_refused=U_refused, heartbeat_refused=heartbeat_refused
        )
        if command.U is not None and not U_refused:
            taken = command.U, now
