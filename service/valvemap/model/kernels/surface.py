"""Maps as cubic tensor splines: their value, and its variance.

A few dense columns ("border") stand beside the spline: eq. (7), and the trend with temperature.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner, kernel, lean_kernel
from valvemap.model.kernels.spline import basis, hats
from valvemap.model.samples import Floats, Times

T_REFERENCE = 40.0
T_UNIT = 20.0
BORDER = 8
SPLINE_ROW = 16
FIVE_TERMS = 5
TREND = BORDER - FIVE_TERMS
APART = 7  # offsets in s of two of a point's four parameters: -3 to 3
PAIRS = 3 * APART + 4  # of parameters that a point can have, one being given: the rest of the band
# of the inverse is of no concern


class Surface(NamedTuple):
    """A map for the kernels: knots, nodes, coefficients (n_U, n_s, n_T), half the play in %."""

    knots_U: Floats
    knots_s: Floats
    nodes_T: Floats
    theta: Floats
    play: float


@lean_kernel
def value(
    knots_U: Floats,
    knots_s: Floats,
    nodes_T: Floats,
    theta: Floats,
    U: float,
    s: float,
    T: float,
    scratch: Floats,
) -> float:
    """Q at one point; ``theta`` is (n_U, n_s, n_T), ``scratch`` (4, 4)."""
    in_U, in_s, slope, in_T = scratch[0], scratch[1], scratch[2], scratch[3]
    first_U = basis(knots_U, U, in_U, slope)
    first_s = basis(knots_s, s, in_s, slope)
    first_T = hats(nodes_T, T, in_T)
    total = 0.0
    for a in range(4):
        along = 0.0
        for b in range(4):
            for c in range(min(2, theta.shape[2])):
                along += in_s[b] * in_T[c] * theta[first_U + a, first_s + b, first_T + c]
        total += in_U[a] * along
    return total


@inner
def border(U: float, s: float, T: float, row: Floats) -> None:
    """Fill the border: eq. (7), then its trend with temperature; all ~1."""
    opening, root, warmth = U / 100.0, s / 10.0, (T - T_REFERENCE) / T_UNIT
    row[0] = 1.0
    row[1] = opening
    row[2] = root
    row[3] = opening * root
    row[4] = root * abs(root)
    row[5] = warmth * root
    row[6] = warmth * opening * root
    row[7] = warmth * root * abs(root)


@kernel
def misfit(surface: Surface, points: Floats) -> Floats:
    """|Q - Q̂|·√weight of each point (weight, U, s, T, direction, Q)."""
    out, scratch = np.empty(len(points)), np.empty((4, 4))
    for i in range(len(points)):
        weight, s, T, Q = points[i, 0], points[i, 2], points[i, 3], points[i, 5]
        at = points[i, 1] - surface.play * points[i, 4]
        knots_U, knots_s = surface.knots_U, surface.knots_s
        forecast = value(knots_U, knots_s, surface.nodes_T, surface.theta, at, s, T, scratch)
        out[i] = abs(Q - forecast) * math.sqrt(weight)
    return out


@kernel
def evaluate(
    knots_U: Floats,
    knots_s: Floats,
    nodes_T: Floats,
    theta: Floats,
    play: float,
    inverse: Floats,
    mixed: Floats,
    corner: Floats,
    U: Floats,
    dp: Floats,
    T: Floats,
    direction: Floats,
    Q: Floats,
    variance: Floats,
) -> None:
    """Q at N points and its variance over σ²; NaN in T is replaced by 40 °C."""
    point, scratch = np.zeros(6), np.empty((4, 4))
    for i in range(len(U)):
        point[1] = U[i] - play * direction[i]
        point[2] = math.copysign(math.sqrt(abs(dp[i])), dp[i])
        point[3] = T[i] if math.isfinite(T[i]) else T_REFERENCE
        Q[i] = value(knots_U, knots_s, nodes_T, theta, point[1], point[2], point[3], scratch)
        variance[i] = spread(knots_U, knots_s, inverse, mixed, corner, point, scratch)


@kernel
def evaluate_many(
    knots_U: Floats,
    knots_s: Floats,
    nodes_T: Floats,
    coefficients: Floats,
    sizes: Times,
    free: Times,
    inverse: NDArray[np.float32],
    mixed: NDArray[np.float32],
    corner: Floats,
    U: Floats,
    dp: Floats,
    T: Floats,
    Q: Floats,
    variance: Floats,
) -> None:
    """Evaluate M maps at the same N points in the middle of the hysteresis: Q, variance (M, N).

    Arrays have a leading axis M and are padded. ``free[m]`` is the number of spline parameters in
    map m's variance, 0 for eq. (7) alone. NaN for a map of size 0.
    """
    middle = np.zeros(len(U))
    for m in range(len(sizes)):
        n_U, n_s, n = sizes[m, 0], sizes[m, 1], free[m]
        if n_U == 0:
            Q[m], variance[m] = math.nan, math.nan
            continue
        evaluate(
            knots_U[m, : n_U + 4],
            knots_s[m, : n_s + 4],
            nodes_T,
            coefficients[m, : 2 * n_U * n_s].reshape(n_U, n_s, 2),
            0.0,
            inverse[m, :n].astype(np.float64),
            mixed[m, :n].astype(np.float64),
            corner[m],
            U,
            dp,
            T,
            middle,
            Q[m],
            variance[m],
        )


@kernel
def spread(
    knots_U: Floats,
    knots_s: Floats,
    inverse: Floats,
    mixed: Floats,
    corner: Floats,
    point: Floats,
    scratch: Floats,
) -> float:
    """Variance of Q̂ over σ² at one point (weight, U, s, T, direction, Q), see `map_fit.fit`.

    ``inverse`` is (n, PAIRS), ``mixed`` (n, TREND): a spline has no additional eq. (7).
    """
    n, n_s, x = len(inverse), len(knots_s) - 4, np.empty(SPLINE_ROW + BORDER)
    at = _row(point, 0.0, knots_U, knots_s, n, x, scratch)
    total = 0.0
    for u in range(4 if n else 0):
        for v in range(4):
            here, along, value_here = at + u * n_s + v, 0.0, x[4 * u + v]
            for r in range(u):
                for q in range(4):
                    along += x[4 * r + q] * inverse[here, (u - r) * APART + v - q]
            for q in range(v):
                along += x[4 * u + q] * inverse[here, v - q]
            total += value_here * (2.0 * along + value_here * inverse[here, 0])
            for k in range(TREND):
                x[SPLINE_ROW + FIVE_TERMS + k] -= value_here * mixed[here, k]
    for k in range(BORDER):
        along = 0.0
        for j in range(BORDER):
            along += corner[k, j] * x[SPLINE_ROW + j]
        total += x[SPLINE_ROW + k] * along
    return total


@inner
def _row(
    point: Floats,
    play: float,
    knots_U: Floats,
    knots_s: Floats,
    n: int,
    row: Floats,
    scratch: Floats,
) -> int:
    """Fill the sixteen values of the spline (if there is one) and the border's; return the offset.

    Value a of the spline belongs to the parameter offset + a // 4 · n_s + a % 4.
    """
    U = point[1] - play * point[4]
    border(U, point[2], point[3], row[SPLINE_ROW:])
    if n == 0:
        return 0
    in_U, in_s, slope = scratch[0], scratch[1], scratch[2]
    first_U = basis(knots_U, U, in_U, slope)
    first_s = basis(knots_s, point[2], in_s, slope)
    for u in range(4):
        for v in range(4):
            row[4 * u + v] = in_U[u] * in_s[v]
    return first_U * (len(knots_s) - 4) + first_s
