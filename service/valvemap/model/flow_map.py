"""`FlowMap`: the map as one Gaussian model, all of whose scales the samples decide."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from valvemap.model import flow_findings, flow_map_looks, flow_parameters
from valvemap.model.change import Change
from valvemap.model.fleet import alone, member, update_one
from valvemap.model.flow_map_state import FlowMapState, Range, axes, empty
from valvemap.model.kernels import (
    flow_drift,
    flow_memory,
    flow_play,
)
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.vocabulary.findings import Finding
from valvemap.vocabulary.statuses import Adaptation, Quality


@dataclass(frozen=True)
class FlowMap:
    """The flow map as a Gaussian field over (U, s), s = sign(Δp)·√|Δp|.

        Q = g(U, s) + b_cell + ε,   g = Σ c_ij·B_i(U)·B_j(s)

    with quadratic B-splines B, second differences of c as a prior, a deviation b ~ N(0, δ²) of each
    cell from the smooth map, and noise ε ~ AR(1) of variance σ². The precisions of the prior, δ²,
    σ² and ρ are estimated by marginal likelihood (:mod:`kernels.flow_fit`); bends along U have a
    Student-t prior, so a dead band or a knee needs no shape of its own.

    Parameters
    ----------
    U_range, dp_range
        Of the valve, % and bar.

    Examples
    --------
    >>> U, dp = np.meshgrid(np.linspace(0, 100, 40), np.linspace(1, 200, 40))
    >>> Q = 0.14 * U.ravel() * np.sqrt(dp.ravel())
    >>> flow_map = FlowMap()
    >>> state, _ = flow_map.update(
    ...     flow_map.initial_state(), Samples.of(np.arange(1600), U.ravel(), dp.ravel(), 0 * Q, Q)
    ... )
    >>> flow_map.predict(state, np.array([50.0]), np.array([100.0]), np.array([40.0]))[0].round(2)
    array([70.])
    """

    fits_in_bursts: ClassVar[bool] = True

    U_range: Range = (0.0, 100.0)
    dp_range: Range = (0.0, 200.0)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Points at which the map is published, then physical quantities."""
        return flow_parameters.NAMES

    def initial_state(self) -> FlowMapState:
        """State before the first sample."""
        return empty(*axes(self.U_range, self.dp_range))

    def update(self, state: FlowMapState, samples: Samples) -> tuple[FlowMapState, Trace]:
        """Learn from N samples, one after another."""
        return update_one(self, state, samples)

    def update_many(self, states: FlowMapState, samples: Samples, segments: Segments) -> Trace:
        """Learn from the samples of many valves; their states are written in place."""
        N = len(samples)
        predicted, residual = np.full((2, N), np.nan)
        trace = Trace(predicted, residual, residual, np.zeros(N, np.uint8))
        batch = flow_memory.Batch(
            t=samples.t,
            U=samples.U,
            dp=samples.dp,
            p1=samples.p1,
            T=samples.T,
            Q=samples.Q,
            usable=samples.quality != Quality.BAD,
            predicted=predicted,
            residual=residual,
            status=trace.status,
        )
        both = axes(self.U_range, self.dp_range)
        with np.errstate(all="ignore"):
            for m, start, stop in zip(*segments, strict=True):
                flow_map_looks.learn(member(states, int(m)), both, batch, int(start), int(stop))
        return trace

    def predict(
        self, state: FlowMapState, U: Floats, dp: Floats, T: Floats
    ) -> tuple[Floats, Floats]:
        """Flow Q̂ (N,) and its standard deviation (N,), l/min."""
        return flow_map_looks.predict(state, axes(self.U_range, self.dp_range), U, dp, T)

    def parameters(self, state: FlowMapState) -> tuple[Floats, Floats]:
        """Flows and physical quantities, see `flow_parameters`, and their standard deviations."""
        return flow_parameters.parameters(state, axes(self.U_range, self.dp_range))

    def parameters_many(self, states: FlowMapState) -> tuple[Floats, Floats]:
        """What ``parameters`` gives valve by valve, both (M, 65)."""
        found = [self.parameters(member(states, m)) for m in range(len(states.counters))]
        Q, std = (
            np.array(x).reshape(len(found), len(flow_parameters.NAMES))
            for x in zip(*found, strict=True)
        )
        return Q, std

    def adaptation(self, state: FlowMapState) -> Adaptation:
        """What the estimator makes of its residuals by now."""
        return Adaptation(int(self.adaptation_many(alone(state))[0]))

    def adaptation_many(self, states: FlowMapState) -> Codes:
        """`adaptation` of M models (M,): drift where it is likelier than not on either side."""
        moving = (states.chance[..., flow_drift.MOVING] > 0.5).any(axis=-1)
        young = states.counters[..., flow_memory.USED] < rules.SETTLED_MAP
        steady = np.where(young, Adaptation.UNDECIDED, Adaptation.STEADY)
        return np.where(moving & ~young, Adaptation.DRIFT, steady).astype(np.uint8)

    def rates(self, state: FlowMapState) -> tuple[Floats, Floats]:
        """Rates of gain (1/h) and edge (%/h), and their standard deviations, (2, 2): by side."""
        return flow_parameters.rates(state)

    def findings(self, state: FlowMapState) -> tuple[Finding, ...]:
        """Causes of what the samples show, the likeliest first."""
        return flow_findings.findings(state, axes(self.U_range, self.dp_range))

    def play(self, state: FlowMapState) -> float:
        """Play between U and the spool, %."""
        return 2.0 * float(state.play[flow_play.HALF])

    @property
    def uses_temperature(self) -> bool:
        """Whether the map may depend on the oil temperature: always."""
        return True

    @property
    def finds_changes(self) -> bool:
        """Whether changes are detected: always."""
        return True

    def change_counts(self, states: FlowMapState) -> Times:
        """How many sudden changes were found of each of M valves."""
        return np.asarray(states.counters[..., flow_memory.CHANGES])

    def last_change(self, state: FlowMapState) -> Change | None:
        """Return the last sudden change of gain or edge, None if there was none."""
        counters = state.counters
        if not counters[flow_memory.CHANGES]:
            return None
        return Change(
            count=int(counters[flow_memory.CHANGES]),
            sample=int(counters[flow_memory.CHANGE_SAMPLE]),
            t=int(counters[flow_memory.CHANGE_TIME]),
            size=float(state.stay[flow_memory.CHANGE_SIZE]),
        )
