"""The loop that aligns data changes into samples."""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import kernel as counting_kernel
from valvemap.pipeline.kernels.by_number import judge, place_by_number, resume, settle
from valvemap.pipeline.kernels.by_time import leave_by_time, place_by_time
from valvemap.pipeline.kernels.compiled import kernel
from valvemap.pipeline.kernels.waiting import (
    BEGIN_ANEW,
    FILLED,
    JUDGE,
    MAKE_ROOM,
    NOTHING,
    SEQUENCE,
    SETTLE,
    SIGNALS,
    SIZE,
    STRIDE,
    TIME,
    ZERO,
    Aligned,
    Changes,
    Rules,
    Waiting,
)


@kernel
def align_changes(
    changes: Changes,
    start: int,
    valves: NDArray[np.int64],
    command: int,
    rules: Rules,
    may_grow: bool,  # noqa: FBT001 - numba takes positions only
    w: Waiting,
    out: Aligned,
) -> tuple[int, int]:
    """Process changes from ``start`` on; return the index of the next one and the samples emitted.

    Before that, ``command`` (FLUSH or BEGIN_ANEW) is executed for ``valves``. If a row is full and
    ``may_grow`` is set, the loop stops before the change that needs more room.
    """
    n = ZERO
    capacity = w.slots.shape[1]
    for i in range(start - len(valves), len(changes.item)):
        k, todo, time = -1, NOTHING, 0
        if i < start:
            v, todo = int(valves[start - 1 - i]), command
        else:
            v = int(changes.item[i] // STRIDE)
            j = changes.item[i] % STRIDE
            if may_grow and w.order[v, SIZE] == capacity:
                return i, n
            time, value, status = changes.source_time[i], changes.value[i], changes.status[i]
            if rules.numbered[v]:
                k = place_by_number(w, v, j, time, value, status, rules)
                if k >= 0:
                    todo, time = JUDGE, int(w.slots[v, k, TIME])
                elif w.order[v, SIZE] == capacity and not may_grow:
                    todo = MAKE_ROOM
            elif j != SEQUENCE:
                k = place_by_time(w, v, j, time, value, status, rules)
                todo = SETTLE if k >= 0 else NOTHING
        if todo != NOTHING and not rules.numbered[v]:
            n = leave_by_time(w, v, k, todo, rules, out, n)
            continue
        while todo != NOTHING:
            if todo == JUDGE:
                todo = judge(w, v, k, rules)
            n = settle(w, v, todo, rules, out, n)
            if todo == BEGIN_ANEW and k >= 0:
                k, todo = resume(w.order[v], w.slots[v], time), JUDGE
            elif w.order[v, SIZE] == capacity and not may_grow:
                todo = MAKE_ROOM
            else:
                todo = NOTHING
    return len(changes.item), n


@kernel
def find_waiting(rules: Rules, w: Waiting, waits: NDArray[np.bool_]) -> None:
    """Set ``waits`` (V,) for valves with complete samples that wait."""
    for v in range(len(waits)):
        waits[v] = False
        for k in range(w.order[v, SIZE]):
            if w.slots[v, k, FILLED] & rules.required[v] == rules.required[v]:
                waits[v] = True
                break


@counting_kernel
def sort_by_valve(
    out: Aligned,
    t: NDArray[np.int64],
    columns: NDArray[np.float64],
    quality: NDArray[np.uint8],
    edges: NDArray[np.int64],
) -> None:
    """Write the samples sorted by valve, each valve's in their order (a counting sort).

    ``columns`` (SIGNALS, N); ``edges`` (V + 1,), initially 0: valve v has edges[v] to
    edges[v + 1] - 1.
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
