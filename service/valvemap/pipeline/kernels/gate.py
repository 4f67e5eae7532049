"""The loop that gates samples one after another, each signal by its own limits."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.prefetch import fetch
from valvemap.model.samples import Segments
from valvemap.pipeline.kernels.compiled import inner, kernel
from valvemap.vocabulary.signals import COUNT, IS_OPTIONAL

WINDOW = 5

NOT_FINITE, OUT_OF_RANGE, FROZEN, TOO_FAST, SPIKE, REASONS = range(6)


class Limits(NamedTuple):
    """Limits of the signals, one per signal; a check is off where it is inf (``frozen_ns``: 0)."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    frozen_ns: NDArray[np.int64]
    max_rate: NDArray[np.float64]
    spike: NDArray[np.float64]


class Memory(NamedTuple):
    """State of each signal of M valves, (M, COUNT).

    ``window`` (M, COUNT, WINDOW), ``counters`` (M, COUNT, REASONS).
    """

    last: NDArray[np.float64]
    last_time: NDArray[np.int64]
    still_since: NDArray[np.int64]
    window: NDArray[np.float64]
    counters: NDArray[np.int64]


@kernel
def judge_samples(
    t: NDArray[np.int64],
    values: NDArray[np.float64],
    limits: Limits,
    memory: Memory,
    quality: NDArray[np.uint8],
    bad_status: NDArray[np.int64],
    use_uncertain: bool,  # noqa: FBT001 - numba takes positions only
    segments: Segments,
) -> None:
    """Judge N samples ``values`` (N, COUNT); set ``quality`` (N,) to 2 where a check fails.

    ``bad_status`` (M,) counts the samples that arrived as bad.
    """
    for s in range(len(segments.members)):
        m = segments.members[s]
        if s + 1 < len(segments.members):
            fetch(memory, segments.members[s + 1])
        start, stop = segments.starts[s], segments.stops[s]
        for i in range(start, stop):
            if quality[i] == 1 and not use_uncertain:
                quality[i] = 2
            bad_status[m] += quality[i] == 2
        own = Memory(
            memory.last[m],
            memory.last_time[m],
            memory.still_since[m],
            memory.window[m],
            memory.counters[m],
        )
        _judge(t, values, limits, own, quality, start, stop)


@inner
def _judge(
    t: NDArray[np.int64],
    values: NDArray[np.float64],
    limits: Limits,
    memory: Memory,
    quality: NDArray[np.uint8],
    start: int,
    stop: int,
) -> None:
    """Judge samples start … stop - 1 of one valve."""
    low, high, frozen_ns, max_rate, spike = limits
    last, last_time, still_since, window, counters = memory
    for i in range(start, stop):
        for j in range(COUNT):
            x = values[i, j]
            if IS_OPTIONAL[j] and np.isnan(x):  # only maps that depend on it are affected
                continue
            if not np.isfinite(x):
                counters[j, NOT_FINITE] += 1
                quality[i] = 2
                continue
            if x < low[j] or x > high[j]:
                counters[j, OUT_OF_RANGE] += 1
                quality[i] = 2
                continue
            first = not np.isfinite(last[j])
            if first or x != last[j]:
                still_since[j] = t[i]
            elif frozen_ns[j] > 0 and t[i] - still_since[j] > frozen_ns[j]:
                counters[j, FROZEN] += 1
                quality[i] = 2
            if not first and np.isfinite(max_rate[j]) and t[i] > last_time[j]:
                if np.abs(x - last[j]) > max_rate[j] * ((t[i] - last_time[j]) * 1e-9):
                    counters[j, TOO_FAST] += 1
                    quality[i] = 2
            if np.isfinite(spike[j]):
                for k in range(WINDOW - 1):
                    window[j, k] = window[j, k + 1]
                window[j, WINDOW - 1] = x
                if np.abs(x - _median(window[j])) > spike[j]:
                    counters[j, SPIKE] += 1
                    quality[i] = 2
            last[j] = x
            last_time[j] = t[i]


@inner
def _median(window: NDArray[np.float64]) -> float:
    """Median of the window; while it fills, of its values (the lower of two)."""
    n = 0
    for x in window:
        n += not np.isnan(x)
    for x in window:
        below = 0
        equal = 0
        for y in window:
            below += y < x
            equal += y == x
        if below <= (n - 1) // 2 < below + equal:
            return float(x)
    return np.nan
