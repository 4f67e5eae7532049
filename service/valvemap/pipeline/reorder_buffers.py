"""The reorder buffers of many valves; an error at one valve stops that valve alone. Pure."""

from collections.abc import Callable

import numpy as np

from valvemap.model.samples import Times
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.by_valve import ByValve, together
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels.waiting import Waiting
from valvemap.pipeline.lane_failures import CopyBuffer, Restore, Rows, isolate, saved
from valvemap.vocabulary.signals import PER_VALVE


class ReorderBuffers:
    """Aligns the changes of all valves, and keeps which of the valves have failed.

    If an operation raises at a valve, its writes are undone, and the valve has failed. The others
    get the same bits as without the error.

    Parameters
    ----------
    alignment
        How the signals of V valves are aligned.

    Attributes
    ----------
    waiting : Waiting
        What waits in the reorder buffers, arrays (V, …).
    failed : bool
        Mask (V,) of the valves at which an operation has raised; its owner clears it.
    """

    def __init__(self, alignment: Alignment) -> None:
        self.waiting = alignment.initial_state()
        self.failed = np.zeros(len(alignment.optional), np.bool_)
        self._alignment = alignment
        self._buffer = CopyBuffer()
        self._errors: list[tuple[int, Exception]] = []

    def align(self, changes: DataChanges) -> ByValve:
        """Align data changes; return the samples that they completed."""
        valve = changes.item // PER_VALVE
        present = np.zeros(len(self.failed), np.bool_)
        present[valve] = True
        members = present.nonzero()[0]

        def align(own: Times) -> tuple[Waiting, ByValve]:
            some = changes if len(own) == len(members) else changes[valve == own[0]]
            return self._alignment.take(self.waiting, some)

        return self._isolated(members, align)

    def flush(self, valves: Times) -> ByValve:
        """Flush the reorder buffers of these valves; return their samples."""
        return self._isolated(valves, lambda own: self._alignment.flush(self.waiting, own))

    def begin_anew(self, valves: Times) -> ByValve:
        """Accept any running number next: the source of these valves was restarted."""
        return self._isolated(valves, lambda own: self._alignment.begin_anew(self.waiting, own))

    def set_clock(self, valves: Times, command: int) -> ByValve:
        """Note that the clock of these valves' source was set: SET_BACK or SET_FORWARD."""
        return self._isolated(
            valves, lambda own: self._alignment.set_clock(self.waiting, own, command)
        )

    def put(self, valve: int, waiting: Waiting) -> None:
        """Restore the buffer of one valve, (1, …).

        Raises
        ------
        StateMismatchError
            if more samples wait than ``max_pending``.
        """
        self.waiting = self._alignment.put(self.waiting, valve, waiting)

    def stop(self, valve: int, error: Exception) -> None:
        """Note that a valve has failed."""
        self.failed[valve] = True
        self._errors.append((valve, error))

    def new_failures(self) -> list[tuple[int, Exception]]:
        """Return the valves that have failed since the last call, with the error."""
        new, self._errors = self._errors, []
        return new

    def _isolated(self, members: Times, do: Callable[[Times], tuple[Waiting, ByValve]]) -> ByValve:
        """Call ``do`` for the valves together or, if that raises, one by one."""
        parts: list[ByValve] = []

        def align(rows: Rows) -> None:
            self.waiting, samples = do(members[rows])
            parts.append(samples)

        isolate(members, align, self._saved, self.stop)
        return parts[0] if len(parts) == 1 else together(parts)

    def _saved(self, valves: Times) -> Restore:
        """Copy what waits of the given valves; the result writes the copies back."""
        self._buffer.clear()
        return saved(self.waiting, valves, self._buffer)
