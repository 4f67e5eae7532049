"""Steps of the source's clock in a batch of changes that is processed in parts. Pure."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Times
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.clock_steps import ClockSteps, Known, Step
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.kernels.waiting import Waiting
from valvemap.vocabulary.signals import PER_VALVE

_NO_ROWS: Final = np.zeros(0, np.bool_)


class StepsOfPart(NamedTuple):
    """Steps in one part of N changes.

    ``due`` are its steps; ``after`` (N,) masks the changes of a valve after its step, and
    ``repeated`` those that repeat changes from before a step (empty: none is known to).
    """

    due: list[Step]
    after: NDArray[np.bool_]
    repeated: NDArray[np.bool_]


class AnnouncedSteps:
    """Finds the steps in announced changes, and assigns them to the parts.

    Parameters
    ----------
    required
        (V, SIGNALS) mask of the signals that each sample has.
    numbered
        (V,) mask of the valves with running number, whose clock is not watched.
    reorder_ns
        (V,) how much earlier than the newest a change may be, ns.
    """

    def __init__(
        self, required: NDArray[np.bool_], numbered: NDArray[np.bool_], reorder_ns: Times
    ) -> None:
        self._steps = ClockSteps(required, ~numbered, reorder_ns)
        self._may_step = not numbered.all()
        self._due: list[Step] = []
        self._repeated = _NO_ROWS
        self._processed = 0  # changes, of those announced

    def announce(
        self, changes: DataChanges, now_s: float, waiting: Waiting, are_alike: NDArray[np.bool_]
    ) -> None:
        """Find the steps in changes received at ``now_s`` (monotonic), s.

        ``waiting`` is the alignment's state. ``are_alike`` (V,) masks the valves whose signals'
        timestamps are used as they are; the others have no steps.
        """
        self._processed = 0
        self._due, self._repeated = [], _NO_ROWS
        if self._may_step:
            found = self._steps.find(changes, now_s, waiting)
            self._due = [step for step in found.steps if are_alike[step.valve]]
            self._repeated = found.repeated

    def next_part(self, changes: DataChanges) -> StepsOfPart:
        """Return the steps in the next of the announced changes."""
        first, self._processed = self._processed, self._processed + len(changes)
        due = [step for step in self._due if first <= step.row < self._processed]
        after = np.zeros(len(changes), np.bool_)
        for step in due:
            after[step.row - first :] |= changes.item[step.row - first :] // PER_VALVE == step.valve
        return StepsOfPart(due, after, self._repeated[first : self._processed])

    def remember(self, parts: Sequence[ByValve]) -> None:
        """Remember times and contents of the samples that a part completed."""
        if self._may_step:
            for part in parts:
                self._steps.remember(part)

    def known(self, valve: int) -> Known:
        """Return one valve's samples around a step back of the clock."""
        return self._steps.known(valve)

    def put(self, valve: int, known: Known) -> None:
        """Restore one valve from the result of `known`."""
        self._steps.put(valve, known)
