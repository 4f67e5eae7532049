"""Alignment: data changes of single signals become samples of equal source time."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import StateMismatchError
from valvemap.model.samples import Samples, Segments, Times
from valvemap.pipeline.data_changes import DataChanges, Signal
from valvemap.pipeline.kernels import alignment as kernel
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import Aligned, Changes, Rules, Waiting

COUNTER_NAMES = (
    "late",
    "missing",
    "duplicates",
    "clock_steps",
    "gaps",
    "aligned",
    "lost_by_time",
    "restarts",
)

_FIRST_CAPACITY = 16
_LOST_KEPT = 8  # stretches given up, by which what comes late is told from what comes twice
_TIMES_KEPT = 1024  # samples that are known again by their time alone


@dataclass(frozen=True)
class AlignmentSettings:
    """How the signals of a valve find together.

    Attributes
    ----------
    tolerance_ns : int
        Largest difference of source times within one sample; 0 = the same timestamp.
    max_wait_ns : int
        A sample still incomplete is given up once a complete one is newer by this much; a source
        time that steps back by more tells of a step of the source's clock.
    reorder_ns : int
        How long a sample waits behind a hole in the running numbers for what is missing there.
        Where there is no hole it leaves at once.
    reorder_by_time_ns : int
        The same for valves without running number: each sample waits until one so much newer is
        complete.
    max_pending : int
        Incomplete samples kept per valve; the oldest is given up beyond that.
    hold_ns : mapping of Signal to int
        Signals that report less often than the others: the last value serves for this long.
    """

    tolerance_ns: int = 0
    max_wait_ns: int = 2_000_000_000
    reorder_ns: int = 1_000_000_000
    reorder_by_time_ns: int = 0
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
    """Aligns the changes of V valves.

    ``has_T`` tells which of them have a temperature sensor, ``has_sequence`` which have a running
    number; none has, if it is empty.

    Every change is sorted by its source time into a waiting sample of its valve. Complete samples
    leave each once: by their running number, as :mod:`valvemap.pipeline.kernels.by_number` says,
    or else in the order of time. What a sample overtakes is given up and counted as ``missing``,
    what comes after that as ``late``, what comes twice as ``duplicates``. ``gaps`` counts the
    running numbers that never came, ``lost_by_time`` what the usual pace shows as lost where no
    number tells, ``clock_steps`` the steps back of the source's clock, ``restarts`` how often its
    running number began anew.

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
    has_sequence: tuple[bool, ...] = ()

    def initial_state(self) -> Waiting:
        """Nothing has arrived yet."""
        return self.nothing(len(self.has_T), min(_FIRST_CAPACITY, self.settings.max_pending))

    def nothing(self, valves: int, pending: int) -> Waiting:
        """Nothing has arrived yet at some valves, with room for so many samples of each."""
        signals = slots.SIGNALS
        order = np.zeros((valves, slots.ORDER_FIELDS), np.int64)
        order[:, [slots.LAST, slots.BASE]] = slots.NO_NUMBER
        order[:, list(_TIMES)] = slots.NEVER
        order[:, slots.SEEN :] = slots.NEVER
        return Waiting(
            slots=np.zeros((valves, pending, slots.SLOT_FIELDS), np.int64),
            values=np.zeros((valves, pending, signals)),
            status=np.zeros((valves, pending, signals), np.uint32),
            held_value=np.zeros((valves, signals)),
            held_status=np.zeros((valves, signals), np.uint32),
            held_time=np.full((valves, signals), slots.NEVER),
            lost=np.zeros((valves, _LOST_KEPT, 2), np.int64),
            left=np.zeros((valves, 0 if self._numbered.all() else _TIMES_KEPT), np.int64),
            order=order,
            counters=np.zeros((valves, slots.COUNTERS), np.int64),
        )

    def update(self, state: Waiting, changes: DataChanges) -> tuple[Waiting, ByValve]:
        """Take changes in; hand out the samples that may leave, by valve, in their order."""
        return self.take(Waiting._make(array.copy() for array in state), changes)

    def take(self, waiting: Waiting, changes: DataChanges) -> tuple[Waiting, ByValve]:
        """The same; ``waiting`` is written in place, and must not be used any more."""
        return self._run(waiting, changes, _NO_VALVES, slots.NOTHING)

    def waits(self, waiting: Waiting) -> NDArray[np.bool_]:
        """Which valves (V,) have samples that are all there and wait for earlier ones."""
        found = np.zeros(len(self.has_T), np.bool_)
        kernel.find_waiting(self._rules, waiting, found)
        return found

    def of(self, waiting: Waiting, valve: int) -> Waiting:
        """Copies of what waits at one valve, (1, …), no longer than needed."""
        one = Waiting._make(array[valve : valve + 1].copy() for array in waiting)
        size = int(one.order[0, slots.SIZE])
        return one._replace(
            slots=one.slots[:, :size], values=one.values[:, :size], status=one.status[:, :size]
        )

    def put(self, waiting: Waiting, valve: int, one: Waiting) -> Waiting:
        """Have another valve's copies of `of` wait at a valve; ``waiting`` as in `take`.

        Raises
        ------
        StateMismatchError
            if more wait than this alignment lets.
        """
        size = one.slots.shape[1]
        if size > self.settings.max_pending:
            raise StateMismatchError(f"{size} samples wait, {self.settings.max_pending} may")
        while waiting.slots.shape[1] < size:
            waiting = _grown(waiting, min(2 * waiting.slots.shape[1], self.settings.max_pending))
        for name in Waiting._fields:
            array, kept = getattr(waiting, name), getattr(one, name)
            own = array[valve, :size] if name in _BY_SLOT else array[valve]
            own[...] = kept[0]
        return waiting

    def pending(self, waiting: Waiting) -> Times:
        """How many samples of each valve wait, (V,)."""
        return waiting.order[:, slots.SIZE].copy()

    def newest(self, waiting: Waiting, valve: int) -> Times:
        """Source time of each signal's newest value, (5,), UTC ns; ``NEVER`` before the first."""
        seen = waiting.order[valve, slots.SEEN : slots.SEEN + slots.SIGNALS]
        newest: Times = np.maximum(seen, waiting.held_time[valve])
        return newest

    def flush(self, waiting: Waiting, valves: Times) -> tuple[Waiting, ByValve]:
        """Have what waits for earlier samples leave without them; ``waiting`` as in `take`."""
        return self._run(waiting, DataChanges.empty(), valves, slots.FLUSH)

    def begin_anew(self, waiting: Waiting, valves: Times) -> tuple[Waiting, ByValve]:
        """The source of some valves was restarted: any running number may be the next."""
        return self._run(waiting, DataChanges.empty(), valves, slots.BEGIN_ANEW)

    def counters(self, state: Waiting, valve: int) -> Mapping[str, int]:
        """Counts of one valve since the start."""
        return dict(zip(COUNTER_NAMES, state.counters[valve].tolist(), strict=True))

    def _run(
        self, waiting: Waiting, changes: DataChanges, valves: Times, command: int
    ) -> tuple[Waiting, ByValve]:
        columns = Changes(changes.item, changes.value, changes.status, changes.source_time)
        parts: list[Aligned] = []
        done = 0
        while not parts or done < len(changes):
            pending = waiting.slots.shape[1]
            may_grow = pending < self.settings.max_pending
            out = _room(len(changes) - done + int(waiting.order[:, slots.SIZE].sum()))
            done, n = kernel.align_changes(
                columns, done, valves, command, self._rules, may_grow, waiting, out
            )
            parts.append(Aligned._make(array[:n] for array in out))
            valves = _NO_VALVES
            if done < len(changes):
                waiting = _grown(waiting, min(2 * pending, self.settings.max_pending))
        return waiting, _by_valve(_joined(parts), len(self.has_T))

    @cached_property
    def _numbered(self) -> NDArray[np.bool_]:
        return np.array(self.has_sequence or (False,) * len(self.has_T), np.bool_)

    @cached_property
    def _rules(self) -> Rules:
        settings, has_T = self.settings, np.array(self.has_T, np.bool_)
        one = [settings.hold_ns.get(Signal(j), 0) for j in range(slots.SIGNALS)]
        hold = np.tile(np.array(one, np.int64), (len(has_T), 1))
        hold[~has_T, Signal.T] = 0
        needed = hold == 0
        needed[~has_T, Signal.T] = False
        bits = np.uint8(1) << np.arange(slots.SIGNALS, dtype=np.uint8)
        by_time = settings.reorder_by_time_ns
        return Rules(
            required=(needed * bits).sum(axis=1).astype(np.uint8),
            hold=hold,
            numbered=self._numbered,
            reorder=np.where(self._numbered, settings.reorder_ns, by_time).astype(np.int64),
            tolerance=settings.tolerance_ns,
            max_wait=settings.max_wait_ns,
        )


_BY_SLOT = ("slots", "values", "status")
_NO_VALVES = np.empty(0, np.int64)
_TIMES = (
    slots.LAST_TIME,
    slots.HIGH,
    slots.FLOOR,
    slots.NEWEST,
    slots.FIRST_TIME,
    slots.BEFORE_FIRST,
)


def _room(n: int) -> Aligned:
    return Aligned(
        valve=np.empty(n, np.int64),
        time=np.empty(n, np.int64),
        values=np.empty((n, slots.SIGNALS)),
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
        slots=wider(waiting.slots), values=wider(waiting.values), status=wider(waiting.status)
    )


def _by_valve(out: Aligned, valves: int) -> ByValve:
    n = len(out.time)
    columns = np.empty((slots.SIGNALS, n))
    t, quality, edges = np.empty(n, np.int64), np.empty(n, np.uint8), np.zeros(valves + 1, np.int64)
    kernel.sort_by_valve(out, t, columns, quality, edges)
    present = np.flatnonzero(np.diff(edges))
    U, p1, p2, Q, T = columns
    return ByValve(
        Samples(t, U, p1, p2, Q, T, quality), Segments(present, edges[present], edges[present + 1])
    )
