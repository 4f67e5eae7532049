"""Batch least squares, eq. (16): the reference of the recursive methods."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import qr, solve_triangular

from valvemap.model.samples import Floats


def batch_least_squares(X: ArrayLike, y: ArrayLike, lam: float = 1.0) -> Floats:
    """Theta (n,) that minimises Σ λ^(N-i)·(y(i) - Xᵀ(i)·theta)².

    Uses orthogonal factors of the column-scaled X, not the normal equations of eq. (16), which
    square the condition number. Rows of X and y are both weighted by λ^((N-i)/2); the paper
    prints the weight on X alone (before eq. 26).

    Parameters
    ----------
    X : (N, n)
        Regressors; rows with NaN or inf in X or y are left out.
    y : (N,)
        Output.
    lam
        Forgetting factor, 0 < lam ≤ 1.

    Raises
    ------
    ValueError
        if shapes do not fit, lam is out of range or the samples do not determine theta.

    Examples
    --------
    >>> batch_least_squares([[1, 0], [1, 1], [1, 2]], [1, 3, 5]).round(9)
    array([1., 2.])
    """
    rows, output = np.asarray(X, np.float64), np.asarray(y, np.float64)
    if rows.ndim != 2 or output.shape != rows.shape[:1]:
        raise ValueError(f"X {rows.shape} and y {output.shape} do not fit: (N, n) and (N,)")
    if not 0.0 < lam <= 1.0:
        raise ValueError(f"forgetting factor lam = {lam!r} is not in (0, 1]")
    usable = np.isfinite(rows).all(axis=1) & np.isfinite(output)
    weight = np.sqrt(lam) ** np.arange(len(output) - 1, -1, -1.0)[usable]
    rows, output = rows[usable] * weight[:, None], output[usable] * weight
    scale = np.linalg.norm(rows, axis=0)
    n = rows.shape[1]
    if len(rows) < n or (scale == 0.0).any():
        raise ValueError(f"{len(rows)} usable samples do not determine {n} parameters")
    Q, R, order = qr(rows / scale, mode="economic", pivoting=True)
    if abs(R[-1, -1]) <= len(rows) * np.finfo(float).eps * abs(R[0, 0]):
        raise ValueError("the regressors are linearly dependent: theta is not determined")
    theta = np.empty(n)
    theta[order] = solve_triangular(R, Q.T @ output)
    return np.asarray(theta / scale)
