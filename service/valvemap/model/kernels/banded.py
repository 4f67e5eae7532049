"""Linear algebra of symmetric band matrices: Cholesky factor, solutions, band of the inverse.

Column k of an (n, n) matrix is in ``A[k * band : (k + 1) * band]``: element (k + d, k) at d.
Every inner loop runs along a row, so that it is vectorized without a change of the summation order.
"""

import math

import numpy as np

from valvemap.model.kernels.compiled import Index, inner, maker
from valvemap.model.samples import Floats


@maker
def factorise(A: Floats, n: int, band: int) -> bool:
    """Cholesky factor in place; False if the matrix is not positive definite."""
    column = np.empty(band)
    for j in range(n):
        at = j * band
        if not A[at] > 0.0:
            return False
        high = min(band, n - j)
        pivot = math.sqrt(A[at])
        A[at] = pivot
        for d in range(1, high):
            A[Index(at + d)] /= pivot
            column[Index(d)] = A[Index(at + d)]
        for a in range(1, high):
            factor, below = column[a], at + a * band
            for d in range(high - a):
                A[Index(below + d)] -= factor * column[Index(a + d)]
    return True


@inner
def substitute(L: Floats, band: int, Y: Floats) -> None:
    """Solve L·Lᵀ·X = Y in place; each right-hand side is a row of Y (m, n)."""
    m, n = Y.shape
    for k in range(m):
        y = Y[k]
        for j in range(n):
            at = j * band
            y[j] /= L[at]
            known = y[j]
            for d in range(1, min(band, n - j)):
                y[Index(j + d)] -= L[Index(at + d)] * known
        for j in range(n - 1, -1, -1):
            at, left = j * band, y[j]
            for d in range(1, min(band, n - j)):
                left -= L[Index(at + d)] * y[Index(j + d)]
            y[j] = left / L[at]


@maker
def invert_band(L: Floats, n: int, band: int, Z: Floats) -> None:
    """Elements of (L·Lᵀ)⁻¹ within the band: Takahashi's equations.

    Z[k * (2·band - 1) + band - 1 + i - k] is element (k, i), on either side of the diagonal.
    """
    middle, width = band - 1, 2 * band - 1
    found = np.empty(band)
    for j in range(n - 1, -1, -1):
        high, at, here = min(band, n - j), j * band, j * width + middle
        pivot = L[at]
        found[:] = 0.0
        for a in range(1, high):
            factor, known = L[Index(at + a)], here + a * (width - 1)
            for d in range(1, high):
                found[Index(d)] -= factor * Z[Index(known + d)]
        corner = 1.0 / pivot
        for d in range(1, high):
            found[d] /= pivot
            corner -= L[Index(at + d)] * found[d]
            Z[Index(here + d)] = found[d]
            Z[Index(here + d * (width - 1))] = found[d]
        Z[here] = corner / pivot


@inner
def invert(A: Floats) -> bool:
    """Invert a small symmetric positive definite matrix in place, Gauss-Jordan on the diagonal."""
    n = len(A)
    for p in range(n):
        pivot = A[p, p]
        if not pivot > 0.0:
            return False
        A[p, p] = 1.0
        for j in range(n):
            A[p, j] /= pivot
        for i in range(n):
            if i != p:
                factor = A[i, p]
                A[i, p] = 0.0
                for j in range(n):
                    A[i, j] -= factor * A[p, j]
    return True
