"""Cubic B-splines: the four basis functions that are not zero at a point, in fixed order."""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, lean_kernel
from valvemap.model.samples import Floats


@lean_kernel
def basis(knots: Floats, x: float, value: Floats, slope: Floats) -> int:
    """Fill ``value`` and ``slope`` (4,) and return the index of the first of the four functions.

    ``knots`` are clamped: each end four times. Outside them the functions continue along their
    tangents, so that a map is extrapolated linearly.
    """
    n = len(knots) - 4
    at = min(max(x, knots[3]), knots[n])
    low, high = 3, n
    while high - low > 1:
        middle = (low + high) // 2
        if knots[middle] <= at:
            low = middle
        else:
            high = middle
    # Cox and de Boor (The NURBS Book, A2.2); the slopes come from the quadratic stage.
    value[0] = 1.0
    for degree in range(1, 4):
        if degree == 3:
            _slopes(knots, low, value, slope)
        carried = 0.0
        for r in range(degree):
            right = knots[low + r + 1]
            left = knots[low + r + 1 - degree]
            part = value[r] / (right - left)
            value[r] = carried + (right - at) * part
            carried = (at - left) * part
        value[degree] = carried
    beyond = x - at
    if beyond != 0.0:  # also for NaN
        for r in range(4):
            value[r] += beyond * slope[r]
    return low - 3


@inner
def _slopes(knots: Floats, span: int, quadratic: Floats, slope: Floats) -> None:
    before = 0.0
    for r in range(3):
        after = 3.0 * quadratic[r] / (knots[span + r + 1] - knots[span + r - 2])
        slope[r] = before - after
        before = after
    slope[3] = before


@lean_kernel
def hats(nodes: Floats, x: float, value: Floats) -> int:
    """Fill ``value`` (2,) for linear interpolation between nodes; extrapolated along the ends."""
    n = len(nodes)
    if n < 2:
        value[0], value[1] = 1.0, 0.0
        return 0
    first = 0
    while first < n - 2 and x >= nodes[first + 1]:
        first += 1
    value[1] = (x - nodes[first]) / (nodes[first + 1] - nodes[first])
    value[0] = 1.0 - value[1]
    return first


@kernel
def tensor_rows(
    U: Floats,
    dp: Floats,
    T: Floats,
    knots_U: Floats,
    knots_s: Floats,
    nodes_T: Floats,
    without: int,
) -> Floats:
    """Rows (N, n_U·n_s·n_T), the temperature's index fastest; n_T = 1 without temperature.

    The first ``without`` functions of s are omitted.
    """
    n_s, n_T = len(knots_s) - 4 - without, max(1, len(nodes_T))
    rows = np.zeros((len(U), (len(knots_U) - 4) * n_s * n_T))
    in_U, in_s, slope, in_T = np.empty(4), np.empty(4), np.empty(4), np.empty(2)
    for i in range(len(U)):
        s = math.copysign(math.sqrt(abs(dp[i])), dp[i])
        first_U = basis(knots_U, U[i], in_U, slope)
        first_s = basis(knots_s, s, in_s, slope) - without
        first_T = hats(nodes_T, T[i], in_T)
        for a in range(4):
            for b in range(max(0, -first_s), 4):
                at = ((first_U + a) * n_s + first_s + b) * n_T + first_T
                for c in range(min(2, n_T)):
                    rows[i, at + c] = in_U[a] * in_s[b] * in_T[c]
    return rows
