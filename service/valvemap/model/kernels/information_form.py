"""The recursion in the information form, from P₀ = ∞ until theta is determined: exact, eq. (16)."""

import numpy as np

from valvemap.model.kernels.compiled import kernel, maker
from valvemap.model.kernels.factors import (
    back_substitute,
    independence,
    invert_triangle,
    is_estimable,
    rotate_in,
)
from valvemap.model.kernels.row_layout import (
    COUNT,
    FACTORED,
    SQUARES,
    TRACE,
    VARIANCE,
    WEIGHT,
    Counts,
    places_of,
)
from valvemap.model.kernels.rules import RESETTING, TRACE_LIMIT, rejection
from valvemap.model.samples import Codes, Floats
from valvemap.vocabulary.statuses import Status

INDEPENDENT = 1e-3  # minimum independence of the regressors for which U·D·Uᵀ is as accurate as R

_OK = int(Status.OK)
_WARMING_UP = int(Status.WARMING_UP)


@maker
def warm_up(
    s: Floats,
    R: Floats,
    rhs: Floats,
    counters: Counts,
    kind: int,
    lam: float,
    X: Floats,
    y: Floats,
    usable: Codes,
    predicted: Floats,
    residual: Floats,
    early: Floats,
    status: Codes,
    thetas: Floats,
    i: int,
) -> None:
    """Add sample i to R and rhs, and update theta, scale, spread and noise of the row ``s``."""
    n = len(rhs)
    at = places_of(n)
    code = rejection(X, y, usable, i)
    predicted[i] = np.nan
    residual[i] = np.nan
    scale = s[at.scale : at.scale + n]
    known = is_estimable(R, X, i, scale)
    if known:
        predicted[i] = 0.0
        for j in range(n):
            predicted[i] += X[i, j] * s[at.theta + j]
    if code == _OK:
        x = np.empty(n)
        if kind > RESETTING:
            lam = 1.0
        for j in range(n):
            x[j] = X[i, j]
            scale[j] = max(scale[j], abs(x[j]))
            if R[j, j] != 0.0 and (R[j, j] / scale[j]) ** 2 < 1.0 / TRACE_LIMIT:
                lam = 1.0
        if kind <= RESETTING:
            p = at.spread
            for j in range(n):
                for k in range(j + 1):
                    s[p] = lam * lam * s[p] + x[j] * x[k]
                    p += 1
        rest = rotate_in(R, rhs, x, y[i], lam, scale, counters[COUNT])
        if known:
            noise = at.noise
            residual[i] = y[i] - predicted[i]
            s[noise + WEIGHT] = lam * s[noise + WEIGHT] + 1.0
            s[noise + SQUARES] = lam * lam * s[noise + SQUARES] + 1.0
            s[noise + VARIANCE] += (rest * rest - s[noise + VARIANCE]) / s[noise + WEIGHT]
        counters[COUNT] += 1
        code = _OK if determine(s, R, rhs, counters, kind) else _WARMING_UP
    early[i] = residual[i]
    status[i] = code
    if i < len(thetas):
        for j in range(n):
            thetas[i, j] = s[at.theta + j]


@kernel
def determine(s: Floats, R: Floats, rhs: Floats, counters: Counts, kind: int) -> bool:
    """Solve R·theta = z, and convert R to U·D·Uᵀ once that loses no digits."""
    n = len(rhs)
    at = places_of(n)
    back_substitute(R, rhs, s[at.theta : at.theta + n])
    least = independence(R)
    if least < (INDEPENDENT if kind <= RESETTING else 0.0) or least == 0.0:
        return least > 0.0
    settle(s, R)
    for j in range(n):
        rhs[j] = 0.0
        for k in range(n):
            R[j, k] = 0.0
    counters[FACTORED] = 1
    return True


@maker
def settle(s: Floats, R: Floats) -> None:
    """Write U and D of P = (RᵀR)⁻¹, and its trace in units of the scales, into the row ``s``."""
    n = len(R)
    at = places_of(n)
    ut = np.empty((n, n))
    invert_triangle(R, ut)
    p = at.factor
    trace = 0.0
    for j in range(n):
        squares = s[at.scale + j] ** 2
        for k in range(j):
            squares += (ut[j, k] * s[at.scale + k]) ** 2
        trace += ut[j, j] * squares
        for k in range(j + 1):
            s[p] = ut[j, k]
            p += 1
    s[at.noise + TRACE] = trace
