"""Exact conversion of a state to another unit of flow.

A state is homogeneous in Q if samples with c·Q give each of its values times a fixed power of c:
theta once, σ² twice, P not at all. It can then be converted without its samples.
"""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import State
from valvemap.model.protocol_checks import CheckedByClass

Powers = Mapping[str, NDArray[np.int64]]
"""The power of Q of each value, by array; arrays that are not named do not depend on Q's unit."""

S = TypeVar("S", bound=State)


@runtime_checkable
class FlowHomogeneous(Protocol, metaclass=CheckedByClass):
    """An estimator whose states may be homogeneous in Q."""

    def flow_powers(self, state: Any) -> Powers | None:  # noqa: ANN401 - the estimator's state
        """Return the powers of Q of a state's arrays; None if it is not homogeneous."""


def in_flow_unit(state: S, powers: Powers, factor: float) -> S:
    """Return the state that the same samples with Q times ``factor`` > 0 would have given.

    >>> from valvemap.model.recursive_least_squares import RecursiveLeastSquares
    >>> from valvemap.model.samples import Samples
    >>> samples = Samples.of(range(9), range(9), range(9), [0] * 9, range(9))
    >>> rls = RecursiveLeastSquares()
    >>> state, _ = rls.update(rls.initial_state(), samples)
    >>> twice = in_flow_unit(state, rls.flow_powers(state), 2.0)
    >>> bool((twice.theta == 2.0 * state.theta).all())
    True
    """
    converted = {name: times(getattr(state, name), power, factor) for name, power in powers.items()}
    return replace(state, **converted)


def times(array: NDArray[Any], power: NDArray[np.int64] | int, factor: float) -> NDArray[Any]:
    """Return an array of the same type, each value times ``factor`` to its power."""
    with np.errstate(all="ignore"):
        return np.asarray(array * np.power(factor, np.asarray(power, np.float64)), array.dtype)


def no_powers(state: State, *names: str) -> dict[str, NDArray[np.int64]]:
    """Return zeros in the shapes of the named arrays, or of all."""
    chosen = names or tuple(f.name for f in fields(state))
    return {name: np.zeros(np.shape(getattr(state, name)), np.int64) for name in chosen}
