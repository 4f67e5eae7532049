"""The loop that sorts data changes into samples by their source time."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

SIGNALS = 5
SEQUENCE = 5
STRIDE = 6

LATE, MISSING, DUPLICATES, CLOCK_STEPS, GAPS, EMITTED, COUNTERS = range(7)

NEVER = np.iinfo(np.int64).min
NO_SEQUENCE = np.int64(-1)


class Changes(NamedTuple):
    """Data changes, all (N,): see :class:`service.streaming.data_changes.DataChanges`."""

    item: NDArray[np.int32]
    value: NDArray[np.float64]
    status: NDArray[np.uint32]
    source_time: NDArray[np.int64]


class Waiting(NamedTuple):
    """What waits for its fellows; the first axis of every array is the valve (V).

    One row of ``times`` (V, K), ``values`` (V, K, 5), ``status`` (V, K, 5) and ``filled`` (V, K;
    a bit per signal) holds the incomplete samples of a valve in the order of their time; the first
    ``size`` (V,) count. ``seen`` (V, 5) is the newest time of every signal, ``held_*`` (V, 5) its
    last value where it may be held, ``sequence`` (V,) the last running number, ``counters``
    (V, COUNTERS) counts since the start.
    """

    times: NDArray[np.int64]
    values: NDArray[np.float64]
    status: NDArray[np.uint32]
    filled: NDArray[np.uint8]
    size: NDArray[np.int64]
    emitted_until: NDArray[np.int64]
    seen: NDArray[np.int64]
    held_value: NDArray[np.float64]
    held_status: NDArray[np.uint32]
    held_time: NDArray[np.int64]
    sequence: NDArray[np.int64]
    counters: NDArray[np.int64]


class Aligned(NamedTuple):
    """Room for the samples that leave: ``valve``, ``time``, ``quality`` (N,), ``values`` (N, 5)."""

    valve: NDArray[np.int64]
    time: NDArray[np.int64]
    values: NDArray[np.float64]
    quality: NDArray[np.uint8]


@njit(cache=True)
def _find(times: NDArray[np.int64], size: int, time: int) -> int:
    """Position of the first slot not before ``time``."""
    low, high = 0, size
    while low < high:
        middle = (low + high) // 2
        if times[middle] < time:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True)
def _copy(w: Waiting, v: int, here: int, there: int) -> None:
    """Copy a slot, element by element: whole rows take numba seconds to compile."""
    w.times[v, there] = w.times[v, here]
    w.filled[v, there] = w.filled[v, here]
    for m in range(SIGNALS):
        w.values[v, there, m] = w.values[v, here, m]
        w.status[v, there, m] = w.status[v, here, m]


@njit(cache=True)
def _open(w: Waiting, v: int, k: int, time: int) -> None:
    """Insert an empty slot at place ``k``."""
    for n in range(w.size[v], k, -1):
        _copy(w, v, n - 1, n)
    w.times[v, k] = time
    w.filled[v, k] = 0
    w.size[v] += 1


@njit(cache=True)
def _drop(w: Waiting, v: int, count: int) -> None:
    """Take the ``count`` oldest slots away."""
    w.emitted_until[v] = w.times[v, count - 1]
    for n in range(count, w.size[v]):
        _copy(w, v, n, n - count)
    w.size[v] -= count


@njit(cache=True)
def _severity(status: int) -> int:
    """0 Good, 1 Uncertain, 2 Bad: the top two bits of a StatusCode (Part 4, 7.39)."""
    return min(status >> 30, 2)


@njit(cache=True)
def _count_sequence(w: Waiting, v: int, number: int) -> None:
    """Count the running numbers between the last one and ``number``; a restart counts none."""
    if w.sequence[v] != NO_SEQUENCE:
        step = (number - w.sequence[v]) & 0xFFFFFFFF
        if 1 < step < 0x80000000:
            w.counters[v, GAPS] += step - 1
    w.sequence[v] = number


@njit(cache=True)
def _restart(w: Waiting, v: int) -> None:
    """The source's clock has stepped back: what waits will not be completed."""
    w.counters[v, CLOCK_STEPS] += 1
    w.counters[v, MISSING] += w.size[v]
    w.size[v] = 0
    w.emitted_until[v] = NEVER
    for k in range(SIGNALS):
        w.seen[v, k] = NEVER


@njit(cache=True)
def _hopeless(w: Waiting, v: int, k: int, required: int, tolerance: int) -> bool:
    """Every signal that slot ``k`` lacks has moved on: a signal delivers in its order."""
    for m in range(SIGNALS):
        if required & ~w.filled[v, k] & (1 << m) and w.seen[v, m] <= w.times[v, k] + tolerance:
            return False
    return True


@njit(cache=True)
def _emit(
    w: Waiting, v: int, k: int, required: int, hold: NDArray[np.int64], out: Aligned, n: int
) -> None:
    """Write slot ``k`` as sample ``n``; its quality is that of its worst signal."""
    worst = 0
    for m in range(SIGNALS):
        out.values[n, m] = np.nan
        if required & (1 << m):
            out.values[n, m] = w.values[v, k, m]
            worst = max(worst, _severity(w.status[v, k, m]))
        elif hold[m] > 0:
            if w.held_time[v, m] == NEVER or w.times[v, k] - w.held_time[v, m] > hold[m]:
                worst = 2
            else:
                out.values[n, m] = w.held_value[v, m]
                worst = max(worst, _severity(w.held_status[v, m]))
    out.valve[n] = v
    out.time[n] = w.times[v, k]
    out.quality[n] = worst
    w.counters[v, EMITTED] += 1


@njit(cache=True)
def align_changes(
    changes: Changes,
    start: int,
    required: NDArray[np.uint8],
    hold: NDArray[np.int64],
    tolerance: int,
    max_wait: int,
    may_grow: bool,  # noqa: FBT001 - numba takes positions only
    w: Waiting,
    out: Aligned,
) -> tuple[int, int]:
    """Take the changes from ``start`` on in; return how many are done and how many samples left.

    ``required`` (V,) has a bit for every signal that a sample must have, ``hold`` (V, 5) the ns
    for which a signal's last value serves. Where a row is full and ``may_grow``, the loop stops
    before the change that found it so.
    """
    n = 0
    capacity = w.times.shape[1]
    for i in range(start, len(changes.item)):
        v = changes.item[i] // STRIDE
        j = changes.item[i] % STRIDE
        time = changes.source_time[i]
        if may_grow and w.size[v] == capacity:
            return i, n
        if j == SEQUENCE:
            if np.isfinite(changes.value[i]) and _severity(changes.status[i]) < 2:
                _count_sequence(w, v, int(changes.value[i]))
            continue
        if w.seen[v, j] != NEVER and time < w.seen[v, j] - max_wait:
            _restart(w, v)
        if time == w.seen[v, j]:
            w.counters[v, DUPLICATES] += 1
            continue
        w.seen[v, j] = max(w.seen[v, j], time)
        if hold[v, j] > 0:
            w.held_value[v, j] = changes.value[i]
            w.held_status[v, j] = changes.status[i]
            w.held_time[v, j] = time
            continue
        started = w.emitted_until[v] != NEVER  # before the first sample nothing can be missed
        if started and time <= w.emitted_until[v]:
            w.counters[v, LATE] += 1
            continue
        k = _find(w.times[v], w.size[v], time - tolerance)
        bit = np.uint8(1 << j)
        if k == w.size[v] or w.times[v, k] > time + tolerance:
            if w.size[v] == capacity:
                w.counters[v, MISSING] += started
                if k == 0:  # it is the oldest itself
                    continue
                _drop(w, v, 1)
                k -= 1
            _open(w, v, k, time)
        elif w.filled[v, k] & bit:
            w.counters[v, DUPLICATES] += 1
            continue
        w.values[v, k, j] = changes.value[i]
        w.status[v, k, j] = changes.status[i]
        w.filled[v, k] |= bit
        if w.filled[v, k] != required[v]:
            continue
        newest = w.times[v, k]
        done = 0
        while done < w.size[v]:
            if w.filled[v, done] == required[v]:
                _emit(w, v, done, required[v], hold[v], out, n)
                n += 1
            elif w.times[v, done] < newest - max_wait or _hopeless(
                w, v, done, required[v], tolerance
            ):
                w.counters[v, MISSING] += started
            else:
                break
            done += 1
        if done > 0:
            _drop(w, v, done)
    return len(changes.item), n


@njit(cache=True)
def sort_by_valve(
    out: Aligned,
    t: NDArray[np.int64],
    columns: NDArray[np.float64],
    quality: NDArray[np.uint8],
    edges: NDArray[np.int64],
) -> None:
    """Write the samples valve by valve, each valve's in their order; counting, not comparing.

    ``columns`` (5, N); ``edges`` (V + 1,), zeros before: valve v has edges[v] … edges[v + 1] - 1.
    """
    for v in out.valve:
        edges[v + 1] += 1
    for v in range(1, len(edges)):
        edges[v] += edges[v - 1]
    place = edges[:-1].copy()
    for i in range(len(out.valve)):
        k = place[out.valve[i]]
        place[out.valve[i]] += 1
        t[k] = out.time[i]
        quality[k] = out.quality[i]
        for m in range(SIGNALS):
            columns[m, k] = out.values[i, m]
