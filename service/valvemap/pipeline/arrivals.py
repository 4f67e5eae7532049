"""Conversion of many valves' data changes into samples: timing, then alignment. Pure."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.pipeline.alignment import COUNTER_NAMES, Alignment, presence
from valvemap.pipeline.announced_steps import AnnouncedSteps
from valvemap.pipeline.by_valve import ByValve, in_turn
from valvemap.pipeline.clock_steps import Known, Step
from valvemap.pipeline.command_rests import CommandRests
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import NEVER, SET_BACK, SET_FORWARD, Waiting
from valvemap.pipeline.packed_arrivals import key_of_arrivals, pack, unpack
from valvemap.pipeline.reorder_buffers import ReorderBuffers
from valvemap.pipeline.timing import Timing, TimingSettings
from valvemap.pipeline.timing_state import IN_SCANS, LISTENING
from valvemap.pipeline.waiting import waited_for
from valvemap.vocabulary.signals import COUNT, PER_VALVE

_MISSING: Final = COUNTER_NAMES.index("missing")
_DUPLICATES: Final = COUNTER_NAMES.index("duplicates")


class ArrivalsOfValve(NamedTuple):
    """State of one valve.

    ``waiting`` as from :meth:`Alignment.of`, (1, …); ``source_started`` as in `Arrivals`;
    ``known`` are its samples around a step back of the source's clock.
    """

    waiting: Waiting
    source_started: int
    known: Known


class Arrivals:
    """Converts data changes into samples; its state can be packed and restored bitwise.

    If that raises at a valve, the alignment's writes are undone, and the timing of the valve is
    detected again. Its changes are dropped until `start_again`, or until its source restarts; their
    samples are counted as missing. The others get the same bits as without the error.

    Parameters
    ----------
    names
        Names of the valves.
    alignment, timing
        How the signals are aligned, and how their stamping is detected (None: it is configured).

    Attributes
    ----------
    buffers : ReorderBuffers
        What waits, and the errors at which a valve stopped.
    finds_timing : bool
        Whether the stamping of the signals is detected.
    source_started : int
        Start time of the source (V,), UTC ns, with which each valve's running numbers restarted;
        0: none is known.

    Examples
    --------
    >>> from valvemap.pipeline.alignment import AlignmentSettings
    >>> arrivals = Arrivals(["V1"], Alignment(AlignmentSettings(), optional=((),)))
    >>> len(arrivals.take(DataChanges.empty()))
    0
    """

    def __init__(
        self, names: Sequence[str], alignment: Alignment, timing: Timing | None = None
    ) -> None:
        self.names = tuple(names)
        self.alignment = alignment
        self.finds_timing = timing is not None
        self.timing = timing or Timing(TimingSettings(), alignment.optional, fixed=True)
        self.buffers = ReorderBuffers(alignment)
        rules = alignment.rules
        bits = np.int64(1) << np.arange(slots.SIGNALS)
        required = (rules.required[:, np.newaxis] & bits) > 0
        self._rests = CommandRests(required, self.timing.settings.horizon_ns)
        self._steps = AnnouncedSteps(required, rules.numbered, rules.reorder)
        self.source_started = np.zeros(len(self.names), np.int64)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Mask (V,) of the valves whose changes are dropped after an error."""
        return self.buffers.failed

    def announce(self, changes: DataChanges, now_s: float) -> None:
        """Find the steps of the source's clock in changes that are going to be taken, in parts.

        ``now_s`` is our monotonic time of their receipt.
        """
        self._steps.announce(changes, now_s, self.buffers.waiting, self.timing.are_alike)

    def take(self, changes: DataChanges) -> ByValve:
        """Process data changes; return the samples that they completed."""
        parts = self._taken(changes)
        if self.finds_timing:
            parts += self._held_commands(parts)
        if np.count_nonzero(self.failed):
            self._count_dropped(changes)
        return parts[0] if len(parts) == 1 else in_turn(parts)

    def _taken(self, changes: DataChanges) -> list[ByValve]:
        due, after, repeated = self._steps.next_part(changes)
        if np.count_nonzero(repeated):
            self._count_duplicates(changes[repeated])
            changes, after = changes[~repeated], after[~repeated]
        if np.count_nonzero(self.failed):
            works = ~self.failed[changes.item // PER_VALVE]
            changes, after = changes[works], after[works]
        if not due:
            parts = [self._aligned(changes)]
        else:
            parts = [self._aligned(changes[~after])]
            parts += self._set_clocks(due)
            parts.append(self._aligned(changes[after]))
        self._steps.remember(parts)
        return parts

    def _aligned(self, changes: DataChanges) -> ByValve:
        return self.buffers.align(self.timing.take(changes, self.buffers.stop))

    def _held_commands(self, parts: Sequence[ByValve]) -> list[ByValve]:
        """Hold the commands that have come to rest; return the samples that waited for them."""
        for part in parts:
            self._rests.note(part, self.buffers.waiting)
        found = []
        for rest in self._rests.find(self.buffers.waiting, self.timing.are_alike & ~self.failed):
            found.append(self.buffers.align(rest.changes))
            self.timing.hold_command(*rest.held)
        return found

    def _count_duplicates(self, changes: DataChanges) -> None:
        measured = changes.item % PER_VALVE < COUNT
        counts = self.buffers.waiting.counters[:, _DUPLICATES]
        np.add.at(counts, changes.item[measured] // PER_VALVE, 1)

    def _count_dropped(self, changes: DataChanges) -> None:
        """Count the samples of failed valves as missing: as many as their most frequent signal."""
        valve, signal = np.divmod(changes.item, PER_VALVE)
        for failed in self.failed.nonzero()[0].tolist():
            own = signal[(valve == failed) & (signal < COUNT)]
            if len(own):
                self.buffers.waiting.counters[failed, _MISSING] += np.bincount(own).max()

    def _set_clocks(self, steps: Sequence[Step]) -> Iterator[ByValve]:
        for command in (SET_BACK, SET_FORWARD):
            own = np.array([step.valve for step in steps if step.command == command], np.int64)
            if len(own):
                yield self.buffers.set_clock(own, command)

    def left_out(self) -> dict[str, int]:
        """Return the number of missing samples of each valve whose changes are dropped, by name."""
        rows = self.failed.nonzero()[0]
        missing = self.counts(rows)[:, _MISSING].tolist()
        return dict(zip((self.names[row] for row in rows), missing, strict=True))

    def start_again(self, valve: int) -> None:
        """Process a valve's changes again after an error."""
        self.failed[valve] = False

    def waits(self) -> NDArray[np.bool_]:
        """Mask of the valves with samples in the reorder buffer, or changes buffered for scans."""
        found = self.alignment.waits(self.buffers.waiting) | (self.timing.pending > 0)
        return found & ~self.failed

    def pending(self) -> Times:
        """Number of samples of each valve that wait for signals or for earlier samples, (V,)."""
        return self.alignment.pending(self.buffers.waiting) + self.timing.pending

    def wait_no_longer(self, valves: Times) -> ByValve:
        """Flush the reorder buffer of these valves; return its samples."""
        valves = valves[~self.failed[valves]]
        unfinished = self.timing.flush(valves, self.buffers.stop)
        if len(unfinished):
            return self.buffers.align(unfinished)
        return self.buffers.flush(valves)

    def begin_source_anew(self, valves: Times, started: int) -> ByValve:
        """Reset the alignment of these valves: the running numbers of their source restart.

        ``started`` is the start time of the source, UTC ns. Valves whose numbers have restarted
        with it, before a kill, continue: the source may send the samples since then again.
        """
        anew = valves[self.source_started[valves] != started]
        self.source_started[anew] = started
        self.failed[anew] = False
        return self.buffers.begin_anew(anew)

    def finish(self) -> list[ByValve]:
        """Flush all buffers; return their samples, those without a running number last."""
        every = (~self.failed).nonzero()[0]
        unfinished = self.buffers.align(self.timing.flush(every, self.buffers.stop))
        return [unfinished, self.buffers.flush(every), self.buffers.flush(every)]

    def counts(self, valves: Times) -> Times:
        """Return the counters of the given valves, a column for each of ``COUNTER_NAMES``."""
        counts: Times = self.buffers.waiting.counters[valves]
        counts[:, _MISSING] += self.timing.not_made(valves)
        return counts

    def waited_for(self, valve: int, nodes: Mapping[str, str]) -> tuple[str, ...]:
        """Return the signals that are missing for a valve's samples, and a remedy."""
        timing, optional = self.timing.valves[valve], self.alignment.optional[valve]
        aligned = self.alignment.newest(self.buffers.waiting, valve)
        newest = np.maximum(aligned, timing.newest[:-1])
        if timing.stands == IN_SCANS:
            return (*timing.words.losses(nodes), *timing.words.still(nodes))
        said = waited_for(newest, self.alignment.settings, optional=optional, nodes=nodes)
        if timing.stands == LISTENING and (newest[:COUNT][presence([optional])[0]] != NEVER).all():
            return ("how the signals come is not found yet: it takes some seconds of changes",)
        return said

    def stand_still(self, valve: int, nodes: Mapping[str, str]) -> tuple[str, ...]:
        """Return a valve's on-change signals that have not changed for long."""
        return self.timing.valves[valve].words.still(nodes)

    def how_signals_come(self, valve: int, nodes: Mapping[str, str]) -> tuple[str, ...]:
        """Describe how each of a valve's signals is stamped."""
        return self.timing.valves[valve].words.sentences(nodes)

    def of(self, valve: int) -> ArrivalsOfValve:
        """Return copies of one valve's state."""
        return self.view(valve)._replace(waiting=self.alignment.of(self.buffers.waiting, valve))

    def view(self, valve: int) -> ArrivalsOfValve:
        """As `of`, not copied: the next changes change it."""
        waiting = self.alignment.view(self.buffers.waiting, valve)
        started = int(self.source_started[valve])
        return ArrivalsOfValve(waiting, started, self._steps.known(valve))

    def put(self, valve: int, one: ArrivalsOfValve) -> None:
        """Restore one valve from the result of `of`.

        Raises
        ------
        StateMismatchError
            if more samples wait than ``max_pending``.
        """
        self.buffers.put(valve, one.waiting)
        self.source_started[valve] = one.source_started
        self._steps.put(valve, one.known)

    def to_bytes(self) -> bytes:
        """Pack the state of all valves."""
        return pack(self.buffers.waiting, self.timing, self._key)

    def resume(self, packed: bytes) -> None:
        """Restore the state of all valves.

        Raises
        ------
        StateMismatchError
            if it is damaged, or the configuration differs; the present state is then unchanged.
        """
        waiting, states = unpack(packed, self._key, len(self.names), self.alignment)
        for number in range(len(self.names)):
            self.buffers.put(number, self.alignment.of(waiting, number))
            self.timing.put(number, states.get(number, _ALIKE))

    @cached_property
    def _key(self) -> str:
        timing = self.timing if self.finds_timing else None
        return key_of_arrivals(self.names, self.alignment, timing)


_ALIKE: Final = Timing(TimingSettings(), ((),), fixed=True).valves[0].state
