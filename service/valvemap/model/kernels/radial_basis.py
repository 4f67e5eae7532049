"""Rows of Gaussians on a grid beside eq. (7), point by point in fixed order."""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Floats

TAIL = 5


@kernel
def rows(
    U: Floats, dp: Floats, centres_U: Floats, centres_s: Floats, width_U: float, width_s: float
) -> Floats:
    """Rows (N, 5 + n_U·n_s): 1, U, s, U·s, dp, then the Gaussians, the index of s fastest."""
    n_U, n_s = len(centres_U), len(centres_s)
    result = np.empty((len(U), TAIL + n_U * n_s))
    in_U, in_s = np.empty(n_U), np.empty(n_s)
    for t in range(len(U)):
        s = math.copysign(math.sqrt(abs(dp[t])), dp[t])
        _gaussians(centres_U, width_U, U[t], in_U)
        _gaussians(centres_s, width_s, s, in_s)
        result[t, 0] = 1.0
        result[t, 1] = U[t]
        result[t, 2] = s
        result[t, 3] = U[t] * s
        result[t, 4] = dp[t]
        for a in range(n_U):
            for b in range(n_s):
                result[t, TAIL + a * n_s + b] = in_U[a] * in_s[b]
    return result


@inner
def _gaussians(centres: Floats, width: float, x: float, value: Floats) -> None:
    for j in range(len(centres)):
        z = (x - centres[j]) / width
        value[j] = math.exp(-0.5 * z * z)
