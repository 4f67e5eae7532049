"""The arrivals of one valve, or of one line of an axis, as arrays of a stored state. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State, StateMismatchError
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.arrivals import ArrivalsOfValve
from valvemap.pipeline.clock_steps import MOST_KNOWN, Known
from valvemap.pipeline.kept_waiting import contents_of_waiting
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import Waiting

_TIMES = "source_started", "known_times", "known_digests"


def arrays_of_arrivals(one: ArrivalsOfValve) -> dict[str, Any]:
    """Return the arrays by name: those of `Waiting`, and the state of source and clock."""
    return {
        **one.waiting._asdict(),
        "source_started": np.array(one.source_started),
        "known_times": one.known.times,
        "known_digests": one.known.digests,
    }


@dataclass(frozen=True)
class KeptArrivals(State):
    """The arrays of `arrays_of_arrivals`, in a stored state that has others, too."""

    slots: Any
    values: Any
    status: Any
    held_value: Any
    held_status: Any
    held_time: Any
    lost: Any
    left: Any
    order: Any
    counters: Any
    source_started: Any
    known_times: Any
    known_digests: Any

    def arrivals_like(self, alignment: Alignment) -> dict[str, Any]:
        """Return initial arrays, of as many samples as these."""
        waiting = alignment.nothing(1, length_of(self.slots, 1))
        waiting.order[0, slots.SIZE] = length_of(self.slots, 1)
        known = Known.nothing(min(length_of(self.known_times, 0), MOST_KNOWN))
        return arrays_of_arrivals(ArrivalsOfValve(waiting, 0, known))

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content; ``order`` must count all stored samples."""
        times = {name: Contents(np.asarray(getattr(self, name))).any_time() for name in _TIMES}
        return {**contents_of_waiting(self._waiting), **times}

    def arrivals(self) -> ArrivalsOfValve:
        """Return the arrivals of checked arrays."""
        known = Known(self.known_times, self.known_digests)
        return ArrivalsOfValve(self._waiting, int(self.source_started), known)

    @property
    def _waiting(self) -> Waiting:
        return Waiting(*(getattr(self, name) for name in Waiting._fields))


def length_of(array: Any, axis: int) -> int:  # noqa: ANN401 - unchecked content of a checkpoint
    """Return the length of a stored array along an axis.

    Raises
    ------
    StateMismatchError
        if it has no such axis.
    """
    shape: tuple[int, ...] = np.shape(array)
    if len(shape) <= axis:
        raise StateMismatchError("an array of another shape")
    return shape[axis]
