"""The state of an axis as bytes. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvemap.model.axis import SIZE, AxisRegression, AxisState
from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.samples import Floats


@dataclass(frozen=True)
class Learnt:
    """The regression with its play and spool, its sums, and the covariance due to both (n, n)."""

    regression: AxisRegression
    state: AxisState
    of_shape: Floats


@dataclass(frozen=True)
class _Kept(State):
    """What is stored of an axis."""

    period_s: Any
    play_percent: Any
    lag_s: Any
    of_shape: Any
    last: Any
    memory: Any
    filtered: Any
    M: Any
    b: Any
    squares: Any
    counts: Any
    theta: Any
    errors: Any
    score: Any
    scores: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            "period_s": Contents(self.period_s).within(1e-6, 1.0),
            "play_percent": Contents(self.play_percent).within(0.0, 100.0),
            "lag_s": Contents(self.lag_s).within(0.0, 10.0),
            "last": Contents(self.last).any_time(),
            "memory": Contents(self.memory).or_nan(),
        }


def pack(learnt: Learnt, key: str) -> bytes:
    """Return the state as bytes, bound to ``key``."""
    one = learnt.regression
    return _Kept(
        period_s=np.array(one.period_s),
        play_percent=np.array(one.play_percent),
        lag_s=np.array(1.0 / one.spool_hz),
        of_shape=learnt.of_shape,
        **vars(learnt.state),
    ).to_bytes(key)


def unpack(packed: bytes, key: str, regression: AxisRegression) -> Learnt:
    """Return the state that `pack` has packed; ``regression`` has the geometry and the memory.

    Raises
    ------
    StateMismatchError
        if it is damaged, or bound to something else.
    """
    kept = _Kept.from_bytes(packed, key)
    fresh, zero = vars(regression.initial_state()), np.array(0.0)
    kept.check(_Kept(zero, zero, zero, np.zeros((SIZE, SIZE)), **fresh))
    lag_s = float(kept.lag_s)
    found = replace(
        regression,
        period_s=float(kept.period_s),
        play_percent=float(kept.play_percent),
        spool_hz=1.0 / lag_s if lag_s > 0.0 else np.inf,
    )
    state = AxisState(**{name: getattr(kept, name) for name in fresh})
    return Learnt(found, state, kept.of_shape)
