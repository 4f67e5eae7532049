"""`Leakage`: what a line loses while all of its edges are closed."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.fleet import alone, member, update_one
from valvemap.model.kernels import leakage as kernel
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.vocabulary.statuses import Adaptation, Quality


@dataclass(frozen=True)
class LeakageState(State):
    """What `Leakage` knows.

    Attributes
    ----------
    sums : (SUMS,) float64
        Sums of least squares and of the residuals, see :mod:`kernels.leakage`.
    counts : (COUNTS,) int64
        Closed samples, and when the present rest began.
    """

    sums: Floats
    counts: Times

    def contents(self) -> Mapping[str, Contents]:
        """What may stand in them."""
        positive = [kernel.XX, kernel.UU, kernel.RR, kernel.WEIGHT]
        return {
            "sums": Contents(self.sums).within(0.0, where=positive),
            "counts": Contents(self.counts).any_time(kernel.SINCE),
        }

    def is_coherent(self) -> bool:
        """Whether the sums are of some samples (Cauchy and Schwarz)."""
        xx, xu, uu = self.sums[[kernel.XX, kernel.XU, kernel.UU]]
        return bool(xu * xu <= xx * uu * (1.0 + 1e-9) + 1e-9)


@dataclass(frozen=True)
class Leakage:
    """The leakage of a line, from samples with all edges closed.

        Q = -c·Δp + g·U + ε,   |U| ≤ closed for 0.1 s

    c is the leakage, g the start of an opening where edges do not overlap: with it, c is right
    there, too. Least squares with a memory of 20,000 closed samples; the standard deviation allows
    for coloured noise by (1 + ρ)/(1 - ρ). An open valve teaches nothing: the prediction is then
    the leakage's part of the flow, and there is no residual.

    Parameters
    ----------
    closed
        Largest |U| at which all edges are closed, %.
    U_range
        Of the valve, %.

    Examples
    --------
    >>> leakage = Leakage()
    >>> dp = np.linspace(-80.0, 80.0, 400)
    >>> samples = Samples.of(np.arange(400) * 10_000_000, 0.0 * dp, dp, 0.0 * dp, -0.01 * dp)
    >>> state, _ = leakage.update(leakage.initial_state(), samples)
    >>> leakage.parameters(state)[0].round(4)
    array([0.01])
    """

    closed: float = 3.0
    U_range: tuple[float, float] = (-100.0, 100.0)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The leakage, l/min/bar."""
        return ("c",)

    def initial_state(self) -> LeakageState:
        """State before the first sample."""
        return LeakageState(np.zeros(kernel.SUMS), np.zeros(kernel.COUNTS, np.int64))

    def update(self, state: LeakageState, samples: Samples) -> tuple[LeakageState, Trace]:
        """Learn from N samples, one after another."""
        return update_one(self, state, samples)

    def update_many(self, states: LeakageState, samples: Samples, segments: Segments) -> Trace:
        """Learn from the samples of many lines; their states are written in place."""
        predicted, residual = np.full((2, len(samples)), np.nan)
        trace = Trace(predicted, residual, residual, np.zeros(len(samples), np.uint8))
        usable = samples.quality != Quality.BAD
        kernel.learn(
            samples.t, samples.U, samples.dp, samples.Q, usable, self.closed, states.sums,
            states.counts, predicted, residual, trace.status, segments,
        )  # fmt: skip
        return trace

    def predict(
        self, state: LeakageState, U: Floats, dp: Floats, T: Floats
    ) -> tuple[Floats, Floats]:
        """The leakage's part of the line's flow (N,) and its standard deviation (N,), l/min."""
        found = np.empty(2)
        kernel.used(state.sums, state.counts, found)
        nothing = 0.0 * (U + np.nan_to_num(T))
        return -found[0] * dp + nothing, np.abs(dp) * found[1] + nothing

    def parameters(self, state: LeakageState) -> tuple[Floats, Floats]:
        """The leakage (1,) and its standard deviation (1,), l/min/bar; NaN while unknown."""
        c, std = self.parameters_many(alone(state))
        return c[0], std[0]

    def parameters_many(self, states: LeakageState) -> tuple[Floats, Floats]:
        """What ``parameters`` gives line by line, both (M, 1)."""
        found = np.empty((len(states.counts), 2))
        for m, row in enumerate(found):
            one = member(states, m)
            kernel.parameters(one.sums, one.counts, row)
        return found[:, :1].copy(), found[:, 1:].copy()

    def adaptation(self, state: LeakageState) -> Adaptation:
        """What the residuals say: not known, one number fits any closed valve."""
        return Adaptation(int(self.adaptation_many(alone(state))[0]))

    def adaptation_many(self, states: LeakageState) -> Codes:
        """`adaptation` of M lines (M,)."""
        return np.full(len(states.counts), Adaptation.UNDECIDED, np.uint8)
