"""The states of one estimator on M valves: stacked as arrays where possible, else a list."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.capabilities import Censors, ChoosesStructure, FindsChanges, FindsLags, Restarts
from valvemap.model.change import Change
from valvemap.model.estimator import State
from valvemap.model.fleet import ManyModels, copied, copied_member, member, members, repeated, stack
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.pipeline.lane_failures import CopyBuffer, Restore, saved
from valvemap.pipeline.valve_state import AnyEstimator

CHANGE = np.dtype([("count", np.int64), ("t", np.int64), ("size", np.float64)])  # see `Change`


def states_of(estimator: AnyEstimator, M: int) -> "Stacked | Listed":
    """Return M initial states in the container that the estimator supports."""
    return Stacked(estimator, M) if isinstance(estimator, ManyModels) else Listed(estimator, M)


class Stacked:
    """A structure of arrays, for an estimator that updates many models at once."""

    def __init__(self, estimator: ManyModels[Any], M: int) -> None:
        self._estimator = estimator
        self._finder = estimator if isinstance(estimator, FindsChanges) else None
        self._chooser = estimator if isinstance(estimator, ChoosesStructure) else None
        self._laggard = estimator if isinstance(estimator, FindsLags) else None
        self._censor = estimator if isinstance(estimator, Censors) else None
        self._restarting = estimator if isinstance(estimator, Restarts) else None
        self._all = repeated(estimator.initial_state(), M)
        self._arrays = tuple(self.columns().values())
        self._changes: list[Change | None] = [None] * M
        self._newest_changes = np.zeros(M, CHANGE)
        self._changed = np.zeros(M, np.int64)  # change counts behind `_changes`; -1: unknown

    def update(self, samples: Samples, segments: Segments) -> Trace:
        """Update each segment's valve with its samples; return the trace."""
        return self._estimator.update_many(self._all, samples, segments)

    def get(self, m: int) -> State:
        """Return a copy of the state of valve ``m``."""
        one: State = copied_member(self._all, m)
        return one

    def view(self, m: int) -> State:
        """Return the state of valve ``m``, not copied."""
        one: State = member(self._all, m)
        return one

    def parameters(self, chosen: Times) -> tuple[Floats, Floats]:
        """Return ``theta`` and its standard deviation of the given valves (K, n)."""
        return self._estimator.parameters_many(members(self._all, chosen))

    def changes(self, chosen: Times) -> Sequence[Change | None]:
        """Return the newest detected change of each given valve."""
        self._look_for_changes(chosen)
        return [self._changes[m] for m in chosen]

    def newest_changes(self, chosen: Times) -> NDArray[Any]:
        """Return the newest changes as a `CHANGE` table (K,); zeros if none was detected."""
        self._look_for_changes(chosen)
        return self._newest_changes[chosen]

    def _look_for_changes(self, chosen: Times) -> None:
        if self._finder is None:
            return
        counts = self._finder.change_counts(self._all)[chosen]
        for m in chosen[counts != self._changed[chosen]]:
            self._changes[m] = found = self._finder.last_change(member(self._all, m))
            self._newest_changes[m] = (found.count, found.t, found.size) if found else 0
        self._changed[chosen] = counts

    def structures(self, chosen: Times) -> Sequence[str | None]:
        """Return the structures chosen for the given valves; None if the estimator has one only."""
        if self._chooser is not None:
            return self._chooser.describe_many(self._all, chosen)
        return [None] * len(chosen)

    def lags(self, chosen: Times) -> Sequence[tuple[float, float] | None]:
        """Return the lags of U and Q of the given valves, s; None if not estimated."""
        if self._laggard is not None:
            return self._laggard.lags_many(self._all, chosen)
        return [None] * len(chosen)

    def largest_lags(self, chosen: Times) -> Floats:
        """Return the largest lag or dead time, s; NaN if not estimated (K,)."""
        if self._laggard is not None:
            return self._laggard.largest_lags(self._all)[chosen]
        return np.full(len(chosen), np.nan)

    def adaptations(self, chosen: Times) -> Codes:
        """Return the diagnosis of the residuals of the given valves (K,)."""
        return self._estimator.adaptation_many(members(self._all, chosen))

    def censored(self, chosen: Times) -> Times:
        """Number of samples not learnt as the meter does not show their flow (K,)."""
        if self._censor is not None:
            return self._censor.censored(self._all)[chosen]
        return np.zeros(len(chosen), np.int64)

    def began(self) -> Times:
        """Sample count at the last restart of each map (M,)."""
        if self._restarting is not None:
            return self._restarting.began(self._all)
        return np.zeros_like(self._changed)

    def samples_since(self) -> Times:
        """Number of samples since the last restart of each map (M,); 0 if maps never restart."""
        if self._restarting is not None:
            return self._restarting.samples_since(self._all)
        return np.zeros_like(self._changed)

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return all states as named arrays, the first axis over valves."""
        return {f.name: getattr(self._all, f.name) for f in fields(self._all)}

    def take_up(self, _written: Mapping[str, NDArray[Any]]) -> None:
        """Note that the arrays of `columns` were written to."""
        self._changed[:] = -1

    def saved(self, members: Times, buffer: CopyBuffer) -> Restore:
        """Copy the states of the given valves; the result writes the copies back."""
        restore = saved(self._arrays, members, buffer)

        def restore_all() -> None:
            restore()
            self._changed[members] = -1

        return restore_all

    def put(self, m: int, state: State) -> None:
        """Replace the state of valve ``m``."""
        self._changed[m] = -1
        for f in fields(state):
            getattr(self._all, f.name)[m] = getattr(state, f.name)


class Listed:
    """A list of states, for an estimator that updates one model at a time."""

    def __init__(self, estimator: AnyEstimator, M: int) -> None:
        self._estimator = estimator
        self._all: list[State] = [estimator.initial_state()] * M

    def update(self, samples: Samples, segments: Segments) -> Trace:
        """Update each segment's valve with its samples; return the trace."""
        N = len(samples)
        predicted, residual, early = np.empty((3, N))
        trace = Trace(predicted, residual, early, np.empty(N, np.uint8))
        for m, start, stop in zip(*segments, strict=True):
            rows = slice(start, stop)
            self._all[m], said = self._estimator.update(self._all[m], samples[rows])
            trace.put(rows, said)
        return trace

    def get(self, m: int) -> State:
        """Return the state of valve ``m``; updates replace it by a new one."""
        return self._all[m]

    view = get

    def parameters(self, chosen: Times) -> tuple[Floats, Floats]:
        """Return ``theta`` and its standard deviation of the given valves (K, n)."""
        found = [self._estimator.parameters(self._all[m]) for m in chosen]
        theta, std = zip(*found, strict=True)
        return np.stack(theta), np.stack(std)

    def changes(self, chosen: Times) -> Sequence[Change | None]:
        """Return None for each given valve: no changes are detected."""
        return [None] * len(chosen)

    def newest_changes(self, chosen: Times) -> NDArray[Any]:
        """Return a `CHANGE` table (K,) of zeros."""
        return np.zeros(len(chosen), CHANGE)

    def structures(self, chosen: Times) -> Sequence[str | None]:
        """Return None for each given valve: the structure is fixed."""
        return [None] * len(chosen)

    def lags(self, chosen: Times) -> Sequence[tuple[float, float] | None]:
        """Return None for each given valve: lags are not estimated."""
        return [None] * len(chosen)

    def largest_lags(self, chosen: Times) -> Floats:
        """Return NaN for each given valve (K,): lags are not estimated."""
        return np.full(len(chosen), np.nan)

    def adaptations(self, chosen: Times) -> Codes:
        """Return the diagnosis of the residuals of the given valves (K,)."""
        return np.array([self._estimator.adaptation(self._all[m]) for m in chosen], np.uint8)

    def censored(self, chosen: Times) -> Times:
        """Return zeros (K,)."""
        return np.zeros(len(chosen), np.int64)

    def began(self) -> Times:
        """Return zeros (M,)."""
        return np.zeros(len(self._all), np.int64)

    def samples_since(self) -> Times:
        """Return zeros (M,)."""
        return np.zeros(len(self._all), np.int64)

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return all states as named arrays, the first axis over valves."""
        stacked = stack(self._all)
        return {f.name: getattr(stacked, f.name) for f in fields(stacked)}

    def take_up(self, written: Mapping[str, NDArray[Any]]) -> None:
        """Replace all states by the written arrays of `columns`."""
        stacked = type(self._all[0])(**written)
        self._all = [copied(member(stacked, m)) for m in range(len(self._all))]

    def saved(self, members: Times, _: CopyBuffer) -> Restore:
        """Copy the states of the given valves; the result writes the copies back."""
        states = {m: self._all[m] for m in members.tolist()}

        def restore() -> None:
            for m, state in states.items():
                self._all[m] = state

        return restore

    def put(self, m: int, state: State) -> None:
        """Replace the state of valve ``m``."""
        self._all[m] = state
