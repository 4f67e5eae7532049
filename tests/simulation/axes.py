"""The axes of a world: their source, their lives beside the valves', and what must be true of them.

Their jobs (searches and fits, which take seconds) are left: the state is the sums' alone, which are
the same bits for the same samples. An axis begins with a map, so that it learns from the first one.
"""

import random
from types import SimpleNamespace
from unittest import mock

import numpy as np

from simulation import judge
from simulation.axis_installation import InstalledAxis, edited_axis, first_state, relived
from simulation.installation import MOST_PENDING, reorder
from simulation.plant_server import Server
from simulation.source_client import Client
from simulation.stores import StateFile
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_arrivals import counted
from valvemap.pipeline.axis_learner import AxisLearner
from valvemap.pipeline.axis_states import checkpoints_of
from valvemap.pipeline.kept_axes import LEARNT
from valvemap.runtime.axes import LiveAxes
from valvemap.runtime.sources import Part, Sources
from valvemap.runtime.transferred_states import transfer
from valvemap.vocabulary.signals import PER_VALVE, Signal

LINES = (0, 1)
_SWING_S = 9.0  # a move there and back


def _no_job(_axis):
    """A mock would take a tenth of the time of an axis."""


NO_JOB = mock.patch.object(AxisLearner, "job", new=_no_job)


def _terms(installed):
    """What a map is valid under: neither name nor memory."""
    return installed.plan.meaning.to_text(), Axis(installed.plan).key


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
        self.live = self.client = self.sources = None
        self.reloaded = None  # the sources that the next life takes over
        self.transferred = None  # the states, from the start of a process to its end
        self.delivers = False  # whether its source did, until an orderly stop
        self.installed, self.edits = InstalledAxis(), list(world.case.axis_edits)
        self.parts = [(0, self.installed)]  # how many were learnt before each configuration
        self.given_up = {}  # by the terms of a map: its states, and the samples learnt
        first = first_state(self.installed.plan, self.case.period_s)
        (one,) = checkpoints_of(Axis(self.installed.plan), 0, {LEARNT: first})
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
        sources, self.reloaded = self.reloaded or self._sources(), None
        (client,) = (part.source for part in sources.parts)
        client.configure(self._lines())
        self.client = client
        self.world.clients.append(client)
        self.sources = sources
        self.live = LiveAxes(
            [self.installed.plan],
            arrivals,
            self,
            sources,
            self.transferred,
            clock,
            reorder_s=settings.reorder_s,
            stale_after_s=settings.stale_after_s,
            checkpoint_interval_s=settings.checkpoint_interval_s,
            tap=self._learn,
        )
        before, logged = self.transferred.load(), len(self.world.logs)
        self.live.start()
        self._judge_edit(before, repr(self.world.logs[logged:]))
        self._note_line_A()
        self._judge_start(client)
        return sources, self.live

    def _sources(self):
        client = Client(self.server, self.world.time, self._lines())
        return Sources([Part(None, client, LINES)])

    def reload(self):
        """Another configuration takes over the source."""
        self.reloaded = self._sources()
        self.reloaded.succeed(self.sources)

    async def transfer(self):
        """The configuration has ended: the next one has all states."""
        await transfer(self.live.keeper, self.live.finish, self.transferred)

    def edit(self):
        """Edit the configuration as drawn, between two lives."""
        for kind in self.edits.pop(0) if self.edits else ():
            self.installed = edited_axis(self.installed, kind)
            self.world.counts[kind] += 1

    def _lines(self):
        """The gains of both lines: U is in the configured unit."""
        gains = np.ones(PER_VALVE)
        gains[Signal.U] = self.installed.unit
        return {line: SimpleNamespace(gains=gains) for line in LINES}

    def _judge_edit(self, before, said):
        """Nothing is learnt under a wrong meaning, nothing is given up that has the right one."""
        axis, world = self.live.axes[0], self.world
        maps = [one for one in before if one.estimator == LEARNT]
        found = axis.to_bytes().get(LEARNT)
        if valid := [one for one in maps if self._is_valid(one)]:
            if found not in [one.state for one in valid]:
                world.violated("axis: it has forgotten what it had learnt")
            states, learnt = self.given_up.get(_terms(self.installed), ((), None))
            if self.installed != self.parts[-1][1]:
                own = self._counters()["aligned"] - len(axis._unmet[0].t)
                if found in states:  # what replaced it was lost with the power
                    self.learnt, self.of_A, self.parts = (list(one) for one in learnt)
                else:
                    self.parts.append((own, self.installed))
            return
        if found is not None:
            world.violated("axis: it learns on under another meaning")
        kept = (*self.states.load(), *self._aside(), *self.transferred.waiting)
        kept = [one.state for one in kept]
        if any(one.state not in kept for one in maps):
            world.violated("axis: its former state is not kept")
        if any(f"{one.valve}.{LEARNT}" not in said for one in maps):
            world.violated("axis: no word of its former state")
        self.server.excuse((line, k) for k in range(self.server.taken) for line in LINES)
        was = [one.state for one in maps], (self.learnt, self.of_A, self.parts)
        self.given_up[_terms(self.parts[-1][1])] = was
        self.learnt, self.of_A, self.parts = [], [], [(0, self.installed)]
        axis.resume(LEARNT, first_state(self.installed.plan, self.case.period_s))

    def _is_valid(self, row):
        """Whether a stored map was learnt from the signals that are configured now."""
        return (row.meaning, row.key) == _terms(self.installed)

    def _aside(self):
        return [one for one, _ in self.states.aside]

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

    def judge_calm(self):
        """After its last fault, its source delivers again."""
        self.delivers = judge.delivers(self.world, self.client, "the axis")

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

    def _judge_newest(self):
        """All that was delivered of both lines in the end is learnt, but for what waits."""
        unmet = [
            {self.number_of.get(t) for t in one.t.tolist()} for one in self.live.axes[0]._unmet
        ]
        if stuck := set.intersection(*unmet) - {None}:
            self.world.violated(f"axis: {sorted(stuck)[:5]} wait for samples that are there")
        excused = {k for _, k in self.server.undelivered()}  # ends a subscription that has lapsed
        excused = excused.union(*(self.server.excused[line] for line in LINES))
        left = set(range(max(self.learnt) + 1, self.server.subscribed)) - self._waiting() - excused
        dropped = excused - set(self.learnt)
        if left := {k for k in left if not judge.is_overtaken(self.world, self.server, k, dropped)}:
            self.world.violated(f"axis: {sorted(left)[:5]} are not learnt, which were delivered")

    def _judge_end(self):
        """Each lost sample is one that the source dropped, and is counted; none is learnt twice."""
        world, learnt, server = self.world, self.learnt, self.server
        if not learnt:
            return
        if self.delivers:
            self._judge_newest()
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
        stored = self.states.committed.get((self.installed.name, LEARNT))
        if stored is None or not self._is_valid(stored):
            return  # killed before the first save under this configuration
        ends = [n for n, _ in self.parts[1:]] + [len(self.learnt)]
        first = first_state(self.parts[0][1].plan, self.case.period_s)
        again = relived(
            [
                (one.plan, first if n == 0 else b"", self.learnt[n:end])
                for (n, one), end in zip(self.parts, ends, strict=True)
            ],
            self._take_again,
        )
        if again.to_bytes()[LEARNT] != stored.state:
            self.world.violated("axis: the state is not that of an undisturbed life")
        self.world.note(stored.state)

    def _take_again(self, axis, learnt):
        for line in LINES:
            if learnt:
                batch = self.server.as_samples(line, learnt, self._lines()[line].gains)
                axis.take_line(line, next(iter(batch.values())))
