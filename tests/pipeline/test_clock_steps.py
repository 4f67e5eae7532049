"""A source whose clock is set loses no sample and invents no loss, with and without Sequence."""

import numpy as np
import pytest

from support.soaked import soaked
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import PER_VALVE, Signal

START = 1_800_000_000_000_000_000
DAY_S = 86_400.0
STEPS = (-DAY_S, -3600.0, -60.0, -10.0, -3.0, -1.0, 1.0, 3.0, 10.0, 60.0, 3600.0, DAY_S)
PERIOD_NS, AT = 10_000_000, 1003  # 100 Hz; the step lies within a message
LOSSES = ("late", "missing", "duplicates", "gaps", "lost_by_time")


class Stream:
    """Messages of one valve with a constant p1, each received as soon as it is complete."""

    def __init__(self, step_s, numbered, message, n=2000):
        rng = np.random.default_rng(1)
        self.values = rng.normal(size=(n, PER_VALVE))
        self.values[:, Signal.P1] = 200.0
        self.values[:, Signal.SEQUENCE] = np.arange(n)
        taken = np.arange(n) * PERIOD_NS
        self.t = START + taken + np.where(np.arange(n) >= AT, round(step_s * 1e9), 0)
        self.message, self.signals = message, PER_VALVE if numbered else PER_VALVE - 1
        flags = (("T",),), (numbered,)
        self.alignment = Alignment(AlignmentSettings(), *flags)
        self.arrivals = Arrivals(["V1"], self.alignment)
        self.out = []

    def restart(self, *, other_units=False):
        """The service is started again with what it has stored."""
        kept = self.arrivals.of(0)
        if other_units:
            kept = kept._replace(known=kept.known.of_any_content())
        self.arrivals = Arrivals(["V1"], self.alignment)
        self.arrivals.put(0, kept)

    def send(self, rows, now_s):
        k = np.asarray(rows, np.intp)
        changes = DataChanges(
            np.tile(np.arange(self.signals, dtype=np.int32), len(k)),
            self.values[k, : self.signals].ravel(),
            np.zeros(len(k) * self.signals, np.uint32),
            np.repeat(self.t[k], self.signals),
        )
        self.arrivals.announce(changes, now_s)
        for part in (changes[:7], changes[7:]):
            self.out += self.arrivals.take(part).samples.Q.tolist()

    def send_all(self, jitter_s=0.0, without=()):
        rng = np.random.default_rng(2)
        for first in range(0, len(self.t), self.message):
            rows = [k for k in range(first, first + self.message) if k not in without]
            at = (first + self.message) * PERIOD_NS * 1e-9
            self.send(rows, 1000.0 + at + rng.uniform(0.0, jitter_s))

    @property
    def losses(self):
        counted = self.arrivals.alignment.counters(self.arrivals.of(0).waiting, 0)
        return {name: counted[name] for name in LOSSES if counted[name]}


@pytest.mark.parametrize("message", [5, 50, *soaked(100)])
@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("step_s", STEPS)
def test_no_sample_is_lost_and_no_loss_invented(step_s, numbered, message):
    stream = Stream(step_s, numbered, message)
    stream.send_all(jitter_s=0.05)
    assert stream.out == stream.values[:, Signal.Q].tolist()
    assert stream.losses == {}


def test_real_losses_are_still_counted_by_time():
    stream = Stream(0.0, numbered=False, message=50)
    stream.send_all(jitter_s=0.05, without=range(700, 900))
    assert stream.losses == {"lost_by_time": 200}


def test_what_is_sent_again_is_no_step():
    stream = Stream(0.0, numbered=False, message=50, n=600)
    stream.send_all()
    stream.send(range(200, 600), 1010.0)
    assert stream.out == stream.values[:, Signal.Q].tolist()
    assert stream.losses == {"duplicates": 400 * (PER_VALVE - 1)}


@pytest.mark.parametrize("other_units", [False, True])
@pytest.mark.parametrize("step_s", [-0.155, -1.0, -60.0])
def test_what_is_sent_again_around_a_step_back_is_known_after_a_restart(step_s, other_units):
    stream = Stream(step_s, numbered=False, message=50)
    stream.send_all()
    stream.restart(other_units=other_units)
    stream.send(range(AT - 23, AT + 77), 1030.0)
    stream.send(range(1900, 2000), 1030.0)
    assert stream.out == stream.values[:, Signal.Q].tolist()
    assert stream.losses == {"duplicates": 200 * (PER_VALVE - 1)}


def test_messages_that_catch_up_after_an_outage_are_no_step():
    stream = Stream(0.0, numbered=False, message=50, n=600)
    for first in (0, 50, 100):
        stream.send(range(first, first + 50), 1000.0 + 0.01 * first)
    for first in (200, 250):  # 50 samples are lost
        stream.send(range(first, first + 50), 1030.0)
    for first in (300, 350):
        stream.send(range(first, first + 50), 1030.1)
    assert stream.losses == {"lost_by_time": 50}


@pytest.mark.parametrize(
    ("step_s", "lost", "late"),
    [
        (-3.0, (6,), 6),
        (60.0, (6, 7, 8, 10), 10),
        (3600.0, (6, 7), 7),
    ],
)
def test_a_sample_lost_where_the_clock_steps_may_come_late(step_s, lost, late):
    """One sample each 2 s, the clock steps before number 7 or 9; the late one is no restart."""
    settings = AlignmentSettings(max_wait_ns=20 * 10**9, reorder_ns=5 * 10**9)
    align = Alignment(settings, (("T",),), (True,))
    state, before = align.initial_state(), 9 if len(lost) > 3 else 7
    numbers = [k for k in range(15) if k not in lost] + [late, *range(15, 20)]
    learnt = 0
    for k in numbers:
        t = START + round((2 * k + (step_s if k >= before else 0.0)) * 1e9)
        values = np.array([50.0, 200.0, 100.0, 10.0, 40.0, k])
        items = np.arange(PER_VALVE, dtype=np.int32)
        ok, times = np.zeros(PER_VALVE, np.uint32), np.full(PER_VALVE, t)
        state, samples = align.update(state, DataChanges(items, values, ok, times))
        learnt += len(samples.samples)
    counted = align.counters(state, 0)
    assert (learnt, counted["restarts"], counted["gaps"]) == (20 - len(lost), 0, len(lost))
    assert counted["late"] + counted["duplicates"] == PER_VALVE - 1
