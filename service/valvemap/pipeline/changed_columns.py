"""Changes of one valve as columns: cut, joined and copied. Pure."""

from typing import Final

import numpy as np

from valvemap.pipeline.kernels.scans import NEVER, Changed, Scans
from valvemap.vocabulary.signals import PER_VALVE

NOTHING: Final = Changed(
    np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint32), np.empty(0, np.int64)
)


def room(n: int) -> Changed:
    """Return columns for ``n`` changes, to be written."""
    return Changed(
        np.empty(n, np.int64), np.empty(n), np.empty(n, np.uint32), np.empty(n, np.int64)
    )


def part(changes: Changed, start: int, stop: int) -> Changed:
    """Return the changes from ``start`` to before ``stop``."""
    return Changed._make(column[start:stop] for column in changes)


def without_first(changes: Changed, count: int) -> Changed:
    """Drop the oldest ``count`` changes, except the newest of each signal among them."""
    signal = changes.signal[:count]
    last = [int(own[-1]) for j in np.unique(signal) if len(own := np.flatnonzero(signal == j))]
    rows = np.array([*sorted(last), *range(count, len(changes.signal))], np.int64)
    return Changed._make(column[rows] for column in changes)


def joined(first: Changed, second: Changed) -> Changed:
    """Return the changes of both, those of ``first`` first."""
    return Changed(
        np.concatenate((first.signal, second.signal)),
        np.concatenate((first.value, second.value)),
        np.concatenate((first.status, second.status)),
        np.concatenate((first.time, second.time)),
    )


def no_scans(room: int) -> Scans:
    """Return the state before the first scan, with a buffer for ``room`` changes."""
    n = PER_VALVE
    return Scans(
        time=np.zeros(room, np.int64),
        signal=np.zeros(room, np.int64),
        value=np.zeros(room),
        status=np.zeros(room, np.uint32),
        now_value=np.zeros(n),
        now_status=np.zeros(n, np.uint32),
        now_time=np.full(n, NEVER),
        now_rate=np.full(n, np.inf),
        seen=np.full(n, NEVER),
        lacking=np.zeros(n, np.int64),
        moved=np.zeros(n, np.int64),
        course=np.array([0, NEVER, NEVER, 0, 0], np.int64),
    )
