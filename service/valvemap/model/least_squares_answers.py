"""What a state of recursive least squares says: parameters, flows, and their uncertainty."""

import numpy as np

from valvemap.model.forgetting import Forgetting
from valvemap.model.forgetting_rules import keeps_all, rule_of
from valvemap.model.kernels import reaction, uncertainty
from valvemap.model.kernels.factors import covariance
from valvemap.model.kernels.linear_answers import evaluate
from valvemap.model.kernels.place_layout import PROVEN
from valvemap.model.kernels.recursion import Memory
from valvemap.model.kernels.row_layout import (
    FACTORED,
    FLOOR,
    HASTE,
    MISFIT,
    MISFIT_POWER,
    NEW,
    PRODUCT,
    REACTION,
    REVISITED,
    SQUARES,
    VARIANCE,
    WEIGHT,
)
from valvemap.model.kernels.rules import RESETTING
from valvemap.model.least_squares_state import RlsState, writable
from valvemap.model.samples import Codes, Flags, Floats
from valvemap.vocabulary.statuses import Adaptation

BEHIND = 0.9  # factor on the common part of recent innovations: the bias of a map that drifts
EXACT = 1e-30  # relative to the largest pivot of P; smaller ones have no uncertainty
LEAST = 1e-150  # pivot of P if all have no uncertainty
REVISITS = 30.0  # visits of places before misfit can be judged
MISFITS = 0.25  # ratio of misfit to noise, mean squares, from which the structure does not fit


def predict(state: RlsState, X: Floats, forgetting: Forgetting) -> tuple[Floats, Floats]:
    """Xᵀ·theta (N,) at N rows of X and its standard deviation (N,); NaN if unknown."""
    values, variances = np.empty(len(X)), np.empty(len(X))
    evaluate(
        state.theta,
        state.R,
        parameter_covariance(state, forgetting),
        state.scale,
        state.counters,
        writable(X),
        values,
        variances,
    )
    if keeps_all(forgetting) and state.detector[HASTE] > PROVEN:
        variances += BEHIND * max(0.0, float(state.detector[PRODUCT]))
    return values, np.sqrt(variances)


def adaptations(detectors: Floats, forgetting: Forgetting) -> Codes:
    """:class:`~valvemap.vocabulary.statuses.Adaptation` of M models from their detectors."""
    reacting = reaction.reacts(detectors, REACTION)
    if not keeps_all(forgetting):
        return np.where(reacting, Adaptation.REACTING, Adaptation.UNDECIDED).astype(np.uint8)
    noise, seen = np.maximum(detectors[:, MISFIT_POWER], 0.0), detectors[:, REVISITED]
    misfit = (detectors[:, MISFIT] > MISFITS * noise) & (noise > 0.0)
    found = np.where(misfit, Adaptation.MISFIT, Adaptation.STEADY)
    new = detectors[:, NEW] > np.maximum(detectors[:, FLOOR], detectors[:, MISFIT])
    undecided = (seen < REVISITS) | (new & (detectors[:, NEW] > 0.0))
    found = np.where(undecided, Adaptation.UNDECIDED, found)
    found = np.where(detectors[:, HASTE] > PROVEN, Adaptation.DRIFT, found)
    return np.where(reacting, Adaptation.REACTING, found).astype(np.uint8)


def known_theta(state: RlsState) -> Floats:
    """Theta (n,), NaN where the samples do not determine it."""
    if is_determined(state):
        return state.theta.copy()
    n = len(state.rhs)
    values, unknown = np.empty(n), np.full((n, n), np.nan)
    known = writable(state.theta), writable(state.R), unknown, writable(state.scale)
    evaluate(*known, state.counters, np.eye(n), values, np.empty(n))
    return values


def parameter_covariance(state: RlsState, forgetting: Forgetting) -> Floats:
    """Covariance of theta (n, n): noise from the innovations; NaN while not determined."""
    kind, scored = rule_of(forgetting, len(state.rhs)).kind, int(keeps_all(forgetting))
    if state.counters[FACTORED] and state.noise[WEIGHT]:
        found = np.empty_like(state.R)
        uncertainty.parameter_covariance(writable(state.row), kind, scored, found)
        return found
    P = matrix_P(state)
    if kind <= RESETTING and state.noise[WEIGHT] != state.noise[SQUARES]:
        P = P @ _symmetric(state.spread) @ P
    return np.asarray(P * _noise_variance(state))


def variances(fleet: RlsState, forgetting: Forgetting) -> tuple[Floats, Flags]:
    """Variance of each parameter of M models (M, n), and whether it is available (M,)."""
    known = np.empty(fleet.theta.shape)
    kind = rule_of(forgetting, fleet.rhs.shape[-1]).kind
    scored = int(keeps_all(forgetting))
    uncertainty.parameter_variances(writable(fleet.row), kind, scored, known)
    return known, (fleet.counters[:, FACTORED] == 1) & (fleet.noise[:, WEIGHT] > 0.0)


def parameter_variance(state: RlsState, forgetting: Forgetting) -> Floats:
    """Variance of each parameter (n,), as `variances`; NaN while not determined."""
    alone = RlsState(*(getattr(state, name)[None] for name in Memory._fields))
    known, is_known = variances(alone, forgetting)
    return known[0] if is_known[0] else np.diag(parameter_covariance(state, forgetting))


def matrix_P(state: RlsState) -> Floats:
    """P (n, n) of eqs. (17)-(28), the inverse information; NaN while theta is not determined."""
    if not is_determined(state):
        return np.full_like(state.R, np.nan)
    if state.counters[FACTORED]:
        return np.asarray(covariance(state.factor))
    inverse = np.linalg.inv(state.R)  # triangular: no pivoting
    return np.asarray(inverse @ inverse.T)


def information(state: RlsState) -> Floats:
    """P⁻¹ (n, n), the inverse of `matrix_P`; singular while theta is not determined."""
    if state.counters[FACTORED]:
        d = np.diag(state.factor)
        d = np.maximum(d, max(EXACT * d.max(), LEAST))
        V = np.tril(state.factor, -1) + np.eye(len(d))
        inverse = np.linalg.inv(V)  # with ones on the diagonal: P itself may be singular
        return np.asarray((inverse / d) @ inverse.T)
    return np.asarray(state.R.T @ state.R)


def is_determined(state: RlsState) -> bool:
    """Whether the samples determine theta."""
    return bool(state.counters[FACTORED]) or bool(np.diag(state.R).all())


def _noise_variance(state: RlsState) -> float:
    """σ² (NaN before the first innovation)."""
    return float(state.noise[VARIANCE]) if state.noise[WEIGHT] else np.nan


def _symmetric(lower: Floats) -> Floats:
    return np.asarray(lower + np.tril(lower, -1).T)
