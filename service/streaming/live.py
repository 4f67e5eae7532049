"""The live service: data changes in, results, feed-forward and checkpoints out."""

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import structlog

from service.clock import Clock
from service.errors import SourceError, SourceRejected, StorageError
from service.identification.samples import Floats, Samples
from service.streaming.alignment import ByValve
from service.streaming.data_changes import DataChanges
from service.streaming.feedforward import (
    FeedForwardState,
    FeedForwardStatus,
    Refusals,
    Situation,
    decide,
    written,
)
from service.streaming.identification import MAPS_AT_ONCE, Identification
from service.streaming.ports import Checkpoint, CheckpointStore, Health, ResultSink, Source

VALVES_AT_ONCE = 32
OLD = 2.0  # by so many times `stale_after_s` a sample may be old until it is worth nothing
POSITION = "Service", "Position"  # under this name, which no valve has, the source's is kept
KEPT_PER_S = 20  # valves whose states are packed in a second, at 2 ms each, unless more are due
KEPT_IN_ONE_GO = 32  # of them: what a standstill has made late is caught up bit by bit
MAPS_IN_ONE_GO = 10  # of the maps that are computed anew in an interval: 25 ms
HEALTH_EVERY_S = 0.5  # the service's own condition is shown
LONGEST_TICK_S = 0.5  # of more, the rest was our own standstill
FEED_AGAIN_S = 0.05  # feed-forward goes on without samples; with them it has just been asked

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class LiveSettings:
    """Times in s.

    Attributes
    ----------
    stale_after_s : float
        Without a sample for this long a valve's sensors count as lost and its results as bad. Once
        the newest sample is older than this by the source's clock, results are uncertain; once it
        is OLD times as old, bad.
    reorder_s : float
        A sample that waits for earlier ones waits no longer than this, should no more samples come
        that it could be seen by.
    checkpoint_interval_s, map_interval_s : float
        How often states are kept at least (few valves: every second), and how often the inverse
        tables are computed anew.
    publish_budget_s : float
        How long publishing may hold up the next batch. Valves that find no time are first next
        time, with their newest results.
    publish_share : float
        Most of the time that goes into publishing as long as there is more to publish than that:
        samples that come in go before results that go out.
    """

    stale_after_s: float = 2.0
    reorder_s: float = 1.0
    checkpoint_interval_s: float = 10.0
    map_interval_s: float = 1.0
    publish_budget_s: float = 0.02
    publish_share: float = 0.25


class LiveService:
    """Fulfils :class:`service.streaming.supervisor.Consumer`."""

    def __init__(
        self,
        identification: Identification,
        source: Source,
        sink: ResultSink,
        store: CheckpointStore,
        clock: Clock,
        settings: LiveSettings,
        on_samples: Callable[[str, Samples], None] | None = None,
    ) -> None:
        self.identification = identification
        self._source = source
        self._sink = sink
        self._store = store
        self._clock = clock
        self._settings = settings
        self._on_samples = on_samples
        now = clock.monotonic()
        self._last_sample = np.full(len(identification.plans), now)
        self._held_s = np.zeros(len(identification.plans))  # how long samples have waited
        self._held_until = now
        self._source_started = 0
        self._lost = np.zeros(len(identification.plans), np.bool_)
        self._doubted = np.zeros(len(identification.plans), np.bool_)  # and said so
        self._old = np.zeros(len(identification.plans), np.bool_)
        self._health_due = now
        self._kept_at = math.nan
        self._failures = 0
        self._refused = 0
        self._mark: Any = None  # how far the source was heard: now, and when this round began
        self._mark_of_round: Any = None
        self._left_in_round: set[int] = set()
        self._keeping: asyncio.Task[None] | None = None
        self._unpublished: dict[int, None] = {}  # valves, the oldest first
        self._began, self._turns = now, 0  # of keeping the valves' states, one after the other
        self._map_due = now + settings.map_interval_s
        self._publish_due = now
        self._under_way = False
        self._connected = False
        self._fed_at = now
        self._newest = np.zeros(len(identification.plans), np.int64)  # sample's time, UTC ns
        self._newest_U = np.full(len(identification.plans), np.nan)
        self._fed = {
            number: FeedForwardState()
            for number, plan in enumerate(identification.plans)
            if plan.feed_forward is not None
        }

    async def start(self, known: Sequence[Checkpoint] = ()) -> None:
        """Take up what was kept before, and show that nothing is known of the present yet.

        ``known`` is newer than what was kept, if there is something.
        """
        kept = []
        for one in known or self._store.load():
            if (one.valve, one.estimator) == POSITION:
                self._source.resume_at(one.state)
            else:
                kept.append(one)
        self._source.hold_back()
        restored, refused = self.identification.restore(kept)
        self._refused = len({*refused, *self._store.damaged})
        self._lost[:] = True  # nothing is known of the present
        if self._store.damaged:
            log.warning("states damaged, those before them taken", estimators=self._store.damaged)
        if restored:
            log.info("states restored", estimators=restored)
        if refused:
            log.warning("states of another configuration left aside", estimators=refused)
        self._unpublished = dict.fromkeys(range(len(self._lost)))
        while self._unpublished:  # in turns: clients are answered meanwhile
            await self._publish_until(self._clock.monotonic())
            await asyncio.sleep(0.0)

    async def connected(self, source_started: int) -> None:
        """The source is there; if it was restarted, its samples are counted anew."""
        before, self._source_started = self._source_started, source_started
        if before and source_started and source_started != before:
            log.warning("source restarted")
            every = np.arange(len(self._lost))
            await self._use(self.identification.begin_source_anew(every))

    async def take(self, changes: DataChanges) -> None:
        """Identify, publish, feed forward."""
        self._connected = True
        self._mark = self._source.mark
        await self._use(self.identification.take(changes))

    async def _use(self, samples: ByValve) -> None:
        members, _, stops = samples.segments
        self._last_sample[members] = self._clock.monotonic()
        self._held_s[members] = 0.0
        self._newest[members] = samples.samples.t[stops - 1]
        self._newest_U[members] = samples.samples.U[stops - 1]
        ages = self._ages()
        steady = ~self.identification.holds()[members]
        self._lost[members] = steady & (ages[members] > OLD * self._settings.stale_after_s)
        self._old[members] = steady & (ages[members] > self._settings.stale_after_s)
        if self._on_samples is not None:
            for valve, batch in samples.items():
                self._on_samples(self.identification.plans[valve].name, batch)
        self._unpublished.update(dict.fromkeys(samples))
        self._say_what_is_doubted()
        self._say_what_was_found()
        await self._feed_forward()
        await self._publish_in_turn()
        if not self._under_way and len(samples):
            self._under_way = True
            log.info("first results published")

    async def tick(self) -> None:
        """Look after what is due by the clock."""
        now = self._clock.monotonic()
        await self._wait_no_longer(now)
        await self._doubt(now)
        if now - self._fed_at >= FEED_AGAIN_S:
            await self._feed_forward()
        await self._publish_in_turn()
        if now >= self._map_due:
            parts = math.ceil(min(len(self._lost), MAPS_AT_ONCE) / MAPS_IN_ONE_GO)
            self._map_due = now + self._settings.map_interval_s / parts
            self.identification.refresh_maps(1.0 / parts)
        self._keep_in_turn(now)
        await self._show_health(now)

    async def _doubt(self, now: float) -> None:
        """Call old what has become it since the last sample."""
        ages, limit = self._ages(), self._settings.stale_after_s
        silent = self.identification.holds() & self._connected  # nothing has changed
        stale = ((now - self._last_sample > limit) | (ages > OLD * limit)) & ~silent
        await self._lose(np.flatnonzero(stale & ~self._lost).tolist())
        old = np.flatnonzero((ages > limit) & ~self._old & ~silent)
        if len(old):
            self._old[old] = True
            self._unpublished.update(dict.fromkeys(old.tolist()))

    def _ages(self, valves: slice = slice(None)) -> Floats:
        """By how much each valve's newest sample is behind the source's clock, s; NaN: none yet."""
        now = self._clock.now() + round(self._source.clock_offset_s * 1e9)
        newest = self._newest[valves]
        return np.where(newest > 0, np.maximum((now - newest) * 1e-9, 0.0), np.nan)

    async def _show_health(self, now: float) -> None:
        if now < self._health_due:
            return
        self._health_due = now + HEALTH_EVERY_S
        await self._sink.show_health(
            Health(
                age_s=self._ages(),
                waiting=self.identification.pending(),
                source=self._source.counters,
                checkpoint_age_s=now - self._kept_at,
                checkpoint_failures=self._failures,
                checkpoints_refused=self._refused,
                checkpoint_bytes=self._store.size,
            )
        )

    async def _wait_no_longer(self, now: float) -> None:
        """Go on without what samples wait for, where nothing has left for too long.

        Time counts only while there is a connection, and our own standstills do not.
        """
        passed, self._held_until = now - self._held_until, now
        if not self._connected:
            return
        self._held_s += min(passed, LONGEST_TICK_S)
        self._held_s[~self.identification.waits()] = 0.0
        due = self._held_s > self._settings.reorder_s
        if due.any():
            await self._use(self.identification.wait_no_longer(np.flatnonzero(due)))

    async def lost(self, reason: SourceError) -> None:  # noqa: ARG002 - the supervisor logs it
        """Call every result bad: there is no connection."""
        self._connected = False
        await self._feed_forward()
        await self._lose(np.flatnonzero(~self._lost).tolist())

    async def keep(self) -> None:
        """Keep all states now.

        Raises
        ------
        StorageError
            naming the file; the states go on in memory.
        """
        await self.settle()
        await asyncio.to_thread(self._store.save, [*self.states(), *self._position(self._mark)])

    def states(self) -> list[Checkpoint]:
        """All that is known of all valves."""
        return self._states(range(len(self._lost)))

    async def settle(self) -> None:
        """Wait for what is being kept."""
        if self._keeping is not None:
            await self._keeping

    def _states(self, valves: Iterable[int]) -> list[Checkpoint]:
        some = list(valves)
        return [*self.identification.checkpoints(some), *self.identification.memories(some)]

    def _position(self, mark: Any) -> list[Checkpoint]:  # noqa: ANN401
        if mark is None:
            return []
        state = self._source.position(mark)
        return [Checkpoint(*POSITION, "", self._clock.now(), state, lam=None, frozen=False)]

    async def _keep(self, some: list[Checkpoint], mark: Any) -> None:  # noqa: ANN401
        """The disk may be slow, or full: nothing waits for it."""
        try:
            await asyncio.to_thread(self._store.save, some)
            self._kept_at = self._clock.monotonic()
            if mark is not None:
                self._source.commit(mark)
        except StorageError as error:
            self._failures += 1
            log.warning("checkpoint not kept", reason=str(error))

    def _keep_in_turn(self, now: float) -> None:
        """Keep each valve's state once in an interval, a few at a time: no batch waits for all."""
        if self._keeping is not None and not self._keeping.done():
            return
        M = len(self._lost)
        interval_s = min(self._settings.checkpoint_interval_s, max(1.0, M / KEPT_PER_S))
        due = min(int(M * (now - self._began) / interval_s), self._turns + KEPT_IN_ONE_GO)
        some = {turn % M for turn in range(self._turns, due)}
        self._turns = due
        if some:
            if not self._left_in_round:
                self._left_in_round, self._mark_of_round = set(range(M)), self._mark
            self._left_in_round -= some
            mark = None if self._left_in_round else self._mark_of_round
            states = [*self._states(sorted(some)), *self._position(mark)]
            self._keeping = asyncio.create_task(self._keep(states, mark))

    def _say_what_is_doubted(self) -> None:
        """Name the valves that are not learnt from, each once."""
        implausible = self.identification.implausible()
        for valve in np.flatnonzero(implausible & ~self._doubted).tolist():
            self._doubted[valve] = True
            name = self.identification.plans[valve].name
            why = [finding.sentence for finding in self.identification.findings(valve)]
            remedy = "mend the configuration, or insist = true for this valve"
            log.warning("not learnt from", valve=name, why="; ".join(why), remedy=remedy)

    def _say_what_was_found(self) -> None:
        for valve in self.identification.newly_timed():
            name = self.identification.plans[valve].name
            log.info("signals", valve=name, how="; ".join(self.identification.timing(valve)))

    async def _lose(self, valves: list[int]) -> None:
        for valve in valves:
            self._lost[valve] = True
            name = self.identification.plans[valve].name
            why = "; ".join(self.identification.waited_for(valve)) or "nothing comes any more"
            log.warning("sensors lost", valve=name, why=why)
        if valves:
            self._unpublished.update(dict.fromkeys(valves))
            await self._publish_all()

    async def _publish_in_turn(self) -> None:
        """Publish what the budget and the share of time allow."""
        began = self._clock.monotonic()
        if began < self._publish_due or not self._unpublished:
            return
        await self._publish_until(began + self._settings.publish_budget_s)
        now = self._clock.monotonic()
        self._publish_due = now + (now - began) * (1.0 / self._settings.publish_share - 1.0)

    async def _publish_all(self) -> None:
        await self._publish_until(np.inf)

    async def _publish_until(self, end: float) -> None:
        while self._unpublished:
            some = list(islice(self._unpublished, VALVES_AT_ONCE))
            for valve in some:
                del self._unpublished[valve]
            for results in self.identification.results(some, self._lost, self._old):
                await self._sink.publish(results)
            if self._clock.monotonic() >= end:
                break

    async def _feed_forward(self) -> None:
        """Lead every valve that is armed a step on, all at once."""
        self._fed_at = self._clock.monotonic()
        steps = (self._lead(valve) for valve in self._fed)
        for outcome in await asyncio.gather(*steps, return_exceptions=True):
            if isinstance(outcome, BaseException):
                raise outcome

    async def _lead(self, valve: int) -> None:
        settings = self.identification.plans[valve].feed_forward
        assert settings is not None  # noqa: S101 - these valves are fed
        before, situation = self._fed[valve], self._situation(valve)
        state, command = decide(settings, before, situation, self._clock.monotonic())
        if state.status is not before.status:
            self._say(valve, state.status)
        self._fed[valve] = state
        U_taken = command.U is None or await _is_taken(
            self._source.write_required_U(valve, command.U), state.refused_U
        )
        heartbeat_taken = command.heartbeat is None or await _is_taken(
            self._source.write_heartbeat(valve, command.heartbeat), state.refused_heartbeat
        )
        self._fed[valve] = written(
            state,
            command,
            self._clock.monotonic(),
            U_refused=not U_taken,
            heartbeat_refused=not heartbeat_taken,
        )

    def _situation(self, valve: int) -> Situation:
        armed = self.identification.is_armed(valve)
        if not (armed and self._connected):
            return Situation(armed, self._connected)
        waited = self._clock.monotonic() - self._last_sample[valve]
        behind = float(self._ages(slice(valve, valve + 1))[0])
        answer, status = self.identification.required(valve)
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

    def _say(self, valve: int, status: FeedForwardStatus) -> None:
        self.identification.note_feed_forward(valve, status)
        self._unpublished[valve] = None
        name = self.identification.plans[valve].name
        log.info("feed-forward", valve=name, status=status.name, why=status.sentence)


async def _is_taken(write: Awaitable[None], refused: Refusals) -> bool:
    try:
        await write
    except SourceRejected as error:
        if math.isinf(refused.last):
            log.warning("not written", reason=str(error))
        return False
    return True
