"""Valves of one plan in one call: their states are one structure of arrays, written in place.

The plan's valves differ in nothing but their samples and what operators did to them. A batch is
gated, learnt from and scored by one kernel call each, whatever the number of valves; one valve is
a fleet of one. What is handed out (:class:`~service.streaming.pipeline.Lane`,
:class:`~service.streaming.pipeline.ValveState`) are copies that later samples do not change.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.identification.auto import Auto
from service.identification.change import Change, FindsChanges
from service.identification.estimator import State, key_of
from service.identification.extrapolation import U_range_of
from service.identification.fleet import ManyModels, copied, member, members, repeated, stack
from service.identification.residual_spread import ResidualSpread, noise_std
from service.identification.samples import (
    Codes,
    Floats,
    Quality,
    Samples,
    Segments,
    Status,
    Times,
    Trace,
)
from service.identification.sensor_accuracy import SensorAccuracy
from service.identification.support import Support
from service.streaming.alarms import Alarms
from service.streaming.kernels import lanes as kernel
from service.streaming.kernels import score as score_kernel
from service.streaming.kernels.lanes import NO_STATUS
from service.streaming.pipeline import (
    AnyEstimator,
    Lane,
    ValvePlan,
    ValveState,
    finds_changes,
    nothing_seen,
    with_forgetting,
)
from service.streaming.ports import EstimatorResults
from service.streaming.quality_gate import COUNTER_NAMES as OF_GATE
from service.streaming.quality_gate import GateState
from service.streaming.score import Score, recent_rmse
from service.streaming.shared_support import SharedSupport
from service.streaming.valve_columns import Columns

ABOUT_CLOSED = 5.0  # %: a sensor may read that much beside the range
MISFIT_EVERY_NS = 10_000_000_000  # an estimator's adaptation is asked for: it is slow itself

CHANGE = np.dtype([("count", np.int64), ("t", np.int64), ("size", np.float64)])  # see `Change`
COUNTER_NAMES = (*OF_GATE, "beyond_range", "too_fast_for_lag")


class Fleet:
    """M valves that share a plan.

    Parameters
    ----------
    plan
        Gate and estimators of each.
    M
        How many.
    """

    def __init__(self, plan: ValvePlan, M: int) -> None:
        self.plan = plan
        self._key = f"valve {key_of(plan.gate)}"
        self._gate = plan.gate.initial_state(M)
        self._support = SharedSupport(nothing_seen(plan), len(plan.estimators), M)
        self._lanes = {
            name: _Lanes(estimator, M, _Rests(self._support, number), plan.accuracy)
            for number, (name, estimator) in enumerate(plan.estimators.items())
        }
        self._t = np.zeros(M, np.int64)
        self._T = np.full(M, np.nan)
        self._demand = np.full((M, 2), np.nan)  # Q, dp
        self.alarms = Alarms(M, plan.alarms, max(plan.map_Q) - min(plan.map_Q))
        names = [plan.inverse, *plan.estimators]
        self._finder = next((n for n in names if finds_changes(plan.estimators[n])), None)
        self._laggard = next((n for n in names if isinstance(plan.estimators[n], Auto)), None)
        self._misfit_due = np.zeros(M, np.int64)

    def take(self, samples: Samples, segments: Segments) -> tuple[Samples, Mapping[str, Trace]]:
        """Take samples in; return them as the gate judged them, and what every estimator said.

        ``segments`` says which are whose, in the fleet's own numbers; none may be empty.
        """
        judged = self.plan.gate.judge(self._gate, samples, segments)
        traces, rests = {}, []
        for name, lanes in self._lanes.items():
            traces[name], own = lanes.take(judged, segments)
            rests.append((traces[name].status, own))
        self._support.learn(judged, rests, segments)
        self._t[segments.members] = samples.t[segments.stops - 1]
        kernel.last_T(judged.T, judged.quality, self._T, segments)
        self.alarms.watch(judged, traces[self.plan.inverse], segments)
        self._note(segments.members)
        return judged, traces

    def _note(self, chosen: Times) -> None:
        """Take up for the alarms what estimators found in the last samples."""
        if self._finder is not None:
            found = self._lanes[self._finder].newest_changes(chosen)
            self.alarms.note_changes(chosen, found["count"], found["t"], found["size"])
        if self._laggard is not None:
            self.alarms.note_lags(chosen, self._lanes[self._laggard].largest_lags(chosen))
        due = chosen[self._t[chosen] >= self._misfit_due[chosen]]
        if len(due):
            self._misfit_due[due] = self._t[due] + MISFIT_EVERY_NS
            lanes = self._lanes[self.plan.inverse]
            self.alarms.note_misfit(due, lanes.adaptations(due), lanes.recent_rmse(due))

    def lane(self, m: int, name: str) -> Lane:
        """One estimator of one valve as it stands."""
        return self._lanes[name].get(m)

    def put(self, m: int, name: str, lane: Lane) -> None:
        """Have it stand otherwise; its estimator is the plan's, but for ``lam``."""
        self._lanes[name].put(m, lane)

    def state(self, m: int, names: Iterable[str] | None = None) -> ValveState:
        """One valve as it stands, with all its estimators or with those named."""
        one = slice(m, m + 1)
        return ValveState(
            gate=self._gate.of(one),
            lanes={name: self.lane(m, name) for name in names or self._lanes},
            t=int(self._t[m]),
            T=float(self._T[m]),
            demand_Q=float(self._demand[m, 0]),
            demand_dp=float(self._demand[m, 1]),
        )

    def remember(self, m: int, gate: GateState, t: int, T: float) -> None:
        """Have the gate of one valve, and its last time and temperature, stand so."""
        self._gate.put(m, gate)
        self._t[m], self._T[m] = t, T

    def beyond(self, m: int) -> Mapping[str, int]:
        """Samples of one valve that an estimator could not describe."""
        return {name: int(lanes.beyond[m]) for name, lanes in self._lanes.items()}

    def count_beyond(self, m: int, name: str, count: int) -> None:
        """Have it be so many."""
        self._lanes[name].beyond[m] = count

    def results(self, chosen: Times) -> Mapping[str, EstimatorResults]:
        """What is published of the estimators of some valves; surveys are made elsewhere."""
        return {name: lanes.results(chosen) for name, lanes in self._lanes.items()}

    def demands(self, chosen: Times) -> Floats:
        """Flow and pressure drop demanded of some valves (M, 2); NaN where none is."""
        return np.asarray(self._demand[chosen])

    def last_T(self, m: int) -> float:
        """The last temperature measured at one valve, °C."""
        return float(self._T[m])

    def demand(self, m: int, Q: float, dp: float) -> None:
        """Set the standing demand of one valve."""
        self._demand[m] = Q, dp

    def columns(self, valves: Sequence[str]) -> list[Columns]:
        """All that the valves, whose names are given, remember; written to, it is to be taken up.

        What is kept as an array with a row for each valve is that array, the rest are copies.
        """
        gate = {f"gate_{name}": array for name, array in self._gate.memory._asdict().items()}
        own = {"bad_status": self._gate.bad_status, "t": self._t, "T": self._T}
        names = tuple(valves)
        return [
            Columns(self._key, names, {**gate, **own, "demand": self._demand}),
            Columns("alarms", names, {**self.alarms.columns(), "misfit_due": self._misfit_due}),
            *(lanes.columns(name, names) for name, lanes in self._lanes.items()),
        ]

    def take_up(self, written: Sequence[Columns]) -> None:
        """Somebody has written to what `columns` gave."""
        _, _, *of_lanes = written
        for lanes, columns in zip(self._lanes.values(), of_lanes, strict=True):
            lanes.take_up(columns.arrays)

    def rejections(self) -> Times:
        """What was not learnt from since the start, (M, reasons): by the gate, by any estimator."""
        beyond = np.max([lanes.beyond for lanes in self._lanes.values()], axis=0)
        too_fast = np.max([lanes.too_fast() for lanes in self._lanes.values()], axis=0)
        return np.column_stack((self._gate.counts(), beyond, too_fast))


class _Lanes:
    """One estimator on M valves."""

    def __init__(
        self, estimator: AnyEstimator, M: int, rests: "_Rests", accuracy: SensorAccuracy
    ) -> None:
        self._estimator = estimator
        self._states = _states_of(estimator, M)
        self._scores = np.tile(Score.none().sums, (M, 1))
        self._spread = ResidualSpread.none().of_many(M)
        self._rests = rests
        self._accuracy = accuracy
        self._key = key_of(_LaneKey(key_of(estimator), accuracy))
        self.beyond = np.zeros(M, np.int64)  # samples whose U the estimator cannot describe
        self._frozen = np.zeros(M, bool)
        self._lam = np.full(M, np.nan)  # what an operator set
        self._notes = kernel.nothing(M)

    def take(self, samples: Samples, segments: Segments) -> tuple[Trace, Segments]:
        """Learn; what was made of samples, and on which of them the maps rest."""
        beyond, began = self._beyond_range(samples, segments), self._states.began()
        if beyond is None:
            trace = self._learn(samples, segments)
        else:
            quality = np.where(beyond, np.uint8(Quality.BAD), samples.quality)
            trace = self._learn(replace(samples, quality=quality), segments)
            trace.status[beyond] = Status.EXTRAPOLATING
        score_kernel.accumulate(trace.residual, samples.Q, self._scores, segments)
        self._spread.learn(samples, trace, segments)
        kernel.note(samples.t, trace.predicted, trace.residual, trace.status, self._notes, segments)
        return trace, self._of_this_map(began, trace.status, segments)

    def columns(self, name: str, valves: tuple[str, ...]) -> Columns:
        spread = self._spread
        return Columns(
            f"{name} {self._key}",
            valves,
            {
                **{f"state_{n}": array for n, array in self._states.columns().items()},
                **{f"note_{n}": array for n, array in self._notes._asdict().items()},
                "scores": self._scores,
                "cells": spread.cells,
                "stamps": spread.stamps,
                "ages": spread.ages,
                "overall": spread.overall,
                **self._rests.columns(),
                "beyond": self.beyond,
                "frozen": self._frozen,
                "lam": self._lam,
            },
        )

    def take_up(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self._states.take_up({n[6:]: a for n, a in arrays.items() if n.startswith("state_")})
        self._rests.take_up(arrays)

    def changes(self, chosen: Times) -> Sequence[Change | None]:
        """The newest change of some valves that was found."""
        return self._states.changes(chosen)

    def newest_changes(self, chosen: Times) -> NDArray[Any]:
        """The same as a table, see `CHANGE` (K,); all 0 where none was found."""
        return self._states.newest_changes(chosen)

    def largest_lags(self, chosen: Times) -> Floats:
        """The larger of the two lags that were found at some valves, s."""
        return self._states.largest_lags(chosen)

    def adaptations(self, chosen: Times) -> Codes:
        """What the estimator makes of its residuals at some valves."""
        return self._states.adaptations(chosen)

    def recent_rmse(self, chosen: Times) -> Floats:
        """Root mean square of the last residuals of some valves, l/min."""
        return recent_rmse(self._scores[chosen])

    def too_fast(self) -> Times:
        """How many samples moved too fast for the lags of their signals (M,)."""
        return self._states.too_fast(len(self.beyond))

    def _beyond_range(self, samples: Samples, segments: Segments) -> NDArray[np.bool_] | None:
        """Which samples have a U that the estimator cannot describe (N,); they are counted."""
        low, high = U_range_of(self._estimator)
        beyond = (low - ABOUT_CLOSED > samples.U) | (high + ABOUT_CLOSED < samples.U)
        beyond &= samples.quality != Quality.BAD
        if not beyond.any():
            return None
        for m, start, stop in zip(*segments, strict=True):
            self.beyond[m] += beyond[start:stop].sum()
        return beyond

    def _of_this_map(self, before: Times, status: Codes, segments: Segments) -> Segments:
        """From where on the samples are those that the maps rest on; ``before``: `began` then.

        Where a map began anew meanwhile, the places of the one before are forgotten.
        """
        anew = np.flatnonzero((self._states.began() != before)[segments.members])
        if not len(anew):
            return segments
        starts, since = segments.starts.copy(), self._states.samples_since()
        for k in anew:
            m, stop = segments.members[k], segments.stops[k]
            learnt = starts[k] + np.flatnonzero(status[starts[k] : stop] <= Status.UNEXCITED)
            starts[k] = [*learnt, stop][len(learnt) - since[m]]
            self._rests.put(int(m), self._rests.one(int(m)).forgotten())
        return Segments(segments.members, starts, segments.stops)

    def _learn(self, samples: Samples, segments: Segments) -> Trace:
        own_way = self._frozen[segments.members] | np.isfinite(self._lam[segments.members])
        trace = self._states.update(samples, segments.of(~own_way))
        for m, start, stop in zip(*segments.of(own_way), strict=True):
            rows = slice(start, stop)
            said = self._take_own_way(int(m), samples[rows])
            for f in fields(Trace):
                getattr(trace, f.name)[rows] = getattr(said, f.name)
        return trace

    def get(self, m: int) -> Lane:
        count, t, predicted, residual, status = (array[m] for array in self._notes)
        lane = Lane(
            estimator=self._estimator,
            state=self._states.get(m),
            score=Score(self._scores[m].copy()),
            spread=self._spread.one(m),
            support=self._rests.one(m),
            accuracy=self._accuracy,
            frozen=bool(self._frozen[m]),
            count=int(count),
            t=int(t),
            predicted=float(predicted),
            residual=float(residual),
            status=None if status == NO_STATUS else Status(int(status)),
        )
        lam = float(self._lam[m])
        return lane if np.isnan(lam) else with_forgetting(lane, lam)

    def results(self, chosen: Times) -> EstimatorResults:
        notes, said = self._notes, self._notes.status[chosen]
        theta, std = self._states.parameters(chosen)
        status = np.where(said == NO_STATUS, Status.WARMING_UP, said).astype(np.uint8)
        return EstimatorResults(
            t=notes.t[chosen],
            quality=_QUALITY[status],
            theta=theta,
            std=std,
            predicted=notes.predicted[chosen],
            residual=notes.residual[chosen],
            residual_rmse=recent_rmse(self._scores[chosen]),
            sample_count=notes.learnt[chosen],
            status=status,
            noise_std=noise_std(self._spread.overall[chosen]),
            survey=[None] * len(chosen),
            change=self._states.changes(chosen),
            structure=self._states.structures(chosen),
            lags=self._states.lags(chosen),
            adaptation=self._states.adaptations(chosen),
            systematic_std=np.full(len(chosen), np.nan),
        )

    def put(self, m: int, lane: Lane) -> None:
        self._states.put(m, lane.state)
        self._scores[m] = lane.score.sums
        self._spread.put(m, lane.spread)
        self._rests.put(m, lane.support)
        self._frozen[m] = lane.frozen
        self._lam[m] = np.nan if lane.lam is None else lane.lam
        status = NO_STATUS if lane.status is None else int(lane.status)
        notes = self._notes
        notes.learnt[m], notes.t[m], notes.status[m] = lane.count, lane.t, status
        notes.predicted[m], notes.residual[m] = lane.predicted, lane.residual

    def _take_own_way(self, m: int, samples: Samples) -> Trace:
        lane = self.get(m)
        if lane.frozen:
            return _prediction_only(lane, samples)
        state, trace = lane.estimator.update(lane.state, samples)
        self._states.put(m, state)
        return trace


@dataclass(frozen=True)
class _Rests:
    """What one estimator's maps rest on: its part of what all share."""

    shared: SharedSupport
    number: int

    def one(self, m: int) -> Support:
        return self.shared.one(self.number, m)

    def put(self, m: int, support: Support) -> None:
        self.shared.put(self.number, m, support)

    def columns(self) -> Mapping[str, NDArray[Any]]:
        return self.shared.columns(self.number)

    def take_up(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        self.shared.take_up(self.number, arrays)


@dataclass(frozen=True)
class _LaneKey:
    """What a lane's memory belongs to."""

    estimator: str
    accuracy: SensorAccuracy


def _states_of(estimator: AnyEstimator, M: int) -> "_Stacked | _Listed":
    return _Stacked(estimator, M) if isinstance(estimator, ManyModels) else _Listed(estimator, M)


class _Stacked:
    """As a structure of arrays, for an estimator that takes many models at once."""

    def __init__(self, estimator: ManyModels[Any], M: int) -> None:
        self._estimator = estimator
        self._all = repeated(estimator.initial_state(), M)
        self._changes: list[Change | None] = [None] * M
        self._newest_changes = np.zeros(M, CHANGE)
        self._changed = np.zeros(M, np.int64)  # how often, when `_changes` was made; -1: unknown

    def update(self, samples: Samples, segments: Segments) -> Trace:
        return self._estimator.update_many(self._all, samples, segments)

    def get(self, m: int) -> State:
        one: State = copied(member(self._all, m))
        return one

    def parameters(self, chosen: Times) -> tuple[Floats, Floats]:
        return self._estimator.parameters_many(members(self._all, chosen))

    def changes(self, chosen: Times) -> Sequence[Change | None]:
        self._look_for_changes(chosen)
        return [self._changes[m] for m in chosen]

    def newest_changes(self, chosen: Times) -> NDArray[Any]:
        self._look_for_changes(chosen)
        return self._newest_changes[chosen]

    def _look_for_changes(self, chosen: Times) -> None:
        if not isinstance(self._estimator, FindsChanges):
            return
        counts = self._estimator.change_counts(self._all)[chosen]
        for m in chosen[counts != self._changed[chosen]]:
            self._changes[m] = found = self._estimator.last_change(member(self._all, m))
            self._newest_changes[m] = (found.count, found.t, found.size) if found else 0
        self._changed[chosen] = counts

    def structures(self, chosen: Times) -> Sequence[str | None]:
        if isinstance(self._estimator, Auto):
            return self._estimator.describe_many(self._all, chosen)
        return [None] * len(chosen)

    def lags(self, chosen: Times) -> Sequence[tuple[float, float] | None]:
        if isinstance(self._estimator, Auto):
            return self._estimator.lags_many(self._all, chosen)
        return [None] * len(chosen)

    def largest_lags(self, chosen: Times) -> Floats:
        if isinstance(self._estimator, Auto):
            return self._estimator.largest_lags(self._all)[chosen]
        return np.full(len(chosen), np.nan)

    def adaptations(self, chosen: Times) -> Codes:
        return self._estimator.adaptation_many(members(self._all, chosen))

    def too_fast(self, M: int) -> Times:
        if isinstance(self._estimator, Auto):
            return self._estimator.too_fast(self._all)
        return np.zeros(M, np.int64)

    def began(self) -> Times:
        """After how many samples each map began anew (M,)."""
        if isinstance(self._estimator, Auto):
            return self._estimator.began(self._all)
        return np.zeros_like(self._changed)

    def samples_since(self) -> Times:
        """How many samples each map rests on, of those that may begin anew (M,)."""
        if isinstance(self._estimator, Auto):
            return self._estimator.samples_since(self._all)
        return np.zeros_like(self._changed)

    def columns(self) -> Mapping[str, NDArray[Any]]:
        return {f.name: getattr(self._all, f.name) for f in fields(self._all)}

    def take_up(self, _written: Mapping[str, NDArray[Any]]) -> None:
        self._changed[:] = -1

    def put(self, m: int, state: State) -> None:
        self._changed[m] = -1
        for f in fields(state):
            getattr(self._all, f.name)[m] = getattr(state, f.name)


class _Listed:
    """One by one, for an estimator with much to do and to remember at each."""

    def __init__(self, estimator: AnyEstimator, M: int) -> None:
        self._estimator = estimator
        self._all: list[State] = [estimator.initial_state()] * M

    def update(self, samples: Samples, segments: Segments) -> Trace:
        N = len(samples)
        predicted, residual, early = np.empty((3, N))
        trace = Trace(predicted, residual, early, np.empty(N, np.uint8))
        for m, start, stop in zip(*segments, strict=True):
            rows = slice(start, stop)
            self._all[m], said = self._estimator.update(self._all[m], samples[rows])
            for f in fields(Trace):
                getattr(trace, f.name)[rows] = getattr(said, f.name)
        return trace

    def get(self, m: int) -> State:
        return self._all[m]

    def parameters(self, chosen: Times) -> tuple[Floats, Floats]:
        found = [self._estimator.parameters(self._all[m]) for m in chosen]
        theta, std = zip(*found, strict=True)
        return np.stack(theta), np.stack(std)

    def changes(self, chosen: Times) -> Sequence[Change | None]:
        return [None] * len(chosen)

    def newest_changes(self, chosen: Times) -> NDArray[Any]:
        return np.zeros(len(chosen), CHANGE)

    def structures(self, chosen: Times) -> Sequence[str | None]:
        return [None] * len(chosen)

    def lags(self, chosen: Times) -> Sequence[tuple[float, float] | None]:
        return [None] * len(chosen)

    def largest_lags(self, chosen: Times) -> Floats:
        return np.full(len(chosen), np.nan)

    def adaptations(self, chosen: Times) -> Codes:
        return np.array([self._estimator.adaptation(self._all[m]) for m in chosen], np.uint8)

    def too_fast(self, M: int) -> Times:
        return np.zeros(M, np.int64)

    def began(self) -> Times:
        return np.zeros(len(self._all), np.int64)

    def samples_since(self) -> Times:
        return np.zeros(len(self._all), np.int64)

    def columns(self) -> Mapping[str, NDArray[Any]]:
        stacked = stack(self._all)
        return {f.name: getattr(stacked, f.name) for f in fields(stacked)}

    def take_up(self, written: Mapping[str, NDArray[Any]]) -> None:
        stacked = type(self._all[0])(**written)
        self._all = [copied(member(stacked, m)) for m in range(len(self._all))]

    def put(self, m: int, state: State) -> None:
        self._all[m] = state


_QUALITY = np.zeros(max(Status) + 1, np.uint8)
for _status, _quality in {
    Status.OK: Quality.GOOD,
    Status.FROZEN: Quality.GOOD,
    Status.WARMING_UP: Quality.UNCERTAIN,
    Status.UNEXCITED: Quality.UNCERTAIN,
    Status.HELD: Quality.UNCERTAIN,
    Status.EXTRAPOLATING: Quality.UNCERTAIN,
    Status.REJECTED: Quality.BAD,
}.items():
    _QUALITY[_status] = _quality


def _prediction_only(lane: Lane, samples: Samples) -> Trace:
    Q_hat: Floats
    Q_hat, _ = lane.estimator.predict(lane.state, samples.U, samples.dp, samples.T)
    usable = samples.quality != Quality.BAD
    Q_hat = np.where(usable, Q_hat, np.nan)
    residual = samples.Q - Q_hat
    return Trace(
        predicted=Q_hat,
        residual=residual,
        early=residual,
        status=np.where(usable, Status.FROZEN, Status.REJECTED).astype(np.uint8),
    )
