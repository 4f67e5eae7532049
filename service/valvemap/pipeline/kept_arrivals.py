"""The arrivals of one valve, or of one line of an axis, as arrays of a stored state. Pure."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.arrivals import ArrivalsOfValve
from valvemap.pipeline.clock_steps import MOST_KNOWN, Known
from valvemap.pipeline.kept_waiting import contents_of_waiting
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import Waiting

_TIMES = "source_started", "known_times", "known_digests"


def arrays_of_arrivals(one: ArrivalsOfValve) -> dict[str, Any]:
    """Return the arrays by name: those of `Waiting`, and what is known of source and clock."""
    return {
        **one.waiting._asdict(),
        "source_started": np.array(one.source_started),
        "known_times": one.known.times,
        "known_digests": one.known.digests,
    }


def arrivals_like(kept: Any, alignment: Alignment) -> dict[str, Any]:  # noqa: ANN401 - a State
    """Return initial arrays, of as many samples as the stored ones."""
    waiting = alignment.nothing(1, length_of(kept.slots, 1))
    waiting.order[0, slots.SIZE] = length_of(kept.slots, 1)
    known = Known.nothing(min(length_of(kept.known_times, 0), MOST_KNOWN))
    return arrays_of_arrivals(ArrivalsOfValve(waiting, 0, known))


def contents_of_arrivals(kept: Any) -> Mapping[str, Contents]:  # noqa: ANN401 - a State
    """Return the permitted content; ``order`` must count all stored samples."""
    waiting = Waiting(*(getattr(kept, name) for name in Waiting._fields))
    times = {name: Contents(np.asarray(getattr(kept, name))).any_time() for name in _TIMES}
    return {**contents_of_waiting(waiting), **times}


def arrivals_from(kept: Any) -> ArrivalsOfValve:  # noqa: ANN401 - a State
    """Return the arrivals of checked arrays."""
    return ArrivalsOfValve(
        Waiting(*(getattr(kept, name) for name in Waiting._fields)),
        int(kept.source_started),
        Known(kept.known_times, kept.known_digests),
    )


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
