"""The live service: data changes in, results, feed-forward and checkpoints out."""

import asyncio
import math
from collections.abc import Callable

import numpy as np
import structlog

from valvemap.clock import Clock
from valvemap.errors import SourceError, SourceLost, ValvemapError
from valvemap.model.samples import Samples, Times
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.kept_together import KeptValves
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.maps_and_surveys import MAPS_AT_ONCE
from valvemap.pipeline.result_ports import COMPLETE, ResultSink
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import CheckpointStore, KeptElsewhere
from valvemap.runtime.doubted_valves import DoubtedValves
from valvemap.runtime.dynamics import LiveDynamics
from valvemap.runtime.failure_log import log_failure
from valvemap.runtime.feed_forward_writer import FeedForwardWriter
from valvemap.runtime.kept_position import resume_source
from valvemap.runtime.learning_pace import LEARN_S, LearningPace
from valvemap.runtime.led_valves import LedValves
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.restoring import REMEDY, by_reason, restore
from valvemap.runtime.result_publisher import ResultPublisher
from valvemap.runtime.sample_ages import SampleAges
from valvemap.runtime.service_health import ServiceHealth
from valvemap.runtime.source_remarks import SourceRemarks
from valvemap.runtime.stale_samples import StaleSamples
from valvemap.runtime.state_keeper import StateKeeper
from valvemap.runtime.valve_log import ValveLog
from valvemap.runtime.waiting_time import WaitingTime

LAST_S = 0.3  # s; after a request to end, how long incoming changes are still estimated
MAPS_IN_ONE_GO = 10  # inverse tables computed per refresh: 25 ms
FAREWELL_S = 4.2  # s; longest shutdown: some service managers kill after 5 s

log = structlog.get_logger(__name__)


class LiveService:
    """Implements :class:`valvemap.runtime.supervisor.Consumer`."""

    def __init__(
        self,
        identification: Identification,
        source: AllSources,
        sink: ResultSink,
        store: CheckpointStore,
        clock: Clock,
        settings: LiveSettings,
        on_samples: Callable[[str, Samples], None] | None = None,
        past: PastKeeper | None = None,
        dynamics: LiveDynamics | None = None,
    ) -> None:
        self.identification = identification
        self._source = source
        self._sink = sink
        self._store = store
        self._clock = clock
        self._settings = settings
        self._on_samples = on_samples
        self._past = past
        self._dynamics = dynamics
        self._numbers = {plan.name: n for n, plan in enumerate(identification.plans)}
        now = clock.monotonic()
        valves = len(identification.plans)
        self._held = WaitingTime(valves, settings.reorder_s, now)  # samples in the reorder buffer
        self._valve_log = ValveLog(identification)
        self._remarks = SourceRemarks(identification, source)
        self._pace = LearningPace(is_interpreted=identification.journal is not None)
        self._is_whole = asyncio.Event()
        self._end_by = math.inf
        self._samples_wait = False
        self._states = KeptValves(identification)
        self.keeper = StateKeeper(
            self._states, source, store, clock, settings.checkpoint_interval_s
        )
        self._ages = SampleAges(len(identification.plans), source, clock)
        self._publisher = ResultPublisher(
            identification,
            sink,
            past,
            clock,
            self._ages,
            share=settings.publish_share,
            budget_s=settings.publish_budget_s,
            stale_after_s=settings.stale_after_s,
        )
        self._lost = self._publisher.lost
        self._stale = StaleSamples(
            valves, settings.stale_after_s, self._ages, clock, self._lost, self._publisher.old
        )
        self._doubts = DoubtedValves(identification, sink, self._publisher, self._stale, self._ages)
        self.health = ServiceHealth(
            identification, source, sink, store, self.keeper, past, clock, self._ages
        )
        self.health.certificate_until_ns = settings.certificate_until_ns
        self._map_due = now + settings.map_interval_s
        self._under_way = False
        self._newest_U = np.full(len(identification.plans), np.nan)
        led = LedValves(identification, self._stale, self._newest_U, self._publisher.note_new)
        self._feed_forward = FeedForwardWriter(led, len(identification.plans), source, clock)

    def note_states_elsewhere(self, kept: KeptElsewhere) -> None:
        """Include the states of another keeper in the alarm Checkpoint and the counters."""
        self.health.kept_elsewhere = kept

    async def complete(self, whole: Identification) -> None:
        """Let ``whole`` repeat all calls of the preview so far, and replace it."""
        journal = self.identification.journal
        assert journal is not None  # noqa: S101 - the caller started with a preview
        while calls := journal.take_new():
            await asyncio.to_thread(whole.repeat, calls)
        self.identification.take_over(whole)  # nothing was awaited since the last call
        self.health.start_state = COMPLETE
        self._is_whole.set()
        self._publisher.note_new(range(len(self._lost)))

    async def start(self) -> None:
        """Restore the checkpoints and publish all sensors as lost until samples arrive."""
        stored = self._store.load(self._states.together)
        kept, lost_place = resume_source(self._source, stored)
        refused = {**restore(self._states, self._store, kept), **lost_place}
        self.identification.was_away()
        self.keeper.refused = len({*refused, *self._store.damaged})
        self._lost[:] = True  # no sample has arrived yet
        if refused:
            log.warning(
                "checkpoints set aside, their estimators are reset",
                why=by_reason(refused),
                remedy=REMEDY,
            )
        self._publisher.note_new(range(len(self._lost)))
        while len(self._publisher):  # in turns, so that clients are served in between
            await self._publisher.publish_until(self._clock.monotonic())
            await asyncio.sleep(0.0)

    async def connected(self, valves: Times | None = None, *, restarted_at: int | None) -> None:
        """Note the connection; if the source was restarted, restart its alignment."""
        own = self._own(valves)
        if restarted_at is not None:
            log.warning("source restarted")
            self._ages.clocks.forget(own)  # their source was restarted
            await self._use(self.identification.begin_source_anew(own, restarted_at), own)

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:
        """Identify, publish, feed forward, in pieces; a lost connection is raised at the end."""
        own, lost = self._own(valves), None
        self.identification.announce(changes, self._stale.note_source(own))
        rest = changes
        while len(rest):
            await self._wait_if_behind(len(rest))
            began = self._clock.monotonic()
            if began > self._end_by - FAREWELL_S + LAST_S:
                return  # not acknowledged, so the source resends it
            some = self._pace.at_once
            piece, rest = rest[:some], rest[some:]
            samples = self.identification.take(piece)
            took_s = self._clock.monotonic() - began
            self._pace.note(len(piece), took_s)
            if took_s > LEARN_S / 2.0:
                await asyncio.sleep(0.0)
            self._samples_wait = len(rest) > 0
            try:
                await self._use(samples, own if lost is None else _NONE)
            except SourceLost as error:
                lost = error
            self.health.worked_s += self._clock.monotonic() - began
            if len(rest):
                await self._doubts.doubt_old(self._ages.of())
                await self._show_health(self._clock.monotonic())
                await asyncio.sleep(0.0)
        self.keeper.mark = self._source.mark
        if lost is not None:
            raise lost

    async def _wait_if_behind(self, changes: int) -> None:
        """Wait for the whole identification if the preview cannot keep up; the source queues."""
        journal = self.identification.journal
        if journal is None or self._is_whole.is_set():
            return
        if journal.is_full or self._pace.falls_behind(changes):
            log.warning("too many samples for interpreted kernels", remedy="wait for compilation")
            await self._is_whole.wait()

    def end_soon(self) -> None:
        """Start the shutdown time: changes are estimated for another LAST_S, then rejected."""
        self._end_by = self._clock.monotonic() + FAREWELL_S
        self._is_whole.set()

    @property
    def time_left_s(self) -> float:
        """Time left to save checkpoints, s."""
        return min(FAREWELL_S, max(self._end_by - self._clock.monotonic(), 0.0))

    def _own(self, valves: Times | None) -> Times:
        return np.arange(len(self._lost)) if valves is None else valves

    async def _use(self, samples: ByValve, own: Times | None = None) -> None:
        members, _, stops = samples.segments
        self._held.heard(members)
        self._newest_U[members] = samples.samples.U[stops - 1]
        newest = samples.samples.t[stops - 1]
        self._stale.note_samples(members, newest, self.identification.stamping.holds)
        if self._past is not None:
            self._past.take(samples)
        if self._dynamics is not None:
            self._dynamics.take(samples)
        if self._on_samples is not None:
            for valve, batch in samples.items():
                self._record(valve, batch)
        self._publisher.note_new(samples)
        self._log_failures()
        self._valve_log.note_changes()
        await self._feed_forward.write(self._own(own))
        await self._publisher.publish_in_turn(samples_wait=self._samples_wait)
        if not self._under_way and len(samples):
            self._under_way = True
            log.info("first results published")

    def _record(self, valve: int, batch: Samples) -> None:
        assert self._on_samples is not None  # noqa: S101 - the caller checks
        try:
            self._on_samples(self.identification.plans[valve].name, batch)
        except ValvemapError:
            raise
        except Exception as error:  # noqa: BLE001 - a bulkhead: other valves are recorded
            self.identification.stop(valve, Step.RECORDING, error)

    def _log_failures(self) -> None:
        """Log each lane failure once, and publish its status."""
        if self._past is not None:
            for valve, error in self._past.take_failed():
                self.identification.stop(valve, Step.HISTORY, error)
        for failure in self.identification.failures.take_new():
            log_failure(failure)
            self._publisher.note_new([self._numbers[failure.valve]])

    async def tick(self, valves: Times | None = None) -> None:
        """Run the tasks that are due; only ``valves`` are fed forward."""
        now, own = self._clock.monotonic(), self._own(valves)
        self._log_failures()
        self._publisher.note_new(self._remarks.note_changes())
        await self._wait_no_longer(now)
        await self._doubts.doubt(now)
        await self._feed_forward.write(own[self._feed_forward.are_due(own, now)])
        await self._publisher.publish_in_turn(samples_wait=self._samples_wait)
        if now >= self._map_due:
            parts = max(1, math.ceil(min(len(self._lost), MAPS_AT_ONCE) / MAPS_IN_ONE_GO))
            self._map_due = now + self._settings.map_interval_s / parts
            self.identification.maps.refresh(1.0 / parts)
        self.keeper.keep_in_turn(now)
        if self._past is not None:
            self._past.tick(now)
        if self._dynamics is not None:
            self._dynamics.tick()
        await self._show_health(now)

    async def _show_health(self, now: float) -> None:
        await self.health.show_if_due(now, late=self._publisher.late)

    async def _wait_no_longer(self, now: float) -> None:
        """Flush the reorder buffer of valves whose samples have waited longer than `reorder_s`.

        Only time with a connection counts; stalls of this process do not.
        """
        due = self._held.due(now, self._stale.connected, self.identification.arrivals.waits())
        if len(due):
            await self._use(self.identification.wait_no_longer(due), _NONE)

    async def lost(
        self,
        reason: SourceError,  # noqa: ARG002 - the supervisor logs it
        valves: Times | None = None,
    ) -> None:
        """Set all results of these valves Bad: the connection to their source is lost."""
        own = self._own(valves)
        self._stale.connected[own] = False
        await self._feed_forward.write(own)
        await self._doubts.lose(own[~self._lost[own]].tolist())

    async def keep(self, within_s: float = math.inf) -> bool:
        """Save all states, or as many as the time limit permits; see `StateKeeper.keep`."""
        end = self._clock.monotonic() + within_s
        if self._past is not None:
            await self._past.settle()
        return await self.keeper.keep(end)


_NONE: Times = np.empty(0, np.int64)  # no valve: the next tick feeds these forward
