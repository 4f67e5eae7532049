"""Recursive least squares with forgetting, eqs. (17)-(28), in exact and bounded arithmetic."""

from dataclasses import dataclass, replace
from typing import Self, TypeVar, assert_never

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from service.identification.estimator import State
from service.identification.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Forgetting,
    Resetting,
    SlidingWindow,
    Subspace,
    Variable,
    with_lam,
)
from service.identification.kernels import change_detection, recursion
from service.identification.kernels.change_detection import Counts
from service.identification.kernels.factors import covariance, rotate_in
from service.identification.kernels.recursion import Batch, Memory, Rule
from service.identification.kernels.stepwise import run_stepwise
from service.identification.model_structures import FiveTerms, Structure, StructureWithPrior
from service.identification.samples import Codes, Floats, Quality, Samples, Times, Trace

A = TypeVar("A", Floats, Times)


@dataclass(frozen=True)
class RlsState(State):
    """What recursive least squares knows.

    Attributes
    ----------
    theta : (n,)
        Parameters; where the samples leave a direction open, its parameter is 0.
    factor : (n, n)
        The triangle R with RᵀR = P⁻¹ until theta is determined, and as long as regressors nearly
        depend on each other; from then on Uᵀ with D on its diagonal, P = U·D·Uᵀ.
    rhs : (n,)
        z of R·theta = z; unused with U·D·Uᵀ.
    spread : (n, n)
        What the noise has made of theta, over σ²: with rules that divide P by λ the covariance Z
        of P⁻¹·theta (that of theta is P·Z·P), with the others the covariance of theta.
    scale : (n,)
        Largest |Xⱼ| so far: thresholds are in its units.
    noise : (4,)
        Sum of the weights and of their squares, estimate of σ², trace of P in units of the scales.
    counters : (6,)
        Samples used; 1 with U·D·Uᵀ, 0 with R; place and fill of the window; 1 if P holds samples
        from before it; sample number at which the memory was last opened.
    window : (length, n + 1)
        The last samples of a sliding window, X and y; no rows with other rules.
    detector, history, score, previous : (10,), (5,), (n,), (n,)
        Change detection, see :mod:`service.identification.kernels.change_detection`.
    """

    theta: Floats
    factor: Floats
    rhs: Floats
    spread: Floats
    scale: Floats
    noise: Floats
    counters: Counts
    window: Floats
    detector: Floats
    history: Counts
    score: Floats
    previous: Floats


@dataclass(frozen=True)
class Change:
    """A change of the plant that :class:`~service.identification.forgetting.Adaptive` found.

    Attributes
    ----------
    count : int
        How many changes were found so far, this one included.
    sample : int
        Number of the first sample (of those used, from 0) after the change, as estimated.
    t : int
        Time of the last sample before it, UTC ns.
    size : float
        Mean innovation from the change to its detection, l/min.
    """

    count: int
    sample: int
    t: int
    size: float


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
    the earlier ones fix Xᵀ·theta (NaN if not). P is kept as a triangular factor, so it is never
    asymmetric or indefinite.

    Parameters
    ----------
    structure
        Which regressors X(U, dp, T) the flow is linear in.
    forgetting
        A rule of :mod:`service.identification.forgetting`.
    p0
        P(0) = p0·I in physical units, > 0; a finite one is ridge regression, not eq. (16).

    Examples
    --------
    >>> from service.identification.samples import Samples
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

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of theta's elements."""
        return self.structure.parameter_names

    @property
    def lam(self) -> float:
        """Forgetting factor λ."""
        return self.forgetting.lam

    def with_forgetting(self, lam: float) -> Self:
        """Use another λ in the same rule; states may be carried over.

        Raises
        ------
        ValueError
            if λ is not in (0, 1].
        """
        return replace(self, forgetting=with_lam(self.forgetting, lam))

    def initial_state(self) -> RlsState:
        """State before the first sample."""
        prior = self.structure.prior() if isinstance(self.structure, StructureWithPrior) else None
        return initial_state(len(self.parameter_names), self.forgetting, self.p0, prior)

    def update(self, state: RlsState, samples: Samples) -> tuple[RlsState, Trace]:
        """Take N samples in, one after another."""
        X = self.structure.regressors(samples.U, samples.dp, samples.T)
        usable = samples.quality != Quality.BAD
        for signal in (samples.U, samples.dp):  # a structure may clip what it is given
            usable &= np.abs(signal) <= recursion.LARGEST
        n, none = len(state.theta), 0
        return _run(
            state, self.forgetting, samples.t, X, samples.Q, usable.astype(np.uint8),
            np.empty((none, n)), np.empty((none, 3)),
        )  # fmt: skip

    def predict(self, state: RlsState, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Flow Q̂ (N,) and its standard deviation (N,), l/min; NaN if unknown."""
        return predict(state, self.structure.regressors(U, dp, T), self.forgetting)

    def parameters(self, state: RlsState) -> tuple[Floats, Floats]:
        """Theta (n,) and its standard deviations (n,), NaN while not determined."""
        theta = state.theta.copy()
        if not _is_determined(state):
            values, _ = predict(state, np.eye(len(theta)), self.forgetting)
            theta[np.isnan(values)] = np.nan
        return theta, np.sqrt(
            np.maximum(np.diag(parameter_covariance(state, self.forgetting)), 0.0)
        )

    def last_change(self, state: RlsState) -> Change | None:
        """Return the last change of the plant that was found, None if there was none."""
        history = state.history.tolist()
        if not history[change_detection.CHANGES]:
            return None
        return Change(
            count=history[change_detection.CHANGES],
            sample=history[change_detection.SAMPLE] - 1,
            t=history[change_detection.TIME],
            size=float(state.detector[change_detection.SIZE]),
        )


@dataclass(frozen=True)
class RlsResult:
    """Result of :func:`recursive_least_squares` over N samples with n regressors.

    Attributes
    ----------
    theta : (n,)
        Parameters after the last sample.
    theta_history : (N, n)
        Parameters after each sample; open directions are 0.
    innovations : (N,)
        y - Xᵀtheta before each sample; NaN where the samples before do not fix Xᵀtheta.
    covariance : (n, n)
        Covariance of theta (σ² estimated from the innovations); NaN while not determined.
    status : (N,)
        :class:`~service.identification.samples.Status`.
    changes : (C, 3)
        A row per detected change of the plant (`Adaptive` only): sample of the alarm, first sample
        after the change as estimated, mean innovation from there to the alarm.
    """

    theta: Floats
    theta_history: Floats
    innovations: Floats
    covariance: Floats
    status: Codes
    changes: Floats


def recursive_least_squares(
    X: ArrayLike, y: ArrayLike, forgetting: float | Forgetting = 1.0, p0: float = np.inf
) -> RlsResult:
    """Recursive least squares over arrays, one sample after another.

    Parameters
    ----------
    X : (N, n)
        Regressors.
    y : (N,)
        Output.
    forgetting
        λ of exponential forgetting, or a rule of :mod:`service.identification.forgetting`.
    p0
        P(0) = p0·I; infinite: exact least squares from the first samples on.

    Raises
    ------
    ValueError
        if shapes do not fit, or λ or p0 is out of range.

    Examples
    --------
    >>> recursive_least_squares([[1, 0], [1, 1], [1, 2], [1, 3]], [1, 3, 5, 7]).theta.round(9)
    array([1., 2.])
    """
    regressors = np.ascontiguousarray(X, dtype=np.float64)
    output = np.ascontiguousarray(y, dtype=np.float64)
    if regressors.ndim != 2 or output.shape != regressors.shape[:1]:
        raise ValueError(
            f"X {regressors.shape} and y {output.shape} do not fit: (N, n) and (N,) are wanted"
        )
    rule = Exponential(float(forgetting)) if isinstance(forgetting, int | float) else forgetting
    if not p0 > 0.0:
        raise ValueError(f"p0 = {p0!r} is not positive")
    N, n = regressors.shape
    state = initial_state(n, rule, p0)
    thetas, changes = np.empty((N, n)), np.empty((N // change_detection.EVERY + 1, 3))
    state, trace = _run(
        state, rule, np.arange(N), regressors, output, np.ones(N, np.uint8), thetas, changes
    )
    return RlsResult(
        theta=state.theta,
        theta_history=thetas,
        innovations=trace.residual,
        covariance=parameter_covariance(state, rule),
        status=trace.status,
        changes=changes[: state.history[change_detection.CHANGES]],
    )


def initial_state(
    n: int,
    forgetting: Forgetting,
    p0: float = np.inf,
    prior: tuple[Floats, Floats] | None = None,
) -> RlsState:
    """State of n parameters before the first sample; ``prior``: rows (R, n) and values (R,)."""
    length = forgetting.length if isinstance(forgetting, SlidingWindow) else 0
    memory = Memory(
        theta=np.zeros(n),
        factor=np.eye(n) / np.sqrt(p0),
        rhs=np.zeros(n),
        spread=np.eye(n) / p0,
        scale=np.zeros(n),
        noise=np.zeros(recursion.PLACES_OF_NOISE),
        counters=np.zeros(recursion.PLACES_OF_COUNTERS, np.int64),
        window=np.zeros((length, n + 1)),
        detector=np.zeros(change_detection.PLACES_OF_DETECTOR),
        history=np.zeros(change_detection.PLACES_OF_HISTORY, np.int64),
        score=np.zeros(n),
        previous=np.zeros(n),
    )
    if prior is not None:
        rows, values = prior
        memory.spread[:] += rows.T @ rows
        np.max(np.abs(rows), axis=0, initial=0.0, out=memory.scale)
        for i, (row, value) in enumerate(zip(rows, values, strict=True)):
            rotate_in(memory.factor, memory.rhs, row.copy(), value, 1.0, memory.scale, i)
    recursion.determine(
        memory.theta,
        memory.factor,
        memory.rhs,
        memory.spread,
        memory.scale,
        memory.noise,
        memory.counters,
        _rule(forgetting).kind,
    )
    return RlsState(**memory._asdict())


def predict(state: RlsState, X: Floats, forgetting: Forgetting) -> tuple[Floats, Floats]:
    """Xᵀ·theta (N,) at N rows of X and its standard deviation (N,); NaN if unknown."""
    values, variances = np.empty(len(X)), np.empty(len(X))
    recursion.evaluate(
        state.theta,
        state.factor,
        parameter_covariance(state, forgetting),
        state.scale,
        state.counters,
        _writable(X),
        values,
        variances,
    )
    return values, np.sqrt(variances)


def parameter_covariance(state: RlsState, forgetting: Forgetting) -> Floats:
    """Covariance of theta (n, n): σ² from the innovations; NaN while not determined."""
    return _spread(state, forgetting) * _noise_variance(state)


def _spread(state: RlsState, forgetting: Forgetting) -> Floats:
    """Covariance of theta over σ²."""
    if not _is_determined(state):
        return np.full_like(state.factor, np.nan)
    if state.counters[recursion.FACTORED]:
        P = np.asarray(covariance(state.factor))
    else:
        inverse = solve_triangular(state.factor, np.eye(len(state.theta)))
        P = inverse @ inverse.T
    equal_weights = state.noise[recursion.WEIGHT] == state.noise[recursion.SQUARES]
    match forgetting:
        case Directional() | Subspace() | Adaptive():
            return state.spread
        case Exponential() | Variable() | Resetting() if not equal_weights:
            return np.asarray(P @ state.spread @ P)
        case _:
            return P


def _is_determined(state: RlsState) -> bool:
    return bool(state.counters[recursion.FACTORED]) or bool(np.diag(state.factor).all())


def _noise_variance(state: RlsState) -> float:
    """σ² (NaN before the first innovation)."""
    return float(state.noise[recursion.VARIANCE]) if state.noise[recursion.WEIGHT] else np.nan


def _run(
    state: RlsState,
    forgetting: Forgetting,
    t: Times,
    X: Floats,
    y: Floats,
    usable: Codes,
    thetas: Floats,
    changes: Floats,
) -> tuple[RlsState, Trace]:
    N = len(y)
    memory = _memory(state)
    batch = Batch(
        t=_writable(t),
        X=_writable(X),
        y=_writable(y),
        usable=usable,
        predicted=np.empty(N),
        residual=np.empty(N),
        status=np.empty(N, np.uint8),
        thetas=thetas,
        changes=changes,
    )
    match forgetting:
        case Resetting() | Subspace() | SlidingWindow():
            run_stepwise(memory, _rule(forgetting), batch)
        case _:
            recursion.run(memory, _rule(forgetting), batch)
    trace = Trace(predicted=batch.predicted, residual=batch.residual, status=batch.status)
    return RlsState(**memory._asdict()), trace


def _writable(array: A) -> A:
    """The array or a copy: the kernel is compiled once, for plain writable arrays."""
    return np.require(array, requirements=["C", "W", "A"])


def _memory(state: RlsState) -> Memory:
    """Copies that a kernel may write into."""
    return Memory(*(np.array(getattr(state, name)) for name in Memory._fields))


def _rule(forgetting: Forgetting) -> Rule:
    match forgetting:
        case Exponential(lam):
            rule = Rule(recursion.EXPONENTIAL, lam)
        case Variable(lam, least):
            rule = Rule(recursion.VARIABLE, lam, least)
        case Resetting(lam, information):
            rule = Rule(recursion.RESETTING, lam, information)
        case Directional(lam):
            rule = Rule(recursion.DIRECTIONAL, lam)
        case Subspace(lam):
            rule = Rule(recursion.SUBSPACE, lam)
        case SlidingWindow():
            rule = Rule(recursion.WINDOW, forgetting.lam)
        case Adaptive(lam, threshold):
            rule = Rule(recursion.DIRECTIONAL, lam, threshold=threshold)
        case _:
            assert_never(forgetting)
    return rule
