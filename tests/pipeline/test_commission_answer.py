"""Whether the flow answers to U: the map's own uncertainty decides, no fixed time."""

import math

import numpy as np
import pytest

from benchmarks.commission import estimator_of
from benchmarks.commission_plant import VALVES, Happening, Loop, Plant, settings_for
from valvemap.pipeline.commission_answer import STANDS, Answers, Expected, Proof, standing
from valvemap.pipeline.commission_state import Reason
from valvemap.vocabulary.commission import Phase

U, S = np.linspace(0.0, 100.0, 33), np.linspace(2.0, 14.0, 13)


def linear(*, std=0.05, gain=0.14, known=True, wider=1.0):
    """A valve of ``gain`` l/min/√bar per %."""
    return Expected(
        U, S, np.tile(gain * U, (13, 1)), np.full((13, 33), std), np.full(33, known), wider
    )


def ratio(expected, spool, steps=20, rate=2.0, seed=0, begin=20.0, std=0.05):
    """The ratio after ``steps``; ``spool`` gives its place from the course of U until now."""
    noise, answers, course = np.random.default_rng(seed), Answers(), []
    for k in range(steps):
        course.append(begin + rate * k)
        opening = 0.14 * spool(course) + noise.normal(0.0, std)
        answers = answers.after(0.04 * k, course[-1], opening, 10.0, 100.0)
    return standing(expected, answers)


def follows(course):
    return course[-1]


def sticks(course):
    return course[min(len(course) - 1, 12)]


def test_a_spool_that_stands_is_told_from_the_travel_that_its_map_makes_significant():
    assert ratio(linear(), sticks) > STANDS
    assert ratio(linear(std=1.0), sticks) < 0.5 * STANDS
    assert ratio(linear(wider=20.0), sticks) < 0.5 * STANDS


def test_a_spool_that_follows_is_none_with_any_seed():
    assert max(ratio(linear(), follows, seed=k) for k in range(200)) < 0.5 * STANDS


@pytest.mark.parametrize("play", [2.0, 5.0, 10.0])
def test_play_at_a_turn_is_no_standing_spool(play):
    def behind(course):
        return max(course[0], course[-1] - play)

    assert ratio(linear(), behind) < 0.5 * STANDS


def test_an_error_that_the_map_has_in_common_is_none():
    assert ratio(linear(), lambda course: course[-1] + 15.0) < 0.5 * STANDS


def test_a_flat_map_one_that_is_not_known_or_none_is_no_evidence():
    assert ratio(linear(gain=0.0), sticks) < 0.5 * STANDS
    assert ratio(linear(known=False), sticks) == 0.0
    assert ratio(linear(std=math.nan), sticks) == 0.0
    assert ratio(None, sticks) == 0.0


def test_memory_is_bounded_and_the_same_sample_counts_once():
    answers = Answers()
    for k in range(500):
        answers = answers.after(0.04 * k, float(k % 100), 1.0, 10.0, 100.0)
    assert len(answers.rows) == 40
    assert answers.after(answers.arrived, 50.0, 1.0, 10.0, 100.0) is answers


def test_a_map_is_believed_after_it_foretold_what_came():
    rng, proof = np.random.default_rng(1), Proof()
    assert proof.wider == math.inf
    course = np.linspace(10.0, 40.0, 100)
    for _ in range(2):
        right = 0.14 * course + rng.normal(0.0, 0.05, 100)
        proof = proof.after(linear(), course, right, np.full(100, 10.0))
    assert proof.wider == pytest.approx(1.0, abs=0.2)
    proof = proof.after(linear(), course, 0.1 * course, np.full(100, 10.0))
    assert proof.wider > 10.0


@pytest.mark.parametrize("name", ["ordinary, no play", "two slopes, play 2 %"])
def test_a_spool_that_sticks_in_mid_travel_is_seen_within_half_a_second(name):
    valve = VALVES[name]
    stuck = Happening("stuck spool", 9.4)
    settings = settings_for(valve, sweep_s=10.0, most_s=12.0)
    loop = Loop(Plant(valve, 3), settings, stuck, estimator=estimator_of(valve)).run(14.0)
    assert (loop.state.phase, loop.state.reason) == (Phase.ABORTED, Reason.STUCK)
    at = next(t for t, phase, _ in loop.log.phases if phase is Phase.RETURNING)
    assert 0.0 < at - 9.4 < 0.5
