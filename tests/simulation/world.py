"""One seed: lives of the real service in a simulated world, and what must be true of them."""

import asyncio
import hashlib
import random
from collections import Counter
from dataclasses import dataclass, field
from unittest import mock

import structlog

from simulation.draws import SIMULATED_S, draw
from simulation.source import Client, Server
from simulation.stores import PastFile, StateFile
from simulation.virtual_loop import DeadlockError, VirtualTime, process
from support.plant import START
from valvemap.errors import SourceLost
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.pipeline.alignment import COUNTER_NAMES, Alignment, AlignmentSettings
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.runtime import live as live_module
from valvemap.runtime import past as past_module
from valvemap.runtime.live import LiveService, LiveSettings
from valvemap.runtime.past import PastKeeper, results_of, signals_of
from valvemap.runtime.sources import Part, Sources, supervise_all
from valvemap.runtime.supervisor import SupervisorSettings
from valvemap.vocabulary.statuses import Quality

RLS = "RLS"
_SLACK_S = 1.0  # between two looks at what is shown
_MOST_PENDING = 256


@dataclass
class Outcome:
    """``violations`` of a seed are sentences; ``trace`` is the digest of all that happened."""

    seed: int
    violations: list
    trace: str
    counts: Counter


def simulate(seed):
    """Live through one seed."""
    world = World(draw(seed))
    with (
        structlog.testing.capture_logs() as logs,
        mock.patch.multiple(
            live_module, FEWEST_AT_ONCE=world.case.at_once, FIRST_AT_ONCE=world.case.at_once
        ),
        mock.patch.object(past_module, "MOST_ROWS", world.case.history_rows),
    ):
        try:
            world.run()
        except DeadlockError:
            world.violated("all tasks wait for ever")
        except Exception as error:  # noqa: BLE001 - whatever ends the service is a finding
            world.violated(f"the service ended with {error!r}")
    for line in logs:
        world.note(sorted(line.items()))
    return Outcome(seed, world.violations, world.trace.hexdigest(), world.counts)


def fresh(case):
    """An identification of the case's valves that has learnt nothing."""
    numbered = {valve: part.numbered for part in case.sources for valve in part.valves}
    reorder_s = reorder(case)
    plans = [
        ValvePlan(
            f"V{valve}",
            QualityGate(),
            {RLS: RecursiveLeastSquares()},
            RLS,
            map_Q=(50.0, 100.0),
            map_dp=(50.0, 100.0),
        )
        for valve in range(case.valves)
    ]
    settings = AlignmentSettings(
        max_wait_ns=round(2e9 * reorder_s),
        reorder_ns=round(1e9 * reorder_s),
        max_pending=_MOST_PENDING,
    )
    flags = tuple(numbered[valve] for valve in range(case.valves))
    return Identification(plans, Alignment(settings, (("T",),) * case.valves, flags))


def reorder(case):
    """How long samples wait for earlier ones, s: longer than any of a connected source is late."""
    return 4.0 * max(part.publishing_s + part.period_s for part in case.sources)


@dataclass
class Shown:
    """Implements `ResultSink`: the newest results of each valve."""

    world: "World"
    quality: dict = field(default_factory=dict)
    t: dict = field(default_factory=dict)

    async def publish(self, results):
        world = self.world
        found = results.estimators[RLS]
        for m, valve in enumerate(results.valves.tolist()):
            self.quality[valve], self.t[valve] = int(found.quality[m]), int(found.t[m])
            world.note((valve, self.quality[valve], self.t[valve], int(found.sample_count[m])))
            name = f"V{valve}"
            world.published[results_of(name, RLS)] += int(found.t[m] > 0)
            world.published[results_of(name, past_module._INVERSE)] += int(results.inverse.t[m] > 0)
            lost = results.signals.quality[m] == Quality.BAD and results.signals.t[m] > 0
            world.published[signals_of(name)] += int(lost)
        if world.case.sink_s:
            await asyncio.sleep(world.case.sink_s)

    async def doubt(self, valves):
        for valve in valves.tolist():
            if self.quality.get(valve) == Quality.GOOD:
                self.quality[valve] = int(Quality.UNCERTAIN)

    async def show_health(self, health):
        self.world.note(health.source_states)


class World:
    """Servers, files and time survive a process; `run` lives through all its lives."""

    def __init__(self, case):
        self.case = case
        self.rng = random.Random(case.seed + 1)
        self.time = VirtualTime(START)
        self.servers = [Server(part, self.time, self.rng, START) for part in case.sources]
        self.server_of = {v: server for server in self.servers for v in server.case.valves}
        self.number_of = {v: self._numbers(v) for v in self.server_of}  # sample by source time
        self.states, self.past = StateFile(), PastFile()
        self.learnt = [[] for _ in range(case.valves)]  # samples (k), in their order
        self.published = Counter()  # rows for the history, of this life
        self.stored = Counter()  # rows of the history at the start of this life
        self.violations = []
        self.counts = Counter()
        self.trace = hashlib.sha256()
        self.disturbed = 0.0  # end of the last stall

    def _numbers(self, valve):
        t = self.server_of[valve].t.tolist()
        return {t[k]: k for k in range(len(t) - 1, -1, -1)}

    def note(self, event):
        """Add to the trace."""
        self.trace.update(repr((self.time.elapsed, event)).encode())

    def violated(self, sentence):
        """A broken promise."""
        self.violations.append(f"{self.time.elapsed:.2f} s: {sentence}")

    def run(self):
        """Every life, and the judgement at the end."""
        for at, kind, pause in (*self.case.ends, (SIMULATED_S, "stop", 0.0)):
            if self.time.elapsed < at:
                self._live(at, kind)
                self.time.elapsed += pause
                self.counts[kind] += 1
        self._judge_states()

    def _thread_takes(self):
        slow = self.case.thread_s
        return (self.rng.uniform(0.0, slow), self.rng.uniform(0.0, slow)) if slow else (0.0, 0.0)

    def _live(self, until, kind):
        clients = [Client(server, self.time) for server in self.servers]
        parts = [
            Part(str(n) if len(clients) > 1 else None, client, client.server.case.valves)
            for n, client in enumerate(clients)
        ]
        self.published, self.stored = Counter(), self.past.rows.copy()
        with process(self.time, self._thread_takes) as loop:
            loop.set_exception_handler(self._forgotten)
            loop.run_until_complete(self._process(Sources(parts), until, kind))
            for client in clients:
                client.alive = False  # a killed process says no good-bye
            self.states.refuses = self.past.refuses = True  # a dead process writes nothing
        self.states.refuses = self.past.refuses = False
        self.note(kind)
        if kind == "power":
            self.states.lose_power()

    def _forgotten(self, _loop, context):
        """An error that no task awaited; a lost connection at a kill is none."""
        error = context.get("exception")
        if error is not None and not isinstance(error, SourceLost):
            self.violated(f"nobody awaited {error!r}")

    async def _process(self, sources, until, kind):
        case, clock = self.case, self.time
        settings = LiveSettings(
            stale_after_s=case.stale_after_s, reorder_s=reorder(case), map_interval_s=20.0
        )
        identification = fresh(case)
        keeper = PastKeeper(self.past, [plan.name for plan in identification.plans])
        shown = Shown(self)
        live = LiveService(
            identification,
            sources,
            shown,
            self.states,
            clock,
            settings,
            self._learn,
            keeper,
        )
        await live.start()
        self._judge_start(identification, [part.source for part in sources.parts])
        stop = asyncio.Event()
        supervision = SupervisorSettings(
            startup_timeout_s=0.0, tick_s=case.tick_s, connected_before=True
        )
        supervising = asyncio.create_task(supervise_all(sources, live, clock, stop, supervision))
        await self._watch(live, keeper, shown, until, supervising)
        if kind != "stop":
            return
        live.end_soon()
        stop.set()
        await supervising
        self.states.refuses = self.past.refuses = False
        if not await live.keep(within_s=live.time_left_s):
            self.counts["not all saved"] += 1
            return
        self._judge_history(keeper)
        self._judge_counts(identification)

    def _learn(self, name, samples: Samples):
        valve = int(name[1:])
        self.learnt[valve] += [self.number_of[valve][t] for t in samples.t.tolist()]
        self.published[signals_of(name)] += len(samples)
        self.note((name, samples.t.tolist()))

    async def _watch(self, live, keeper, shown, until, supervising):
        """Run until the end of this life; look every second at what must hold at any time."""
        case, time = self.case, self.time
        while time.elapsed < until and not supervising.done():
            now = time.elapsed
            troubles = {kind for first, last, kind in case.disks if first <= now < last}
            self.states.refuses, self.past.refuses = "state" in troubles, "history" in troubles
            time.service_ahead_s = sum(by for at, by in case.service_steps if at <= now)
            for at, by in case.stalls:
                if now - _SLACK_S < at <= now:
                    time.elapsed += by
                    self.disturbed = time.elapsed
            await asyncio.sleep(min(_SLACK_S, until - time.elapsed))
            self._judge_shown(shown)
            self._judge_queues(live, keeper)
        if supervising.done():
            supervising.result()
            self.violated("the supervision ended")

    def _judge_shown(self, shown):
        """Nothing older than announced is Good."""
        now, limit = self.time.elapsed, self.case.stale_after_s + self.case.tick_s + _SLACK_S
        limit += self.case.sink_s * 4
        if now < self.disturbed + self.case.tick_s + _SLACK_S + self.case.sink_s * 4:
            return
        for valve, quality in shown.quality.items():
            server = self.server_of[valve]
            if quality != Quality.GOOD or shown.t[valve] not in self.number_of[valve]:
                continue
            taken = server.at[self.number_of[valve][shown.t[valve]]]
            stepped = any(taken <= at <= now for at, _ in server.case.steps)
            if now - taken > limit and not stepped:
                self.violated(f"V{valve} is Good, {now - taken:.2f} s old, {limit:.2f} allowed")

    def _judge_queues(self, live, keeper):
        """Each queue is within its bound."""
        if keeper._rows > self.case.history_rows:
            self.violated(f"{keeper._rows} rows buffered")
        if len(live._to_publish) > self.case.valves:
            self.violated(f"{len(live._to_publish)} valves queued for publication")
        if live.identification.arrivals.pending().max() > _MOST_PENDING:
            self.violated("too many samples wait")
        for server in self.servers:
            if server.longest > server.case.queue:
                self.violated("the server's queue is too long")

    def _judge_start(self, identification, clients):
        """After a restart: what was acknowledged, or lies before the position, is in the states."""
        behind = set().union(*(client.resumes_behind for client in clients))
        for valve, learnt in enumerate(self.learnt):
            aligned = identification.results.counters(valve)["aligned"]
            if aligned > len(learnt):
                self.violated(f"V{valve} restored {aligned} samples, {len(learnt)} were learnt")
            del learnt[aligned:]
            server = self.server_of[valve]
            excused = server.excused[valve]
            known = {*learnt, *self._waiting(identification, valve), *excused}
            passed = server.acknowledged[valve] | {k for v, k in behind if v == valve}
            ahead = {k for k in passed - known if not self._is_overtaken(server, k, excused)}
            if ahead:
                self.violated(
                    f"V{valve}: the position is ahead of the state by {sorted(ahead)[:5]}"
                )

    def _waiting(self, identification, valve):
        one = identification._arrivals.of(valve)
        times = one.slots[0, :, slots.TIME].tolist()
        return {self.number_of[valve][t] for t in times if t in self.number_of[valve]}

    def _judge_history(self, keeper):
        """History = published values minus counted losses."""
        missing = (self.stored + self.published) - self.past.rows
        if sum(missing.values()) > keeper.lost:
            self.violated(f"history lacks {dict(missing)}, counted {keeper.lost}")
        if invented := self.past.rows - (self.stored + self.published):
            self.violated(f"history holds rows never published: {dict(invented)}")

    def _judge_counts(self, identification):
        """Every lost sample is one that the source dropped, and is counted."""
        for valve, learnt in enumerate(self.learnt):
            if not learnt:
                continue
            server = self.server_of[valve]
            lost = set(range(min(learnt), max(learnt))) - set(learnt)
            excused = server.excused[valve] | self._waiting(identification, valve)
            wrong = {k for k in lost - excused if not self._is_overtaken(server, k, lost & excused)}
            if wrong:
                self.violated(f"V{valve} lost {sorted(wrong)[:5]}, which the source had")
            if len(set(learnt)) < len(learnt):
                self.violated(f"V{valve} learnt samples twice")
            counters = identification.results.counters(valve)
            self.counts["lost"] += len(lost)
            self.counts["learnt"] += len(learnt)
            counted = counters["gaps"] + counters["missing"]
            is_exact = server.case.numbered and not server.case.restarts
            if is_exact and counted != len(lost):
                named = {name: counters[name] for name in COUNTER_NAMES}
                self.violated(f"V{valve} lost {len(lost)}, counted {named}")

    def _is_overtaken(self, server, k, dropped):
        """Whether a late sample lies behind a gap, whose end it need not wait for."""
        wait = reorder(self.case) / server.case.period_s
        messy = server.case.late or server.case.split
        return bool(messy) and any(0 < k - other <= wait for other in dropped)

    def _judge_states(self):
        """The saved states are the bits of one undisturbed life over the same samples."""
        again = fresh(self.case)
        saved = {one: c for one, c in self.states.committed.items() if one[1] == RLS}
        restored = fresh(self.case)
        restored.restore(self.states.load())
        for server in self.servers:
            for valve in server.case.valves:
                n = restored.results.counters(valve)["aligned"]
                if n:
                    again.learn(server.as_samples(valve, self.learnt[valve][:n]))
        for one in again.states.checkpoints():
            key = one.valve, one.estimator
            if key in saved and saved[key].state != one.state:
                self.violated(f"{one.valve}: the state is not that of an undisturbed life")
            self.note(one.state)
