"""The consumer of a site's sources: aligns their changes and keeps the samples as blocks."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import structlog

from valvemap.app.build import build_alignment, build_timing
from valvemap.clock import Clock, SystemClock
from valvemap.errors import SourceError, StorageError
from valvemap.kafka.blocks import SamplesBlock, write_samples
from valvemap.kafka.catalogue import Catalogue, groups_of
from valvemap.kafka.decoding import most_rows
from valvemap.kafka.sending import SAID_AGAIN_S
from valvemap.kafka.settings import FleetConfig
from valvemap.kafka.spool import Packed, Spool
from valvemap.model.estimator import StateMismatchError
from valvemap.model.samples import Samples, Segments, Times
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.runtime.failure_log import log_left_out, log_missing
from valvemap.runtime.sources import Sources
from valvemap.runtime.waiting_time import WaitingTime

_UNSAVED: Final = 64_000_000  # bytes; limit of the buffer while the disk fails; drops the oldest
_NUMBERS: Final = "numbers"
_ARRIVALS: Final = "arrivals"
_POSITION: Final = "position"

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class _Taken:
    """Blocks, and the source position after them."""

    blocks: list[SamplesBlock]
    kept: Mapping[str, bytes]
    mark: tuple[Any, ...] | None


class Collector:
    """Implements :class:`valvemap.runtime.supervisor.Consumer`.

    The source position, the alignment buffers, the block numbers and the blocks are saved in one
    transaction. After a restart, no sample is lost and none is in two blocks.

    Parameters
    ----------
    catalogue, site
        All groups, and the site of the sources.
    config
        Interval and size of the blocks.
    sources, spool
        Source of the samples, and queue of the blocks.
    clock
        The system clock if None.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        site: str,
        config: FleetConfig,
        sources: Sources,
        spool: Spool,
        clock: Clock | None = None,
    ) -> None:
        valves = catalogue.sites[site].valves
        self._sources, self._spool = sources, spool
        self._clock = clock or SystemClock()
        self._catalogue = catalogue.version
        self._groups = groups_of(catalogue, site)
        self._per_group = config.catalogue.valves_per_group
        self._commit_s = config.collect.commit_s
        self._rows = most_rows(round(config.topics.message_mb * 1e6))
        site_config = catalogue.sites[site]
        self._arrivals = Arrivals(
            [valve.name for valve in valves],
            build_alignment(site_config),
            build_timing(site_config),
        )
        self._numbers = {group.name: 0 for group in self._groups}
        self.given_up = 0  # samples dropped since the first start
        self.packed = self.left_out = 0  # samples in blocks; samples of failed valves
        self._parts: list[ByValve] = []
        self._has_new_data = False
        self._unsaved: list[Packed] = []
        self._saving: asyncio.Task[None] | None = None
        now = self._clock.monotonic()
        self._due = now
        self._held = WaitingTime(len(valves), site_config.alignment.reorder_ms * 1e-3, now)
        self._said = now - SAID_AGAIN_S
        self._connected = np.zeros(len(valves), np.bool_)

    def resume(self) -> None:
        """Resume from the saved state, as far as the configuration is unchanged."""
        kept = self._spool.kept()
        if kept:
            said = json.loads(kept[_NUMBERS])
            self._numbers.update((n, k) for n, k in said["groups"].items() if n in self._numbers)
            self.given_up = said["given_up"]
            try:
                self._arrivals.resume(kept[_ARRIVALS])
            except StateMismatchError as error:
                log.warning("signals not yet aligned are dropped", reason=str(error))
            if _POSITION in kept and not self._sources.resume_at(kept[_POSITION]):
                log.warning("not a position at this source: samples may be missing")
            log.info("collecting continues", blocks=sum(self._numbers.values()))
        self._sources.hold_back()

    async def connected(self, valves: Times | None = None, *, restarted_at: int | None) -> None:
        """Note the start of a source; if it was restarted, reset its sample counting."""
        own = self._own(valves)
        if restarted_at is not None:
            log.warning("source restarted")
            self._use(self._arrivals.begin_source_anew(own, restarted_at))

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:
        """Align changes to samples; save them if a save is due."""
        own = self._own(valves)
        self._connected[own] = True
        self._has_new_data = True
        self._use(self._arrivals.take(changes))
        self._save_in_time()

    async def tick(self, valves: Times | None = None) -> None:  # noqa: ARG002 - all are looked at
        """Flush overdue samples; save if a save is due."""
        self._wait_no_longer(self._clock.monotonic())
        self._save_in_time()

    async def lost(
        self,
        reason: SourceError,  # noqa: ARG002 - the supervisor logs it
        valves: Times | None = None,
    ) -> None:
        """Mark the valves' source as disconnected."""
        self._connected[self._own(valves)] = False

    async def finish(self) -> None:
        """Save all pending samples.

        Raises
        ------
        StorageError
        """
        log_missing(self._arrivals.left_out())
        if self._saving is not None:
            await self._saving
        await self._save(self._taken())
        if self._unsaved:
            raise StorageError(f"{self._spool.path}: {self._lost_samples()} samples are lost")

    @property
    def unsaved_bytes(self) -> int:
        """Size of the blocks in memory that the disk has not taken."""
        return sum(len(one.data) for one in list(self._unsaved))

    @property
    def connected_valves(self) -> tuple[int, int]:
        """Number of valves whose source is connected, and of the others."""
        connected = int(self._connected.sum())
        return connected, len(self._connected) - connected

    @property
    def source_counters(self) -> SourceCounters:
        """Counters of all sources."""
        return self._sources.counters

    def _own(self, valves: Times | None) -> Times:
        return np.arange(len(self._connected)) if valves is None else valves

    def _use(self, samples: ByValve) -> None:
        for valve, error in self._arrivals.buffers.new_failures():
            log_left_out(self._arrivals.names[valve], error)
        if left_out := self._arrivals.left_out():
            self.left_out = sum(left_out.values())
            self._say("valves are left out, their samples are missing", samples=left_out)
        self._held.heard(samples.segments.members)
        if len(samples):
            self._parts.append(samples)

    def _wait_no_longer(self, now: float) -> None:
        """Flush the reorder buffer of valves without a sample for longer than ``reorder_ms``."""
        due = self._held.due(now, self._connected, self._arrivals.waits())
        if len(due):
            self._has_new_data = True
            self._use(self._arrivals.wait_no_longer(due))

    def _save_in_time(self) -> None:
        under_way = self._saving is not None and not self._saving.done()
        if under_way or not self._has_new_data or self._clock.monotonic() < self._due:
            return
        self._due = self._clock.monotonic() + self._commit_s
        self._saving = asyncio.create_task(self._save(self._taken()))

    def _taken(self) -> _Taken:
        """Return the pending blocks with the current source position."""
        blocks = list(self._cut())
        self._parts, self._has_new_data = [], False
        mark = self._sources.mark
        kept = {
            _NUMBERS: json.dumps({"groups": self._numbers, "given_up": self.given_up}).encode(),
            _ARRIVALS: self._arrivals.to_bytes(),
        }
        if mark is not None:
            kept[_POSITION] = self._sources.position(mark)
        return _Taken(blocks, kept, mark)

    def _cut(self) -> Sequence[SamplesBlock]:
        """Return the pending samples as blocks by group, split at the largest message size."""
        if not self._parts:
            return []
        whole = Samples.concatenate([part.samples for part in self._parts])
        valve = np.concatenate([_valve_of(part.segments) for part in self._parts])
        order = np.argsort(valve, kind="stable")
        whole, valve = whole[order], valve[order]
        found = []
        for number in np.unique(valve // self._per_group).tolist():
            first = number * self._per_group
            low, high = np.searchsorted(valve, [first, first + self._per_group]).tolist()
            for start in range(low, high, self._rows):
                rows = slice(start, min(start + self._rows, high))
                found.append(self._block(number, whole[rows], valve[rows] - first))
        return found

    def _block(self, number: int, samples: Samples, member: Times) -> SamplesBlock:
        group = self._groups[number]
        self.packed += len(samples)
        self._numbers[group.name] += 1
        starts = np.flatnonzero(np.diff(member, prepend=-1)).astype(np.int64)
        stops = np.append(starts[1:], len(member))
        return SamplesBlock(
            group.name,
            self._numbers[group.name],
            tuple(plan.name for plan in group.plans),
            ByValve(samples, Segments(member[starts], starts, stops)),
            self._catalogue,
        )

    async def _save(self, taken: _Taken) -> None:
        """Save in a thread; if the disk fails, keep the blocks in memory."""
        try:
            given_up = await asyncio.to_thread(self._put_down, taken)
        except StorageError as error:
            self._has_new_data = True
            self._hold_no_more_than_allowed()
            self._say("samples not kept, they are held in memory", reason=str(error))
            return
        if taken.mark is not None:
            self._sources.commit(taken.mark)
        if given_up:
            self._give_up(given_up, "spool is full, the oldest samples are given up")

    def _put_down(self, taken: _Taken) -> int:
        self._unsaved += [_packed(block) for block in taken.blocks]
        given_up = self._spool.save(self._unsaved, taken.kept).samples
        self._unsaved = []
        return given_up

    def _hold_no_more_than_allowed(self) -> None:
        excess = sum(len(one.data) for one in self._unsaved) - _UNSAVED
        lost = 0
        while excess > 0:
            oldest = self._unsaved.pop(0)
            excess, lost = excess - len(oldest.data), lost + oldest.samples
        if lost:
            self._give_up(lost, "disk takes nothing, the oldest samples are given up")

    def _give_up(self, samples: int, why: str) -> None:
        self.given_up += samples
        self._say(why, samples=self.given_up)

    def _lost_samples(self) -> int:
        return sum(one.samples for one in self._unsaved)

    def _say(self, what: str, **more: object) -> None:
        """Log a warning, at most once in an interval."""
        if self._clock.monotonic() - self._said >= SAID_AGAIN_S:
            self._said = self._clock.monotonic()
            log.warning(what, file=str(self._spool.path), **more)


def _valve_of(segments: Segments) -> Times:
    """The valve of each row."""
    members, starts, stops = segments
    return np.repeat(members, stops - starts)


def _packed(block: SamplesBlock) -> Packed:
    samples = len(block.samples.samples)
    return Packed(block.group, block.number, samples, write_samples(block))
