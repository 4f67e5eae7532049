"""Recursive maximum likelihood, eq. (29): parameters with a model of coloured noise."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.fleet import alone, member, update_one
from valvemap.model.flow_units import Powers
from valvemap.model.forgetting import Directional, check_lam, least_lam
from valvemap.model.kernels import likelihood_memory as memories
from valvemap.model.kernels import likelihood_spread, reaction
from valvemap.model.kernels import maximum_likelihood as kernel
from valvemap.model.kernels.factors import covariance
from valvemap.model.kernels.filtered_scores import REACTING
from valvemap.model.kernels.stability import root_margins
from valvemap.model.linear_map import LinearParameters
from valvemap.model.maximum_likelihood_lags import lags_of
from valvemap.model.maximum_likelihood_state import (
    MaximumLikelihoodState,
    diagonals,
    flow_powers,
    initial_state_of,
    learn,
    memory_of,
    noise_variance,
    noise_variances,
    parameter_covariance,
)
from valvemap.model.model_structures import (
    FiveTerms,
    Structure,
    StructureWithPrior,
    reads_temperature,
)
from valvemap.model.samples import Codes, Floats, Samples, Segments, Trace
from valvemap.vocabulary.statuses import Adaptation, Quality, Status


@dataclass(frozen=True)
class MaximumLikelihood:
    """Recursive maximum likelihood for a static map whose noise is a moving average.

    Q(t) = Xᵀ(t)·a + v(t) + d1·v(t-1) + … + d_nd·v(t-nd), v white. With
    h = [X(t), v̂(t-1) … v̂(t-nd)] and h_f = h/D̂(q), the constant column included, eq. (29) reads

        L = P·h_f / (λ + h_fᵀ·P·h_f),  ε = Q - hᵀθ̂(t-1),  θ̂ += L·ε,  P = (P - L·h_fᵀ·P)/λ

    and the noise fed back is the residual *after* the update, v̂ = Q - hᵀθ̂(t) (the published
    equation feeds back ε and diverges). A step that would make D̂(q) unstable is halved until D̂(q)
    is stable; λ rises from 0.95; the prior variance of d is small. ``lam`` < 1 forgets along h_f
    only (Kulhavý 1987), so that levels of U without samples are kept. Plain RLS runs in parallel;
    if RML is worse for long, it restarts from the RLS estimate.

    Attributes
    ----------
    structure : Structure
        The map, linear in its parameters.
    nd : int
        Order of the noise model, 0 to 8.
    lam : float
        Directional forgetting factor in (0, 1].
    p0 : float
        Prior variance of a parameter in units of the noise variance, for regressors scaled to
        magnitude 1 over U = 0 … 100 %, dp = 0 … 200 bar.
    radius : float
        The roots of D̂(q) stay inside it, in (0, 1).

    References
    ----------
    Ljung, Söderström: Theory and Practice of Recursive Identification, 1983. Bierman:
    Factorization Methods for Discrete Sequential Estimation, 1977.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> U, dp, e = rng.uniform(0, 100, 3000), rng.uniform(0, 200, 3000), rng.normal(size=3001)
    >>> Q = 0.2 * U * np.sqrt(dp) + e[1:] + 0.8 * e[:-1]
    >>> samples = Samples.of(t=np.arange(3000), U=U, p1=dp, p2=0 * dp, Q=Q)
    >>> rml = MaximumLikelihood()
    >>> state, trace = rml.update(rml.initial_state(), samples)
    >>> theta, std = rml.parameters(state)
    >>> dict(zip(rml.parameter_names, theta.round(1).tolist()))["d1"]
    0.8
    """

    structure: Structure = field(default_factory=FiveTerms)
    nd: int = 1
    lam: float = 1.0
    p0: float = 1e6
    radius: float = 0.995

    def __post_init__(self) -> None:
        """Validate the hyper-parameters."""
        check_settings(self.nd, self.lam, self.p0, self.radius)
        check_lam(self.lam, least_lam(Directional(), len(self.parameter_names)))

    @property
    def uses_temperature(self) -> bool:
        """Whether the map may depend on the oil temperature: if its structure does."""
        return reads_temperature(self.structure)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The structure's names, then d1 … d_nd."""
        return self.structure.parameter_names + tuple(f"d{i + 1}" for i in range(self.nd))

    def with_forgetting(self, lam: float) -> Self:
        """Return the same estimator with another λ; a state fits both."""
        return replace(self, lam=lam)

    def initial_state(self) -> MaximumLikelihoodState:
        """Return theta = 0, P = p0·I for scaled regressors, with the structure's prior."""
        state = initial_state_of(self._orders(), self.p0)
        if isinstance(self.structure, StructureWithPrior):
            rows, values = self.structure.prior()
            kernel.learn(memory_of(state), rows / self._scale, values)
        return state

    def update(
        self, state: MaximumLikelihoodState, samples: Samples
    ) -> tuple[MaximumLikelihoodState, Trace]:
        """Update with N samples; bad and non-finite ones do not change the state."""
        return update_one(self, state, samples)

    def update_many(
        self, states: MaximumLikelihoodState, samples: Samples, segments: Segments
    ) -> Trace:
        """Update many models with their samples; their states are written in place."""
        X, good = self._scaled_regressors(samples.U, samples.dp, samples.T)
        good &= (samples.quality != Quality.BAD) & np.isfinite(samples.Q)
        rule = memories.Rule(memories.DIRECTIONAL, float(self.lam), float(self.radius))
        where = samples.U[good], samples.Q[good], segments.among(good)
        run = learn(states, rule, self._orders(), X[good], *where)
        # NaN where the samples do not determine it.
        with np.errstate(invalid="ignore"):
            known = np.where(run.share <= memories.UNDETERMINED, run.predicted, np.nan)
        predicted, behind = np.full((2, len(samples)), np.nan)
        predicted[good], behind[good] = known, run.early
        status = np.full(len(samples), Status.REJECTED, np.uint8)
        status[good] = run.status
        return Trace(predicted, samples.Q - predicted, behind, status)

    def predict(
        self, state: MaximumLikelihoodState, U: Floats, dp: Floats, T: Floats
    ) -> tuple[Floats, Floats]:
        """Flow and its standard deviation, l/min; NaN where the samples do not determine it."""
        points = (np.ascontiguousarray(a, np.float64) for a in (U, dp, T))
        X, finite = self._scaled_regressors(*points)
        values, variances, share = np.empty((3, len(X)))
        lags = lags_of(alone(state))
        memory = memory_of(member(lags.without(alone(state)), 0))
        likelihood_spread.evaluate(
            memory, np.where(finite[:, None], X, 0.0), values, variances, share
        )
        known = finite & (share <= memories.UNDETERMINED) & (state.monitor[memories.COUNT] > 0)
        with np.errstate(all="ignore"):
            own = np.sqrt(variances * noise_variance(state))
        (std,) = lags.beyond(X, own[None])
        return np.where(known, values, np.nan), np.where(known, std, np.nan)

    def parameters(self, state: MaximumLikelihoodState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations: the structure's in its units, d without unit."""
        theta, std = self.parameters_many(alone(state))
        return theta[0], std[0]

    def parameters_many(self, states: MaximumLikelihoodState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations of M ≥ 1 models, both (M, n)."""
        n, scale = len(self._scale), np.append(self._scale, np.ones(self.nd))
        lags = lags_of(states)
        P, inflations = diagonals(lags.without(states))
        determined = states.monitor[:, memories.DETERMINED, None] > 0
        over = np.where(determined, np.diagonal(states.spread, axis1=1, axis2=2), P)
        with np.errstate(all="ignore"):
            variance = np.maximum(noise_variances(states)[:, None] * over, 0.0)
        variance[:, :n] *= inflations
        std = np.sqrt(variance)
        std[:, :n] = lags.beyond(np.eye(n), std[:, :n])
        known = (P > 0) & (memories.UNDETERMINED * states.prior >= P)
        known[:, len(scale) - self.nd :] = determined
        return states.theta / scale, np.where(known, std, np.nan) / scale

    def adaptation(self, state: MaximumLikelihoodState) -> Adaptation:
        """Return undecided, or reacting: it cannot separate misfit from drift."""
        return Adaptation.REACTING if _reacts(state.colour) else Adaptation.UNDECIDED

    def adaptation_many(self, states: MaximumLikelihoodState) -> Codes:
        """`adaptation` of M models (M,)."""
        reacting = _reacts(states.colour)
        return np.where(reacting, Adaptation.REACTING, Adaptation.UNDECIDED).astype(np.uint8)

    def covariance(self, state: MaximumLikelihoodState) -> Floats:
        """Covariance (n, n) of the structure's parameters."""
        n = len(self._scale)
        wider = np.sqrt(diagonals(alone(state))[1][0]) / self._scale
        return parameter_covariance(state)[:n, :n] * np.outer(wider, wider)

    def to_map(self, state: MaximumLikelihoodState) -> LinearParameters:
        """Return structure, theta and covariance."""
        theta, _ = self.parameters(state)
        return LinearParameters.of(self.structure, theta, self.covariance(state))

    def information(self, state: MaximumLikelihoodState) -> Floats:
        """P⁻¹ (n, n) of the structure's parameters, for any noise model.

        NaN if P is singular.
        """
        n = len(self._scale)
        P = covariance(state.factor)[:n, :n] / np.outer(self._scale, self._scale)
        try:
            return np.asarray(np.linalg.inv(P))
        except np.linalg.LinAlgError:  # singular
            return np.full_like(P, np.nan)

    def flow_powers(self, state: MaximumLikelihoodState) -> Powers | None:
        """Return the powers of Q of a state's values; None with a prior in units of Q."""
        return None if isinstance(self.structure, StructureWithPrior) else flow_powers(state)

    def root_margin(self, state: MaximumLikelihoodState) -> float:
        """1 - max|root of D̂(q)|: 1 for white noise, near 0 on the edge of invertibility."""
        n = len(state.theta)
        return float(root_margins(state.theta[None, n - self.nd :])[0])

    def _orders(self) -> memories.Orders:
        return np.array([0] + [1] * len(self.structure.parameter_names) + [self.nd], np.int64)

    @cached_property
    def _scale(self) -> Floats:
        """Magnitude of each regressor over the nominal range: powers of two, for exact division."""
        grid = np.meshgrid(np.linspace(0, 100, 9), np.linspace(0, 200, 9), np.linspace(20, 60, 3))
        rows = self.structure.regressors(*(axis.ravel() for axis in grid))
        rms = np.sqrt(np.mean(rows**2, axis=0))
        scale: Floats = np.exp2(np.round(np.log2(np.where(rms > 0, rms, 1.0))))
        return scale

    def _scaled_regressors(
        self, U: Floats, dp: Floats, T: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Return scaled rows, and a mask of the finite ones."""
        with np.errstate(all="ignore"):
            X = self.structure.regressors(U, dp, T) / self._scale
        return X, np.isfinite(U) & np.isfinite(dp) & np.isfinite(X).all(axis=1)


def check_settings(nd: int, lam: float, p0: float, radius: float) -> None:
    """Validate hyper-parameters.

    Raises
    ------
    ValueError
        naming the one that is not allowed.
    """
    if not 0 <= nd <= 8:
        raise ValueError(f"nd is {nd}; 0 to 8 is allowed")
    if not 0 < lam <= 1:
        raise ValueError(f"forgetting factor is {lam}; 0 < lam <= 1 is allowed")
    if not p0 > 0:
        raise ValueError(f"p0 is {p0}; a positive number is allowed")
    if not 0 < radius < 1:
        raise ValueError(f"radius is {radius}; 0 < radius < 1 is allowed")


def _reacts(colours: Floats) -> NDArray[np.bool_]:
    return np.asarray(reaction.reacts(colours, REACTING))
