"""The axes of a world: their source, their lives beside the valves', and what must be true of them.

Their jobs (searches and fits, which take seconds) are left: the state is the sums' alone, which are
the same bits for the same samples. An axis begins with a map, so that it learns from the first one.
"""

import random
from types import SimpleNamespace
from unittest import mock

import numpy as np

from simulation import judge
from simulation.installation import MOST_PENDING, reorder
from simulation.source import Client, Server
from simulation.stores import StateFile
from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import LEARNT, Axis, AxisPlan
from valvemap.pipeline.axis_arrivals import counted
from valvemap.pipeline.kept_axes import Learnt
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.runtime.axes import LiveAxes
from valvemap.runtime.sources import Part, Sources
from valvemap.vocabulary.signals import PER_VALVE, Signal

PLAN = AxisPlan("Press", AxisGeometry(63, 45, 800, 1.2, 1.2))
LINES = (0, 1)
_PLAIN = {line: SimpleNamespace(gains=np.ones(PER_VALVE)) for line in LINES}
_SWING_S = 9.0  # a move there and back
NO_JOB = mock.patch.object(Axis, "job", return_value=None)


class Axes:
    """The axis of one world: its server and its states survive a process."""

    def __init__(self, world):
        self.world, self.case = world, world.case.axis
        own = random.Random(f"{world.case.seed} axis")
        self.server = Server(self.case, world.time, own, world.start_ns)
        self._move()
        t = self.server.t.tolist()
        self.number_of = {t[k]: k for k in range(len(t) - 1, -1, -1)}
        self.states = StateFile()
        self.learnt = []  # samples (k) of both lines, in their order
        self.of_A = []  # those of line A alone, by which the axis counts
        self.live = None
        axis = Axis(PLAN)
        regression = AxisRegression(PLAN.geometry, period_s=self.case.period_s, play_percent=2.0)
        axis.continue_from(Learnt(regression, regression.initial_state(), np.zeros((SIZE, SIZE))))
        self.first = axis.to_bytes()[LEARNT]
        one = Checkpoint(PLAN.name, LEARNT, axis.key, 0, self.first, lam=None, frozen=False)
        self.states.committed = self.states.durable = {(one.valve, one.estimator): one}

    def _move(self):
        """Both lines have U and position of one cylinder."""
        swing = 2.0 * np.pi * self.server.at / _SWING_S
        for line in LINES:
            values = self.server.values[line]
            values[:, Signal.U] = 40.0 * np.cos(swing)
            values[:, Signal.Q] = 400.0 + 300.0 * np.sin(swing)

    def begin(self, settings):
        """A process starts: return its sources and their consumer, and judge what it resumed."""
        alignment = AlignmentSettings(
            max_wait_ns=round(2e9 * reorder(self.world.case)),
            reorder_ns=round(1e9 * reorder(self.world.case)),
            max_pending=MOST_PENDING,
        )
        flags = (self.case.numbered,) * len(LINES)
        arrivals = Arrivals(["A", "B"], Alignment(alignment, (("T",),) * len(LINES), flags))
        clock = self.world.time
        client = Client(self.server, clock, _PLAIN)
        self.world.clients.append(client)
        sources = Sources([Part(None, client, LINES)])
        self.live = LiveAxes(
            [PLAN],
            arrivals,
            self,
            sources,
            self.states,
            clock,
            reorder_s=settings.reorder_s,
            stale_after_s=settings.stale_after_s,
            checkpoint_interval_s=settings.checkpoint_interval_s,
            tap=self._learn,
        )
        self.live.start()
        self._note_line_A()
        self._judge_start(client)
        return sources, self.live

    def _note_line_A(self):
        axis = self.live.axes[0]
        take_line = axis.take_line

        def noted(line, samples):
            if line == 0:
                self.of_A += [self.number_of[t] for t in samples.t.tolist()]
            take_line(line, samples)

        axis.take_line = noted

    def show_axis(self, axis, results):
        """Implements `AxisSink`."""

    def _learn(self, _operator, _axis, samples):
        self.learnt += [self.number_of[t] for t in samples.t.tolist()]
        self.world.note(("axis", samples.t.tolist()))

    async def end(self):
        """An orderly stop: all is saved."""
        await self.live.finish()
        self._judge_end()

    def _waiting(self):
        """The samples of which a line waits in a buffer, or for the other line."""
        arrivals, axis = self.live._arrivals, self.live.axes[0]
        found = [judge.times_waiting(arrivals, row) for row in LINES]
        found += [one.t.tolist() for one in axis._unmet]
        return {self.number_of[t] for times in found for t in times if t in self.number_of}

    def _counters(self):
        return counted(self.live._arrivals, 0, self.live.axes[0].unpaired)

    def _judge_start(self, client):
        axis = self.live.axes[0]
        counts = self._counters()
        own = counts["aligned"] - len(axis._unmet[0].t)
        if own > len(self.learnt):
            self.world.violated(f"the axis restored {own} samples of {len(self.learnt)}")
        del self.learnt[own:], self.of_A[counts["aligned"] + axis.unpaired :]
        behind = {k for _, k in client.resumes_behind}
        acknowledged = set.union(*(self.server.acknowledged[line] for line in LINES))
        excused = set.union(*(self.server.excused[line] for line in LINES))
        known = {*self.learnt, *self._waiting(), *excused}
        ahead = {
            k
            for k in (behind | acknowledged) - known
            if not judge.is_overtaken(self.world, self.server, k, excused)
        }
        if ahead:
            self.world.violated(f"axis: the position is ahead of the state by {sorted(ahead)[:5]}")

    def _judge_end(self):
        """Each lost sample is one that the source dropped, and is counted; none is learnt twice."""
        world, learnt, server = self.world, self.learnt, self.server
        if not learnt:
            return
        if len(set(learnt)) < len(learnt):
            world.violated("axis: learnt samples twice")
        lost = set(range(min(learnt), max(learnt))) - set(learnt)
        excused = set.union(*(server.excused[line] for line in LINES)) | self._waiting()
        dropped = excused - set(learnt)
        wrong = {k for k in lost - excused if not judge.is_overtaken(world, server, k, dropped)}
        if wrong:
            world.violated(f"axis: lost {sorted(wrong)[:5]}, which the source had")
        world.counts["axis lost"] += len(lost)
        world.counts["axis learnt"] += len(learnt)
        counts, is_exact = self._counters(), server.case.numbered and not server.case.restarts
        unmet = {self.number_of[t] for t in self.live.axes[0]._unmet[0].t.tolist()}
        uncounted = set(range(min(self.of_A), max(self.of_A))) - set(learnt) - unmet
        if is_exact and counts["gaps"] + counts["missing"] != len(uncounted):
            world.violated(f"axis: lost {len(uncounted)}, counted {counts}")

    def judge_states(self):
        """The stored map is the bits of one undisturbed life over the same samples."""
        stored = self.states.committed[PLAN.name, LEARNT]
        again = Axis(PLAN)
        again.resume(LEARNT, self.first)
        for line in LINES:
            if self.learnt:
                batch = self.server.as_samples(line, self.learnt, np.ones(PER_VALVE))
                again.take_line(line, next(iter(batch.values())))
        if again.to_bytes()[LEARNT] != stored.state:
            self.world.violated("axis: the state is not that of an undisturbed life")
        self.world.note(stored.state)
