"""Valves of one plan in one call: their states are one structure of arrays, written in place.

The plan's valves differ in nothing but their samples and what operators did to them. A batch is
gated, learnt from and scored by one kernel call each, whatever the number of valves; one valve is
a fleet of one. What is handed out (:class:`~valvemap.pipeline.valve_state.Lane`,
:class:`~valvemap.pipeline.valve_state.ValveState`) are copies that later samples do not change.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from valvemap.model.auto import Auto
from valvemap.model.estimator import key_of
from valvemap.model.samples import Floats, Samples, Segments, Times, Trace
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.kernels import lanes as kernel
from valvemap.pipeline.lanes import Lanes, SharedRests
from valvemap.pipeline.ports import EstimatorResults
from valvemap.pipeline.quality_gate import COUNTER_NAMES as OF_GATE
from valvemap.pipeline.quality_gate import GateState
from valvemap.pipeline.shared_support import SharedSupport
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_state import (
    Lane,
    ValvePlan,
    ValveState,
    finds_changes,
    nothing_seen,
)

MISFIT_EVERY_NS = 10_000_000_000  # an estimator's adaptation is asked for: it is slow itself

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
            name: Lanes(estimator, M, SharedRests(self._support, number), plan.accuracy)
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
