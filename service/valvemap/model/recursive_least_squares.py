"""Recursive least squares with forgetting, eqs. (17)-(28), in exact and bounded arithmetic."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np

from valvemap.model.change import Change
from valvemap.model.fleet import learn_many, member, update_one
from valvemap.model.flow_units import Powers
from valvemap.model.forgetting import (
    Adaptive,
    Exponential,
    Forgetting,
    SlidingWindow,
    check_lam,
    least_lam,
    with_lam,
)
from valvemap.model.kernels.row_layout import CHANGES, SAMPLE, SIZE, TIME
from valvemap.model.kernels.rules import LARGEST
from valvemap.model.least_squares_answers import (
    adaptations,
    information,
    is_determined,
    known_theta,
    parameter_covariance,
    parameter_variance,
    predict,
    variances,
)
from valvemap.model.least_squares_state import RlsState, flow_powers, initial_state
from valvemap.model.linear_map import LinearParameters
from valvemap.model.model_structures import (
    FiveTerms,
    Structure,
    StructureWithPrior,
    reads_temperature,
    rows_of,
)
from valvemap.model.place_grid import grid_of
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.vocabulary.statuses import Adaptation, Quality


@dataclass(frozen=True)
class RecursiveLeastSquares:
    """Recursive least squares for any structure that is linear in its parameters.

    ::

        e(t)     = Q(t) - Xᵀ(t)·theta(t-1)                  innovation, l/min
        L(t)     = P(t-1)·X(t) / (λ + Xᵀ(t)·P(t-1)·X(t))    eq. (28)
        theta(t) = theta(t-1) + L(t)·e(t)
        P(t)     = as `forgetting` says; exponential: (P(t-1) - L(t)·Xᵀ(t)·P(t-1))/λ

    With ``p0`` = ∞ the start is exact: at λ = 1 theta equals batch least squares, eq. (16), as soon
    as the samples determine it. Until then the status is WARMING_UP, and a sample is predicted if
    the earlier ones determine Xᵀ·theta (NaN if not). P is stored as a triangular factor, so it is
    always symmetric and positive definite.

    Parameters
    ----------
    structure
        Regressors X(U, dp, T) of the flow.
    forgetting
        A rule of :mod:`valvemap.model.forgetting`.
    p0
        P(0) = p0·I in physical units, > 0; a finite one is ridge regression, not eq. (16).

    Examples
    --------
    >>> from valvemap.model.samples import Samples
    >>> U, dp = np.meshgrid([10.0, 50.0, 90.0], [25.0, 100.0, 196.0])
    >>> theta = np.array([1.0, 0.02, 0.3, 0.12, -0.01])
    >>> X = FiveTerms().regressors(U.ravel(), dp.ravel(), dp.ravel())
    >>> samples = Samples.of(range(9), U.ravel(), dp.ravel(), np.zeros(9), X @ theta)
    >>> rls = RecursiveLeastSquares()
    >>> state, trace = rls.update(rls.initial_state(), samples)
    >>> rls.parameters(state)[0].round(6)
    array([ 1.  ,  0.02,  0.3 ,  0.12, -0.01])
    """

    structure: Structure = FiveTerms()  # noqa: RUF009 - frozen
    forgetting: Forgetting = Exponential(lam=1.0)  # noqa: RUF009 - frozen
    p0: float = np.inf

    def __post_init__(self) -> None:
        if not self.p0 > 0.0:
            raise ValueError(f"p0 = {self.p0!r} is not positive")
        if not isinstance(self.forgetting, SlidingWindow):
            check_lam(self.lam, least_lam(self.forgetting, _parameters_of_a_sample(self.structure)))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of theta's elements."""
        return self.structure.parameter_names

    @property
    def lam(self) -> float:
        """Forgetting factor λ."""
        return self.forgetting.lam

    def with_forgetting(self, lam: float) -> Self:
        """Return the same estimator with another λ; its states stay valid.

        Raises
        ------
        ValueError
            if λ is below `least_lam` or above 1.
        """
        check_lam(lam, least_lam(self.forgetting, _parameters_of_a_sample(self.structure)))
        return replace(self, forgetting=with_lam(self.forgetting, lam))

    def initial_state(self) -> RlsState:
        """State before the first sample."""
        prior = self.structure.prior() if isinstance(self.structure, StructureWithPrior) else None
        return initial_state(len(self.parameter_names), self.forgetting, self.p0, prior)

    def update(self, state: RlsState, samples: Samples) -> tuple[RlsState, Trace]:
        """Update with N samples in sequence."""
        return update_one(self, state, samples)

    def update_many(self, states: RlsState, samples: Samples, segments: Segments) -> Trace:
        """Update many models with their samples; their states are written in place."""
        X = rows_of(self.structure, samples)
        usable = samples.quality != Quality.BAD
        for signal in (samples.U, samples.dp):  # a structure may clip its arguments
            usable &= np.abs(signal) <= LARGEST
        codes = usable.astype(np.uint8)
        grid = None
        if isinstance(self.forgetting, Adaptive):
            grid = grid_of(self.structure, samples.U, samples.dp)
        return learn_many(states, self.forgetting, X, samples.Q, samples.t, codes, segments, grid)

    def predict(self, state: RlsState, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Flow Q̂ (N,) and its standard deviation (N,), l/min; NaN if unknown."""
        return predict(state, self.structure.regressors(U, dp, T), self.forgetting)

    def parameters(self, state: RlsState) -> tuple[Floats, Floats]:
        """Theta (n,) and its standard deviations (n,), NaN while not determined."""
        theta = known_theta(state)
        if not is_determined(state):
            return theta, np.full_like(theta, np.nan)
        return theta, np.sqrt(np.maximum(parameter_variance(state, self.forgetting), 0.0))

    def parameters_many(self, states: RlsState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations of M ≥ 1 models, both (M, n)."""
        variance, is_known = variances(states, self.forgetting)
        theta, std = states.theta.copy(), np.sqrt(np.maximum(variance, 0.0))
        for m in (~is_known).nonzero()[0].tolist():
            theta[m], std[m] = self.parameters(member(states, m))
        return theta, std

    def adaptation(self, state: RlsState) -> Adaptation:
        """Return the assessment of the residuals: UNDECIDED or REACTING, unless places are kept."""
        return Adaptation(int(adaptations(state.detector[None], self.forgetting)[0]))

    def adaptation_many(self, states: RlsState) -> Codes:
        """`adaptation` of M models (M,)."""
        return adaptations(states.detector, self.forgetting)

    def covariance(self, state: RlsState) -> Floats:
        """Covariance of theta (n, n); NaN while not determined."""
        return parameter_covariance(state, self.forgetting)

    def to_map(self, state: RlsState) -> LinearParameters:
        """Return structure, theta and covariance."""
        theta, _ = self.parameters(state)
        return LinearParameters.of(self.structure, theta, self.covariance(state))

    def information(self, state: RlsState) -> Floats:
        """P⁻¹ (n, n); singular while theta is not determined."""
        return information(state)

    def flow_powers(self, state: RlsState) -> Powers | None:
        """Return the powers of Q of a state's values; None with a prior in units of Q."""
        has_prior = isinstance(self.structure, StructureWithPrior) or np.isfinite(self.p0)
        return None if has_prior else flow_powers(state)

    @property
    def uses_temperature(self) -> bool:
        """Whether the map may depend on the oil temperature: if its structure does."""
        return reads_temperature(self.structure)

    @property
    def finds_changes(self) -> bool:
        """Whether changes are detected: by adaptive forgetting only."""
        return isinstance(self.forgetting, Adaptive)

    def change_counts(self, states: RlsState) -> Times:
        """Return the number of detected plant changes of each of M models (M,)."""
        return np.asarray(states.counters[..., CHANGES])

    def last_change(self, state: RlsState) -> Change | None:
        """Return the last detected plant change, None if there was none."""
        counters = state.counters.tolist()
        if not counters[CHANGES]:
            return None
        return Change(
            count=counters[CHANGES],
            sample=counters[SAMPLE] - 1,
            t=counters[TIME],
            size=float(state.detector[SIZE]),
        )


@lru_cache(maxsize=64)
def _parameters_of_a_sample(structure: Structure) -> int:
    """Largest number of parameters that one sample depends on: of a spline, those around its cell.

    The participation ratio (Σ|x|)²/Σx² of a row with scaled columns: n if all n regressors have
    equal weight, 1 if a single one has all.
    """
    grid = np.meshgrid(np.linspace(0, 100, 9), np.linspace(0, 200, 9), np.linspace(20, 60, 3))
    rows = np.abs(structure.regressors(*(axis.ravel() for axis in grid)))
    rows = rows[np.isfinite(rows).all(axis=1)]
    largest = rows.max(axis=0)
    rows /= np.where(largest > 0.0, largest, 1.0)
    squares = (rows**2).sum(axis=1)
    ratio = rows.sum(axis=1) ** 2 / np.where(squares > 0.0, squares, 1.0)
    return max(1, round(float(ratio.max())))
