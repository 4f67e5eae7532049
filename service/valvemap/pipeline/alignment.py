"""Alignment: data changes of single signals become samples with one source time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import StateMismatchError
from valvemap.model.samples import Times
from valvemap.pipeline.aligned_columns import by_valve, grown, joined, room_for
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels import alignment as kernel
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import Aligned, Changes, Rules, Waiting
from valvemap.vocabulary.signals import MEASURED, REQUIRED, Signal

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
_LOST_KEPT = 8  # dropped stretches kept, to distinguish late samples from duplicates
_TIMES_KEPT = 1024  # times of emitted samples kept, to detect duplicates without running number


@dataclass(frozen=True)
class AlignmentSettings:
    """How the signals of a valve are aligned.

    Attributes
    ----------
    tolerance_ns : int
        Largest difference of source times within one sample; 0 = the same timestamp.
    max_wait_ns : int
        An incomplete sample is dropped once a complete one is newer by this much; a source time
        that steps back by more is a step of the source's clock.
    reorder_ns : int
        How long a sample waits behind a gap in the running numbers for the missing samples.
        Without a gap it is emitted at once.
    reorder_by_time_ns : int
        The same for valves without running number: each sample waits until one newer by this much
        is complete.
    max_pending : int
        Incomplete samples kept per valve; beyond that the oldest is dropped.
    hold_ns : mapping of Signal to int
        Signals that report less often than the others: the last value is held for this long.
    """

    tolerance_ns: int = 0
    max_wait_ns: int = 2_000_000_000
    reorder_ns: int = 1_000_000_000
    reorder_by_time_ns: int = 0
    max_pending: int = 4096
    hold_ns: Mapping[Signal, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Alignment:
    """Aligns the changes of V valves.

    ``optional`` (V,) names each valve's optional signals, ``has_sequence`` (V,) marks those with a
    running number; if it is empty, no valve has one.

    Every change is added to the pending sample of its valve with its source time. Complete samples
    are emitted once each: in the order of their running number
    (:mod:`valvemap.pipeline.kernels.by_number`), or else of time. Samples that a later one
    overtakes are dropped and counted as ``missing``; samples that arrive after that count as
    ``late``, repeated ones as ``duplicates``. ``gaps`` counts the running numbers that never
    arrived; ``lost_by_time`` the losses inferred from the usual sampling period, without running
    number; ``clock_steps`` the backward steps of the source's clock; ``restarts`` the restarts of
    its running number.

    Examples
    --------
    >>> align = Alignment(AlignmentSettings(), optional=((),))
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
    optional: tuple[tuple[str, ...], ...]
    has_sequence: tuple[bool, ...] = ()

    def initial_state(self) -> Waiting:
        """Return the state before the first change."""
        return self.nothing(len(self.optional), min(_FIRST_CAPACITY, self.settings.max_pending))

    def nothing(self, valves: int, pending: int) -> Waiting:
        """Return the initial state of ``valves`` valves, with room for ``pending`` samples each."""
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
        """Process changes; return the samples that are due, by valve, in their order."""
        return self.take(Waiting._make(array.copy() for array in state), changes)

    def take(self, waiting: Waiting, changes: DataChanges) -> tuple[Waiting, ByValve]:
        """As `update`, in place: ``waiting`` must not be used afterwards."""
        return self._run(waiting, changes, _NO_VALVES, slots.NOTHING)

    def waits(self, waiting: Waiting) -> NDArray[np.bool_]:
        """Mask (V,) of the valves with complete samples in the reorder buffer."""
        found = np.zeros(len(self.optional), np.bool_)
        if np.count_nonzero(waiting.order[:, slots.SIZE]):
            kernel.find_waiting(self._rules, waiting, found)
        return found

    def of(self, waiting: Waiting, valve: int) -> Waiting:
        """Return copies of one valve's state, (1, …), trimmed to the samples in use."""
        return Waiting._make([array.copy() for array in self.view(waiting, valve)])

    def view(self, waiting: Waiting, valve: int) -> Waiting:
        """As `of`, not copied."""
        one = Waiting._make([array[valve : valve + 1] for array in waiting])
        size = int(one.order[0, slots.SIZE])
        return one._replace(
            slots=one.slots[:, :size], values=one.values[:, :size], status=one.status[:, :size]
        )

    def put(self, waiting: Waiting, valve: int, one: Waiting) -> Waiting:
        """Restore one valve from the result of `of`; ``waiting`` is used up, as in `take`.

        Raises
        ------
        StateMismatchError
            if more samples wait than ``max_pending``.
        """
        size = one.slots.shape[1]
        if size > self.settings.max_pending:
            raise StateMismatchError(f"{size} samples wait, {self.settings.max_pending} may")
        while waiting.slots.shape[1] < size:
            waiting = grown(waiting, min(2 * waiting.slots.shape[1], self.settings.max_pending))
        for name in Waiting._fields:
            array, kept = getattr(waiting, name), getattr(one, name)
            own = array[valve, :size] if name in _BY_SLOT else array[valve]
            own[...] = kept[0]
        return waiting

    def pending(self, waiting: Waiting) -> Times:
        """Number of waiting samples of each valve, (V,)."""
        return waiting.order[:, slots.SIZE].copy()

    def newest(self, waiting: Waiting, valve: int) -> Times:
        """Source time of each signal's newest value, (5,), UTC ns; ``NEVER`` before the first."""
        seen = waiting.order[valve, slots.SEEN : slots.SEEN + slots.SIGNALS]
        newest: Times = np.maximum(seen, waiting.held_time[valve])
        return newest

    def flush(self, waiting: Waiting, valves: Times) -> tuple[Waiting, ByValve]:
        """Flush the reorder buffers of ``valves``; ``waiting`` is used up, as in `take`."""
        return self._run(waiting, DataChanges.empty(), valves, slots.FLUSH)

    def begin_anew(self, waiting: Waiting, valves: Times) -> tuple[Waiting, ByValve]:
        """Accept any running number next: the source of these valves was restarted."""
        return self._run(waiting, DataChanges.empty(), valves, slots.BEGIN_ANEW)

    def set_clock(self, waiting: Waiting, valves: Times, command: int) -> tuple[Waiting, ByValve]:
        """The source's clock of these valves, without running number, was set.

        ``command`` is SET_BACK or SET_FORWARD of :mod:`valvemap.pipeline.kernels.waiting`.
        """
        return self._run(waiting, DataChanges.empty(), valves, command)

    @property
    def rules(self) -> Rules:
        """The rules as the kernels take them."""
        return self._rules

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
            out = room_for(len(changes) - done + int(waiting.order[:, slots.SIZE].sum()))
            done, n = kernel.align_changes(
                columns, done, valves, command, self._rules, may_grow, waiting, out
            )
            parts.append(Aligned._make(array[:n] for array in out))
            valves = _NO_VALVES
            if done < len(changes):
                waiting = grown(waiting, min(2 * pending, self.settings.max_pending))
        return waiting, by_valve(joined(parts), len(self.optional))

    @cached_property
    def _numbered(self) -> NDArray[np.bool_]:
        return np.array(self.has_sequence or (False,) * len(self.optional), np.bool_)

    @cached_property
    def _rules(self) -> Rules:
        settings, absent = self.settings, ~presence(self.optional)
        one = [settings.hold_ns.get(Signal(j), 0) for j in range(slots.SIGNALS)]
        hold = np.tile(np.array(one, np.int64), (len(absent), 1))
        hold[absent] = 0
        needed = hold == 0
        needed[absent] = False
        bits = np.int64(1) << np.arange(slots.SIGNALS)
        by_time = settings.reorder_by_time_ns
        return Rules(
            required=(needed * bits).sum(axis=1),
            hold=hold,
            numbered=self._numbered,
            reorder=np.where(self._numbered, settings.reorder_ns, by_time).astype(np.int64),
            tolerance=settings.tolerance_ns,
            max_wait=settings.max_wait_ns,
        )


def presence(optional: Sequence[tuple[str, ...]]) -> NDArray[np.bool_]:
    """Mask (V, COUNT) of the signals that V valves have: all required ones, and these optional.

    >>> presence([("T",), ()])[:, -1]
    array([ True, False])
    """
    there = [[name in REQUIRED or name in own for name in MEASURED] for own in optional]
    return np.array(there, np.bool_).reshape(-1, len(MEASURED))


def optional_in_keys(optional: tuple[str, ...]) -> bool | tuple[str, ...]:
    """Return a valve's optional signals as they enter the keys of stored states.

    Version 0.1 knew one and noted whether there is a T: keys without another are as in its files.
    """
    return {(): False, ("T",): True}.get(optional, optional)


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
