"""Publishes one site's results of the topic on its results server; history and alarms follow."""

import asyncio
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final, Protocol

import numpy as np
import structlog

from valvemap.clock import Clock, SystemClock
from valvemap.kafka.blocks import SamplesBlock, renumbered
from valvemap.kafka.catalogue import Catalogue
from valvemap.kafka.decoding import Tracebacks
from valvemap.kafka.group import Group
from valvemap.kafka.mirror import Mirror
from valvemap.kafka.operating import FleetOperator, Post
from valvemap.kafka.reading import Heard
from valvemap.kafka.rejections import Rejection, Rejections
from valvemap.kafka.result_blocks import ResultsBlock
from valvemap.kafka.settings import FleetConfig
from valvemap.model.samples import Times
from valvemap.opcua_results.results_server import ResultsServer
from valvemap.pipeline.alarm_results import AlarmChange
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.result_ports import Health, PastCounters
from valvemap.pipeline.results import Results
from valvemap.pipeline.store_ports import PastStore
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.service_health import DAY_NS, EVERY_S
from valvemap.vocabulary.service_alarms import ServiceAlarm
from valvemap.vocabulary.statuses import Quality

_VALVES_AT_ONCE: Final = 32  # valves published before yielding to other tasks
_COMMIT_EVERY_S: Final = 5.0  # s; interval of offset commits, after a flush of the history

log = structlog.get_logger(__name__)


class Reader(Protocol):
    """The methods of `ResultsReader` that `Show` uses."""

    def read(self) -> Heard:
        """Poll with a short timeout."""

    def commit(self) -> None:
        """Commit the offsets of all messages read."""


class Show:
    """Publishes the results of the topic on the results server."""

    def __init__(
        self,
        catalogue: Catalogue,
        site: str,
        config: FleetConfig,
        groups: dict[str, Group],
        post: Post,
        past: PastStore | None = None,
        clock: Clock | None = None,
    ) -> None:
        names = [valve.name for valve in catalogue.sites[site].valves]
        self._numbers = {name: number for number, name in enumerate(names)}
        self._clock = clock or SystemClock()
        self._post = post
        self._stale_s = config.serve.stale_after_s
        self.mirror, self._earlier = Mirror(names), Mirror(names)
        self.operator = FleetOperator(
            {plan.name: group.plan.name for group in groups.values() for plan in group.plan.plans},
            self._numbers,
            self.mirror,
            post,
            config.serve.answer_s,
            {
                plan.name: group.identification.alarms(plan.name)
                for group in groups.values()
                for plan in group.plan.plans
            },
        )
        self._past = None if past is None else PastKeeper(past, names)
        self.certificate_until_ns = 0
        self.failed = 0  # valid messages that raised an unexpected exception
        self._tracebacks = Tracebacks()
        self._rejections = Rejections(config.serve.rejected_quiet_s)
        now = self._clock.monotonic()
        self._heard_at = np.full(len(names), now)
        self._standing = np.full(len(names), int(Quality.BAD))  # until the first current results
        self._health_due = self._commit_due = now

    def keep(self, change: AlarmChange) -> None:
        """Store an alarm change in the history."""
        if self._past is not None:
            self._past.note_alarm(change)

    async def first(self, server: ResultsServer, blocks: Sequence[ResultsBlock]) -> None:
        """Publish the checkpoints' results with quality Bad: the present state is unknown."""
        for block in blocks:
            self.mirror.take(block)
        await self._again(server, range(len(self._numbers)), Quality.BAD)

    async def run(self, server: ResultsServer, reader: Reader, stop: asyncio.Event) -> None:
        """Publish results until ``stop`` is set."""
        try:
            while not stop.is_set():
                await self._take(server, await asyncio.to_thread(reader.read))
                self._post.tend()
                await self._doubt(server)
                await self._look_after(server, reader)
        finally:
            if self._past is not None and await self._past.settle():
                reader.commit()

    async def _take(self, server: ResultsServer, heard: Heard) -> None:
        now = self._clock.monotonic()
        self._rejections.note(heard.rejected, now, self._clock.now())
        if self._past is not None:
            for block in heard.earlier:
                with self._bulkhead(block.group):
                    self._past.note(self._earlier.take(block))
            for samples in heard.samples:
                with self._bulkhead(samples.group):
                    self._past.take(self._own(samples))
        for block in heard.results:
            try:
                await self._show(server, block, now)
            except Exception as error:  # noqa: BLE001 - bulkhead: one message ends no server
                self._note(block.group, error)
                self.mirror.forget(block.valves)
            await asyncio.sleep(0)
        for reply in heard.replies:
            self.operator.take(reply)

    async def _show(self, server: ResultsServer, block: ResultsBlock, now: float) -> None:
        before = self.mirror.newest.copy()
        found = self.mirror.take(block)
        if not len(found.valves):
            return
        # Not "later than": after results with a wrong time, the next ones must be accepted as new.
        newer = found.valves[self.mirror.newest[found.valves] != before[found.valves]]
        self._heard_at[newer], self._standing[newer] = now, int(Quality.GOOD)
        for results in self._as_they_stand(found.valves):
            await server.publish(results)
            if self._past is not None:
                self._past.note(results)

    @contextmanager
    def _bulkhead(self, group: str) -> Iterator[None]:
        """Log unexpected exceptions: one message must not stop the server."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - bulkhead
            self._note(group, error)

    def _note(self, group: str, error: Exception) -> None:
        self.failed += 1
        why = self._tracebacks.note(error)
        now, utc = self._clock.monotonic(), self._clock.now()
        self._rejections.note([Rejection.of(group.encode(), why)], now, utc)
        log.warning("results not shown", group=group, reason=why, failed=self.failed)

    def _as_they_stand(self, valves: Times) -> Iterator[Results]:
        for quality in np.unique(self._standing[valves]).tolist():
            some = valves[self._standing[valves] == quality].tolist()
            yield from self.mirror.again(some, quality)

    async def _doubt(self, server: ResultsServer) -> None:
        """Lower the quality of valves without newer results."""
        silent = self._clock.monotonic() - self._heard_at
        now_at = np.where(silent > 2.0 * self._stale_s, int(Quality.BAD), int(Quality.GOOD))
        now_at[(silent > self._stale_s) & (silent <= 2.0 * self._stale_s)] = int(Quality.UNCERTAIN)
        worse = np.flatnonzero(now_at > self._standing)
        if not len(worse):
            return
        self._standing[worse] = now_at[worse]
        for quality in np.unique(now_at[worse]).tolist():
            some = worse[now_at[worse] == quality]
            log.warning("no newer results", valves=len(some), quality=Quality(quality).name)
            await self._again(server, some.tolist(), Quality(quality))

    async def _again(self, server: ResultsServer, valves: Sequence[int], quality: Quality) -> None:
        for start in range(0, len(valves), _VALVES_AT_ONCE):
            for results in self.mirror.again(valves[start : start + _VALVES_AT_ONCE], quality):
                await server.publish(results)
                if self._past is not None:
                    self._past.note(results)
            await asyncio.sleep(0)

    async def _look_after(self, server: ResultsServer, reader: Reader) -> None:
        now, utc = self._clock.monotonic(), self._clock.now()
        if self._past is not None:
            self._past.tick(now)
            if now >= self._commit_due:
                self._commit_due = now + _COMMIT_EVERY_S
                if await self._past.settle():
                    reader.commit()
        if now < self._health_due:
            return
        self._health_due = now + EVERY_S
        self._note_alarms(now, utc)
        newest = self.mirror.newest
        age = np.where(newest > 0, np.maximum((utc - newest) * 1e-9, 0.0), np.nan)
        await server.show_health(
            Health(
                age_s=age,
                waiting=np.zeros(len(newest), np.int64),
                history=PastCounters() if self._past is None else self._past.counters,
                alarms=self.operator.alarms(None),
            )
        )

    def _note_alarms(self, now: float, utc: int) -> None:
        """Update the alarms of the service."""
        alarms, days_left = self.operator.service_alarms, np.nan
        if self.certificate_until_ns:
            days_left = (self.certificate_until_ns - utc) / DAY_NS
        rejected = self._rejections.count(now)
        alarms.give_reason(ServiceAlarm.MESSAGES_REJECTED, self._rejections.reason)
        alarms.note(
            utc,
            {ServiceAlarm.CERTIFICATE: -days_left, ServiceAlarm.MESSAGES_REJECTED: float(rejected)},
        )

    def _own(self, block: SamplesBlock) -> ByValve:
        """Return the samples with the site's valve numbers."""
        members = block.samples.segments.members
        own = [self._numbers.get(block.valves[member], -1) for member in members]
        return renumbered(block.samples, np.array(own, np.int64))
