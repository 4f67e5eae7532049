"""One seed: lives of the real service in a simulated world; `judge` says what must be true."""

import asyncio
import hashlib
import random
import re
import tempfile
from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import structlog

from simulation import judge, people
from simulation.axes import NO_JOB, Axes
from simulation.draw_sources import SIMULATED_S
from simulation.draws import draw
from simulation.history import Rows
from simulation.installation import edited, fresh, installed, reorder
from simulation.leading import Leading
from simulation.meeting import give_one_flow
from simulation.overtaken import Overtaken
from simulation.plant_server import Server
from simulation.ports import give_signals
from simulation.reloads import reload
from simulation.shown import Shown
from simulation.source_client import Client
from simulation.stores import PastFile, RealPastFile, StateFile
from simulation.virtual_loop import DeadlockError, VirtualTime, process
from support.plant import START
from valvemap.errors import SourceLost
from valvemap.model.samples import Samples
from valvemap.runtime import learning_pace
from valvemap.runtime import past as past_module
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.past_pieces import signals_of
from valvemap.runtime.sources import Part, Sources, supervise_all
from valvemap.runtime.supervisor import SupervisorSettings
from valvemap.runtime.transferred_states import TransferredStates
from valvemap.storage import history_series
from valvemap.storage.state_lock import FileLock

_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - a disk that costs no time
_FOLDER = tempfile.TemporaryDirectory(prefix="simulation", dir=_MEMORY)  # lock file and histories
_SEALED_ROWS = 24  # of a block of the history: several in a simulated minute


@dataclass
class Outcome:
    """``violations`` of a seed are sentences; ``trace`` is the digest of all that happened."""

    seed: int
    violations: list
    trace: str
    counts: Counter


def simulate(seed, drawn=draw):
    """Live through one seed."""
    world = World(drawn(seed))
    with (
        structlog.testing.capture_logs() as world.logs,
        mock.patch.multiple(
            learning_pace, FEWEST_AT_ONCE=world.case.at_once, FIRST_AT_ONCE=world.case.at_once
        ),
        mock.patch.object(past_module, "MOST_ROWS", world.case.history_rows),
        mock.patch.object(history_series, "BLOCK", _SEALED_ROWS),
        NO_JOB,
    ):
        try:
            world.run()
        except DeadlockError:
            world.violated("all tasks wait for ever")
        except Exception as error:  # noqa: BLE001 - whatever ends the service is a finding
            world.violated(f"the service ended with {error!r}")
        finally:
            world.past.remove()
    for line in world.logs:
        said = repr(sorted(line.items()))
        world.note(re.sub(rf"{_FOLDER.name}[\w/.-]*", "", said))  # another one in each process
    return Outcome(seed, world.violations, world.trace.hexdigest(), world.counts)


class World:
    """Servers, files and time survive a process; `run` lives through all its lives."""

    def __init__(self, case):
        self.case = case
        self.rng = random.Random(case.seed + 1)
        self.time, self.start_ns = VirtualTime(START), START
        self.servers = [Server(part, self.time, self.rng, START) for part in case.sources]
        if case.ports:
            give_signals(self.servers[0], self.rng)
        if case.meter:
            give_one_flow(self.servers[0])
        self.server_of = {v: server for server in self.servers for v in server.case.valves}
        self.number_of = {v: self._numbers(v) for v in self.server_of}  # sample by source time
        self.states, self.past, self.rows = StateFile(), PastFile(), None
        if case.reads:
            self.past, self.rows = RealPastFile(_FOLDER.name, self.time), Rows(self)
        self.leading = None if case.led is None else Leading(self)
        self.axes = None if case.axis is None else Axes(self)
        self.plant = installed(case)
        self.meanings = {}  # each configuration of a valve, by the text stored with its states
        self.lock_path = Path(_FOLDER.name) / "state"
        self.clients = []  # of this life
        self.logs = []
        self.learnt = [[] for _ in range(case.valves)]  # samples (k), in their order
        self.commands = [[] for _ in range(case.valves)]  # (how many were learnt before, kind)
        self.began = [0] * case.valves  # how many of them were learnt before the present map
        self.converted = [False] * case.valves  # whether the map was, to another unit
        self.published = Counter()  # rows for the history, of this life
        self.stored = Counter()  # rows of the history at the start of this life
        self.violations = []
        self.counts = Counter(kind for part in case.sources for *_, kind in part.retyped)
        self.trace = hashlib.sha256()
        self.disturbed = 0.0  # end of the last stall, or begin of this life
        self.delivering = set()  # valves whose source delivered until an orderly stop
        self.all_taken = []  # servers of which the stop refused no part of a batch
        self.all_saved = False  # whether the last life ended so
        self.reloaded = None  # the sources that the next life takes over
        self.transferred = None  # the states, from the start of a process to its end
        self.keeper = None  # of the history, from the start of a process to its end

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
        edits = (*self.case.edits, *[()] * len(self.case.ends))
        last = (SIMULATED_S, "stop", 0.0), ()
        for (at, kind, pause), changes in (*zip(self.case.ends, edits, strict=False), last):
            if self.time.elapsed < at:
                self._live(at, kind)
                self.time.elapsed += pause
                self.counts[kind] += 1
            for edit in changes:
                self.plant = edited(self.plant, *edit)
                self.counts[edit[0]] += 1
            if self.axes is not None:
                self.axes.edit()
        judge.of_states(self)
        if self.axes is not None:
            self.axes.judge_states()

    def fresh(self):
        """An identification of the present configuration that has learnt nothing."""
        return fresh(self.case, self.plant)

    def known_as(self, row, estimators):
        """The valve that a stored state of one of these estimators was learnt from, or None."""
        found = self.meanings.get(row.meaning)
        return found.valve if found is not None and row.estimator in estimators else None

    def _thread_takes(self):
        slow = self.case.thread_s
        return (self.rng.uniform(0.0, slow), self.rng.uniform(0.0, slow)) if slow else (0.0, 0.0)

    def _live(self, until, kind):
        reloaded, self.reloaded = self.reloaded, None
        sources = reloaded or self.connect()
        clients = self.clients = [part.source for part in sources.parts]
        for client in clients:
            client.configure(self.plant)
        if self.leading is not None:
            self.leading.begin()
            for client in clients:
                client.leading = self.leading
        self.disturbed = max(self.disturbed, self.time.elapsed)
        self.meanings |= {one.meaning.to_text(): one for one in self.plant}
        if reloaded is None:
            self._begin_process()
        lock = FileLock(self.lock_path)
        with closing(lock), process(self.time, self._thread_takes) as loop:
            loop.set_exception_handler(self._forgotten)
            loop.run_until_complete(self._process(sources, until, kind))
            for client in self.clients:
                client.alive = False  # a killed process says no good-bye
            lock.close()  # as the kernel does
            self._refuse(refuses=True)  # a dead process writes nothing
            if kind != "reload":
                self.past.die()
        self._refuse(refuses=False)
        self.note(kind)
        if kind == "power":
            for one in self._state_files():
                one.lose_power()

    def connect(self):
        """The sources of a configuration, not connected yet."""
        clients = [Client(server, self.time, self.plant) for server in self.servers]
        return Sources(
            [
                Part(str(n) if len(clients) > 1 else None, client, client.server.case.valves)
                for n, client in enumerate(clients)
            ]
        )

    def _begin_process(self):
        self.past.start()
        self.keeper, self.transferred = PastKeeper(self.past), TransferredStates(self.states)
        if self.axes is not None:
            self.axes.transferred = TransferredStates(self.axes.states)
        self.published, self.stored = Counter(), self.past.rows.copy()
        if self.rows is not None:
            self.rows.begin()

    def _state_files(self):
        return [self.states] if self.axes is None else [self.states, self.axes.states]

    def _refuse(self, *, refuses):
        for one in self._state_files():
            one.refuses = refuses

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
        identification = self.fresh()
        self.numbers = {plan.name: n for n, plan in enumerate(identification.plans)}
        keeper = self.keeper
        await keeper.follow([plan.name for plan in identification.plans])
        shown = Shown(self)
        live = LiveService(
            identification,
            sources,
            shown,
            self.transferred,
            clock,
            settings,
            self._learn,
            keeper,
        )
        before, logged = self.transferred.load(), len(self.logs)
        await live.start()
        said = repr(self.logs[logged:])
        judge.of_start(self, identification, [p.source for p in sources.parts], before, said)
        self.all_saved = False
        stop = asyncio.Event()
        supervision = SupervisorSettings(
            startup_timeout_s=0.0, tick_s=case.tick_s, connected_before=True
        )
        lives = [supervise_all(sources, live, clock, stop, supervision)]
        if self.axes is not None:
            lives.append(supervise_all(*self.axes.begin(settings), clock, stop, supervision))
        supervising = asyncio.create_task(_together(lives))
        taking = Overtaken(live, self.states)
        at_work = asyncio.create_task(people.act(self, live, settings, supervision))
        await self._watch(live, keeper, shown, until, supervising)
        if kind == "kill" and len(sources.parts) > 1 and case.sink_s:
            await taking.wait()
        at_work.cancel()
        if kind == "reload":
            await reload(self, live, sources, stop, supervising)
        if kind != "stop":
            return
        judge.of_calm(self, [p.source for p in sources.parts])
        if self.axes is not None:
            self.axes.judge_calm()
        live.end_soon()
        stop.set()
        await supervising
        self._refuse(refuses=False)
        self.past.refuses = False
        if self.axes is not None:
            await self.axes.end()
        if not await live.keep(within_s=live.time_left_s):
            self.counts["not all saved"] += 1
            return
        self.all_saved = True
        if self.rows is None:
            judge.of_history(self, keeper)
        else:
            self.rows.judge(keeper)
        marks = live.keeper.mark or [None] * len(sources.parts)
        clients = [part.source for part in sources.parts]
        self.all_taken = [
            c.server for c, mark in zip(clients, marks, strict=True) if c.mark == mark
        ]
        judge.of_counts(self, identification)

    def _learn(self, name, samples: Samples):
        valve = self.numbers[name]
        rows = [self.number_of[valve][t] for t in samples.t.tolist()]
        self.learnt[valve] += rows
        if self.leading is not None:
            self.leading.heard(valve, rows)
        self.published[signals_of(name)] += len(samples)
        if self.rows is not None:
            self.rows.add(signals_of(name), samples.t)
        self.note((name, samples.t.tolist()))

    async def _watch(self, live, keeper, shown, until, supervising):
        """Run until the end of this life; look every second at what must hold at any time."""
        case, time = self.case, self.time
        while time.elapsed < until and not supervising.done():
            now = time.elapsed
            troubles = {kind for first, last, kind in case.disks if first <= now < last}
            self._refuse(refuses="state" in troubles)
            self.past.refuses = "history" in troubles
            time.service_ahead_s = sum(by for at, by in case.service_steps if at <= now)
            for at, by in case.stalls:
                if now - judge.SLACK_S < at <= now:
                    time.elapsed += by
                    self.disturbed = time.elapsed
            await asyncio.sleep(min(judge.SLACK_S, until - time.elapsed))
            judge.of_shown(self, shown)
            judge.of_queues(self, live, keeper)
        if supervising.done():
            supervising.result()
            self.violated("the supervision ended")


async def _together(lives):
    await asyncio.gather(*lives)
