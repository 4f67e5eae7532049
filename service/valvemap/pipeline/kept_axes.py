"""The state of an axis as bytes. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final

import numpy as np

from valvemap.model import drift_states
from valvemap.model.axis import AxisRegression, AxisState
from valvemap.model.axis_basis import SIZE
from valvemap.model.axis_fit import DELAY_SIZE, FORCE_SIZE
from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.samples import Floats

LEARNT, SEARCHES, WATCH, ALARMS = "Axis", "AxisSearches", "AxisWatch", "AxisAlarms"
"""Names of the stored parts."""
NEWER: Final = FORCE_SIZE, FORCE_SIZE, DELAY_SIZE, DELAY_SIZE
"""Prior sizes of the last columns, which states of earlier versions lack: `axis_rows.FORCE` on."""


@dataclass(frozen=True)
class Learnt:
    """The regression with its play and spool, its sums, and the covariance due to both (n, n)."""

    regression: AxisRegression
    state: AxisState
    of_shape: Floats


@dataclass(frozen=True)
class KeptShape(State):
    """The stored form of a regression: its period, play, spool, and the covariance due to both."""

    period_s: Any
    play_percent: Any
    lag_s: Any
    of_shape: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            "period_s": Contents(self.period_s).within(1e-6, 1.0),
            "play_percent": Contents(self.play_percent).within(0.0, 100.0),
            "lag_s": Contents(self.lag_s).within(0.0, 10.0),
        }

    def of(self, geometry: AxisRegression) -> AxisRegression:
        """Return the regression with the geometry and the memory of another one."""
        lag_s = float(self.lag_s)
        return replace(
            geometry,
            period_s=float(self.period_s),
            play_percent=float(self.play_percent),
            spool_hz=1.0 / lag_s if lag_s > 0.0 else np.inf,
        )


def shape_of(one: AxisRegression) -> dict[str, Any]:
    """Return the numbers of a regression as `KeptShape` has them."""
    return {
        "period_s": np.array(one.period_s),
        "play_percent": np.array(one.play_percent),
        "lag_s": np.array(1.0 / one.spool_hz),
    }


def with_newer_columns(arrays: dict[str, Any]) -> dict[str, Any]:
    """Return arrays with the columns, 0, which the version that stored them did not have.

    >>> with_newer_columns({"theta": np.ones(SIZE - 2), "U": np.ones(3)})["theta"][-3:].tolist()
    [1.0, 0.0, 0.0]
    """
    before, found = np.size(arrays["theta"]), dict(arrays)
    added = SIZE - before
    if not 0 <= added <= len(NEWER):
        return {}
    for name in ("M", "scores", "of_shape", "precision", "b", "theta", "score"):
        if name in arrays and set(np.shape(arrays[name])) == {before}:
            found[name] = np.pad(arrays[name], (0, added))
    if "filtered" in arrays:
        found["filtered"] = np.insert(arrays["filtered"], [before] * added, 0.0, axis=-1)
    return found


@dataclass(frozen=True)
class _Kept(KeptShape):
    """The stored form of an axis."""

    state_version: ClassVar[int] = 6  # 5: no delays; 4: no force; 3: offsets did not jump; 2: none

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Add the sensors' offsets, and the columns of the force and of the delays."""
        if version == "2":
            drift_states.upgrade(arrays, "drift_")
        elif version == "3":
            drift_states.add_jumps_of_offsets(arrays, "drift_")
        return with_newer_columns(arrays) if version in ("2", "3", "4", "5") else {}

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
    drift_x: Any
    drift_P: Any
    drift_chance: Any
    drift_now: Any
    stay: Any
    stay_end: Any
    stay_noise: Any
    known: Any

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {
            **super().contents(),
            "last": Contents(self.last).any_time(),
            "memory": Contents(self.memory).or_nan(),
            "drift_chance": Contents(self.drift_chance).within(0.0, 1.0),
            "stay_end": Contents(self.stay_end).any_time(),
            "stay_noise": Contents(self.stay_noise).within(0.0),
        }


def pack(learnt: Learnt, key: str) -> bytes:
    """Return the state as bytes, bound to ``key``."""
    return _Kept(
        **shape_of(learnt.regression),
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
    state = AxisState(**{name: getattr(kept, name) for name in fresh})
    return Learnt(kept.of(regression), state, kept.of_shape)
