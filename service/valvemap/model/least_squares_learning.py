"""Learning of recursive least squares: samples, in sequence, into one state or many."""

import numpy as np

from valvemap.model.forgetting import Forgetting, Resetting, SlidingWindow
from valvemap.model.forgetting_rules import rule_of
from valvemap.model.kernels.recursion import Batch, Memory, run
from valvemap.model.kernels.row_layout import size_of
from valvemap.model.kernels.stepwise import run_stepwise
from valvemap.model.least_squares_state import RlsState, memory_of, writable
from valvemap.model.place_grid import Grid, nowhere
from valvemap.model.samples import Codes, Floats, Segments, Times, Trace


def learn(
    state: RlsState,
    forgetting: Forgetting,
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    thetas: Floats | None = None,
    changes: Floats | None = None,
    grid: Grid | None = None,
) -> tuple[RlsState, Trace]:
    """Update with N samples in sequence.

    Parameters
    ----------
    state, forgetting
        Previous state; its forgetting rule.
    X, y, t, usable : (N, n), (N,), (N,), (N,)
        Regressors, output, times; samples with ``usable`` 0 do not change the state.
    thetas : (N, n), optional
        Written: theta after each sample.
    changes : (C, 3), optional
        Written: the first C detected changes, see `RlsResult`.
    grid : optional
        Places of the samples; without it, `Adaptive` has a single place.
    """
    after = RlsState(*(np.array(getattr(state, name))[None] for name in Memory._fields))
    batch = batch_of(X, y, t, usable, thetas, changes, grid)
    learn_segments(after, forgetting, batch, Segments.one(len(y)))
    trace = Trace(
        predicted=batch.predicted, residual=batch.residual, early=batch.early, status=batch.status
    )
    return RlsState(*(getattr(after, name)[0] for name in Memory._fields)), trace


def learn_segments(
    states: RlsState, forgetting: Forgetting, batch: Batch, segments: Segments
) -> None:
    """Update many models with their samples, in place; ``states`` have a leading axis."""
    n = states.rhs.shape[-1]
    size, rule = size_of(n), rule_of(forgetting, n)
    match forgetting:
        case Resetting() | SlidingWindow():
            run_stepwise(size, memory_of(states), rule, batch, segments)
        case _:
            run(size, memory_of(states), rule, batch, segments)


def batch_of(
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    thetas: Floats | None = None,
    changes: Floats | None = None,
    grid: Grid | None = None,
) -> Batch:
    """Pack samples and output arrays for a kernel."""
    N, n = X.shape
    where = nowhere(n) if grid is None else grid
    return Batch(
        t=writable(t),
        X=writable(X),
        y=writable(y),
        usable=writable(usable),
        a=writable(where.a),
        b=writable(where.b),
        nodes=writable(where.nodes),
        predicted=np.empty(N),
        residual=np.empty(N),
        early=np.empty(N),
        status=np.empty(N, np.uint8),
        thetas=np.empty((0, n)) if thetas is None else thetas,
        changes=np.empty((0, 3)) if changes is None else changes,
    )
