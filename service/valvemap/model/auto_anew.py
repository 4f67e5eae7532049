"""A map of `Auto` that begins anew behind other lags, and what it keeps of the samples before.

The last rows are learnt again behind the lags that are known now. What the cells held is not
forgotten, as a machine may never come to some of them again, but counts for as much as the lags
let it that it was learnt behind. These put it off by a variance of b² = UNEVEN·excess·σ², where
excess is by what share they leave more of the last rows than those known now: the mean of w samples
is worth w / (1 + w·b²/σ²) of them.
"""

import math
from dataclasses import fields
from typing import Final, NamedTuple

import numpy as np

from valvemap.model import lag_search
from valvemap.model.auto_fits import refit
from valvemap.model.auto_state import MAY_BE_UNKNOWN, AutoState, empty, last_rows
from valvemap.model.fleet import alone
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import grid, lag
from valvemap.model.lag_search import Pair
from valvemap.model.samples import Floats, Times

UNEVEN: Final = 20.0  # (4.5)²: so much farther than rows on average lags put the fastest off
LEAST_KEPT: Final = 0.02  # samples' weight: a cell worth less is forgotten
NEVER: Final = np.iinfo(np.int64).max
KEPT: Final = frozenset({"recent", "cells", "slots"})  # arrays that outlive the map


class Rule(NamedTuple):
    """How a valve learns."""

    given: tuple[float | None, float | None]  # lags of U and Q, s; None: looked for
    longest: float  # bound of a cell's weight
    most_steps: int  # of a climb


def begin_anew(state: AutoState, rule: Rule, before: Pair, T: float) -> None:
    """Have the map begin anew behind the lags now in use; ``before`` are those it began with.

    ``T`` is the oil's temperature now, °C.
    """
    path, rows = state.scalars[memory.LAGS :], last_rows(state)
    now = float(path[lag.LAG_U]), float(path[lag.LAG_Q])
    path[lag.BEGAN_U], path[lag.BEGAN_Q] = now
    _doubt_cells(state.cells, lag_search.excess(rows, before, now))
    _forget_the_map(state, rule)
    smooth(state)
    _learn_again(state, rows, rule, T)


def smooth(state: AutoState) -> None:
    """Choose the smoothing behind which the meter's lag is taken back; the signals begin anew."""
    path = state.scalars[memory.LAGS :]
    step = float(np.median(last_rows(state)[:, lag.STEP]))
    path[lag.SMOOTHING] = lag.smoothing(step, path[lag.LAG_Q])
    path[lag.U_EFFECT] = math.nan


def _doubt_cells(cells: np.ndarray, excess: float) -> None:
    """Have what cells hold count for as much as the lags let it that it was learnt behind."""
    weights = cells[:, grid.WEIGHT].astype(np.float64)
    weights /= 1.0 + UNEVEN * excess * weights
    cells[:, grid.WEIGHT] = np.where(weights < LEAST_KEPT, 0.0, weights)


def _forget_the_map(state: AutoState, rule: Rule) -> None:
    """Forget the map and its noise; keep cells, and what is known of time, lags and changes."""
    fresh, path = empty(*rule.given), state.scalars[memory.LAGS :].copy()
    path[MAY_BE_UNKNOWN] = math.nan
    kept = [
        *(memory.USED, memory.ALARMS, memory.NEXT_LOOK, memory.TOO_FAST),
        *(memory.CHANGE_SAMPLE, memory.CHANGE_TIME, memory.TAKEN, memory.CLOCK),
        *range(memory.LAGGING, memory.COUNTERS),
    ]
    counters, size = fresh.counters, state.scalars[memory.CHANGE_SIZE]
    counters[kept] = state.counters[kept]
    counters[[memory.OPENED, memory.BEGAN]] = counters[memory.USED]
    counters[memory.NEXT_FIT] += counters[memory.USED]
    for field in fields(state):
        if field.name not in KEPT:
            getattr(state, field.name)[...] = getattr(fresh, field.name)
    state.scalars[memory.LAGS :], state.scalars[memory.CHANGE_SIZE] = path, size


def _learn_again(state: AutoState, rows: Floats, rule: Rule, T: float) -> None:
    """Take the last rows, since the valve changed, into the cells once more; fit the map to them.

    They are no new samples: nothing that counts samples may count them twice.
    """
    counters = state.counters
    before, recent = counters.copy(), state.recent.copy()
    times = _times(rows, int(before[memory.LAGGING + lag.KEPT_TIME]))
    if before[memory.ALARMS]:
        rows = rows[times >= before[memory.CHANGE_TIME]]
        times = times[len(times) - len(rows) :]
    n = len(rows)
    counters[[memory.USED, memory.OPENED]] -= n
    counters[[memory.NEXT_FIT, memory.NEXT_LOOK, memory.NEW_CELLS]] = NEVER
    one, zero = alone(state), np.zeros(1, np.int64)
    fleet = memory.Fleet(*(getattr(one, name) for name in memory.Fleet._fields))
    memory.run_many(
        0, 0, _batch(rows, times, T), zero, zero, zero + n, rule.longest, fleet, np.empty((4, 4))
    )
    state.recent[...] = recent
    same = [memory.TOO_FAST, memory.NEXT_LOOK, *range(memory.LAGGING, memory.COUNTERS)]
    counters[same] = before[same]
    refit(state, rule.most_steps)


def _times(rows: Floats, last: int) -> Times:
    """When the rows were, ns; ``last``: the last of them."""
    steps = np.rint(1e9 * rows[:, lag.STEP]).astype(np.int64)
    return np.asarray(last - (steps.sum() - steps.cumsum()))


def _batch(rows: Floats, times: Times, T: float) -> memory.Batch:
    n = len(rows)
    U, s, Q = np.ascontiguousarray(rows[:, [lag.LEFT_U, lag.LEFT_S, lag.LEFT_Q]].T)
    return memory.Batch(
        t=times,
        U=U,
        dp=s * np.abs(s),
        T=np.full(n, T),
        Q=Q,
        usable=np.ones(n, np.bool_),
        predicted=np.empty(n),
        residual=np.empty(n),
        status=np.empty(n, np.uint8),
    )
