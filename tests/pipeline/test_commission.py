"""The commissioning's state machine: limits by construction, reactions, checks, resuming."""

import math
from dataclasses import replace

import numpy as np
import pytest

from valvemap.model.samples import Samples
from valvemap.pipeline.commission import lost, start, step, written
from valvemap.pipeline.commission_limits import MOST_STEP_S, Limits, Point, bounded
from valvemap.pipeline.commission_plan import Plan, Uncertainty, route, sweep
from valvemap.pipeline.commission_state import Command, CommissionState, Reason, Seen, Settings
from valvemap.vocabulary.commission import Phase

LIMITS = Limits((10.0, 90.0), 200.0, safe_U=20.0, p1_range=(100.0, 210.0), p_most=220.0)
SETTINGS = Settings(LIMITS, Plan(4.0, 8.0, 12.0), check_s=0.2, opening=5.0)
GOOD = Seen(age_s=0.0, U=20.0, p1=200.0, p2=100.0, Q=10.0)
STEP_S = 0.04


LOADED = replace(
    SETTINGS,
    limits=replace(LIMITS, load_range=(40.0, 160.0), load_slew_bar_per_s=300.0, safe_load=150.0),
)


def sample(seen, t):
    """The newest sample, taken at ``t`` s by a clock that is an hour ahead."""
    at = np.array([round((3600.0 + t) * 1e9)])
    values = (np.array([x]) for x in (seen.U, seen.p1, seen.p2, seen.Q, 40.0))
    return Samples.of(at, *values)


class Course:
    """Steps in simulated time; the valve follows its command at once."""

    def __init__(self, settings=SETTINGS, seen=GOOD, response_s=0.0):
        self.settings, self.seen, self.now, self.response_s = settings, seen, 0.0, response_s
        self.state, self.writes, self.loads = start(CommissionState(), 0.0), [], []
        self.late_s = 0.0

    def steps(self, seconds, **seen):
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            U = self.state.at.U if self.state.is_led else self.seen.U
            flow = {"Q": 0.1 * U * math.sqrt(100.0)} | seen
            self.seen = Seen(**{**vars(self.seen), "U": U, **flow})
            self.seen = replace(self.seen, came=sample(self.seen, self.now - self.late_s))
            self.state, command = step(self.settings, self.state, self.seen, self.now)
            if command.U is not None:
                self.writes.append((self.now, command.U))
            if command.load is not None:
                self.loads.append((self.now, command.load))
            self.state = written(self.state, command, self.now + self.response_s)
        return self.state


def test_every_command_is_within_range_and_slew_whatever_is_wanted():
    rng = np.random.default_rng(0)
    at = Point(50.0)
    for wanted in [math.nan, math.inf, -math.inf, *rng.uniform(-1e3, 1e3, 500).tolist()]:
        passed = float(rng.uniform(-1.0, 1.0))
        new = bounded(LIMITS, at, Point(wanted), passed)
        assert 10.0 <= new.U <= 90.0
        assert abs(new.U - at.U) <= 200.0 * min(max(passed, 0.0), MOST_STEP_S) + 1e-12
        at = new


def test_it_begins_where_the_valve_is_and_sweeps_both_ways_to_both_ends():
    course = Course()
    assert course.steps(10.0).phase is Phase.REFINING
    U = np.array(course.writes)[:, 1]
    assert U[0] == 20.0
    assert (U.min(), U.max()) == (10.0, pytest.approx(90.0, abs=2.0))
    assert (np.diff(U) > 0).any() and (np.diff(U) < 0).any()  # noqa: PT018 - both ways


@pytest.mark.parametrize(("response_s", "slew"), [(0.03, 200.0), (0.0, 25.0), (0.03, 100.0)])
def test_both_ends_are_reached_however_late_the_responses_and_small_the_slew(response_s, slew):
    limits = replace(LIMITS, slew_percent_per_s=slew)
    settings = replace(SETTINGS, limits=limits, plan=Plan(4.0, 14.0, 20.0))
    course = Course(settings, response_s=response_s)
    course.steps(14.0)
    t, U = np.array(course.writes).T
    assert (U.min(), U.max()) == pytest.approx((10.0, 90.0), abs=2.0)
    assert (np.abs(np.diff(U)) <= slew * (np.diff(t) - response_s) + 1e-9).all()


def test_it_ends_in_time_at_the_safe_u_and_hands_the_valve_back():
    course = Course()
    state = course.steps(14.0)
    assert (state.phase, state.reason) == (Phase.DONE, Reason.TIME_UP)
    assert course.writes[-1][1] == 20.0
    assert not state.is_led


def test_it_ends_as_soon_as_the_map_is_accurate_enough():
    course = Course(Settings(LIMITS, Plan(4.0, 2.0, 60.0), accuracy=0.2, check_s=0.2))
    course.steps(4.0, error=0.3)
    state = course.steps(2.0, error=0.1)
    assert (state.phase, state.reason) == (Phase.DONE, Reason.ACCURATE)


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        ({"abort": True}, Reason.OPERATOR),
        ({"operator_age_s": 5.0}, Reason.OPERATOR_GONE),
        ({"p1": 250.0}, Reason.PRESSURE),
        ({"p2": 250.0}, Reason.PRESSURE),
    ],
)
def test_it_aborts_to_the_safe_u(seen, reason):
    course = Course()
    course.steps(2.5)
    at, before = course.now, len(course.writes)
    state = course.steps(2.0, **seen)
    assert (state.phase, state.reason) == (Phase.ABORTED, reason)
    after = course.writes[before:]
    assert after[0][0] - at <= 0.2
    assert next(t for t, U in after if U == 20.0) - at <= 0.5


def test_a_late_operator_moves_u_to_safety_at_once_and_the_run_goes_on_when_he_is_back():
    course = Course()
    elapsed = course.steps(3.0).elapsed
    at, before = course.now, len(course.writes)
    state = course.steps(0.4, operator_late_s=0.11, operator_age_s=0.21)
    assert (state.phase, state.reason) == (Phase.PAUSED, Reason.OPERATOR_LATE)
    after = course.writes[before:]
    assert abs(after[0][1] - 20.0) < abs(course.writes[before - 1][1] - 20.0)
    assert next(t for t, U in after if U == 20.0) - at <= 0.4
    state = course.steps(0.8, operator_late_s=0.0, operator_age_s=0.0)
    assert state.phase is Phase.SWEEPING
    assert state.elapsed - elapsed < 0.5


def test_limits_are_watched_while_the_operator_is_late():
    course = Course()
    course.steps(3.0)
    state = course.steps(0.2, operator_late_s=0.5, p1=250.0)
    assert state.reason is Reason.PRESSURE


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        ({"feed_forward": True}, Reason.FEED_FORWARD),
        ({"U": 5.0}, Reason.U_OUTSIDE),
        ({"p1": 50.0, "p2": 100.0}, Reason.P_ORDER),
        ({"p1": 90.0, "p2": 50.0}, Reason.LIMIT_BEFORE),
    ],
)
def test_it_refuses_before_the_first_command(seen, reason):
    course = Course(seen=Seen(**{**vars(GOOD), **seen}))
    state = course.steps(1.0, **seen)
    assert (state.phase, state.reason) == (Phase.REFUSED, reason)
    assert course.writes == []


def test_a_second_writer_is_seen_before_and_after_the_first_command():
    course = Course()
    course.steps(0.08)
    assert course.steps(0.08, U=40.0).reason is Reason.OTHER_WRITER
    course = Course()
    course.steps(2.0)
    assert course.steps(1.0, U=0.0).reason is Reason.NOT_FOLLOWED


def test_a_measured_u_that_stands_moves_u_to_safety_at_once_then_ends_the_run():
    course = Course()
    course.steps(5.0)
    at, before, stands = course.now, len(course.writes), course.state.at.U
    state = course.steps(0.3, U=stands)
    assert (state.phase, state.reason) == (Phase.PAUSED, Reason.U_LATE)
    after = course.writes[before:]
    turned = next(t for t, U in after if abs(U - 20.0) < abs(after[0][1] - 20.0) - 1.0)
    assert turned - at <= 0.2
    state = course.steps(1.0, U=stands)
    assert (state.phase, state.reason) == (Phase.ABORTED, Reason.NOT_FOLLOWED)


def test_a_measured_u_that_is_late_once_pauses_the_run_once():
    course, pauses = Course(), 0
    course.steps(5.0)
    for _ in range(3):
        was, stands = course.state.phase, course.state.at.U
        for _ in range(5):
            course.steps(STEP_S, U=stands)
        pauses += course.state.phase is Phase.PAUSED
        assert was is not Phase.PAUSED
        course.steps(1.0)
    assert (pauses, course.state.phase) == (1, Phase.SWEEPING)


@pytest.mark.parametrize("late_s", [0.0, 0.4, 0.8])
def test_u_is_compared_with_the_commands_of_its_own_time(late_s):
    """Samples that come later and later show U as it was; another writer is still seen."""
    course = Course(replace(SETTINGS, follow_s=0.1))
    course.steps(2.0)
    past = dict(course.writes)
    for _ in range(30):
        course.late_s = min(course.late_s + 0.02, late_s)
        then = course.now + STEP_S - course.late_s
        was = [U for t, U in past.items() if t <= then]
        assert course.steps(STEP_S, U=was[-1]).reason is Reason.NONE
        past = dict(course.writes)
    assert course.steps(1.0 + late_s, U=0.0).reason is Reason.NOT_FOLLOWED


def test_a_stuck_spool_ends_the_run():
    course = Course()
    state = course.steps(8.0, Q=30.0)
    assert (state.phase, state.reason) == (Phase.ABORTED, Reason.STUCK)


def test_u_retreats_from_a_limit_and_the_run_goes_on():
    course = Course()
    course.steps(1.6)
    before = course.state.at.U
    state = course.steps(0.3, p1=90.0)
    assert state.reason is Reason.LIMIT
    assert before > state.at.U
    assert course.steps(14.0).phase is Phase.DONE


@pytest.mark.parametrize("seen", [{"age_s": 1.0}, {"Q": math.nan}, {"good": False}])
def test_it_pauses_at_the_safe_u_while_samples_fail_then_continues_where_it_was(seen):
    course = Course()
    elapsed = course.steps(3.0).elapsed
    state = course.steps(1.0, **seen)
    assert (state.phase, state.at.U) == (Phase.PAUSED, 20.0)
    good = {"age_s": 0.0, "good": True}
    state = course.steps(0.8, **good)
    assert state.phase is Phase.SWEEPING
    assert 0.0 < state.elapsed - elapsed < 0.5


def test_after_a_lost_source_it_leads_again_from_the_measured_u():
    course = Course()
    course.steps(3.0)
    course.steps(1.0, connected=False)
    assert not course.state.is_led
    course.seen = Seen(**{**vars(course.seen), "U": 33.0})
    n = len(course.writes)
    course.steps(0.8, connected=True)
    assert course.writes[n][1] == 33.0


def test_a_write_without_a_response_is_followed_by_the_measured_u():
    course = Course()
    course.steps(3.0)
    course.state = lost(course.state, course.now)
    assert (course.state.phase, course.state.is_led) == (Phase.PAUSED, False)


def refused_for(steps):
    course = Course()
    course.steps(2.0)
    for _ in range(steps):
        course.now += STEP_S
        course.seen = replace(course.seen, came=sample(course.seen, course.now))
        course.state, command = step(SETTINGS, course.state, course.seen, course.now)
        refused = command != Command()
        course.state = written(course.state, Command(), course.now, refused=refused)
    return course


def test_refused_commands_end_the_run():
    course = refused_for(40)
    assert course.state.reason in {Reason.NOT_TAKEN, Reason.NOT_FOLLOWED}


def test_commands_refused_for_a_moment_do_not_end_the_run():
    course = refused_for(11)
    assert course.steps(1.0).phase is Phase.SWEEPING


def test_a_response_later_than_the_sources_watchdog_pauses_the_run():
    course = Course()
    course.steps(3.0)
    course.now += STEP_S
    course.state, command = step(SETTINGS, course.state, course.seen, course.now)
    beat = Command(command.U, heartbeat=course.state.heartbeat + 1)
    course.now += 0.5
    course.state = written(course.state, beat, course.now)
    assert (course.state.phase, course.state.reason) == (Phase.PAUSED, Reason.STALLED)
    assert not course.state.is_led
    assert course.steps(1.0).phase is Phase.SWEEPING


def test_two_heartbeats_pause_the_run_if_the_first_may_have_come_too_long_before_the_second():
    """Each response is in time; the first was late, and the second heartbeat was."""
    course = Course()
    course.steps(3.0)
    for sent_s, answered_s in ((0.1, 0.3), (0.39, 0.6)):
        course.state, command = step(SETTINGS, course.state, course.seen, 3.0 + sent_s)
        beat = Command(command.U, heartbeat=course.state.heartbeat + 1)
        course.state = written(course.state, beat, 3.0 + answered_s)
    assert (course.state.phase, course.state.reason) == (Phase.PAUSED, Reason.STALLED)


def test_the_triangles_of_u_and_load_have_periods_without_a_common_multiple():
    plan, limits = Plan(4.0), Limits(load_range=(10.0, 190.0))
    points = np.array([vars(sweep(plan, limits, t))["load"] for t in np.arange(0.0, 40.0, 4.0)])
    assert len(np.unique(points.round(3))) == len(points)


def test_the_last_triangle_of_a_sweep_may_be_slower_and_u_never_jumps():
    plan = Plan(8.0, sweep_s=61.0, most_s=61.0, last_period_s=52.0)
    t = np.arange(0.0, 61.0, 0.01)
    U = np.array([sweep(plan, Limits(), at).U for at in t])
    pace = np.abs(np.diff(U)) / 0.01
    assert plan.last() == (8.0, 53.0)
    assert np.allclose(pace[t[1:] < 8.0], 25.0)
    assert np.allclose(pace[t[:-1] > 8.0], 200.0 / 53.0, atol=0.1)
    assert pace.max() < 25.1


def test_refinement_goes_where_the_variance_is_and_comes_back_from_the_other_side():
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(0, 100, 21), np.linspace(5, 190, 9)))
    variance = np.where(U > 80.0, 1.0, 1e-4)
    limits = Limits()
    at = Uncertainty(U, dp, variance)
    moves = route(limits, Plan().pace(limits), Point(10.0), Point(10.0, 100.0), at)
    assert max(move.U for move in moves) > 80.0
    assert moves == moves[::-1]


def test_the_load_begins_where_it_is_and_keeps_its_range_and_slew():
    course = Course(LOADED)
    state = course.steps(14.0)
    t, load = np.array(course.loads).T
    assert (state.phase, load[0], load[-1]) == (Phase.DONE, 100.0, 150.0)
    assert (load.min(), load.max()) == pytest.approx((40.0, 160.0), abs=2.0)
    assert (np.abs(np.diff(load)) <= 300.0 * np.diff(t) + 1e-9).all()


@pytest.mark.parametrize("fault", [{"abort": True}, {"p2": 250.0}, {"operator_age_s": 5.0}])
def test_an_abort_takes_the_load_to_its_safe_value_too(fault):
    course = Course(LOADED)
    course.steps(3.0)
    at = course.now
    assert course.steps(1.0, **fault).phase is Phase.ABORTED
    assert course.loads[-1][1] == 150.0
    assert next(t for t, U in course.writes if t > at and U == 20.0) - at <= 0.5


def test_a_refused_load_is_offered_again_with_u_held_then_ends_the_run():
    course = Course(LOADED)
    for _ in range(40):
        course.now += STEP_S
        course.state, command = step(LOADED, course.state, course.seen, course.now)
        if command.U is not None:
            course.writes.append((course.now, command.U))
        taken = replace(command, load=None)
        course.state = written(course.state, taken, course.now, refused=taken != command)
    assert course.state.reason is Reason.NOT_TAKEN
    assert {U for _, U in course.writes} == {20.0}


def test_after_a_pause_of_its_own_it_leads_again_from_the_measured_u():
    course = Course()
    course.steps(3.0)
    course.now += 0.6  # the process was held up; the source has taken the valve back
    course.seen = Seen(**{**vars(course.seen), "U": 33.0})
    n = len(course.writes)
    course.state, _ = step(SETTINGS, course.state, course.seen, course.now)
    assert (course.state.phase, course.state.reason) == (Phase.PAUSED, Reason.STALLED)
    assert not course.state.is_led
    assert course.steps(0.8).phase is Phase.SWEEPING
    assert course.writes[n][1] == 33.0
