"""A `FlowMap` begins again where its operators are other ones.

Cells hold places and flows as the operators of before made them, so the last samples are learnt
once more. By how much the flow at known places moved, the coarse maps of the same samples tell
(`flow_evidence`). Where that is less than the noise, what is known elsewhere is still right by as
much: it is kept, with that as its uncertainty.
"""

import math
from typing import Final

import numpy as np

from valvemap.model import flow_evidence
from valvemap.model.fleet import copied
from valvemap.model.flow_arrays import Both, given_of, memory_of, new_room, rows_of
from valvemap.model.flow_fits import refit
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import (
    flow_cells,
    flow_drift,
    flow_fit,
    flow_memory,
    flow_path,
    flow_run,
    flow_stay,
)
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.samples import Floats, Times

NANOSECONDS: Final = 1e9


def begin_again(
    state: FlowMapState, both: Both, T: float, longest: float, moved: float = math.inf
) -> None:
    """Begin the map again, with the last samples.

    ``moved``: mean square, (l/min)², by which the flow at known places is another one now. Where
    that is less than the noise, the map elsewhere is kept, as far as it is still right.
    """
    rows, before = rows_of(state), copied(state)
    N = len(rows)
    t = _times(rows, int(state.counters[flow_memory.LAST_TIME]))
    memory, room, counters = memory_of(state), new_room(), state.counters
    worth = float(before.scalars[flow_fit.VARIANCE]) / max(moved, 1e-300)
    flow_stay.begin_replay(memory, N, T)
    if worth >= 1.0:
        _keep_offsets(state, before)
    predicted, residual = np.empty((2, N))
    batch = flow_memory.Batch(
        t=t,
        U=rows[:, flow_path.LEFT_U].copy(),
        dp=rows[:, flow_path.LEFT_DP].copy(),
        p1=rows[:, flow_path.LEFT_P1].copy(),
        T=np.full(N, T),
        Q=rows[:, flow_path.LEFT_Q].copy(),
        usable=np.ones(N, np.bool_),
        predicted=predicted,
        residual=residual,
        status=np.empty(N, np.uint8),
        longest=longest,
    )
    counters[flow_memory.WATCHED] = counters[flow_memory.WEIGHED] = N
    _begin_coarse(state, both, rows)
    flow_run.run(0, N, batch, *both, memory, room)
    if worth >= 1.0:
        _keep_cells(state, before, worth)
    else:
        counters[flow_memory.RESTARTED] = counters[flow_memory.USED]
    counters[flow_memory.FITTED] = 0  # the next fit starts from the first guess
    refit(state, *both)


def _keep_offsets(state: FlowMapState, before: FlowMapState) -> None:
    """Keep the sensors' offsets where one was found to have jumped: operators have no part in it.

    One that has only drifted may come from what the operators explain now.
    """
    kind = int(before.counters[flow_memory.CHANGE_KIND]) % flow_drift.NAMED
    if kind not in (flow_drift.OTHER_ZERO, flow_drift.OTHER_PRESSURE):
        return
    for k in (flow_drift.ZERO, flow_drift.PRESSURE):
        of_models = np.array(flow_drift.PLACES) + k * (k + 3) // 2
        state.x[:, :, k], state.now[:, 0, k] = before.now[:, 0, k, None], before.now[:, 0, k]
        state.P[:, of_models] = before.now[:, 1 + k, k, None]
        state.now[:, 1 + k, k] = before.now[:, 1 + k, k]
    state.scalars[flow_fit.ZERO_SCALE] = before.scalars[flow_fit.ZERO_SCALE]


def _keep_cells(state: FlowMapState, before: FlowMapState, worth: float) -> None:
    """Keep cells that the last samples did not reach, together worth ``worth`` samples at most.

    What the operators change of them, they may have in common.
    """
    then, now = before.cells, state.cells
    kept = (now[:, flow_cells.COUNT] == 0.0) & (then[:, flow_cells.WORTH] > 0.0)
    share = worth / (int(kept.sum()) or 1) / then[kept, flow_cells.WORTH]
    now[kept] = then[kept]
    for column in (flow_cells.COUNT, flow_cells.WORTH):
        now[kept, column] *= np.minimum(share, 1.0)


def _begin_coarse(state: FlowMapState, both: Both, rows: Floats) -> None:
    """Take the coarse map of the rows until all are learnt: a meter's filter is undone by it."""
    given = given_of(state)
    evidence = flow_evidence.Evidence(*both, rows)
    left = evidence.of(given).square
    evidence.fill(given, *both, state.theta)
    scale = float(state.scalars[flow_fit.SCALE])
    state.std[:] = rules.COARSE * math.sqrt(scale)
    state.scalars[flow_fit.VARIANCE] = left  # what it was before came from another map
    state.path[flow_path.FLOOR] = rules.OF_COARSE * left if flow_path.has_past(given) else 0.0
    state.counters[flow_memory.FITTED] = 1
    state.counters[flow_memory.NEXT_FIT] = state.counters[flow_memory.USED] + len(rows) + 1


def _times(rows: Floats, last: int) -> Times:
    steps = np.round(NANOSECONDS * rows[:, flow_path.STEP]).astype(np.int64)
    behind = np.cumsum(steps[::-1])[::-1]  # from the row before to the last one
    return np.asarray(last - behind + steps, np.int64)
