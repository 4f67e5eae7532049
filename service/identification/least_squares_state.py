"""The state of recursive least squares, and what can be done with it, on plain arrays."""

from dataclasses import dataclass
from typing import TypeVar, assert_never

import numpy as np

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
)
from service.identification.kernels import change_detection, recursion
from service.identification.kernels.change_detection import Counts
from service.identification.kernels.factors import covariance, rotate_in
from service.identification.kernels.recursion import Batch, Memory, Rule
from service.identification.kernels.stepwise import run_stepwise
from service.identification.samples import Codes, Floats, Times, Trace

A = TypeVar("A", Floats, Times, Codes)


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
    detector, history, score, variance, previous : (13,), (5,), (n,), (n, n), (n,)
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
    variance: Floats
    previous: Floats


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
        variance=np.zeros((n, n)),
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
        rule_of(forgetting).kind,
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


def variances(fleet: RlsState, forgetting: Forgetting) -> Floats | None:
    """Variance of each parameter of M models (M, n); None where it is not at hand for all."""
    ready = (fleet.counters[:, recursion.FACTORED] == 1) & (fleet.noise[:, recursion.WEIGHT] > 0.0)
    match forgetting:
        case Directional() | Subspace() | Adaptive() if ready.all():
            own = np.diagonal(fleet.spread, axis1=1, axis2=2)
            return np.asarray(own * fleet.noise[:, recursion.VARIANCE, None])
        case _:
            return None


def _spread(state: RlsState, forgetting: Forgetting) -> Floats:
    """Covariance of theta over σ²."""
    P = matrix_P(state)
    equal_weights = state.noise[recursion.WEIGHT] == state.noise[recursion.SQUARES]
    match forgetting:
        case Directional() | Subspace() | Adaptive() if is_determined(state):
            return state.spread
        case Exponential() | Variable() | Resetting() if not equal_weights:
            return np.asarray(P @ state.spread @ P)
        case _:
            return P


def matrix_P(state: RlsState) -> Floats:
    """P (n, n) of eqs. (17)-(28), the inverse information; NaN while theta is not determined."""
    if not is_determined(state):
        return np.full_like(state.factor, np.nan)
    if state.counters[recursion.FACTORED]:
        return np.asarray(covariance(state.factor))
    inverse = np.linalg.inv(state.factor)  # of a triangle: no row is ever exchanged
    return np.asarray(inverse @ inverse.T)


def information(state: RlsState) -> Floats:
    """P⁻¹ (n, n), the inverse of `matrix_P`; singular while theta is not determined."""
    if state.counters[recursion.FACTORED]:
        return np.asarray(np.linalg.inv(covariance(state.factor)))
    return np.asarray(state.factor.T @ state.factor)


def is_determined(state: RlsState) -> bool:
    """Whether the samples determine theta."""
    return bool(state.counters[recursion.FACTORED]) or bool(np.diag(state.factor).all())


def _noise_variance(state: RlsState) -> float:
    """σ² (NaN before the first innovation)."""
    return float(state.noise[recursion.VARIANCE]) if state.noise[recursion.WEIGHT] else np.nan


def learn(
    state: RlsState,
    forgetting: Forgetting,
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    thetas: Floats | None = None,
    changes: Floats | None = None,
) -> tuple[RlsState, Trace]:
    """Take N samples in, one after another.

    Parameters
    ----------
    state, forgetting
        State before; rule of forgetting, the one the state was made for.
    X, y, t, usable : (N, n), (N,), (N,), (N,)
        Regressors, output, times; where ``usable`` is 0 the state is not touched.
    thetas : (N, n), optional
        Written: theta after each sample.
    changes : (C, 3), optional
        Written: the first C detected changes, see `RlsResult`.
    """
    memory, batch = memory_of(state), batch_of(X, y, t, usable, thetas, changes)
    match forgetting:
        case Resetting() | SlidingWindow():
            run_stepwise(memory, rule_of(forgetting), batch)
        case _:
            recursion.run(memory, rule_of(forgetting), batch)
    trace = Trace(predicted=batch.predicted, residual=batch.residual, status=batch.status)
    return RlsState(**memory._asdict()), trace


def batch_of(
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    thetas: Floats | None = None,
    changes: Floats | None = None,
) -> Batch:
    """Pack samples, and room for what becomes of them, for a kernel."""
    N = len(y)
    return Batch(
        t=_writable(t),
        X=_writable(X),
        y=_writable(y),
        usable=_writable(usable),
        predicted=np.empty(N),
        residual=np.empty(N),
        status=np.empty(N, np.uint8),
        thetas=np.empty((0, X.shape[1])) if thetas is None else thetas,
        changes=np.empty((0, 3)) if changes is None else changes,
    )


def _writable(array: A) -> A:
    """The array or a copy: the kernel is compiled once, for plain writable arrays."""
    return np.require(array, requirements=["C", "W", "A"])


def memory_of(state: RlsState) -> Memory:
    """Copies that a kernel may write into."""
    return Memory(*(np.array(getattr(state, name)) for name in Memory._fields))


def rule_of(forgetting: Forgetting) -> Rule:
    """The rule in numbers, for a kernel."""
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
        case Adaptive(lam, least, threshold):
            rule = Rule(recursion.SUBSPACE, lam, least, threshold)
        case _:
            assert_never(forgetting)
    return rule
