"""How well many models know their parameters."""

import numpy as np

from service.identification.kernels.compiled import inner, kernel
from service.identification.kernels.row_layout import (
    BLOCKS,
    SQUARES,
    VARIANCE,
    WEIGHT,
    Places,
    places_of,
)
from service.identification.kernels.rules import RESETTING, WINDOW
from service.identification.kernels.scores import STUDENT, is_coloured
from service.identification.samples import Floats


@kernel
def parameter_variances(rows: Floats, kind: int, variances: Floats) -> None:
    """Write the variance of each parameter (M, n) of models in the covariance form.

    The diagonal of P·Z·P with rules that divide P by λ, else that of P - P·(P⁻¹ - Z)·P, times σ².
    """
    M, n = variances.shape
    at = places_of(n)
    P, A = np.empty((n, n)), np.empty((n, n))
    for m in range(M):
        s = rows[m]
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
        noise = at.noise
        equal_weights = s[noise + WEIGHT] == s[noise + SQUARES]
        for i in range(n):
            turned = 0.0
            for j in range(n):
                along = 0.0
                for k in range(n):
                    along += A[j, k] * P[i, k]
                turned += P[i, j] * along
            over = P[i, i]
            if kind > RESETTING and kind != WINDOW:
                over -= turned
            elif kind <= RESETTING and not equal_weights:
                over = turned
            variances[m, i] = max(over, 0.0) * s[noise + VARIANCE]
        if kind > RESETTING and kind != WINDOW and is_coloured(s, at.detector):
            _long_run(s, at, P, A, variances[m])


@inner
def _long_run(s: Floats, at: Places, P: Floats, A: Floats, variances: Floats) -> None:
    """Variances (n,) from the long-run covariance of the scores; A is scratch."""
    n = len(variances)
    p, trace = 0, 0.0
    for i in range(n):
        for k in range(i + 1):
            A[i, k] = s[at.omega + p]
            A[k, i] = s[at.omega + p]
            trace += P[i, k] * s[at.moments + p] * (1.0 if i == k else 2.0)
            p += 1
    samples = n / trace * (1.0 + STUDENT / s[at.detector + BLOCKS])
    for i in range(n):
        turned = 0.0
        for j in range(n):
            along = 0.0
            for k in range(n):
                along += A[j, k] * P[i, k]
            turned += P[i, j] * along
        variances[i] = max(samples * turned, 0.0)
