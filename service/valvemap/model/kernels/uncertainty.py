"""Covariance of the parameters."""

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.kernels.place_layout import PROVEN
from valvemap.model.kernels.row_layout import (
    BLOCKS,
    HASTE,
    SQUARES,
    VARIANCE,
    WEIGHT,
    Places,
    places_of,
)
from valvemap.model.kernels.rules import RESETTING, WINDOW
from valvemap.model.kernels.scores import BLOCK, FEWEST, REACTS, STUDENT, is_coloured
from valvemap.model.samples import Floats


@kernel
def parameter_variances(rows: Floats, kind: int, scored: int, variances: Floats) -> None:
    """Write the variance of each parameter (M, n) of models in the covariance form.

    ``kind`` is that of forgetting; ``scored`` is 1 for a rule that uses the scores.
    """
    M, n = variances.shape
    P, A, C = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for m in range(M):
        _covariance(rows[m], kind, scored, P, A, C)
        for i in range(n):
            variances[m, i] = max(C[i, i], 0.0)


@kernel
def parameter_covariance(row: Floats, kind: int, scored: int, C: Floats) -> None:
    """Write the covariance (n, n) of the parameters of a model in the covariance form."""
    _covariance(row, kind, scored, np.empty_like(C), np.empty_like(C), C)


@inner
def _covariance(s: Floats, kind: int, scored: int, P: Floats, A: Floats, C: Floats) -> None:
    """P·Z·P with rules that divide P by λ, else P - P·(P⁻¹ - Z)·P, times σ²; or from the scores."""
    n = len(C)
    at = places_of(n)
    p = 0
    for i in range(n):
        for k in range(i + 1):
            A[i, k] = s[at.spread + p]
            A[k, i] = s[at.spread + p]
            total = 0.0
            for j in range(i, n):
                own = at.factor + j * (j + 1) // 2
                left = s[own + i] if i < j else 1.0
                right = s[own + k] if k < j else 1.0
                total += left * s[own + j] * right
            P[i, k] = total
            P[k, i] = total
            p += 1
    drifts = s[at.detector + HASTE] > PROVEN
    if scored == 1 and not drifts and is_coloured(s, at.detector):
        _long_run(s, at, P, A, C)
    else:
        _sandwich(P, A, C)
        equal_weights = s[at.noise + WEIGHT] == s[at.noise + SQUARES]
        for i in range(n):
            for k in range(n):
                if kind > RESETTING and kind != WINDOW:
                    C[i, k] = P[i, k] - C[i, k]
                elif kind > RESETTING or equal_weights:
                    C[i, k] = P[i, k]
                C[i, k] *= s[at.noise + VARIANCE]
    if scored == 1 and not drifts and s[at.detector + BLOCKS] >= FEWEST:
        _add_reaction(s, at, P, C)


@inner
def _sandwich(P: Floats, A: Floats, C: Floats) -> None:
    """C = P·A·P of symmetric matrices."""
    n = len(C)
    for i in range(n):
        for k in range(i + 1):
            total = 0.0
            for j in range(n):
                along = 0.0
                for m in range(n):
                    along += A[j, m] * P[k, m]
                total += P[i, j] * along
            C[i, k] = total
            C[k, i] = total


@inner
def _samples(s: Floats, at: Places, P: Floats) -> float:
    """Effective number of samples in P: n over the trace of P·M."""
    n = len(P)
    p, trace = 0, 0.0
    for i in range(n):
        for k in range(i + 1):
            trace += P[i, k] * s[at.moments + p] * (1.0 if i == k else 2.0)
            p += 1
    return float(n / trace)


@inner
def _long_run(s: Floats, at: Places, P: Floats, A: Floats, C: Floats) -> None:
    """Write the covariance from the long-run covariance of the scores; A is scratch."""
    n = len(C)
    p = 0
    for i in range(n):
        for k in range(i + 1):
            A[i, k] = s[at.omega + p]
            A[k, i] = s[at.omega + p]
            p += 1
    _sandwich(P, A, C)
    samples = _samples(s, at, P) * (1.0 + STUDENT / s[at.detector + BLOCKS])
    for i in range(n):
        for k in range(n):
            C[i, k] *= samples


@maker
def _add_reaction(s: Floats, at: Places, P: Floats, C: Floats) -> None:
    """Add the squared bias of theta by regressors that react to the noise, N·P·Γ."""
    n = len(C)
    blocks = s[at.detector + BLOCKS]
    reacts, p = False, 0
    for i in range(n):
        p += i
        variance = s[at.doubt + p + i] / (BLOCK * blocks)
        reacts = reacts or s[at.reacted + i] ** 2 > REACTS * variance
    if reacts:
        samples = _samples(s, at, P)
        bias = np.zeros(n)
        for i in range(n):
            for k in range(n):
                bias[i] += samples * P[i, k] * s[at.reacted + k]
        for i in range(n):
            for k in range(n):
                C[i, k] += bias[i] * bias[k]
