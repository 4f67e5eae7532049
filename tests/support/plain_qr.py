"""Batch least squares by Householder's reflections in one fixed order of operations.

LAPACK's own QR differs in its last digits from one processor to the next, and on an ill-conditioned
problem that is a digit or two of the solution: no yardstick for a test. This one gives the same
bits on every machine.
"""

import math

import numpy as np


def plain_qr_least_squares(X, y):
    """Theta (n,) that minimises |y - X·theta|, columns first to last without pivoting."""
    N, n = X.shape
    A = [[*row, output] for row, output in zip(X.tolist(), y.tolist(), strict=True)]
    for k in range(n):
        norm = math.sqrt(sum(A[i][k] ** 2 for i in range(k, N)))
        head = A[k][k] + math.copysign(norm, A[k][k])
        v = [head, *(A[i][k] for i in range(k + 1, N))]
        half = sum(x * x for x in v) / 2.0
        for j in range(k, n + 1):
            step = sum(v[i] * A[k + i][j] for i in range(N - k)) / half
            for i in range(N - k):
                A[k + i][j] -= step * v[i]
    theta = [0.0] * n
    for k in reversed(range(n)):
        rest = sum(A[k][j] * theta[j] for j in range(k + 1, n))
        theta[k] = (A[k][n] - rest) / A[k][k]
    return np.array(theta)
