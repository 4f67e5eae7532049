"""Timing of signals: detected at the start and then fixed; the step before alignment."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.pipeline.changed_columns import NOTHING
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels.scans import Changed
from valvemap.pipeline.lane_failures import Rows, Stop, isolate, raised
from valvemap.pipeline.scan_search import Comes
from valvemap.pipeline.timing_state import ALIKE, IN_SCANS, TimingSettings, TimingState
from valvemap.pipeline.valve_timing import ValveTiming
from valvemap.vocabulary.signals import PER_VALVE

__all__ = ["Timing", "TimingSettings", "TimingState"]


class Timing:
    """Timing of V valves' signals; if ``fixed``, their timestamps are used as they are.

    U is a command, which rests exactly. Unless the source is seen to send it unchanged, it is held
    from change to change, also if it moved in all scans at the start (`hold_command`).

    Examples
    --------
    >>> timing = Timing(TimingSettings(), optional=((),))
    >>> len(timing.take(DataChanges.empty()))
    0
    """

    def __init__(
        self,
        settings: TimingSettings,
        optional: Sequence[tuple[str, ...]],
        has_sequence: Sequence[bool] = (),
        *,
        fixed: bool = False,
    ) -> None:
        self.settings = settings
        self._optional = list(optional)
        self._has_sequence = list(has_sequence or [False] * len(optional))
        self.valves = [self._fresh(number) for number in range(len(optional))]
        self._special = np.full(len(self.valves), not fixed)
        self._new: list[int] = []
        if fixed:
            for valve in self.valves:
                valve.stands = ALIKE

    def take(self, changes: DataChanges, stop: Stop = raised) -> DataChanges:
        """Process changes; return those that are due for alignment.

        If that raises at a valve, its timing is detected again, and ``stop`` is called.
        """
        if not np.count_nonzero(self._special) or not len(changes):
            return changes
        valve = changes.item // PER_VALVE
        special = self._special[valve]
        if not special.any():
            return changes
        parts = [changes[~special]]
        for number in np.unique(valve[special]).tolist():
            own, before = changes[valve == number], self.valves[number].stands
            changed = Changed(
                (own.item % PER_VALVE).astype(np.int64),
                own.value,
                own.status,
                own.source_time,
            )
            parts.append(self._isolated(number, changed, stop))
            if before != IN_SCANS and self.valves[number].stands == IN_SCANS:
                self._new.append(number)
            self._special[number] = self.valves[number].stands != ALIKE
        return DataChanges.concatenate(parts)

    @property
    def are_alike(self) -> NDArray[np.bool_]:
        """Mask (V,) of the valves whose signals' timestamps are used as they are."""
        alike: NDArray[np.bool_] = ~self._special
        return alike

    def hold_command(self, valve: int, command: float, newest: int, period: int) -> None:
        """Hold a valve's U from change to change; see `ValveTiming.hold_command`."""
        self.valves[valve].hold_command(command, newest, period)
        self._special[valve] = True
        self._new.append(valve)

    def flush(self, valves: Times, stop: Stop = raised) -> DataChanges:
        """Flush the changes buffered for scans; ``stop`` as in `take`."""
        parts = [
            self._isolated(number, NOTHING, stop, flush=True)
            for number in valves.tolist()
            if self.valves[number].stands == IN_SCANS
        ]
        return DataChanges.concatenate(parts)

    @property
    def pending(self) -> Times:
        """Number of changes of each valve that are buffered for scans, (V,)."""
        if not np.count_nonzero(self._special):
            return np.zeros(len(self.valves), np.int64)
        return np.array([valve.pending for valve in self.valves], np.int64)

    def not_made(self, valves: Times) -> Times:
        """Number of scans of the given valves that gave no sample, (M,)."""
        found = np.zeros(len(valves), np.int64)
        for k in self._special[valves].nonzero()[0]:
            found[k] = self.valves[valves[k]].not_made
        return found

    def newly_found(self) -> list[int]:
        """Return the valves whose signals were newly found to have different timestamps."""
        new, self._new = self._new, []
        return new

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Mask (V,) of the valves with on-change signals: their silence is no loss."""
        held = np.zeros(len(self.valves), np.bool_)
        if not np.count_nonzero(self._special):
            return held
        for number in self._special.nonzero()[0].tolist():
            found = self.valves[number].found
            held[number] = found is not None and bool((found.comes == Comes.HELD).any())
        return held

    def may_rest(self, valves: Times) -> bool:
        """Whether the silence of all these valves is no loss, also while nothing is found yet."""
        return all(self.valves[valve].may_rest for valve in valves.tolist())

    def found_by(self, names: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Return the detected timing, by valve name, of valves without a common timestamp."""
        return {
            name: {
                "signals": valve.words.sentences({}),
                "offset_ms": (valve.found.offset * 1e-6).tolist(),
                "period_ms": valve.found.period * 1e-6,
                "window_ms": valve.found.window * 1e-6,
            }
            for name, valve in zip(names, self.valves, strict=True)
            if valve.found is not None
        }

    def put(self, valve: int, state: TimingState) -> None:
        """Restore the timing of one valve from a stored state.

        Raises
        ------
        StateMismatchError
        """
        self.valves[valve].put(state)
        self._special[valve] = self.valves[valve].stands != ALIKE

    def _isolated(
        self, number: int, changed: Changed, stop: Stop, *, flush: bool = False
    ) -> DataChanges:
        out = NOTHING

        def take(_: Rows) -> None:
            nonlocal out
            out = self.valves[number].take(changed, flush=flush)

        def forget() -> None:
            self.valves[number] = self._fresh(number)

        isolate(np.array([number]), take, lambda _: forget, stop)
        return _as_changes(number, out)

    def _fresh(self, number: int) -> ValveTiming:
        return ValveTiming(
            self.settings,
            optional=self._optional[number],
            has_sequence=self._has_sequence[number],
        )


def _as_changes(valve: int, out: Changed) -> DataChanges:
    item = (valve * PER_VALVE + out.signal).astype(np.int32)
    return DataChanges(item, out.value, out.status, out.time)
