"""`SharedMeter`: the flow of each of several valves behind one flow meter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.kernels import shared_meter as kernel
from valvemap.model.samples import Floats

LEAK_PRECISION: Final = (kernel.USUAL_NOISE / kernel.USUAL_LEAK) ** 2  # before the first sample
MOST_VALVES: Final = 8  # behind one meter: a sample costs the square of their number


@dataclass(frozen=True)
class SharedMeterState(State):
    """What `SharedMeter` knows: weights (n,), their covariance (n, n), sums of the residuals.

    ``held`` (M, 2) are the weight and the weighted residuals that are not yet a sample of a valve.
    """

    weights: Floats
    P: Floats
    sums: Floats
    held: Floats

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        return {"sums": Contents(self.sums).within(0.0)}

    def is_coherent(self) -> bool:
        """Whether no variance is negative."""
        return bool((np.diag(self.P) >= 0.0).all())


class Divided(NamedTuple):
    """The other valves' flows of N samples, (M, N), by valve; NaN of a sample that is not usable.

    ``others`` are as predicted from the samples before, l/min; ``std`` is their standard deviation
    in that of the meter's noise. Where ``told``, the sample, with those before it that said a part
    each, says as much of the valve as one of a meter of its own: from these it is to be learnt.
    """

    others: Floats
    std: Floats
    told: np.ndarray


@dataclass(frozen=True)
class SharedMeter:
    """The flows of M valves whose sum is measured.

        Q = Σ_m w_m(U_m) √Δp_m + ε

    w_m is a broken line over the range of U_m. All w_m are learnt together by recursive least
    squares: where one valve is open alone, it is learnt; from then on its flow is known where
    another one opens, too. At U = 0 a valve passes next to nothing, which makes the sum separable:
    its leak is not negative, so it is no larger than the sum of all leaks, which is soon known.

    Parameters
    ----------
    ranges
        Range of U of each of the M valves, %.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> U, dp = rng.uniform(0, 100, (2, 4000)), rng.uniform(20, 150, (2, 4000))
    >>> flows = np.array([[0.05], [0.02]]) * U * np.sqrt(dp)
    >>> meter = SharedMeter(((0.0, 100.0), (0.0, 100.0)))
    >>> state = meter.initial_state()
    >>> found = meter.learn(state, U, dp, flows.sum(axis=0), np.ones(4000, np.bool_))
    >>> bool(np.abs(found.others[0] - flows[1])[-100:].max() < 0.1)
    True
    """

    ranges: Sequence[tuple[float, float]]

    def initial_state(self) -> SharedMeterState:
        """State before the first sample."""
        n = kernel.KNOTS * len(self.ranges)
        sums = np.array([kernel.USUAL_NOISE**2, 0.0, (kernel.USUAL_NOISE / kernel.USUAL_LEAK) ** 2])
        return SharedMeterState(np.zeros(n), self._prior(), sums, np.zeros((len(self.ranges), 2)))

    def learn(
        self, state: SharedMeterState, U: Floats, dp: Floats, Q: Floats, usable: np.ndarray
    ) -> Divided:
        """Learn from N samples, U and dp (M, N); the state is written in place."""
        M, n = len(self.ranges), len(state.weights)
        low, high = np.array(self.ranges, float).T.copy()
        others, std = np.full((2, M, len(Q)), np.nan)
        told = np.zeros((M, len(Q)), np.bool_)
        kernel.learn(
            np.ascontiguousarray(U), np.ascontiguousarray(dp), np.ascontiguousarray(Q), usable,
            low, high, state.weights, state.P, state.sums, state.held,
            np.diag(self._prior()).copy(), self._shut(), others, std, told,
            np.zeros(2 * M, np.int64), np.zeros(2 * M), np.zeros(n), np.zeros((M, 2)),
        )  # fmt: skip
        return Divided(others, std, told)

    def noise(self, state: SharedMeterState) -> float:
        """Return the standard deviation of the meter's noise, l/min."""
        return float(np.sqrt(max(state.sums[kernel.MEAN_SQUARE], kernel.LEAST_NOISE**2)))

    def _shut(self) -> np.ndarray:
        """Return the place of each valve's weight at U = 0, (M,)."""
        K = kernel.KNOTS
        at = [np.abs(np.linspace(low, high, K)).argmin() for low, high in self.ranges]
        return np.arange(len(self.ranges)) * K + np.array(at, np.int64)

    def _prior(self) -> Floats:
        """Return the covariance (n, n) of the weights before the first sample, in noise variances.

        The gain leaves zero at U = 0 with a slope that changes as a Wiener process.
        """
        K = kernel.KNOTS
        found = np.zeros((K * len(self.ranges),) * 2)
        for m, (low, high) in enumerate(self.ranges):
            U = np.linspace(low, high, K)
            from_shut = np.abs(U - min(max(low, 0.0), high))
            bend = np.where(from_shut < kernel.OVERLAPPED, kernel.BEND_OF_EDGE, kernel.USUAL_BEND)
            beyond = np.maximum(from_shut[:, None] - from_shut, 0.0)
            of_bend = (beyond * bend**2) @ beyond.T * (high - low) / (K - 1)
            one_side = np.sign(U)[:, None] * np.sign(U) >= 0.0
            own = of_bend + kernel.USUAL_SLOPE**2 * np.outer(from_shut, from_shut)
            own = np.where(one_side, own, 0.0) + kernel.USUAL_LEAK**2
            found[m * K : (m + 1) * K, m * K : (m + 1) * K] = own
        found[np.diag_indices_from(found)] += kernel.USUAL_KINK**2
        return found / kernel.USUAL_NOISE**2
