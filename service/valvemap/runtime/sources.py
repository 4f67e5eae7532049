"""Several sources of one service: one connection each, one consumer for all."""

import asyncio
import base64
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from valvemap.clock import Clock
from valvemap.errors import SourceError, SourceLost
from valvemap.model.samples import Floats, Times, field_names
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.source_ports import Source, SourceCounters
from valvemap.runtime.supervisor import Consumer, SupervisorSettings, supervise
from valvemap.vocabulary.signals import PER_VALVE

_MOST_REMARKS: Final = 20  # nodes of one source that are named


class SourceWithHeir(Source, Protocol):
    """A source that can be checked, and that can resume where a predecessor stops."""

    async def check(self) -> None:
        """Connect, check every node, and disconnect."""

    def succeed(self, before: Any) -> None:  # noqa: ANN401 - a source of the same class
        """Take over the position of ``before`` when it is closed."""


@dataclass(frozen=True)
class Part:
    """One source: its name (None: the only one), its client, the numbers of its valves."""

    name: str | None
    source: SourceWithHeir
    valves: tuple[int, ...]

    @cached_property
    def items(self) -> NDArray[np.int32]:
        """Numbers of the source's items among the items of all valves."""
        first = np.repeat(np.array(self.valves, np.int32) * PER_VALVE, PER_VALVE)
        within = np.tile(np.arange(PER_VALVE), len(self.valves))
        return np.asarray(first + within, np.int32)

    def renumbered(self, changes: DataChanges) -> DataChanges:
        """Return the changes with items numbered among all valves; drop unknown items."""
        known = (changes.item >= 0) & (changes.item < len(self.items))
        changes = changes if known.all() else changes[known]
        item = self.items[changes.item]
        return DataChanges(item, changes.value, changes.status, changes.source_time)


class Sources:
    """All sources of a service, as one `AllSources`."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)
        self.connected = [False] * len(parts)
        self.taken: list[Any] = [None] * len(parts)  # marks of changes passed to the consumer
        self.before: dict[str | None, bytes] = {}  # restored positions, until there is a mark
        self._offsets_s: list[float | Floats] = []  # of the sources, behind `_offset_of`
        self._offset_of: Floats = np.zeros(0)
        valves = sum(len(part.valves) for part in parts)
        self._part_of = np.zeros((valves, 2), np.int64)  # part, number there
        for k, part in enumerate(parts):
            for number, valve in enumerate(part.valves):
                self._part_of[valve] = k, number

    @property
    def mark(self) -> tuple[Any, ...] | None:
        """Mark of the changes passed to the consumer, by source; None: no source has a mark yet.

        Changes that another source has received, but that wait for the lock, are not included.
        """
        marks = tuple(self.taken)
        return None if all(mark is None for mark in marks) else marks

    def hold_back(self) -> None:
        """As `Source.hold_back`."""
        for part in self.parts:
            part.source.hold_back()

    def commit(self, mark: tuple[Any, ...]) -> None:
        """As `Source.commit`."""
        for part, own in zip(self.parts, mark, strict=True):
            if own is not None:
                part.source.commit(own)

    def position(self, mark: tuple[Any, ...]) -> bytes:
        """As `Source.position`; with several sources, by source name."""
        kept = self.before | {
            part.name: part.source.position(own)
            for part, own in zip(self.parts, mark, strict=True)
            if own is not None
        }
        if None in kept:
            return bytes(kept[None])
        return json.dumps({n: base64.b64encode(p).decode() for n, p in kept.items()}).encode()

    def resume_at(self, position: bytes) -> bool:
        """As `Source.resume_at`; True if every source with a stored position accepted it."""
        if not self.parts:
            return False
        if self.parts[0].name is None:
            return bool(self.parts[0].source.resume_at(position))
        try:
            kept = {n: base64.b64decode(p) for n, p in json.loads(position).items()}
        except (ValueError, TypeError, AttributeError):
            return False
        by_name = {part.name: part.source for part in self.parts}
        taken = {
            name: p for name, p in kept.items() if name in by_name and by_name[name].resume_at(p)
        }
        self.before = taken
        return len(taken) == len(kept)

    async def write_required_U(self, valve: int, U: float) -> None:
        """As `Source.write_required_U`."""
        k, number = self._part_of[valve].tolist()
        await self.parts[k].source.write_required_U(number, U)

    async def write_heartbeat(self, valve: int, count: int) -> None:
        """As `Source.write_heartbeat`."""
        k, number = self._part_of[valve].tolist()
        await self.parts[k].source.write_heartbeat(number, count)

    @property
    def counters(self) -> SourceCounters:
        """Sum of the counters of all sources."""
        every = [part.source.counters for part in self.parts]
        if len(every) == 1:
            return every[0]
        names = field_names(SourceCounters)
        return SourceCounters(*(sum(getattr(one, name) for one in every) for name in names))

    @property
    def clock_offset_s(self) -> Floats:
        """By valve, offset of the source's clock from ours, s; not to be written to."""
        offsets_s = [part.source.clock_offset_s for part in self.parts]
        if offsets_s != self._offsets_s:  # they are asked for often, and seldom change
            self._offsets_s = offsets_s
            self._offset_of = np.array(offsets_s, np.float64)[self._part_of[:, 0]]
        return self._offset_of

    @property
    def remarks(self) -> Mapping[int, tuple[str, ...]]:
        """As `Source.remarks`, by number among all valves."""
        return {
            part.valves[number]: words
            for part in self.parts
            for number, words in part.source.remarks.items()
        }

    @property
    def states(self) -> tuple[str, ...]:
        """One line for each source: its connection and its losses; one for each of its remarks."""
        lines = []
        for part, there in zip(self.parts, self.connected, strict=True):
            seen = part.source.counters
            lines.append(
                f"{part.name or 'source'}: {'connected' if there else 'away'}, "
                f"{seen.missing_messages} messages missing, {seen.overflows} overflows, "
                f"{seen.undecodable} undecodable"
            )
            said = [words for of_valve in part.source.remarks.values() for words in of_valve]
            lines += said[:_MOST_REMARKS]
            if len(said) > _MOST_REMARKS:
                lines.append(f"… and {len(said) - _MOST_REMARKS} more nodes")
        return tuple(lines)

    async def check(self) -> None:
        """Connect to each, check every node, disconnect; a named source may be unreachable.

        Raises
        ------
        SourceError
        """
        for part in self.parts:
            try:
                await part.source.check()
            except SourceLost:
                if part.name is None:
                    raise

    def succeed(self, before: "Sources") -> None:
        """Take over the positions of sources of the same name when they are closed."""
        others = {part.name: k for k, part in enumerate(before.parts)}
        for part in self.parts:
            if part.name not in others:
                continue
            k = others[part.name]
            source, mark = before.parts[k].source, before.taken[k]
            if mark is not None:
                self.before[part.name] = source.position(mark)
            elif part.name in before.before:
                self.before[part.name] = before.before[part.name]
            part.source.succeed(source)

    async def close(self) -> None:
        """Disconnect all sources."""
        for part in self.parts:
            await part.source.close()


async def supervise_all(
    sources: Sources,
    consumer: Consumer,
    clock: Clock,
    stop: asyncio.Event,
    settings: SupervisorSettings,
) -> None:
    """Supervise each source on its own connection; an outage of one does not affect the others.

    Raises
    ------
    SourceLost, SourceRejected
        the first error that ends the run.
    """
    one_at_a_time = asyncio.Lock()
    if not sources.parts:
        await _tick_alone(consumer, stop, settings.tick_s)
        return
    lives = [
        asyncio.create_task(
            supervise(
                part.source,
                _OfPart(consumer, sources, k, one_at_a_time),
                clock,
                stop,
                replace(settings, name=part.name),
            )
        )
        for k, part in enumerate(sources.parts)
    ]
    try:
        await asyncio.wait(lives, return_when=asyncio.FIRST_EXCEPTION)
    finally:
        for life in lives:
            life.cancel()
        outcomes = await asyncio.gather(*lives, return_exceptions=True)
        sources.connected = [False] * len(lives)
    for outcome in outcomes:
        if isinstance(outcome, Exception):
            raise outcome


async def _tick_alone(consumer: Consumer, stop: asyncio.Event, tick_s: float) -> None:
    """Without a source, call the consumer's tick until ``stop`` is set."""
    while not stop.is_set():
        await consumer.tick()
        with suppress(TimeoutError):
            await asyncio.wait_for(stop.wait(), tick_s)


class _OfPart:
    """Forwards one source's calls to the consumer; a lock serialises those of all sources."""

    def __init__(
        self, consumer: Consumer, sources: Sources, k: int, one_at_a_time: asyncio.Lock
    ) -> None:
        self._consumer, self._sources, self._k = consumer, sources, k
        self._part, self._turn = sources.parts[k], one_at_a_time
        self._valves: Times = np.array(self._part.valves, np.int64)

    async def connected(self, valves: Times | None = None, *, restarted_at: int | None) -> None:  # noqa: ARG002
        self._sources.connected[self._k] = True
        async with self._turn:
            await self._consumer.connected(self._valves, restarted_at=restarted_at)

    async def take(self, changes: DataChanges, valves: Times | None = None) -> None:  # noqa: ARG002
        mark = self._part.source.mark
        async with self._turn:
            self._sources.taken[self._k] = mark
            await self._consumer.take(self._part.renumbered(changes), self._valves)

    async def tick(self, valves: Times | None = None) -> None:  # noqa: ARG002
        async with self._turn:
            await self._consumer.tick(self._valves)

    async def lost(self, reason: SourceError, valves: Times | None = None) -> None:  # noqa: ARG002
        self._sources.connected[self._k] = False
        async with self._turn:
            await self._consumer.lost(reason, self._valves)
