"""Predictions of maps that are linear in their parameters, with their variance."""

import numpy as np

from valvemap.model.kernels.compiled import kernel
from valvemap.model.kernels.factors import is_estimable
from valvemap.model.kernels.row_layout import (
    FACTORED,
    Counts,
)
from valvemap.model.samples import Floats


@kernel
def evaluate(
    theta: Floats,
    factor: Floats,
    spread: Floats,
    scale: Floats,
    counters: Counts,
    X: Floats,
    values: Floats,
    variances: Floats,
) -> None:
    """Write Xᵀ·theta (N,) and, with theta's covariance, its variance (N,); NaN where unknown."""
    n = len(theta)
    factored = counters[FACTORED] == 1
    for i in range(len(X)):
        values[i] = np.nan
        variances[i] = np.nan
        if factored or is_estimable(factor, X, i, scale):
            total = 0.0
            for j in range(n):
                total += X[i, j] * theta[j]
            if np.isfinite(total):
                values[i] = total
        if np.isfinite(spread[0, 0]):
            total = 0.0
            for j in range(n):
                for k in range(n):
                    total += X[i, j] * spread[j, k] * X[i, k]
            if np.isfinite(total):
                variances[i] = max(total, 0.0)
