"""Whether the flow answers to U: the map's own uncertainty decides, no fixed time."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.commission import estimator_of
from benchmarks.commission_plant import (
    PUBLISHED_S,
    SAMPLE_S,
    VALVES,
    Happening,
    Loop,
    Plant,
    settings_for,
)
from support.soaked import soaked
from valvemap.model.samples import Samples
from valvemap.pipeline.commission_answer import STANDS, Answers, Expected, Proof, standing
from valvemap.pipeline.commission_guard import noted
from valvemap.pipeline.commission_state import CommissionState, Reason, Seen, Settings
from valvemap.vocabulary.commission import Phase

U, S = np.linspace(0.0, 100.0, 33), np.linspace(2.0, 14.0, 13)


def linear(*, std=0.05, gain=0.14, known=True, number=0):
    """A valve of ``gain`` l/min/√bar per %."""
    opening = np.tile(gain * U, (13, 1))
    return Expected(
        U, S, opening, np.full((13, 33), std), np.full(33, known), number, 10.0 * min(std, 0.05)
    )


def after(answers, k, U, opening, expected=None):
    """The memory with a sample at 40 ms times ``k``."""
    return answers.after(40_000_000 * k, U, opening, 10.0, 100.0, expected)


def ratio(expected, spool, steps=20, rate=2.0, seed=0, begin=20.0, std=0.05, refit=0):
    """The ratio after ``steps``; ``spool`` gives its place from the course of U until now.

    Each ``refit`` steps there is another map, off by a constant of its own.
    """
    noise, course = np.random.default_rng(seed), []
    answers = Answers(proof=Proof(errors=(1.0, 1.0)))
    for k in range(steps):
        course.append(begin + rate * k)
        opening = 0.14 * spool(course) + noise.normal(0.0, std)
        if refit and k % refit == 0:
            off = noise.normal(0.0, 1.0)
            expected = replace(expected, opening=linear().opening + off, number=k)
        answers = after(answers, k, course[-1], opening, expected)
    return standing(answers)


def follows(course):
    return course[-1]


def sticks(course):
    return course[min(len(course) - 1, 12)]


def test_a_spool_that_stands_is_told_from_the_travel_that_its_map_makes_significant():
    assert ratio(linear(), sticks) > STANDS
    assert ratio(linear(std=1.0), sticks) < 0.5 * STANDS


def test_a_spool_that_follows_is_none_with_any_seed():
    assert max(ratio(linear(), follows, seed=k) for k in range(200)) < 0.5 * STANDS


@pytest.mark.parametrize("play", [2.0, 5.0, 10.0])
def test_play_at_a_turn_is_no_standing_spool(play):
    def behind(course):
        return max(course[0], course[-1] - play)

    assert ratio(linear(), behind) < 0.5 * STANDS


def test_an_error_that_the_map_has_in_common_is_none():
    assert ratio(linear(), lambda course: course[-1] + 15.0) < 0.5 * STANDS


def test_an_unsure_map_still_tells_whether_the_flow_changes_with_U():
    """An error of the map is alike at values of U that are near: 8 % of travel tell."""
    assert ratio(linear(std=0.3), sticks, steps=17, std=0.05) > STANDS


def test_a_smooth_error_of_the_map_is_none():
    def bent(course):
        return course[-1] + 2.0 * math.sin(2.0 * math.pi * course[-1] / 80.0)

    assert max(ratio(linear(std=0.3), bent, seed=k, steps=35) for k in range(20)) < 0.5 * STANDS


def test_maps_that_differ_by_a_constant_each_second_are_none():
    assert max(ratio(linear(), follows, seed=k, refit=6) for k in range(50)) < 0.5 * STANDS
    assert ratio(linear(), sticks, refit=6) > STANDS


def test_a_play_that_was_learnt_is_not_waited_for():
    """Six turns tell 4 %: at the next, a spool that stands shows before 12 % of travel."""

    def at_turn(turn, begin, steps):
        noise, answers = np.random.default_rng(0), Answers(proof=Proof(errors=(1.0, 1.0)))
        course = 50.0 + np.abs((np.arange(turn + steps) + 10.0) % 40.0 - 20.0) * 2.0
        spool = course[begin] - 2.0
        for k in range(begin, turn + steps):
            U = course[k]
            if k <= turn:
                spool = min(max(spool, U - 2.0), U + 2.0)
            opening = 0.14 * spool + noise.normal(0.0, 0.02)
            answers = after(answers, k, U, opening, linear(std=0.02))
        return standing(answers)

    assert at_turn(150, begin=150, steps=5) < STANDS
    assert at_turn(150, begin=20, steps=6) > STANDS


def test_a_map_that_learnt_the_standing_spool_does_not_hide_it():
    answers = Answers(proof=Proof(errors=(1.0, 1.0)))
    for k in range(14):
        U, place = 20.0 + 2.0 * k, min(20.0 + 2.0 * k, 36.0)
        expected = linear() if k < 12 else linear(gain=0.0, number=1)
        answers = after(answers, k, U, 0.14 * place, expected)
    assert standing(answers) > STANDS


def test_a_flat_map_one_that_is_not_known_or_none_is_no_evidence():
    assert ratio(linear(gain=0.0), sticks) < 0.5 * STANDS
    assert ratio(linear(known=False), sticks) == 0.0
    assert ratio(linear(std=math.nan), sticks) == 0.0
    assert ratio(None, sticks) == 0.0


def test_memory_is_bounded_and_the_same_sample_counts_once():
    answers = Answers()
    for k in range(500):
        answers = after(answers, k, float(k % 100), 1.0)
    assert len(answers.rows) == 40
    assert after(answers, 499, 50.0, 1.0) is answers


def swept(n=400, play=4.0):
    """N samples of 10 ms of triangles of U on a linear valve with play."""
    rng, t = np.random.default_rng(2), 0.01 * np.arange(n)
    course = 10.0 + 80.0 * np.abs((t / 1.2 + 0.3) % 2.0 - 1.0)
    spool = [course[0]]
    for U in course[1:]:
        spool.append(min(max(spool[-1], U - 0.5 * play), U + 0.5 * play))
    Q = 1.4 * np.array(spool) + rng.normal(0.0, 0.5, n)
    at = (t * 1e9).astype(np.int64)
    return Samples.of(at, course, np.full(n, 200.0), np.full(n, 100.0), Q, np.full(n, 40.0))


def remembered(samples, ends):
    """The memory after deliveries that end at these samples, each judged when it comes."""
    state, begin = CommissionState(phase=Phase.SWEEPING), 0
    for end in ends:
        came, begin = samples[begin:end], end
        last = (float(x[-1]) for x in (came.U, came.p1, came.p2, came.Q))
        seen = Seen(**dict(zip(("U", "p1", "p2", "Q"), last, strict=True)), age_s=0.0, came=came)
        state = noted(Settings(), state, seen, 1e-9 * float(came.t[-1]) + 0.3)
    return state.watch.answers


def test_the_memory_is_the_same_in_whatever_bunches_samples_are_delivered():
    samples, rng = swept(), np.random.default_rng(3)
    prompt = remembered(samples, range(4, 401, 4))
    for most in (2, 10, 60):
        ends = np.unique(np.append(np.cumsum(rng.integers(1, most, 400)), 400))
        assert remembered(samples, ends[ends <= 400].tolist()) == prompt
    assert len(prompt.rows) == 40


def test_a_clock_set_back_begins_the_memory_anew():
    samples = swept()
    back = replace(samples, t=samples.t - 3_600_000_000_000)
    both = Samples.concatenate([samples, back])
    assert remembered(both, range(4, 801, 4)) == remembered(back, range(4, 401, 4))


class LateDeliveries(Loop):
    """The machine is busy: samples come in bunches, and each bunch makes one step."""

    def run(self, until_s):
        rng, due, self.worst = np.random.default_rng([self.plant.seed, 99]), 0.0, 0.0
        for k in range(1, round(until_s / SAMPLE_S)):
            now = k * SAMPLE_S
            kind = self._sample(now)
            if now >= due:
                self._publish(now, kind)
                self._step(now, kind)
                self.worst = max(self.worst, standing(self.state.watch.answers))
                due = now + float(rng.choice([PUBLISHED_S, rng.uniform(0.1, 0.5)]))
        return self


class Lagging(Plant):
    """A plant whose spool lags by 80 ms."""

    place = 0.0

    def measured(self, now):
        U = self.U
        self.place += (U - self.place) * SAMPLE_S / (0.08 + SAMPLE_S)
        self.U = self.place
        _, *others = super().measured(now)
        self.U = U
        return (U, *others)


@pytest.mark.parametrize(
    ("name", "plant", "seed"),
    [
        ("ordinary, play 4 %", Plant, 1),
        ("two slopes, play 2 %", Lagging, 1),
        *soaked(
            ("two slopes, play 2 %", Plant, 1),
            *(("ordinary, play 4 %", Lagging, seed) for seed in (1, 2)),
            ("two slopes, play 2 %", Lagging, 2),
        ),
    ],
)
def test_a_valve_that_follows_is_not_ended_by_late_deliveries(name, plant, seed):
    valve = VALVES[name]
    settings = settings_for(valve, sweep_s=14.0, most_s=26.0)
    loop = LateDeliveries(plant(valve, seed), settings, estimator=estimator_of(valve)).run(20.0)
    assert loop.state.reason is not Reason.STUCK
    assert loop.worst < 0.5 * STANDS


def test_a_map_is_believed_after_it_foretold_what_came():
    rng, answers = np.random.default_rng(1), Answers()
    assert answers.proof.wider == math.inf
    for k, U in enumerate(np.linspace(10.0, 40.0, 16)):
        answers = after(answers, k, U, 0.14 * U + rng.normal(0.0, 0.05), linear())
    assert answers.proof.wider == pytest.approx(1.0, abs=0.4)
    for k, U in enumerate(np.linspace(40.0, 70.0, 16), start=16):
        answers = after(answers, k, U, 0.1 * U, linear())
    assert answers.proof.wider > 2.0
    assert answers.begun_anew().proof.wider == answers.proof.wider


@pytest.mark.parametrize("name", ["ordinary, no play", "two slopes, play 2 %"])
def test_a_spool_that_sticks_in_mid_travel_is_seen_within_half_a_second(name):
    valve = VALVES[name]
    stuck = Happening("stuck spool", 9.4)
    settings = settings_for(valve, sweep_s=10.0, most_s=12.0)
    loop = Loop(Plant(valve, 3), settings, stuck, estimator=estimator_of(valve)).run(14.0)
    assert (loop.state.phase, loop.state.reason) == (Phase.ABORTED, Reason.STUCK)
    at = next(t for t, phase, _ in loop.log.phases if phase is Phase.RETURNING)
    assert 0.0 < at - 9.4 < 0.5


def test_a_standing_spool_behind_a_compensator_is_seen_although_its_opening_changes():
    """The flow stands, the pressure drop changes: Q/√Δp is no constant."""

    def at_step(k, flow, expected):
        noise, s = np.random.default_rng([1, k]), 10.0 + 2.0 * math.sin(0.4 * k)
        opening = (flow + noise.normal(0.0, 0.5)) / s
        return 40_000_000 * k, 40.0 - 2.0 * k, opening, s, 100.0, expected

    expected = replace(linear(std=0.1), opening=1.4 * U / S[:, None])
    answers = Answers(proof=Proof(errors=(1.0, 1.0)))
    for k in range(16):
        answers = answers.after(*at_step(k, 1.4 * 40.0, expected))
    assert standing(answers) > STANDS
    answers = Answers(proof=Proof(errors=(1.0, 1.0)))
    for k in range(16):
        answers = answers.after(*at_step(k, 1.4 * (40.0 - 2.0 * k), expected))
    assert standing(answers) < 0.5 * STANDS
