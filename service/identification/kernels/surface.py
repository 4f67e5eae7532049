"""Maps as cubic tensor splines: their value, their fit to weighted points, its variance.

The normal equations of a spline have the bandwidth 3·n_s + 3 (the parameters of one U stand
together), so a fit costs n·bandwidth², and of the inverse only the same band is needed
(Takahashi's equations). A few dense columns ("border") stand beside the band: eq. (7), and the
trend with temperature.
"""

import math
from typing import NamedTuple

import numpy as np

from service.identification.kernels.compiled import inner, kernel
from service.identification.kernels.spline import basis, hats
from service.identification.samples import Floats

T_REFERENCE = 40.0
T_UNIT = 20.0
BORDER = 8
SPLINE_ROW = 16
FIVE_TERMS = 5
RIDGE = 1e-6
BORDER_RIDGE = 1e-9
TREND_RIDGE = 1e-3


class Surface(NamedTuple):
    """A map for the kernels: knots, nodes, coefficients (n_U, n_s, n_T), half the play in %."""

    knots_U: Floats
    knots_s: Floats
    nodes_T: Floats
    theta: Floats
    play: float


@kernel
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
def _border(U: float, s: float, T: float, row: Floats) -> None:
    """Fill the border, behind the spline: eq. (7), then its trend with temperature; all ~1."""
    opening, root, warmth = U / 100.0, s / 10.0, (T - T_REFERENCE) / T_UNIT
    row[SPLINE_ROW] = 1.0
    row[SPLINE_ROW + 1] = opening
    row[SPLINE_ROW + 2] = root
    row[SPLINE_ROW + 3] = opening * root
    row[SPLINE_ROW + 4] = root * abs(root)
    row[SPLINE_ROW + 5] = warmth * root
    row[SPLINE_ROW + 6] = warmth * opening * root
    row[SPLINE_ROW + 7] = warmth * root * abs(root)


@kernel
def fit(
    points: Floats,
    play: float,
    knots_U: Floats,
    knots_s: Floats,
    rough_U: Floats,
    rough_s: Floats,
    columns: tuple[int, int],
    theta: Floats,
    inverse: Floats,
    mixed: Floats,
    corner: Floats,
) -> tuple[float, float, float]:
    """Least squares of (n_U·n_s) spline and ``columns`` border parameters over weighted points.

    Parameters
    ----------
    points : (N, 6)
        Weight, U, s, T, direction, Q; rows of weight 0 are left out.
    play
        The spline's argument is U - play·direction.
    rough_U, rough_s : (n_U, n_U), (n_s, n_s)
        The prior's information in either direction, in samples.
    columns
        First and one past the last border column in use.
    theta : (n + BORDER,)
        Noughts that are filled: spline parameters, then the border's.
    inverse, mixed, corner : (n, 3·n_s + 4 or more), (n, BORDER), (BORDER, BORDER)
        Noughts that are filled: with (B C; Cᵀ D) the information, the band of B⁻¹ (column k:
        element (i, i - k)), B⁻¹·C and (D - Cᵀ·B⁻¹·C)⁻¹.

    Returns
    -------
    rss, penalty, n_effective
        Weighted squares of the residuals, of the prior's; parameters that the points determine
        (NaN: the information is not positive).
    """
    n_s = len(rough_s)
    n, band = len(rough_U) * n_s, 3 * n_s + 4
    first, last = columns
    m = last - first
    information = np.zeros((n, band))
    C, D = np.zeros((n, m)), np.zeros((m, m))
    rhs, rhs_border = np.zeros(n), np.zeros(m)
    rows = np.empty((len(points), SPLINE_ROW + BORDER))
    at, scratch = np.empty(len(points), np.int64), np.empty((4, 4))
    for i in range(len(points)):
        weight, Q = points[i, 0], points[i, 5]
        if weight > 0.0:
            x = rows[i]
            at[i] = _row(points[i], play, knots_U, knots_s, n, x, scratch)
            if n:
                _add_row(x, weight, weight * Q, at[i], n_s, first, information, C, rhs)
            for k in range(m):
                weighted = weight * x[SPLINE_ROW + first + k]
                for j in range(m):
                    D[k, j] += weighted * x[SPLINE_ROW + first + j]
                rhs_border[k] += weighted * Q
    _add_prior(information, rough_U, rough_s)
    for k in range(m):
        D[k, k] += _border_ridge(first + k)
    if not _solve(information, C, D, rhs, rhs_border, first, theta, inverse, mixed, corner):
        return math.nan, math.nan, math.nan
    rss = 0.0
    for i in range(len(points)):
        if points[i, 0] > 0.0:
            x, error = rows[i], points[i, 5]
            for u in range(4 if n else 0):
                for v in range(4):
                    error -= x[4 * u + v] * theta[at[i] + u * n_s + v]
            for k in range(first, last):
                error -= x[SPLINE_ROW + k] * theta[n + k]
            rss += points[i, 0] * error * error
    penalty, prior_trace = _prior_terms(rough_U, rough_s, theta, inverse, mixed, corner)
    for k in range(first, last):
        prior_trace += _border_ridge(k) * corner[k, k]
    return rss, penalty, n + m - prior_trace


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
    """Q at N points and its variance over σ²; a T that is not known is taken for 40 °C."""
    point, scratch = np.zeros(6), np.empty((4, 4))
    for i in range(len(U)):
        point[1] = U[i] - play * direction[i]
        point[2] = math.copysign(math.sqrt(abs(dp[i])), dp[i])
        point[3] = T[i] if math.isfinite(T[i]) else T_REFERENCE
        Q[i] = value(knots_U, knots_s, nodes_T, theta, point[1], point[2], point[3], scratch)
        variance[i] = spread(knots_U, knots_s, inverse, mixed, corner, point, scratch)


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
    """Variance of Q̂ over σ² at one point (weight, U, s, T, direction, Q), from :func:`fit`."""
    n, n_s, x = len(inverse), len(knots_s) - 4, np.empty(SPLINE_ROW + BORDER)
    at = _row(point, 0.0, knots_U, knots_s, n, x, scratch)
    total = 0.0
    for u in range(4 if n else 0):
        for v in range(4):
            here, along, value_here = at + u * n_s + v, 0.0, x[4 * u + v]
            for r in range(u):
                for q in range(4):
                    along += x[4 * r + q] * inverse[here, (u - r) * n_s + v - q]
            for q in range(v):
                along += x[4 * u + q] * inverse[here, v - q]
            total += value_here * (2.0 * along + value_here * inverse[here, 0])
            for k in range(BORDER):
                x[SPLINE_ROW + k] -= value_here * mixed[here, k]
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
    """Fill the sixteen values of the spline (if there is one) and the border's; give the place.

    Value a of the spline belongs to the parameter a // 4 · n_s + a % 4 behind the place.
    """
    U = point[1] - play * point[4]
    _border(U, point[2], point[3], row)
    if n == 0:
        return 0
    in_U, in_s, slope = scratch[0], scratch[1], scratch[2]
    first_U = basis(knots_U, U, in_U, slope)
    first_s = basis(knots_s, point[2], in_s, slope)
    for u in range(4):
        for v in range(4):
            row[4 * u + v] = in_U[u] * in_s[v]
    return first_U * (len(knots_s) - 4) + first_s


@inner
def _add_row(
    x: Floats,
    weight: float,
    weighted_Q: float,
    place: int,
    n_s: int,
    first: int,
    information: Floats,
    C: Floats,
    rhs: Floats,
) -> None:
    """Add one point to the band, the border's columns and the right-hand side."""
    for u in range(4):
        for v in range(4):
            here, value_here = place + u * n_s + v, x[4 * u + v]
            weighted = weight * value_here
            for r in range(u):
                back = (u - r) * n_s + v
                for q in range(4):
                    information[here, back - q] += weighted * x[4 * r + q]
            for q in range(v + 1):
                information[here, v - q] += weighted * x[4 * u + q]
            for k in range(C.shape[1]):
                C[here, k] += weighted * x[SPLINE_ROW + first + k]
            rhs[here] += weighted_Q * value_here


@inner
def _border_ridge(column: int) -> float:
    return BORDER_RIDGE if column < FIVE_TERMS else TREND_RIDGE


@inner
def _add_prior(information: Floats, rough_U: Floats, rough_s: Floats) -> None:
    n_U, n_s = len(rough_U), len(rough_s)
    for i in range(n_U):
        for j in range(n_s):
            here = i * n_s + j
            information[here, 0] += RIDGE
            for k in range(max(0, i - 2), i + 1):
                information[here, (i - k) * n_s] += rough_U[i, k]
            for k in range(max(0, j - 2), j + 1):
                information[here, j - k] += rough_s[j, k]


@inner
def _prior_terms(
    rough_U: Floats, rough_s: Floats, theta: Floats, inverse: Floats, mixed: Floats, corner: Floats
) -> tuple[float, float]:
    """The prior's squares at theta, and the trace of prior times inverse information."""
    n_U, n_s = len(rough_U), len(rough_s)
    spread_out = np.zeros(mixed.shape)
    for i in range(len(mixed)):
        for a in range(BORDER):
            for b in range(BORDER):
                spread_out[i, a] += mixed[i, b] * corner[b, a]
    penalty, trace = 0.0, 0.0
    for i in range(n_U):
        for j in range(n_s):
            here = i * n_s + j
            trace += RIDGE * _inverse_at(inverse, mixed, spread_out, here, here)
            for k in range(max(0, i - 2), i + 1):
                share = rough_U[i, k] * (1.0 if k == i else 2.0)
                there = k * n_s + j
                penalty += share * theta[here] * theta[there]
                trace += share * _inverse_at(inverse, mixed, spread_out, here, there)
            for k in range(max(0, j - 2), j + 1):
                share = rough_s[j, k] * (1.0 if k == j else 2.0)
                there = i * n_s + k
                penalty += share * theta[here] * theta[there]
                trace += share * _inverse_at(inverse, mixed, spread_out, here, there)
    return penalty, trace


@inner
def _inverse_at(inverse: Floats, mixed: Floats, spread_out: Floats, i: int, k: int) -> float:
    """Element (i, k), i - k within the band, of the whole inverse's spline block."""
    total: float = inverse[i, i - k]
    for a in range(BORDER):
        total += spread_out[i, a] * mixed[k, a]
    return total


@inner
def _solve(
    information: Floats,
    C: Floats,
    D: Floats,
    rhs: Floats,
    rhs_border: Floats,
    first: int,
    theta: Floats,
    inverse: Floats,
    mixed: Floats,
    corner: Floats,
) -> bool:
    n, m = C.shape
    if not _factorise(information):
        return False
    _substitute(information, rhs)
    column = np.empty(n)
    Y = np.empty((n, m))
    for k in range(m):
        for i in range(n):
            column[i] = C[i, k]
        _substitute(information, column)
        for i in range(n):
            Y[i, k] = column[i]
    for k in range(m):
        for i in range(n):
            rhs_border[k] -= C[i, k] * rhs[i]
            for j in range(m):
                D[k, j] -= C[i, k] * Y[i, j]
    if not _invert(D):
        return False
    for k in range(m):
        for j in range(m):
            theta[n + first + k] += D[k, j] * rhs_border[j]
            corner[first + k, first + j] = D[k, j]
    for i in range(n):
        theta[i] = rhs[i]
        for k in range(m):
            theta[i] -= Y[i, k] * theta[n + first + k]
            mixed[i, first + k] = Y[i, k]
    _invert_band(information, inverse)
    return True


@inner
def _factorise(A: Floats) -> bool:
    """Cholesky in place; A[i, k] is element (i, i - k)."""
    n, band = A.shape
    for i in range(n):
        for j in range(max(0, i - band + 1), i + 1):
            total = A[i, i - j]
            for k in range(max(0, i - band + 1, j - band + 1), j):
                total -= A[i, i - k] * A[j, j - k]
            if i == j:
                if not total > 0.0:
                    return False
                A[i, 0] = math.sqrt(total)
            else:
                A[i, i - j] = total / A[j, 0]
    return True


@inner
def _substitute(L: Floats, x: Floats) -> None:
    """Solve L·Lᵀ·x = x in place."""
    n, band = L.shape
    for i in range(n):
        for k in range(1, min(band, i + 1)):
            x[i] -= L[i, k] * x[i - k]
        x[i] /= L[i, 0]
    for i in range(n - 1, -1, -1):
        x[i] /= L[i, 0]
        for k in range(1, min(band, i + 1)):
            x[i - k] -= L[i, k] * x[i]


@inner
def _invert_band(L: Floats, Z: Floats) -> None:
    """Elements of (L·Lᵀ)⁻¹ within the band: Takahashi's equations."""
    n, band = L.shape
    for j in range(n - 1, -1, -1):
        last = min(n - 1, j + band - 1)
        for i in range(last, j - 1, -1):
            total = 1.0 / L[j, 0] if i == j else 0.0
            for k in range(j + 1, min(i, last) + 1):
                total -= L[k, k - j] * Z[i, i - k]
            for k in range(max(i, j) + 1, last + 1):
                total -= L[k, k - j] * Z[k, k - i]
            Z[i, i - j] = total / L[j, 0]


@inner
def _invert(A: Floats) -> bool:
    """Invert a small symmetric positive matrix in place, Gauss and Jordan on its diagonal."""
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
