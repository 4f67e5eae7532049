"""Alignment: data changes of single signals become samples of equal source time."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.identification.samples import Samples, Segments
from service.streaming.data_changes import DataChanges, Signal
from service.streaming.kernels import alignment as kernel
from service.streaming.kernels.alignment import Aligned, Changes, Waiting

COUNTER_NAMES = ("late", "missing", "duplicates", "clock_steps", "gaps", "aligned")

_FIRST_CAPACITY = 16


@dataclass(frozen=True)
class AlignmentSettings:
    """How the signals of a valve find together.

    Attributes
    ----------
    tolerance_ns : int
        Largest difference of source times within one sample; 0 = the same timestamp.
    max_wait_ns : int
        A sample still incomplete is given up once a complete one is newer by this much; a signal
        whose source time steps back by more tells of a step of the source's clock.
    max_pending : int
        Incomplete samples kept per valve; the oldest is given up beyond that.
    hold_ns : mapping of Signal to int
        Signals that report less often than the others: the last value serves for this long.
    """

    tolerance_ns: int = 0
    max_wait_ns: int = 2_000_000_000
    max_pending: int = 4096
    hold_ns: Mapping[Signal, int] = field(default_factory=dict)


@dataclass(frozen=True)
class ByValve(Mapping[int, Samples]):
    """Samples of several valves, one valve after another: whole for kernels, by valve for others.

    ``segments.members`` are the valves' numbers, ascending.
    """

    samples: Samples
    segments: Segments

    def __getitem__(self, valve: int) -> Samples:
        k = int(np.searchsorted(self.segments.members, valve))
        if k == len(self) or self.segments.members[k] != valve:
            raise KeyError(valve)
        return self.samples[slice(self.segments.starts[k], self.segments.stops[k])]

    def __iter__(self) -> Iterator[int]:
        return iter(self.segments.members.tolist())

    def __len__(self) -> int:
        return len(self.segments.members)


@dataclass(frozen=True)
class Alignment:
    """Aligns the changes of V valves; ``has_T`` tells which of them have a temperature sensor.

    Every change is sorted by its source time into a waiting sample of its valve. A complete sample
    leaves in the order of time; what it overtakes is given up and counted as ``missing``, what
    comes after that as ``late``, what comes twice as ``duplicates``. ``gaps`` counts the running
    numbers that never came, ``clock_steps`` the signals whose source time stepped back.

    Examples
    --------
    >>> align = Alignment(AlignmentSettings(), has_T=(False,))
    >>> changes = DataChanges(
    ...     item=np.array([0, 1, 2, 3], np.int32),
    ...     value=np.array([50.0, 200.0, 100.0, 80.0]),
    ...     status=np.zeros(4, np.uint32),
    ...     source_time=np.full(4, 10),
    ... )
    >>> state, samples = align.update(align.initial_state(), changes)
    >>> samples[0].Q
    array([80.])
    """

    settings: AlignmentSettings
    has_T: tuple[bool, ...]

    def initial_state(self) -> Waiting:
        """Nothing has arrived yet."""
        valves, signals = len(self.has_T), kernel.SIGNALS
        pending = min(_FIRST_CAPACITY, self.settings.max_pending)
        return Waiting(
            times=np.zeros((valves, pending), np.int64),
            values=np.zeros((valves, pending, signals)),
            status=np.zeros((valves, pending, signals), np.uint32),
            filled=np.zeros((valves, pending), np.uint8),
            size=np.zeros(valves, np.int64),
            emitted_until=np.full(valves, kernel.NEVER),
            seen=np.full((valves, signals), kernel.NEVER),
            held_value=np.zeros((valves, signals)),
            held_status=np.zeros((valves, signals), np.uint32),
            held_time=np.full((valves, signals), kernel.NEVER),
            sequence=np.full(valves, kernel.NO_SEQUENCE),
            counters=np.zeros((valves, kernel.COUNTERS), np.int64),
        )

    def update(self, state: Waiting, changes: DataChanges) -> tuple[Waiting, ByValve]:
        """Take changes in; hand out the samples that are complete, by valve, in order of time."""
        waiting = Waiting._make(array.copy() for array in state)
        columns = Changes(changes.item, changes.value, changes.status, changes.source_time)
        parts: list[Aligned] = []
        done = 0
        while done < len(changes):
            pending = waiting.times.shape[1]
            out = _room(len(changes) - done + int(waiting.size.sum()))
            done, n = kernel.align_changes(
                columns,
                done,
                self._required,
                self._hold,
                self.settings.tolerance_ns,
                self.settings.max_wait_ns,
                pending < self.settings.max_pending,
                waiting,
                out,
            )
            parts.append(Aligned._make(array[:n] for array in out))
            if done < len(changes):
                waiting = _grown(waiting, min(2 * pending, self.settings.max_pending))
        return waiting, _by_valve(_joined(parts), len(self.has_T))

    def counters(self, state: Waiting, valve: int) -> Mapping[str, int]:
        """Counts of one valve since the start."""
        return dict(zip(COUNTER_NAMES, state.counters[valve].tolist(), strict=True))

    @cached_property
    def _hold(self) -> NDArray[np.int64]:
        one = [self.settings.hold_ns.get(Signal(j), 0) for j in range(kernel.SIGNALS)]
        hold = np.tile(np.array(one, np.int64), (len(self.has_T), 1))
        hold[~np.array(self.has_T, bool), Signal.T] = 0
        return hold

    @cached_property
    def _required(self) -> NDArray[np.uint8]:
        needed = self._hold == 0
        needed[~np.array(self.has_T, bool), Signal.T] = False
        bits = np.uint8(1) << np.arange(kernel.SIGNALS, dtype=np.uint8)
        required: NDArray[np.uint8] = (needed * bits).sum(axis=1).astype(np.uint8)
        return required


def _room(n: int) -> Aligned:
    return Aligned(
        valve=np.empty(n, np.int64),
        time=np.empty(n, np.int64),
        values=np.empty((n, kernel.SIGNALS)),
        quality=np.empty(n, np.uint8),
    )


def _joined(parts: list[Aligned]) -> Aligned:
    if len(parts) == 1:
        return parts[0]
    return Aligned._make(map(np.concatenate, zip(_room(0), *parts, strict=True)))


def _grown(waiting: Waiting, pending: int) -> Waiting:
    def wider(array: NDArray[Any]) -> NDArray[Any]:
        wide = np.zeros((array.shape[0], pending, *array.shape[2:]), array.dtype)
        wide[:, : array.shape[1]] = array
        return wide

    return waiting._replace(
        times=wider(waiting.times),
        values=wider(waiting.values),
        status=wider(waiting.status),
        filled=wider(waiting.filled),
    )


def _by_valve(out: Aligned, valves: int) -> ByValve:
    n = len(out.time)
    columns = np.empty((kernel.SIGNALS, n))
    t, quality, edges = np.empty(n, np.int64), np.empty(n, np.uint8), np.zeros(valves + 1, np.int64)
    kernel.sort_by_valve(out, t, columns, quality, edges)
    present = np.flatnonzero(np.diff(edges))
    U, p1, p2, Q, T = columns
    return ByValve(
        Samples(t, U, p1, p2, Q, T, quality), Segments(present, edges[present], edges[present + 1])
    )
