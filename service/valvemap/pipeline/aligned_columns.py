"""Aligned samples of many valves as columns: joined, sorted by valve. Pure."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.kernels import alignment as kernel
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import Aligned, Waiting
from valvemap.vocabulary.signals import MEASURED


def room_for(n: int) -> Aligned:
    """Return columns for ``n`` samples, to be written."""
    return Aligned(
        valve=np.empty(n, np.int64),
        time=np.empty(n, np.int64),
        values=np.empty((n, slots.SIGNALS)),
        quality=np.empty(n, np.uint8),
    )


def joined(parts: list[Aligned]) -> Aligned:
    """Return the samples of all parts, in their order."""
    if len(parts) == 1:
        return parts[0]
    return Aligned._make(map(np.concatenate, zip(room_for(0), *parts, strict=True)))


def grown(waiting: Waiting, pending: int) -> Waiting:
    """Return the waiting samples with room for ``pending`` of each valve."""

    def wider(array: NDArray[Any]) -> NDArray[Any]:
        wide = np.zeros((array.shape[0], pending, *array.shape[2:]), array.dtype)
        wide[:, : array.shape[1]] = array
        return wide

    return waiting._replace(
        slots=wider(waiting.slots), values=wider(waiting.values), status=wider(waiting.status)
    )


def by_valve(out: Aligned, valves: int) -> ByValve:
    """Return the samples of each valve in the order of their times."""
    n = len(out.time)
    columns = np.empty((slots.SIGNALS, n))
    t, quality, edges = np.empty(n, np.int64), np.empty(n, np.uint8), np.zeros(valves + 1, np.int64)
    kernel.sort_by_valve(out, t, columns, quality, edges)
    present = (edges[1:] > edges[:-1]).nonzero()[0]
    return ByValve(
        Samples(t=t, quality=quality, **dict(zip(MEASURED, columns, strict=True))),
        Segments(present, edges[present], edges[present + 1]),
    )
