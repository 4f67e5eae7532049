"""Recursive maximum likelihood, eq. (29): parameters beside a model of coloured noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.identification.adaptation import Adaptation
from service.identification.contents import Contents
from service.identification.estimator import State
from service.identification.fleet import alone, member, repeated, update_one
from service.identification.kernels import maximum_likelihood as kernel
from service.identification.kernels import reaction
from service.identification.kernels.factors import covariance
from service.identification.kernels.filtered_scores import (
    BLOCK_SQUARE,
    BLOCKS,
    GATHERED,
    LATELY,
    PLACES_OF_COLOUR,
    REACTING,
    ROWS_OF_BLOCKS,
    SCORE,
    SQUARE,
)
from service.identification.kernels.scores import BLOCK, FEWEST
from service.identification.kernels.stability import is_stable, root_margins
from service.identification.model_structures import FiveTerms, Structure, StructureWithPrior
from service.identification.samples import Codes, Floats, Quality, Samples, Segments, Status, Trace

CHANCE: Final = 4.0  # squared standard deviations of the mean score that are no drift
UNEVEN: Final = 1.0 / 3.0  # variance of lags between none and twice their mean, over its square


@dataclass(frozen=True)
class MaximumLikelihoodState(State):
    """Everything that eq. (29) remembers, for regressors scaled to magnitude 1.

    Attributes
    ----------
    theta : (n,)
        Parameters of the structure, then d.
    factor : (n, n)
        Uᵀ with D on its diagonal, P = U·D·Uᵀ.
    spread : (n, n)
        Lower triangle of the covariance of theta over σ²; unused until theta is determined.
    prior : (n,)
        Variances over σ² that count as knowing nothing; 0 for d until σ² is known.
    rls_theta, rls_factor : (s,), (s, s)
        Plain RLS on the regressors without the noise columns.
    raw, filtered : (channels, lags)
        The last values of output, inputs and residual; the same through 1/D(q).
    monitor : (10,)
        Ramp, counts, noise variance and powers, see the kernel.
    early : (s,)
        The structure's parameters up to 31 samples before; NaN before the first time.
    omega, moments, blocks, colour : (s, s), (s, s), (7, s), (18,)
        Of innovations that stay coloured, see
        :mod:`service.identification.kernels.filtered_scores`.
    """

    state_version: ClassVar[int] = 3  # 2: knew nothing of U that reacts, nor of a drift

    theta: Floats
    factor: Floats
    spread: Floats
    prior: Floats
    rls_theta: Floats
    rls_factor: Floats
    raw: Floats
    filtered: Floats
    monitor: Floats
    early: Floats
    omega: Floats
    moments: Floats
    blocks: Floats
    colour: Floats

    def contents(self) -> Mapping[str, Contents]:
        """What may stand in them."""
        reacts = [REACTING + place for place in (reaction.JITTERY, reaction.SEEN)]
        of_colour = [GATHERED, BLOCKS, SQUARE, BLOCK_SQUARE, *reacts]
        squares = ("factor", "spread", "rls_factor", "omega", "moments")
        return {
            **{name: _with_positive_diagonal(getattr(self, name)) for name in squares},
            "prior": Contents(self.prior).within(0.0),
            "monitor": Contents(self.monitor)
            .within(0.0)
            .within(0.0, 1.0, [kernel.RAMP, kernel.DETERMINED]),
            "early": Contents(self.early).or_nan(),
            "colour": Contents(self.colour).within(0.0, where=of_colour),
        }


@dataclass(frozen=True)
class MaximumLikelihood:
    """Recursive maximum likelihood for a static map whose noise is a moving average.

    Q(t) = Xᵀ(t)·a + v(t) + d1·v(t-1) + … + d_nd·v(t-nd), v white. With
    h = [X(t), v̂(t-1) … v̂(t-nd)] and h_f = h/D̂(q), the constant column included, eq. (29) reads

        L = P·h_f / (λ + h_fᵀ·P·h_f),  ε = Q - hᵀθ̂(t-1),  θ̂ += L·ε,  P = (P - L·h_fᵀ·P)/λ

    and the noise fed back is the residual *after* the update, v̂ = Q - hᵀθ̂(t) (the printed
    equation feeds back ε and fails). A step that would make D̂(q) unstable is halved until it does
    not; λ rises from 0.95; the prior variance of d is small. ``lam`` < 1 forgets along h_f alone
    (Kulhavý 1987), so a level of U that is not visited is not forgotten. Plain RLS runs beside it,
    and where RML is worse for long, it starts again from there.

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
        """Refuse what has no meaning."""
        _check_settings(self.nd, self.lam, self.p0, self.radius)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The structure's names, then d1 … d_nd."""
        return self.structure.parameter_names + tuple(f"d{i + 1}" for i in range(self.nd))

    def with_forgetting(self, lam: float) -> Self:
        """Return the same estimator with another λ; a state fits both."""
        return replace(self, lam=lam)

    def initial_state(self) -> MaximumLikelihoodState:
        """Nothing known but the structure's prior: theta = 0, P = p0·I for scaled regressors."""
        state = _initial_state(self._orders(), self.p0)
        if isinstance(self.structure, StructureWithPrior):
            rows, values = self.structure.prior()
            kernel.learn(_memory(state), rows / self._scale, values)
        return state

    def update(
        self, state: MaximumLikelihoodState, samples: Samples
    ) -> tuple[MaximumLikelihoodState, Trace]:
        """Take N samples in; bad and non-finite ones leave the state untouched."""
        return update_one(self, state, samples)

    def update_many(
        self, states: MaximumLikelihoodState, samples: Samples, segments: Segments
    ) -> Trace:
        """Take the samples of many models in; their states are written in place."""
        X, good = self._scaled_regressors(samples.U, samples.dp, samples.T)
        good &= (samples.quality != Quality.BAD) & np.isfinite(samples.Q)
        rule = kernel.Rule(kernel.DIRECTIONAL, float(self.lam), float(self.radius))
        where = samples.U[good], samples.Q[good], segments.among(good)
        run = _run(states, rule, self._orders(), X[good], *where)
        # Where the samples so far tell nothing, nothing can be said.
        with np.errstate(invalid="ignore"):
            known = np.where(run.share <= kernel.UNDETERMINED, run.predicted, np.nan)
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
        lags = _lags_of(alone(state))
        memory = _memory(member(lags.without(alone(state)), 0))
        kernel.evaluate(memory, np.where(finite[:, None], X, 0.0), values, variances, share)
        known = finite & (share <= kernel.UNDETERMINED) & (state.monitor[kernel.COUNT] > 0)
        with np.errstate(all="ignore"):
            own = np.sqrt(variances * _noise_variance(state))
        (std,) = lags.beyond(X, own[None])
        return np.where(known, values, np.nan), np.where(known, std, np.nan)

    def parameters(self, state: MaximumLikelihoodState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations: the structure's in its units, d without unit."""
        theta, std = self.parameters_many(alone(state))
        return theta[0], std[0]

    def parameters_many(self, states: MaximumLikelihoodState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations of M ≥ 1 models, both (M, n)."""
        n, scale = len(self._scale), np.append(self._scale, np.ones(self.nd))
        lags = _lags_of(states)
        P, inflations = _diagonals(lags.without(states))
        determined = states.monitor[:, kernel.DETERMINED, None] > 0
        over = np.where(determined, np.diagonal(states.spread, axis1=1, axis2=2), P)
        with np.errstate(all="ignore"):
            variance = np.maximum(_noise_variances(states)[:, None] * over, 0.0)
        variance[:, :n] *= inflations
        std = np.sqrt(variance)
        std[:, :n] = lags.beyond(np.eye(n), std[:, :n])
        known = (P > 0) & (kernel.UNDETERMINED * states.prior >= P)
        known[:, len(scale) - self.nd :] = determined
        return states.theta / scale, np.where(known, std, np.nan) / scale

    def adaptation(self, state: MaximumLikelihoodState) -> Adaptation:
        """Undecided, as it does not tell misfit from drift, or reacting."""
        return Adaptation.REACTING if _reacts(state.colour) else Adaptation.UNDECIDED

    def adaptation_many(self, states: MaximumLikelihoodState) -> Codes:
        """`adaptation` of M models (M,)."""
        reacting = _reacts(states.colour)
        return np.where(reacting, Adaptation.REACTING, Adaptation.UNDECIDED).astype(np.uint8)

    def covariance(self, state: MaximumLikelihoodState) -> Floats:
        """Covariance (n, n) of the structure's parameters."""
        n = len(self._scale)
        wider = np.sqrt(_diagonals(alone(state))[1][0]) / self._scale
        return _parameter_covariance(state)[:n, :n] * np.outer(wider, wider)

    def information(self, state: MaximumLikelihoodState) -> Floats:
        """P⁻¹ (n, n) of the structure's parameters, whatever the noise model is."""
        n = len(self._scale)
        P = covariance(state.factor)[:n, :n] / np.outer(self._scale, self._scale)
        return np.asarray(np.linalg.inv(P))

    def root_margin(self, state: MaximumLikelihoodState) -> float:
        """1 - max|root of D̂(q)|: 1 for white noise, near 0 on the edge of invertibility."""
        n = len(state.theta)
        return float(root_margins(state.theta[None, n - self.nd :])[0])

    def _orders(self) -> kernel.Orders:
        return np.array([0] + [1] * len(self.structure.parameter_names) + [self.nd], np.int64)

    @cached_property
    def _scale(self) -> Floats:
        """Magnitude of each regressor over the nominal range: powers of two, exact to divide by."""
        grid = np.meshgrid(np.linspace(0, 100, 9), np.linspace(0, 200, 9), np.linspace(20, 60, 3))
        rows = self.structure.regressors(*(axis.ravel() for axis in grid))
        rms = np.sqrt(np.mean(rows**2, axis=0))
        scale: Floats = np.exp2(np.round(np.log2(np.where(rms > 0, rms, 1.0))))
        return scale

    def _scaled_regressors(
        self, U: Floats, dp: Floats, T: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Rows over their scale, and which of them are finite."""
        with np.errstate(all="ignore"):
            X = self.structure.regressors(U, dp, T) / self._scale
        return X, np.isfinite(U) & np.isfinite(dp) & np.isfinite(X).all(axis=1)


@dataclass(frozen=True)
class MaximumLikelihoodResult:
    """What `recursive_maximum_likelihood` found from N samples.

    Attributes
    ----------
    theta : (n,)
        Final parameters a1 … , b1 … of each input, d1 …
    theta_history : (N, n)
        Parameters after each sample.
    innovations, residuals : (N,)
        ε = y - hᵀθ̂ before, v̂ = y - hᵀθ̂ after the update; NaN where y is missing.
    covariance : (n, n)
        Covariance of theta: the noise variance times P.
    root_margin : (N,)
        1 - max|root of D̂(q)| after each sample.
    status : (N,)
        :class:`~service.identification.samples.Status`.
    restarts : int
        How often the estimate was judged lost, and begun again from plain RLS.
    """

    theta: Floats
    theta_history: Floats
    innovations: Floats
    residuals: Floats
    covariance: Floats
    root_margin: Floats
    status: Codes
    restarts: int


def recursive_maximum_likelihood(
    y: ArrayLike,
    u: ArrayLike,
    na: int,
    nb: int | Sequence[int],
    nd: int,
    forgetting: float = 1.0,
    p0: float = 1e4,
    *,
    theta0: ArrayLike | None = None,
    radius: float = 0.995,
) -> MaximumLikelihoodResult:
    """Identify A(q)·y = Σ B_k(q)·u_k + D(q)·v recursively by maximum likelihood, eq. (29).

    A = 1 + a1·q⁻¹ + …, B_k = b1·q⁻¹ + … + b_nb·q⁻ⁿᵇ, D = 1 + d1·q⁻¹ + …; the algorithm is that of
    :class:`MaximumLikelihood`.

    Parameters
    ----------
    y : (N,)
        Output; a NaN is a missing sample: its prediction takes its place among the lags.
    u : (N,) or (N, m)
        Inputs; where one is missing theta is held until it has left the lags.
    na, nb, nd : int
        Orders; ``nb`` may be a sequence, one order per input.
    forgetting : float
        λ of exponential forgetting, in (0, 1].
    p0 : float
        P(0) = p0·I for a and b, > 0, beyond 1e20 as 1e20; for d it is 0.1 over the noise variance.
    theta0 : (n,), optional
        Initial parameters; an unstable D is contracted.
    radius : float
        The roots of D̂(q) stay inside it, in (0, 1).

    Raises
    ------
    ValueError
        if shapes or orders do not fit.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u, v, y = rng.choice([-1.0, 1.0], 2000), rng.normal(size=2000), np.zeros(2000)
    >>> for t in range(1, 2000):
    ...     y[t] = 0.8 * y[t - 1] + u[t - 1] + v[t] + 0.5 * v[t - 1]
    >>> recursive_maximum_likelihood(y, u, na=1, nb=1, nd=1).theta.round(1)
    array([-0.8,  1. ,  0.5])
    """
    output = np.ascontiguousarray(y, np.float64)
    inputs = np.ascontiguousarray(u, np.float64)
    if inputs.ndim == 1:
        inputs = inputs[:, None]
    if output.ndim != 1 or inputs.ndim != 2 or len(inputs) != len(output):
        raise ValueError(f"y must be (N,) and u (N,) or (N, m), not {output.shape}, {np.shape(u)}")
    m = inputs.shape[1]
    lags = [nb] * m if isinstance(nb, int) else list(nb)
    if len(lags) != m:
        raise ValueError(f"nb has {len(lags)} orders for {m} inputs")
    orders = np.array([na, *lags, nd], np.int64)
    if (orders < 0).any() or orders.sum() == 0:
        raise ValueError(f"orders must be >= 0, and one > 0, not na={na}, nb={nb}, nd={nd}")
    _check_settings(nd, forgetting, p0, radius)

    state = _initial_state(orders, p0)
    n = len(state.theta)
    if theta0 is not None:
        start = np.array(theta0, np.float64)
        if start.shape != (n,) or not (np.abs(start) < kernel.LARGEST).all():
            raise ValueError(f"theta0 must be {n} finite numbers, not {theta0!r}")
        start[n - nd :] = _contracted(start[n - nd :], radius)
        state = replace(state, theta=start)

    X, use = _delayed(inputs, max(lags, default=0))
    use &= np.isfinite(output)
    history = np.empty((len(output), n))
    rule = kernel.Rule(kernel.EXPONENTIAL, float(forgetting), float(radius))
    fleet, whole = repeated(state, 1), Segments.one(len(output))
    no_U = np.zeros(len(output))
    run = _run(fleet, rule, orders, X, no_U, output, whole, use.astype(np.uint8), history)
    state = member(fleet, 0)
    return MaximumLikelihoodResult(
        theta=state.theta,
        theta_history=history,
        innovations=output - run.predicted,
        residuals=run.posterior,
        covariance=_parameter_covariance(state),
        root_margin=root_margins(np.ascontiguousarray(history[:, n - nd :])),
        status=run.status,
        restarts=int(state.monitor[kernel.RESTARTS]),
    )


@dataclass(frozen=True)
class _Run:
    predicted: Floats
    posterior: Floats
    early: Floats
    share: Floats
    status: Codes


def _run(
    states: MaximumLikelihoodState,
    rule: kernel.Rule,
    orders: kernel.Orders,
    X: Floats,
    U: Floats,
    y: Floats,
    segments: Segments,
    use: Codes | None = None,
    history: Floats | None = None,
) -> _Run:
    """Run the kernel; the states' arrays, with a leading axis, are written in place."""
    N, n = len(y), states.theta.shape[1]
    values, status = np.empty((4, N)), np.empty(N, np.uint8)
    found = _Run(values[0], values[1], values[2], values[3], status)
    kernel.run(
        _memory(states),
        rule,
        orders,
        np.ascontiguousarray(X),
        U,
        np.ascontiguousarray(y),
        np.ones(N, np.uint8) if use is None else use,
        found.predicted,
        found.posterior,
        found.early,
        found.share,
        found.status,
        np.empty((0, n)) if history is None else history,
        segments,
        np.zeros((kernel.SCRATCH, n)),
    )
    return found


def _memory(state: MaximumLikelihoodState) -> kernel.Memory:
    return kernel.Memory(*(getattr(state, name) for name in kernel.Memory._fields))


def _initial_state(orders: kernel.Orders, p0: float) -> MaximumLikelihoodState:
    n, nd = int(orders.sum()), int(orders[-1])
    ns = n - nd
    p0 = min(float(p0), kernel.BOUNDLESS)
    unknown = max(p0, kernel.OPEN)
    channels = (len(orders), max(1, int(orders.max())))
    monitor = np.zeros(kernel.PLACES)
    monitor[kernel.RAMP] = kernel.RAMP_START if nd > 0 else 1.0
    return MaximumLikelihoodState(
        theta=np.zeros(n),
        factor=np.diag(np.append(np.full(ns, p0), np.zeros(nd))),
        spread=np.zeros((n, n)),
        prior=np.append(np.full(ns, unknown), np.zeros(nd)),
        rls_theta=np.zeros(ns),
        rls_factor=np.diag(np.full(ns, unknown)),
        raw=np.zeros(channels),
        filtered=np.zeros(channels),
        monitor=monitor,
        early=np.full(ns, np.nan),
        omega=np.zeros((ns, ns)),
        moments=np.zeros((ns, ns)),
        blocks=np.zeros((ROWS_OF_BLOCKS, ns)),
        colour=np.zeros(PLACES_OF_COLOUR),
    )


def _with_positive_diagonal(square: Floats) -> Contents:
    places = np.arange(len(square))
    return Contents(square).within(0.0, where=(places, places))


def _delayed(inputs: Floats, lags: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Rows u(t-1), gaps filled with the value before; and where no gap is among the lags."""
    finite = np.isfinite(inputs)
    rows = np.where(finite, np.arange(len(inputs))[:, None], -1)
    rows = np.maximum.accumulate(rows, axis=0) if len(rows) else rows
    filled = np.where(rows >= 0, np.take_along_axis(inputs, np.maximum(rows, 0), axis=0), 0.0)
    delayed = np.zeros_like(inputs)
    delayed[1:] = filled[:-1]
    gaps = np.concatenate([np.zeros(1), np.cumsum(~finite.all(axis=1))])
    t = np.arange(len(inputs))
    return delayed, gaps[t] == gaps[np.maximum(t - lags, 0)]


def _contracted(d: Floats, radius: float) -> Floats:
    """D with its roots drawn towards 0 until the largest lies well inside ``radius``."""
    if is_stable(d, radius):
        return d
    largest = 1.0 - root_margins(d[None, :])[0]
    result: Floats = d * (0.9 * radius / largest) ** np.arange(1, len(d) + 1)
    return result


def _noise_variance(state: MaximumLikelihoodState) -> float:
    """σ² of the innovation; NaN before the first sample."""
    return float(_noise_variances(alone(state))[0])


def _noise_variances(states: MaximumLikelihoodState) -> Floats:
    known = states.monitor[:, kernel.WEIGHT] > 0
    return np.where(known, states.monitor[:, kernel.VARIANCE], np.nan)


def _parameter_covariance(state: MaximumLikelihoodState) -> Floats:
    """Covariance of theta (n, n), an upper bound until theta is determined."""
    over = covariance(state.factor)
    if state.monitor[kernel.DETERMINED] > 0:
        over = _mirrored(state.spread[None])[0]  # what lies above the diagonal is no part of it
    with np.errstate(all="ignore"):
        return np.asarray(_noise_variance(state) * over)


@dataclass(frozen=True)
class _Lags:
    """What theta lags by behind plants that surely drift, M of the models.

    The scores of the last samples have the mean M·Delta theta. A place that was visited just now
    lags by nothing, one that was visited long ago by more than that.

    Attributes
    ----------
    sure : (models,)
        Which models they are.
    score, theta : (M, s)
        Mean of the scores, and the lag.
    doubt : (M, s, s)
        Covariance of that lag; Omega holds the lag too, so it is rather too large.
    over_all : (M,)
        Mean square of the lag over the samples, (l/min)².
    """

    sure: NDArray[np.bool_]
    score: Floats
    theta: Floats
    doubt: Floats
    over_all: Floats

    def without(self, states: MaximumLikelihoodState) -> MaximumLikelihoodState:
        """States whose Omega is that of the noise: to scores, a lag is noise that lasts."""
        if not self.sure.any():
            return states
        omega = states.omega.copy()
        # Two blocks at a time, as Omega is gathered.
        omega[self.sure] -= 2.0 * BLOCK * self.score[:, :, None] * self.score[:, None, :]
        return replace(states, omega=omega)

    def beyond(self, X: Floats, std: Floats) -> Floats:
        """Standard deviations (models, N) at rows X with the lag, from those without."""
        if not self.sure.any():
            return std
        with np.errstate(all="ignore"):
            # No BLAS over the rows: each has the same bits alone and among others.
            here, chance = (X * self.theta[:, None]).sum(axis=2) ** 2, np.zeros(1)
            for j in range(X.shape[1]):
                chance = chance + X[:, j] * (X * self.doubt[:, None, j]).sum(axis=2)
            lags = np.maximum(here - chance, 0.0) + UNEVEN * self.over_all[:, None]
            lags = np.where(np.isfinite(lags), lags, 0.0)
            wider = std.copy()
            wider[self.sure] = np.sqrt(std[self.sure] ** 2 + lags)
        return wider


def _lags_of(states: MaximumLikelihoodState) -> _Lags:
    """Lags of those models whose last scores have a mean beyond chance."""
    samples = np.minimum(BLOCK * states.colour[:, BLOCKS], 2.0 * LATELY)
    sure = samples >= FEWEST * BLOCK
    M, Omega = (_mirrored(square[sure]) for square in (states.moments, states.omega))
    score = states.blocks[sure, SCORE]
    with np.errstate(all="ignore"):
        inverse = np.linalg.pinv(M, hermitian=True)
        theta = (inverse @ score[:, :, None])[:, :, 0]
        doubt = inverse @ Omega @ inverse / samples[sure, None, None]
        over_all = (score * theta).sum(axis=1)
        chance = np.trace(doubt @ M, axis1=1, axis2=2)
        beyond = over_all > CHANCE * chance
    sure[sure] = beyond
    found = score[beyond], theta[beyond], doubt[beyond], (over_all - chance)[beyond]
    return _Lags(sure, *found)


def _mirrored(squares: Floats) -> Floats:
    """Symmetric matrices (M, n, n) of which the lower triangles are kept."""
    return np.asarray(np.tril(squares) + np.tril(squares, -1).transpose(0, 2, 1))


def _diagonals(states: MaximumLikelihoodState) -> tuple[Floats, Floats]:
    """P's diagonals (M, n), and how many times wider than in white noise variances are (M, s)."""
    P, inflations = np.empty(states.theta.shape), np.empty(states.rls_theta.shape)
    kernel.diagonals(_memory(states), P, inflations)
    return P, inflations


def _reacts(colours: Floats) -> NDArray[np.bool_]:
    return np.asarray(reaction.reacts(colours, REACTING))


def _check_settings(nd: int, lam: float, p0: float, radius: float) -> None:
    if not 0 <= nd <= 8:
        raise ValueError(f"nd is {nd}; 0 to 8 is allowed")
    if not 0 < lam <= 1:
        raise ValueError(f"forgetting factor is {lam}; 0 < lam <= 1 is allowed")
    if not p0 > 0:
        raise ValueError(f"p0 is {p0}; a positive number is allowed")
    if not 0 < radius < 1:
        raise ValueError(f"radius is {radius}; 0 < radius < 1 is allowed")
