"""Many models at once: the states of a fleet as one structure of arrays."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike

from service.identification.forgetting import Forgetting, Resetting, SlidingWindow
from service.identification.kernels.fleet import run_fleet
from service.identification.least_squares_state import (
    RlsState,
    batch_of,
    memory_of,
    rule_of,
)
from service.identification.samples import Codes, Floats, Times, Trace


def stack(states: Sequence[RlsState]) -> RlsState:
    """One state whose arrays have a leading axis M from the states of M models of equal n."""
    return RlsState(
        **{f.name: np.stack([getattr(state, f.name) for state in states]) for f in fields(RlsState)}
    )


def member(fleet: RlsState, m: int) -> RlsState:
    """State of model m."""
    return RlsState(**{f.name: getattr(fleet, f.name)[m] for f in fields(RlsState)})


def learn_fleet(
    fleet: RlsState,
    forgetting: Forgetting,
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    offsets: ArrayLike,
) -> tuple[RlsState, Trace]:
    """Take samples in: model m those from ``offsets[m]`` to ``offsets[m + 1] - 1``.

    Bit for bit what :func:`~service.identification.least_squares_state.learn` gives model by model.

    Parameters
    ----------
    fleet
        M states, see `stack`.
    forgetting
        One rule for all, of those that keep nothing but P.
    X, y, t, usable : (N, n), (N,), (N,), (N,)
        The samples of all models, one model after another.
    offsets : (M + 1,)
        Ascending from 0 to N.

    Raises
    ------
    ValueError
        if the offsets do not fit, or the rule works on one model at a time.

    Examples
    --------
    >>> from service.identification.forgetting import Exponential
    >>> from service.identification.least_squares_state import initial_state
    >>> fleet = stack([initial_state(1, Exponential(0.99))] * 2)
    >>> ones = np.ones(4)
    >>> y, t, usable = np.array([3.0, 3.0, 5.0, 5.0]), np.arange(4), np.ones(4, np.uint8)
    >>> learn_fleet(fleet, Exponential(0.99), ones[:, None], y, t, usable, [0, 2, 4])[0].theta
    array([[3.],
           [5.]])
    """
    edges = np.ascontiguousarray(offsets, np.int64)
    ascending = edges.shape == (len(fleet.theta) + 1,) and (np.diff(edges) >= 0).all()
    if not (ascending and edges[0] == 0 and edges[-1] == len(y)):
        raise ValueError(
            f"offsets of shape {edges.shape}: {len(fleet.theta) + 1} ascending ones are wanted, "
            f"from 0 to {len(y)}"
        )
    if isinstance(forgetting, Resetting | SlidingWindow):
        raise ValueError(f"{forgetting} works on one model at a time")  # noqa: TRY004 - a value
    memory, batch = memory_of(fleet), batch_of(X, y, t, usable)
    run_fleet(memory, rule_of(forgetting), batch, edges)
    trace = Trace(predicted=batch.predicted, residual=batch.residual, status=batch.status)
    return RlsState(**memory._asdict()), trace
