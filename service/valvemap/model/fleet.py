"""Many models at once: the states of a fleet as one structure of arrays."""

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from valvemap.model.estimator import State
from valvemap.model.forgetting import Forgetting
from valvemap.model.least_squares_learning import batch_of, learn_segments
from valvemap.model.least_squares_state import RlsState
from valvemap.model.place_grid import Grid
from valvemap.model.protocol_checks import CheckedByClass
from valvemap.model.samples import (
    Codes,
    Floats,
    Samples,
    Segments,
    Times,
    Trace,
    columns_of,
    field_names,
)

UNREAD = frozenset(  # arrays of a state that no result depends on
    {"flows", "places", "visits", "window", "cells", "slopes", "slots", "recent"}
)

S = TypeVar("S", bound=State)
In_contra = TypeVar("In_contra", bound=State, contravariant=True)


@runtime_checkable
class ManyModels(Protocol[In_contra], metaclass=CheckedByClass):
    """An estimator that can update many models in one call."""

    def initial_state(self) -> Any:  # noqa: ANN401 - of its own kind
        """State of one model before the first sample."""

    def update_many(self, states: In_contra, samples: Samples, segments: Segments) -> Trace:
        """Update with N samples; ``states`` have a leading axis M and are written in place.

        The result equals that of ``update`` for each model, bit by bit. Rows of the trace outside
        the segments are undefined.
        """

    def parameters_many(self, states: In_contra) -> tuple[Floats, Floats]:
        """Return ``parameters`` of each model, both (M, n)."""

    def adaptation_many(self, states: In_contra) -> Codes:
        """Return ``adaptation`` of each model (M,)."""


def stack(states: Sequence[S]) -> S:
    """Stack the states of M models of equal n; arrays get a leading axis M."""
    kind = type(states[0])
    return kind(
        **{name: np.stack([getattr(state, name) for state in states]) for name in field_names(kind)}
    )


def repeated(state: S, M: int) -> S:
    """Repeat a state M times; arrays get a leading axis M."""
    kind = type(state)
    arrays = {name: np.asarray(getattr(state, name)) for name in field_names(kind)}
    return kind(**{name: np.tile(a, (M,) + (1,) * a.ndim) for name, a in arrays.items()})


def alone(state: S) -> S:
    """Return a fleet of one model: views, not copies."""
    kind = type(state)
    return kind(**{name: np.asarray(getattr(state, name))[None] for name in field_names(kind)})


def member(fleet: S, m: int) -> S:
    """Return the state of model m: views, not copies."""
    kind = type(fleet)
    return kind(*[array[m] for array in columns_of(fleet)])


def copied(state: S) -> S:
    """Return a copy of a state."""
    return type(state)(*[np.array(array) for array in columns_of(state)])


def copied_member(fleet: S, m: int) -> S:
    """Return a copy of the state of model m."""
    return type(fleet)(*[np.array(array[m]) for array in columns_of(fleet)])


def members(fleet: S, chosen: Times) -> S:
    """Return copies of the states of the chosen models, with a leading axis.

    Arrays that no result depends on (memories of places, windows, cells) are empty.
    """
    kind, nothing = type(fleet), np.empty((len(chosen), 0))
    arrays = {name: getattr(fleet, name) for name in field_names(kind)}
    return kind(**{k: nothing if k in UNREAD else a[chosen] for k, a in arrays.items()})


def update_one(estimator: ManyModels[S], state: S, samples: Samples) -> tuple[S, Trace]:
    """Update a single model with ``update_many``; ``state`` is not changed."""
    fleet = repeated(state, 1)
    trace = estimator.update_many(fleet, samples, Segments.one(len(samples)))
    return member(fleet, 0), trace


def learn_many(
    fleet: RlsState,
    forgetting: Forgetting,
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    segments: Segments,
    grid: Grid | None = None,
) -> Trace:
    """Update with samples as `learn_fleet` does, writing into the arrays of ``fleet``."""
    batch = batch_of(X, y, t, usable, grid=grid)
    learn_segments(fleet, forgetting, batch, segments)
    return Trace(batch.predicted, batch.residual, batch.early, batch.status)


def learn_fleet(
    fleet: RlsState,
    forgetting: Forgetting,
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    offsets: ArrayLike,
) -> tuple[RlsState, Trace]:
    """Update model m with the samples ``offsets[m]`` to ``offsets[m + 1] - 1``.

    The result equals that of :func:`~valvemap.model.least_squares_learning.learn` for each model,
    bit by bit.

    Parameters
    ----------
    fleet
        M states, see `stack`.
    forgetting
        One rule for all.
    X, y, t, usable : (N, n), (N,), (N,), (N,)
        The samples of all models, one model after another.
    offsets : (M + 1,)
        Ascending from 0 to N.

    Raises
    ------
    ValueError
        if the offsets do not fit.

    Examples
    --------
    >>> from valvemap.model.forgetting import Exponential
    >>> from valvemap.model.least_squares_state import initial_state
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
    after = copied(fleet)
    segments = Segments(np.arange(len(edges) - 1), edges[:-1].copy(), edges[1:].copy())
    return after, learn_many(after, forgetting, X, y, t, usable, segments)
