"""Rank-one steps on triangular factors: information R (QR) and covariance U·D·Uᵀ.

Both forms are invariant to the units of the regressors (a power of two in a column of X changes no
digit of the others), so they use physical units without a scaled copy. Both are always symmetric
and positive definite. All loops run in a fixed order, for bit-identical results.
"""

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.samples import Floats

EPSILON = 2.0**-52
ESTIMABLE = 1e-8  # share of a column's scale outside the known directions that is tolerated


@kernel
def rotate_in(
    R: Floats, z: Floats, x: Floats, y: float, lam: float, scale: Floats, count: int
) -> float:
    """Rotate a row into the triangle by Givens: RᵀR ← lam·RᵀR + x·xᵀ, Rᵀz ← lam·Rᵀz + x·y.

    Exact from R = 0 on: that is P₀ = ∞. An empty row is a direction without samples; it stays
    empty if the rest of x there is rounding error, which after ``count`` samples is up to about
    count·eps of the column's ``scale``.

    x is destroyed. Returns the residual of y, whose square adds to the sum of squares.
    """
    n = len(x)
    root = np.sqrt(lam)
    tolerance = EPSILON * (2.0 * n + count)
    for i in range(n):
        if R[i, i] == 0.0 and abs(x[i]) <= tolerance * scale[i]:
            continue
        a = root * R[i, i]
        h = np.hypot(a, x[i])
        c, s = a / h, x[i] / h
        R[i, i] = h
        for j in range(i + 1, n):
            a = root * R[i, j]
            R[i, j] = c * a + s * x[j]
            x[j] = c * x[j] - s * a
        a = root * z[i]
        z[i] = c * a + s * y
        y = c * y - s * a
    return y


@kernel
def independence(R: Floats) -> float:
    """Smallest share of a column not explained by the ones before; 0: theta is not determined."""
    least = 1.0
    for i in range(len(R)):
        squares = 0.0
        for k in range(i + 1):
            squares += R[k, i] * R[k, i]
        least = min(least, abs(R[i, i]) / np.sqrt(squares)) if R[i, i] != 0.0 else 0.0
    return least


@inner
def back_substitute(R: Floats, z: Floats, theta: Floats) -> None:
    """Solve R·theta = z; directions without samples get 0."""
    for i in range(len(z) - 1, -1, -1):
        total = z[i]
        for j in range(i + 1, len(z)):
            total -= R[i, j] * theta[j]
        theta[i] = total / R[i, i] if R[i, i] != 0.0 else 0.0


@maker
def is_estimable(R: Floats, X: Floats, i: int, scale: Floats) -> bool:
    """Whether the samples in R determine xᵀtheta although not theta; x is row i of X."""
    n = len(R)
    x = np.empty(n)
    for j in range(n):
        x[j] = X[i, j]
    for j in range(n):
        if R[j, j] != 0.0:
            w = x[j] / R[j, j]
            for k in range(j + 1, n):
                x[k] -= w * R[j, k]
        elif not abs(x[j]) <= ESTIMABLE * scale[j]:
            return False
    return True


@inner
def invert_triangle(R: Floats, ut: Floats) -> None:
    """U and D of P = (RᵀR)⁻¹ = U·D·Uᵀ, written over ``ut`` as below."""
    n = len(R)
    for j in range(n):
        ut[j, j] = 1.0
        for i in range(j - 1, -1, -1):
            total = 0.0
            for k in range(i + 1, j + 1):
                total -= R[i, k] * ut[j, k]
            ut[j, i] = total / R[i, i]
    for j in range(n):
        ut[j, j] = 1.0 / (R[j, j] * R[j, j])
        for i in range(j + 1, n):
            ut[j, i] = 0.0


@inner
def project(ut: Floats, x: Floats, f: Floats, Px: Floats) -> float:
    """F = Uᵀx and P·x, and xᵀ·P·x.

    ``ut`` holds the transposed factor: ut[j, i] = U[i, j] for i < j, and D on the diagonal.
    """
    n = len(x)
    r = 0.0
    for j in range(n):
        total = x[j]
        for i in range(j):
            total += ut[j, i] * x[i]
        f[j] = total
        v = ut[j, j] * total
        r += total * v
        Px[j] = v
        for i in range(j):
            Px[i] += ut[j, i] * v
    return r


@inner
def rank_one(ut: Floats, f: Floats, k: Floats, alpha: float, weight: float, growth: float) -> None:
    """P ← growth·(P - weight·P·x·xᵀ·P / (alpha + weight·xᵀ·P·x)), Bierman's recursion.

    ``f`` = Uᵀx. A negative weight removes information; D stays positive as long as
    alpha + weight·xᵀPx > 0. ``k`` is scratch.
    """
    n = len(f)
    inverse = 1.0 / alpha
    for j in range(n):
        v = ut[j, j] * f[j]
        step = -weight * f[j] * inverse
        alpha_next = alpha + weight * f[j] * v
        inverse = 1.0 / alpha_next
        ut[j, j] *= growth * alpha * inverse
        alpha = alpha_next
        for i in range(j):
            u = ut[j, i]
            ut[j, i] = u + step * k[i]
            k[i] += u * v
        k[j] = v


@kernel
def covariance(ut: Floats) -> Floats:
    """Return P; one triangle is computed and mirrored."""
    P = np.empty_like(ut)
    write_covariance(ut, P)
    return P


@inner
def write_covariance(ut: Floats, P: Floats) -> None:
    """`covariance` into ``P`` (n, n)."""
    n = len(ut)
    for i in range(n):
        for k in range(i, n):
            total = 0.0
            for j in range(k, n):
                left = ut[j, i] if i < j else 1.0
                right = ut[j, k] if k < j else 1.0
                total += left * ut[j, j] * right
            P[i, k] = total
            P[k, i] = total
