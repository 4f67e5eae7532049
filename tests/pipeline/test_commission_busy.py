"""A busy source or computer: late samples, responses and heartbeats end no guided run."""

import math
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from valvemap.app.commission import WRITE_S
from valvemap.model.samples import Samples
from valvemap.pipeline.commission import lost, start, step, written
from valvemap.pipeline.commission_limits import Limits
from valvemap.pipeline.commission_plan import Plan
from valvemap.pipeline.commission_state import Command, CommissionState, Reason, Seen, Settings
from valvemap.vocabulary.commission import Phase

SAMPLE_S, WATCHDOG_S, OWN_U = 0.01, 0.45, 20.0
SLEW = 300.0
SETTINGS = Settings(
    Limits((0.0, 100.0), SLEW, safe_U=OWN_U), Plan(4.0, 14.0, 16.0), check_s=0.2, opening=5.0
)


class Busy:
    """Source and run in simulated time; each is held up at random, for up to half a second.

    The source stamps its samples with the times at which they were due, and takes the valve back
    without a heartbeat. What came while it was held up is handled first, or the samples are.
    """

    def __init__(self, seed):
        self.rng = np.random.default_rng([seed, 41])
        self.U, self.commanded, self.beaten, self.k = OWN_U, False, 0.0, 0
        self.source_rests = self.run_rests = 0.0
        self.slow = False
        self.to_source, self.to_run, self.waits = deque(), deque(), None
        self.state, self.seen, self.arrived = start(CommissionState(), 0.0), Seen(), -math.inf
        self.taken_back, self.jumps, self.led = -math.inf, [], []

    def run(self, seconds):
        for k in range(round(seconds / SAMPLE_S)):
            now = SAMPLE_S * k
            self._source(now)
            self._run(now)
            if self.state.phase.is_over:
                break
        return self.state

    def _is_held_up(self, now, rests):
        if now < rests:
            return rests
        longest = float(self.rng.choice([0.05, 0.2, 0.5]))
        return now + longest * self.rng.random() if self.rng.random() < 0.002 else 0.0

    def _source(self, now):
        self.source_rests = self._is_held_up(now, self.source_rests)
        if self.source_rests:
            return
        first, then = self.rng.permutation([self._handle, self._measure])
        first(now)
        then(now)

    def _handle(self, now):
        if self.commanded and now - self.beaten > WATCHDOG_S:
            self._take_back(now)
        while self.to_source and self.to_source[0][0] <= now:
            _, sent, command = self.to_source.popleft()
            if command.heartbeat is not None:
                self.beaten = now
            if command.U is not None:
                if not self.commanded and sent > self.taken_back:
                    self.jumps.append(abs(command.U - self.U))
                self.commanded, self.U = True, command.U
                self.led.append(command.U)
            if command.heartbeat == 0:
                self._take_back(now)
            self.to_run.append((now + self._way(), "answer", command))

    def _take_back(self, now):
        self.commanded, self.U, self.taken_back = False, OWN_U, now

    def _measure(self, now):
        if self.rng.random() < 0.02:  # measuring falls behind, then catches up
            self.slow = bool(self.rng.random() < 0.3)
        if self.slow and round(now / SAMPLE_S) % 2:
            return
        rows, until = [], self.k * SAMPLE_S + 1e-6 if self.slow else now
        while SAMPLE_S * self.k <= until:
            rows.append((SAMPLE_S * self.k, self.U))
            self.k += 1
        for part in range(0, len(rows), 4):  # one response each
            self.to_run.append((now + self._way() + 1e-6 * part, "samples", rows[part : part + 4]))

    def _way(self):
        return float(self.rng.uniform(0.002, 0.02))

    def _run(self, now):
        self.run_rests = self._is_held_up(now, self.run_rests)
        if self.run_rests:
            return
        arrived = sorted((x for x in self.to_run if x[0] <= now), key=lambda x: x[0])
        self.to_run = deque(x for x in self.to_run if x[0] > now)
        for _, what, content in arrived:
            if what == "samples":
                self._hear(content, now)
                self._step(now)
            elif self.waits is not None and self.waits[1] is content:
                self.state, self.waits = written(self.state, content, now), None
        self._step(now)

    def _hear(self, rows, now):
        t, U = np.array(rows).T
        N, flow = len(t), 0.1 * U * math.sqrt(100.0)
        at = np.round((3600.0 + t) * 1e9).astype(np.int64)
        values = np.full(N, 200.0), np.full(N, 100.0), flow, np.full(N, 40.0)
        samples = Samples.of(at, U, *values)
        came = Samples.concatenate([self.seen.came, samples])
        self.arrived = now
        self.seen = replace(self.seen, U=U[-1], p1=200.0, p2=100.0, Q=flow[-1], came=came)

    def _step(self, now):
        if self.waits is not None:
            if now - self.waits[0] > WRITE_S:
                self.state, self.waits = lost(self.state, now), None
            return
        self.seen = replace(self.seen, age_s=now - self.arrived)
        self.state, command = step(SETTINGS, self.state, self.seen, now)
        self.seen = replace(self.seen, came=Samples.empty())
        if command != Command():
            self.to_source.append((now + self._way(), now, command))
            self.waits = now, command


@pytest.fixture(scope="module")
def busy():
    """Runs on busy machines that have ended, by seed."""
    runs = {seed: Busy(seed) for seed in range(6)}
    for run in runs.values():
        run.run(90.0)
    return runs


def test_a_busy_source_or_computer_is_no_u_that_does_not_follow(busy):
    ends = {seed: (run.state.phase, run.state.reason) for seed, run in busy.items()}
    assert ends == dict.fromkeys(busy, (Phase.DONE, Reason.TIME_UP))


def test_a_valve_that_the_source_has_taken_back_is_led_from_where_it_is(busy):
    assert max(jump for run in busy.values() for jump in run.jumps) <= 1.0


def test_both_ends_of_the_range_are_reached_although_responses_take_longer_than_a_step(busy):
    for run in busy.values():
        assert (min(run.led), max(run.led)) == pytest.approx((0.0, 100.0), abs=5.0)
