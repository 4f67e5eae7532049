"""The live service: data changes in, results, feed-forward and checkpoints out."""

import asyncio
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import structlog

from valvemap.clock import Clock
from valvemap.errors import SourceError, ValvemapError
from valvemap.model.samples import Floats, Samples, Times
from valvemap.pipeline.alignment import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.feedforward import Situation
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.kept_together import KeptValves
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.maps_and_surveys import MAPS_AT_ONCE
from valvemap.pipeline.result_ports import COMPLETE, ResultSink
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import Checkpoint, CheckpointStore, KeptElsewhere
from valvemap.runtime.dynamics import LiveDynamics
from valvemap.runtime.failure_log import log_failure
from valvemap.runtime.feed_forward_writer import FeedForwardWriter
from valvemap.runtime.kept_position import resume_source
from valvemap.runtime.led_valves import LedValves
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.restoring import REMEDY, by_reason, restore
from valvemap.runtime.result_publisher import ResultPublisher
from valvemap.runtime.sample_ages import SampleAges
from valvemap.runtime.service_health import ServiceHealth
from valvemap.runtime.state_keeper import StateKeeper
from valvemap.runtime.valve_log import ValveLog
from valvemap.runtime.waiting_time import WaitingTime

OLD = 2.0  # times `stale_after_s`; a sample older than this makes results Bad
BEHIND_S = 1.0  # s; a preview with a longer backlog takes no more samples until compilation ends
LEARN_S = 0.05  # s; target duration of one piece when a backlog is estimated
FEWEST_AT_ONCE = 600  # changes: 100 samples, 0.1 s if Auto fits all; smaller pieces cost more each
FIRST_AT_ONCE = 3_000  # changes; size of the first piece, before the pace is measured
QUICKER = 0.05  # weight of a piece that is quicker than the estimated pace: fits come in bursts
LAST_S = 0.3  # s; after a request to end, how long incoming changes are still estimated
MAPS_IN_ONE_GO = 10  # inverse tables computed per refresh: 25 ms
FAREWELL_S = 4.2  # s; longest shutdown: some service managers kill after 5 s

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class LiveSettings:
    """Times in s.

    Attributes
    ----------
    stale_after_s : float
        Without a sample for this long, a valve's sensors are lost and its results Bad. If the
        newest sample is older than this by the source's clock, results are Uncertain; if it is OLD
        times as old, Bad.
    reorder_s : float
        Longest time that a sample waits in the reorder buffer for earlier samples.
    checkpoint_interval_s, map_interval_s : float
        Longest interval between checkpoints of a valve (few valves: every second), and interval
        at which the inverse tables are recomputed.
    publish_budget_s : float
        Longest time that publishing may delay the next batch. Valves that exceed the budget are
        published first next time, with their newest results.
    publish_share : float
        Largest share of the time spent on publishing while results wait: incoming samples have
        priority over outgoing results. See
        :class:`~valvemap.runtime.publishing_turns.PublishingTurns`.
    certificate_until_ns : int
        Expiry of the service's certificate, UTC ns; 0: no persistent certificate.
    """

    stale_after_s: float = 2.0
    reorder_s: float = 1.0
    checkpoint_interval_s: float = 10.0
    map_interval_s: float = 1.0
    publish_budget_s: float = 0.02
    publish_share: float = 0.25
    certificate_until_ns: int = 0


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
        self._last_sample = np.full(len(identification.plans), now)
        valves = len(identification.plans)
        self._held = WaitingTime(valves, settings.reorder_s, now)  # samples in the reorder buffer
        self._silent = WaitingTime(valves, settings.stale_after_s, now)
        self._heard_at = np.full(len(identification.plans), now)  # last change of their source
        self._valve_log = ValveLog(identification)
        self._remarks: Mapping[int, tuple[str, ...]] = {}  # as published
        self._changes_per_s = FIRST_AT_ONCE / LEARN_S  # estimated pace
        if identification.journal is not None:
            self._changes_per_s = FEWEST_AT_ONCE / LEARN_S  # its kernels run interpreted
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
        self._lost, self._old = self._publisher.lost, self._publisher.old
        self.health = ServiceHealth(
            identification, source, sink, store, self.keeper, past, clock, self._ages
        )
        self.health.certificate_until_ns = settings.certificate_until_ns
        self._map_due = now + settings.map_interval_s
        self._under_way = False
        self._connected = np.zeros(len(identification.plans), np.bool_)
        self._newest_U = np.full(len(identification.plans), np.nan)
        led = LedValves(identification, self._situation, self._publisher.note_new)
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

    async def start(self, known: Sequence[Checkpoint] = ()) -> None:
        """Restore the checkpoints and publish all sensors as lost until samples arrive.

        ``known``, if not empty, replaces the stored checkpoints.
        """
        stored = known or self._store.load(self._states.together)
        kept, lost_place = resume_source(self._source, stored)
        refused = {**restore(self._states, self._store, kept), **lost_place}
        self.identification.was_away()
        self.keeper.refused = len({*refused, *self._store.damaged})
        self._lost[:] = True  # no sample has arrived yet
        if refused:
            log.warning(
                "states left aside, these start afresh", why=by_reason(refused), remedy=REMEDY
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
            self._ages.forget_clock(own)
            await self._use(self.identification.begin_source_anew(own, restarted_at), own)

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:
        """Identify, publish and feed forward; a backlog in pieces, with other tasks in between."""
        own = self._own(valves)
        self._connected[own] = True
        self._heard_at[own] = received = self._clock.monotonic()
        self.identification.announce(changes, received)
        rest = changes
        while len(rest):
            await self._wait_if_behind(len(rest))
            began = self._clock.monotonic()
            if began > self._end_by - FAREWELL_S + LAST_S:
                return  # not acknowledged, so the source resends it
            some = max(FEWEST_AT_ONCE, int(LEARN_S * self._changes_per_s))
            piece, rest = rest[:some], rest[some:]
            samples = self.identification.take(piece)
            took_s = self._clock.monotonic() - began
            self._note_pace(len(piece), took_s)
            if took_s > LEARN_S / 2.0:
                await asyncio.sleep(0.0)
            self._samples_wait = len(rest) > 0
            await self._use(samples, own)
            self.health.worked_s += self._clock.monotonic() - began
            if len(rest):
                await self._doubt_old(self._ages.of())
                await self._show_health(self._clock.monotonic())
                await asyncio.sleep(0.0)
        self.keeper.mark = self._source.mark

    async def _wait_if_behind(self, changes: int) -> None:
        """Wait for the whole identification if the preview cannot keep up; the source queues."""
        journal = self.identification.journal
        if journal is None or self._is_whole.is_set():
            return
        if journal.is_full or changes > BEHIND_S * self._changes_per_s:
            log.warning("too many samples for interpreted kernels", remedy="wait for compilation")
            await self._is_whole.wait()

    def _note_pace(self, changes: int, took_s: float) -> None:
        if changes >= FEWEST_AT_ONCE and took_s > 0.0:
            quicker = changes / took_s - self._changes_per_s
            self._changes_per_s += quicker * (QUICKER if quicker > 0.0 else 1.0)

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
        self._last_sample[members] = self._clock.monotonic()
        self._held.heard(members)
        self._silent.heard(members)
        self._ages.note(members, samples.samples.t[stops - 1])
        self._newest_U[members] = samples.samples.U[stops - 1]
        ages = self._ages.of()
        steady = ~self.identification.holds()[members]
        self._lost[members] = steady & (ages[members] > OLD * self._settings.stale_after_s)
        self._old[members] = steady & (ages[members] > self._settings.stale_after_s)
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
        self._note_remarks()
        await self._wait_no_longer(now)
        await self._doubt(now)
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

    async def _doubt(self, now: float) -> None:
        """Mark valves as lost, overdue or old whose newest sample has aged past its limit.

        Results are old whatever the reason; an alarm needs silence while this process listened.
        """
        ages, limit = self._ages.of(), self._settings.stale_after_s
        silent = self.identification.holds() & self._connected  # on-change signals at rest
        none_came = now - self._last_sample > limit
        stale = (none_came | (ages > OLD * limit)) & ~silent
        listened = np.zeros_like(stale)
        listened[self._silent.due(now, np.ones_like(stale), ~silent)] = True
        silent_now = np.flatnonzero(stale & (listened | ~none_came))
        if len(silent_now):
            source_now = self._ages.source_now()[silent_now]
            self._publisher.note_new(self.identification.say_overdue(silent_now, source_now))
        await self._lose(np.flatnonzero(stale & ~self._lost).tolist())
        await self._doubt_old(ages)

    async def _doubt_old(self, ages: Floats) -> None:
        """Set the shown results of newly old valves Uncertain, and queue their new results."""
        limit, silent = self._settings.stale_after_s, self.identification.holds()
        old = np.flatnonzero((ages > limit) & ~self._old & ~(silent & self._connected))
        if len(old):
            self._old[old] = True
            await self._sink.doubt(old)
            self._publisher.note_new(old.tolist())

    async def _show_health(self, now: float) -> None:
        await self.health.show_if_due(now, late=self._publisher.late)

    async def _wait_no_longer(self, now: float) -> None:
        """Flush the reorder buffer of valves whose samples have waited longer than `reorder_s`.

        Only time with a connection counts; stalls of this process do not.
        """
        due = self._held.due(now, self._connected, self.identification.arrivals.waits())
        if len(due):
            await self._use(self.identification.wait_no_longer(due), _NONE)

    async def lost(
        self,
        reason: SourceError,  # noqa: ARG002 - the supervisor logs it
        valves: Times | None = None,
    ) -> None:
        """Set all results of these valves Bad: the connection to their source is lost."""
        own = self._own(valves)
        self._connected[own] = False
        await self._feed_forward.write(own)
        await self._lose(own[~self._lost[own]].tolist())

    async def keep(self, within_s: float = math.inf) -> bool:
        """Save all states, or as many as the time limit permits; see `StateKeeper.keep`."""
        end = self._clock.monotonic() + within_s
        if self._past is not None:
            await self._past.end()
        return await self.keeper.keep(end)

    async def _lose(self, valves: list[int]) -> None:
        for valve in valves:
            self._lost[valve] = True
            name = self.identification.plans[valve].name
            silent_s = self._clock.monotonic() - self._heard_at[valve]
            if silent_s > self._settings.stale_after_s or not self._connected[valve]:
                why = f"nothing has come from its source for {silent_s:.1f} s"
            else:
                why = (
                    "; ".join(self.identification.results.waited_for(valve))
                    or "nothing comes any more"
                )
            log.warning("sensors lost", valve=name, why=why)
        if valves:
            self._publisher.note_new(valves)
            await self._publisher.publish_until(math.inf)

    def _note_remarks(self) -> None:
        """Publish what the source says of each valve's nodes, where that changed."""
        remarks = self._source.remarks
        if remarks is self._remarks or remarks == self._remarks:
            return
        both = remarks.keys() | self._remarks.keys()
        changed = [n for n in sorted(both) if remarks.get(n) != self._remarks.get(n)]
        self._remarks = remarks
        for valve in changed:
            self.identification.note_source(valve, remarks.get(valve, ()))
        self._publisher.note_new(changed)

    def _situation(self, valve: int) -> Situation:
        armed = self.identification.armed.is_armed(valve)
        connected = bool(self._connected[valve])
        if not (armed and connected):
            return Situation(armed, connected)
        waited = self._clock.monotonic() - self._last_sample[valve]
        behind = float(self._ages.of(slice(valve, valve + 1))[0])
        answer, status = self.identification.answers.required(valve)
        return Situation(
            armed=armed,
            connected=True,
            age_s=max(float(waited), behind),
            U=float(self._newest_U[valve]),
            map=status,
            required_U=answer.U,
            width=answer.width,
            answer=answer.status,
        )


_NONE: Times = np.empty(0, np.int64)  # no valve: the next tick feeds these forward
