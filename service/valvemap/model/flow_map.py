"""`FlowMap`: the map as one Gaussian model, all of whose scales the samples decide."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import numpy as np

from valvemap.model import (
    drift_states,
    flow_findings,
    flow_map_looks,
    flow_parameters,
    flow_pieces,
    flow_words,
)
from valvemap.model.change import Change
from valvemap.model.fleet import alone, member, update_one
from valvemap.model.flow_map_state import FlowMapState, Range, axes, empty
from valvemap.model.forgetting import check_lam, lam_of_memory
from valvemap.model.kernels import (
    flow_fit,
    flow_memory,
    flow_path,
    flow_play,
    flow_wear,
)
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.map_forms import MapForm
from valvemap.model.model_structures import FiveTerms, Structure
from valvemap.model.portable_flow_map import GaussianMap
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.vocabulary.findings import Finding
from valvemap.vocabulary.statuses import Adaptation, Quality

LEAST_LAM: Final = lam_of_memory(2)  # of a cell's samples: its mean and the noise come from them
LAGS: Final = (
    *(flow_path.DEAD_U, flow_path.LAG_U),
    *(flow_path.DEAD_Q, flow_path.AVERAGE, flow_path.LAG_Q),
)
NEARLY_THERE: Final = 0.25  # of half the play; so little is no reason to move the spool


@dataclass(frozen=True)
class FlowMap:
    """The flow map as one Gaussian field over (U, s), s = sign(Δp)·√|Δp|, learnt online.

        Q = g(U, s) + b_cell + ε,   g = Σ c_ij·B_i(U)·B_j(s)

    with quadratic B-splines B, second differences of c as a prior, a deviation b ~ N(0, δ²) of each
    cell from the smooth map, and noise ε ~ AR(1) of variance σ². The precisions of the prior, δ²,
    σ² and ρ are estimated by marginal likelihood (:mod:`kernels.flow_fit`); bends along U have a
    Student-t prior, so a dead band or a knee needs no shape of its own.

    Parameters
    ----------
    U_range, dp_range
        Of the valve, % and bar.
    lam
        Forgetting factor of a cell, per sample that falls into it, LEAST_LAM <= lam <= 1: by
        default 500 samples, .05 σ, less than a map needs. Samples of one visit within .12 s are
        one. What moves in time needs none of it.

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
    lam: float = 0.998

    def __post_init__(self) -> None:
        check_lam(self.lam, LEAST_LAM)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Points at which the map is published, then physical quantities."""
        return flow_parameters.NAMES

    def with_forgetting(self, lam: float) -> Self:
        """Use another forgetting factor; states may be carried over."""
        return replace(self, lam=lam)

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
            longest=math.inf if self.lam == 1.0 else round(1.0 / (1.0 - self.lam), 6),
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

    def inverted(
        self, state: FlowMapState, Q: Floats, dp: Floats, T: Floats
    ) -> tuple[Floats, Floats, Floats, Codes]:
        """U in the middle of the play, U without its bounds, dQ/dU and status, all (N,)."""
        return flow_map_looks.invert(state, axes(self.U_range, self.dp_range), Q, dp, T)

    def noise_std(self, state: FlowMapState) -> float:
        """Standard deviation of the flow meter's noise, l/min.

        The slow part of σ² is the meter's only as far as no cause without a name moves the flow.
        """
        of_causes = state.scalars[flow_fit.SLOW] * float(flow_findings.hidden(state))
        return float(np.sqrt(state.scalars[flow_fit.VARIANCE] * (1.0 - of_causes)))

    def form(self, state: FlowMapState, T: float) -> MapForm | None:
        """Return where the map is smooth at one temperature, see `flow_pieces`."""
        return flow_pieces.form(state, axes(self.U_range, self.dp_range), T)

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
        """`adaptation` of M models (M,): each where it is likelier than not, reaction first."""
        moving = (drift_states.drifting(states.chance) > rules.WORTH_SAYING).any(axis=-1)
        worn = states.wear[..., flow_wear.NODES, flow_wear.CHANCE]
        moving |= (worn > rules.WORTH_SAYING).any(axis=-1)
        young = states.counters[..., flow_memory.USED] < rules.SETTLED_MAP
        steady = np.where(young, Adaptation.UNDECIDED, Adaptation.STEADY)
        found = np.where(moving & ~young, Adaptation.DRIFT, steady)
        hidden = flow_findings.hidden(states) > rules.WORTH_SAYING
        found = np.where(hidden, Adaptation.MISFIT, found)
        reacting = states.path[..., flow_path.NEWS] > 0.0
        return np.where(reacting, Adaptation.REACTING, found).astype(np.uint8)

    def rates(self, state: FlowMapState) -> tuple[Floats, Floats]:
        """Rates of gain (1/h) and edge (%/h), and their standard deviations, (2, 2): by side."""
        return flow_parameters.rates(state)

    def findings(self, state: FlowMapState) -> tuple[Finding, ...]:
        """Causes of what the samples show, the likeliest first."""
        return flow_findings.findings(state, axes(self.U_range, self.dp_range))

    def follows(self, state: FlowMapState) -> bool:
        """Whether there are operators between map and samples."""
        return self.half_play(state) > 0.0 or bool(state.path[: flow_path.OF_MAP].any())

    def half_play(self, state: FlowMapState) -> float:
        """Half of the play between U and the spool, %."""
        return float(state.play[flow_play.HALF])

    def directions(self, state: FlowMapState, U: Floats) -> Floats:
        """Where in its play (-1 … 1) the spool is along a path of its own (N,)."""
        found = np.zeros(len(U))
        if (half := self.half_play(state)) > 0.0:
            flow_play.behind(half, U, found)
        return found

    def predict_along(
        self, state: FlowMapState, U: Floats, dp: Floats, T: Floats, direction: Floats
    ) -> tuple[Floats, Floats]:
        """Flow and standard deviation with U coming from below (1) or above (-1)."""
        return self.predict(state, U - self.half_play(state) * direction, dp, T)

    def approached(self, state: FlowMapState, U: Floats) -> Floats:
        """U (N,) that moves the spool from where it is now to where ``U`` would hold it.

        Through the play in the direction it has to go; see `NEARLY_THERE`.
        """
        half, seen = self.half_play(state), int(state.counters[flow_memory.ROWS_SEEN])
        if half == 0.0 or seen == 0:
            return U
        last = float(state.recent[(seen - 1) % len(state.recent), flow_path.LEFT_U])
        way = U - float(state.play[flow_play.SPOOL])
        moved = np.clip(U + np.copysign(half, way), *self.U_range)
        return np.where(np.abs(way) < NEARLY_THERE * half, last, moved)

    def to_map(self, state: FlowMapState) -> GaussianMap:
        """Return the map as a value."""
        return GaussianMap.of(state, self.U_range, self.dp_range)

    def describe(self, state: FlowMapState) -> str:
        """Return the effects in force, in words."""
        return flow_words.describe(state)

    def describe_many(self, states: FlowMapState, chosen: Times) -> Sequence[str]:
        """What ``describe`` gives of chosen valves."""
        return [flow_words.describe(member(states, int(m))) for m in chosen]

    def structure_now(self, state: FlowMapState) -> Structure | None:
        """Eq. (7), where it is likelier than not; None for a map known only where samples were."""
        return FiveTerms() if flow_words.is_plain(state) else None

    def lags(self, state: FlowMapState) -> tuple[float, float]:
        """First-order lags of U's effect and of the flow meter, s."""
        return float(state.path[flow_path.LAG_U]), float(state.path[flow_path.LAG_Q])

    def lags_many(self, states: FlowMapState, chosen: Times) -> Sequence[tuple[float, float]]:
        """What ``lags`` gives of chosen valves."""
        return [self.lags(member(states, int(m))) for m in chosen]

    def largest_lags(self, states: FlowMapState) -> Floats:
        """The largest lag, dead time or mean of each of M valves, s (M,)."""
        return np.asarray(states.path[..., LAGS].max(axis=-1))

    def censored(self, states: FlowMapState) -> Times:
        """How many samples of each of M valves lay where the meter shows no flow."""
        return np.asarray(states.counters[..., flow_memory.CENSORED])

    def began(self, states: FlowMapState) -> Times:
        """After how many samples the map of each of M valves began anew; 0: it never did."""
        return states.counters[..., flow_memory.RESTARTED].copy()

    def samples_since(self, states: FlowMapState) -> Times:
        """How many samples of each of M valves its map has learnt since it began anew."""
        counters = states.counters
        return np.asarray(counters[..., flow_memory.USED] - counters[..., flow_memory.RESTARTED])

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
