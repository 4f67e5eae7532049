"""Baseline: the approved map of a new valve, stored, compared and restored. Pure."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

import numpy as np

from valvemap.model.estimator import State, StateMismatchError
from valvemap.pipeline import kept_lanes, lane_predictions, valve_state
from valvemap.pipeline.valve_state import Lane, ValvePlan
from valvemap.vocabulary.statuses import Status

KEY: Final = "baseline 1"  # version of the storage format
_GRID_U, _GRID_DP = 21, 15  # points at which maps are compared
_DIGITS = 12  # of the hash, in a version's name


@dataclass(frozen=True)
class Baseline:
    """An approved version of the states of a valve's estimators.

    Attributes
    ----------
    number
        Running number of the approval, from 1.
    t
        Source time of the newest sample, UTC ns.
    digest
        SHA-256 of the states, hexadecimal.
    states
        By estimator: its lane as packed by `lane_to_bytes`.
    keys
        By estimator: the hash of its hyper-parameters.
    statuses
        By estimator: its map's status at the approval; empty in records that did not store it.
    """

    number: int
    t: int
    digest: str
    states: Mapping[str, bytes]
    keys: Mapping[str, str]
    statuses: Mapping[str, int] = field(default_factory=dict)

    @property
    def version(self) -> str:
        """Name of the version: its number, and the first digits of its hash."""
        return f"{self.number}-{self.digest[:_DIGITS]}"

    @classmethod
    def none(cls, number: int) -> "Baseline":
        """Return the record of a deleted baseline, after ``number`` approvals."""
        return cls(number, 0, _digest(0, {}, {}), {}, {})

    @classmethod
    def of(
        cls, number: int, t: int, lanes: Mapping[str, Lane], keys: Mapping[str, str]
    ) -> "Baseline":
        """Build it from the present lanes of a valve."""
        states = {name: kept_lanes.lane_to_bytes(lane, keys[name]) for name, lane in lanes.items()}
        statuses = {
            name: int(Status.WARMING_UP if lane.status is None else lane.status)
            for name, lane in lanes.items()
        }
        return cls(number, t, _digest(t, states, statuses), states, dict(keys), statuses)

    def lane(self, name: str, configured: valve_state.AnyEstimator) -> Lane:
        """Return one estimator's approved lane, with the status that it had when approved.

        Where the record has none, the status is OK: the map was approved.

        Raises
        ------
        StateMismatchError
            if it is not in the baseline, or its configuration has changed.
        """
        if name not in self.states:
            raise StateMismatchError(f"{name} was not there")
        lane = kept_lanes.lane_from_bytes(
            self.states[name], configured, None, frozen=False, t=self.t
        )
        return replace(lane, status=Status(self.statuses.get(name, Status.OK)))

    def to_bytes(self) -> bytes:
        """Pack it."""
        names = list(self.states)
        return _Kept(
            number=np.array(self.number),
            t=np.array(self.t),
            digest=np.array(self.digest),
            names=np.array(names),
            keys=np.array([self.keys[name] for name in names]),
            sizes=np.array([len(self.states[name]) for name in names]),
            states=np.frombuffer(b"".join(self.states.values()), np.uint8),
            statuses=np.array([self.statuses[name] for name in names if self.statuses], np.uint8),
        ).to_bytes(KEY)

    @classmethod
    def from_bytes(cls, data: bytes) -> "Baseline":
        """Unpack it.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, or do not match their hash.
        """
        kept = _Kept.from_bytes(data, KEY)
        try:
            ends = np.cumsum(kept.sizes)
            whole = kept.states.tobytes()
            states = {
                str(name): whole[end - size : end]
                for name, size, end in zip(kept.names, kept.sizes, ends, strict=True)
            }
            keys = dict(zip(map(str, kept.names), map(str, kept.keys), strict=True))
            statuses = {}
            if len(kept.statuses):
                said = (int(Status(status)) for status in kept.statuses.tolist())
                statuses = dict(zip(states, said, strict=True))
            number, t = int(kept.number), int(kept.t)
            found = cls(number, t, str(kept.digest), states, keys, statuses)
        except (ValueError, TypeError, OverflowError) as error:
            raise StateMismatchError(f"not a baseline: {error}") from error
        fits = sum(map(len, states.values())) == len(whole) and found.number >= 0
        if not fits or _digest(found.t, states, statuses) != found.digest:
            raise StateMismatchError("the baseline's hash is another")
        return found


@dataclass(frozen=True)
class Difference:
    """Difference of two maps, l/min, over the points that both have measured.

    ``largest`` occurs at ``U`` (%) and ``dp`` (bar); ``points`` of the grid were compared; without
    any, the figures are NaN.
    """

    mean: float
    largest: float
    U: float
    dp: float
    points: int


def difference(plan: ValvePlan, now: Lane, then: Lane, T: float) -> Difference:
    """Return the difference of a map from an earlier one: ``now`` minus ``then``."""
    U, dp = np.meshgrid(
        np.linspace(*plan.U_range, _GRID_U), np.linspace(0.0, max(plan.map_dp), _GRID_DP)
    )
    points = U.ravel(), dp.ravel(), np.full(U.size, T)
    (Q, _, status), (Q_then, _, status_then) = (
        lane_predictions.predicted(lane, *points) for lane in (now, then)
    )
    off = Q - Q_then
    good = np.isfinite(off)
    good &= (status != Status.EXTRAPOLATING) & (status_then != Status.EXTRAPOLATING)
    if not good.any():
        return Difference(np.nan, np.nan, np.nan, np.nan, 0)
    k = int(np.argmax(np.where(good, np.abs(off), -1.0)))
    mean, largest = float(off[good].mean()), float(off[k])
    return Difference(mean, largest, float(points[0][k]), float(points[1][k]), int(good.sum()))


@dataclass(frozen=True)
class _Kept(State):
    state_version: ClassVar[int] = 3  # 2 stored no statuses

    number: Any
    t: Any
    digest: Any
    names: Any
    keys: Any
    sizes: Any
    states: Any
    statuses: Any

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Accept a record without statuses."""
        return {**arrays, "statuses": np.zeros(0, np.uint8)} if version == "2" else {}


def _digest(t: int, states: Mapping[str, bytes], statuses: Mapping[str, int]) -> str:
    hashed = hashlib.sha256(str(t).encode())
    for name, state in sorted(states.items()):
        hashed.update(name.encode())
        hashed.update(state)
    for name, status in sorted(statuses.items()):
        hashed.update(f"{name} {status}".encode())
    return hashed.hexdigest()
