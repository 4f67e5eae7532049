"""The fit of a map: least squares of a cubic tensor spline and a few dense columns to points.

The normal equations of a spline have the bandwidth 3·n_s + 3 (the parameters of one U stand
together), so a fit costs n·bandwidth², and of the inverse only the same band is needed
(Takahashi's equations). A few dense columns ("border") stand beside the band: eq. (7), and the
trend with temperature. Every inner loop runs along a row, so that it becomes a vector without a
sum being taken in another order.
"""

import math
from typing import NamedTuple

import numpy as np

from service.identification.kernels import ladder
from service.identification.kernels.compiled import inner, kernel
from service.identification.kernels.spline import basis
from service.identification.kernels.surface import BORDER, FIVE_TERMS, T_REFERENCE, T_UNIT
from service.identification.samples import Floats

RIDGE = 1e-6  # samples' worth of information on each spline parameter: keeps the factor positive
BORDER_RIDGE = 1e-9  # the same on eq. (7)'s terms, which few samples determine
TREND_RIDGE = 1e-3  # the same on the trend with T, which samples of one T do not determine
BESIDE = 8  # place of the border in a row, behind four values of a spline in U and four in s

FALLING = 0.2  # weight in the choice of a fall of the map where U rises, 1/(l/min)²


class Plan(NamedTuple):
    """What a fit must know of a shape.

    Attributes
    ----------
    knots_U, knots_s
        Clamped knots; without a spline those of the one that holds eq. (7).
    sites_U, sites_s : (n_U,), (n_s,)
        Greville points over 100 % and over 10 √bar.
    squares : (n_s,)
        The spline in s whose value is s²/100 bar.
    rough_U, rough_s : (n_U, n_U), (n_s, n_s)
        The prior's information in either direction, in samples.
    play
        The spline's argument is U - play·direction, %.
    first, last
        First and one past the last border column in use.
    n
        Parameters of the spline; 0 without one.
    """

    knots_U: Floats
    knots_s: Floats
    sites_U: Floats
    sites_s: Floats
    squares: Floats
    rough_U: Floats
    rough_s: Floats
    play: float
    first: int
    last: int
    n: int


@kernel
def plan_of(shape: Floats, top: float) -> Plan:
    """What a fit must know of a shape whose spline reaches up to ``top`` bar."""
    knots_U, knots_s = ladder.knots_U(shape), ladder.knots_s(shape, top)
    sites_U, sites_s = ladder.sites(knots_U), ladder.sites(knots_s)
    squares = np.empty(len(sites_s))
    for i in range(len(squares)):
        a, b, c = knots_s[i + 1], knots_s[i + 2], knots_s[i + 3]
        squares[i] = (a * b + b * c + c * a) / 300.0
    cells = shape[ladder.CELLS_OF] > 0.0
    return Plan(
        knots_U,
        knots_s,
        _over(sites_U, 100.0),
        _over(sites_s, 10.0),
        squares,
        ladder.roughness(sites_U, shape[ladder.DEAD_BAND], shape[ladder.SATURATION]),
        ladder.roughness(sites_s, math.nan, math.nan),
        shape[ladder.PLAY],
        FIVE_TERMS if cells else 0,
        BORDER if shape[ladder.TREND] > 0.0 else FIVE_TERMS,
        ladder.size(shape),
    )


@inner
def _over(values: Floats, unit: float) -> Floats:
    """Quotients, as a loop: an expression of arrays takes a second to compile."""
    found = np.empty(len(values))
    for i in range(len(values)):
        found[i] = values[i] / unit
    return found


@kernel
def fit(
    points: Floats, plan: Plan, theta: Floats, inverse: Floats, mixed: Floats, corner: Floats
) -> tuple[float, float, float, float]:
    """Least squares of spline and border parameters over weighted points.

    Parameters
    ----------
    points : (N, 6)
        Weight, U, s, T, direction, Q; weights are positive.
    theta : (n + BORDER,)
        Is filled: spline parameters, then the border's.
    inverse, mixed, corner : (n, 3·n_s + 4), (n, BORDER), (BORDER, BORDER)
        Are filled: with (B C; Cᵀ D) the information, the band of B⁻¹ (column k:
        element (i, i - k)), B⁻¹·C and (D - Cᵀ·B⁻¹·C)⁻¹.

    Returns
    -------
    rss, penalty, fall, n_effective
        Weighted squares of the residuals, of the prior's, of the map's falls where U rises;
        parameters that the points determine (NaN: the information is not positive).
    """
    n, first, last = plan.n, plan.first, plan.last
    n_s, m = len(plan.sites_s), last - first
    band = 3 * n_s + 4
    theta[:] = 0.0
    inverse[:] = 0.0
    mixed[:] = 0.0
    corner[:] = 0.0
    A, C, D = np.zeros(n * band), np.zeros((n, m)), np.zeros((m, m))
    rhs, rhs_border = np.zeros(n), np.zeros(m)
    z, at = _rows(points, plan)
    if n:
        _gather(points, z, at, n_s, band, A, C, rhs)
        _add_prior(A, band, plan.rough_U, plan.rough_s)
    _gather_border(points, z, first, D, rhs_border)
    for k in range(m):
        D[k, k] += _border_ridge(first + k)
    Z = np.zeros(n * (2 * band - 1))
    if not _solve(A, band, C, D, rhs, rhs_border, first, theta, Z, mixed, corner):
        return math.nan, math.nan, math.nan, math.nan
    for i in range(n):
        for k in range(min(band, i + 1)):
            inverse[i, k] = Z[i * (2 * band - 1) + band - 1 - k]
    rss = 0.0
    for i in range(len(points)):
        error = points[i, 5]
        if n:
            for u in range(4):
                for v in range(4):
                    error -= z[i, u] * z[i, 4 + v] * theta[at[i] + u * n_s + v]
        for k in range(first, last):
            error -= z[i, BESIDE + k] * theta[n + k]
        rss += points[i, 0] * error * error
    penalty, prior_trace = 0.0, 0.0
    if n:
        penalty, prior_trace = _prior_terms(
            plan.rough_U, plan.rough_s, theta, Z, band, mixed, corner
        )
    for k in range(first, last):
        prior_trace += _border_ridge(k) * corner[k, k]
    table = np.empty((len(plan.sites_U), n_s, 2))
    coefficients(plan, theta, table)
    return rss, penalty, FALLING * _fall(table), n + m - prior_trace


@kernel
def coefficients(plan: Plan, theta: Floats, table: Floats) -> None:
    """Fill (n_U, n_s, 2): the spline at 40 and 60 °C from the fit's theta (n + BORDER,)."""
    n, n_s = plan.n, len(plan.sites_s)
    for i in range(len(plan.sites_U)):
        U = plan.sites_U[i]
        for j in range(n_s):
            s, square = plan.sites_s[j], plan.squares[j]
            cold = theta[n] + theta[n + 1] * U + theta[n + 2] * s
            cold += theta[n + 3] * U * s + theta[n + 4] * square
            if n:
                cold += theta[i * n_s + j]
            trend = theta[n + 5] * s + theta[n + 6] * U * s + theta[n + 7] * square
            table[i, j, 0], table[i, j, 1] = cold, cold + trend


@inner
def _fall(table: Floats) -> float:
    """How far the map falls where U rises, (l/min)²: between levels of U nothing else forbids it.

    A valve opens with U; a fall that the samples do show outweighs this.
    """
    total = 0.0
    for j in range(table.shape[1]):
        falls = 0.0
        for i in range(1, table.shape[0]):
            falls += min(table[i, j, 0] - table[i - 1, j, 0], 0.0)
        total += falls * falls
    return total


@inner
def _rows(points: Floats, plan: Plan) -> tuple[Floats, np.ndarray]:
    """Regressors of each point, (N, 8 + BORDER), and the place of the first spline parameter.

    The product of value u in U and v in s belongs to the parameter u·n_s + v behind that place.
    """
    N, n_s = len(points), len(plan.sites_s)
    z, at = np.zeros((N, BESIDE + BORDER)), np.zeros(N, np.int64)
    scratch = np.empty((3, 4))
    in_U, in_s, slope = scratch[0], scratch[1], scratch[2]
    for i in range(N):
        U, s = points[i, 1] - plan.play * points[i, 4], points[i, 2]
        opening, root, warmth = U / 100.0, s / 10.0, (points[i, 3] - T_REFERENCE) / T_UNIT
        z[i, BESIDE] = 1.0
        z[i, BESIDE + 1] = opening
        z[i, BESIDE + 2] = root
        z[i, BESIDE + 3] = opening * root
        z[i, BESIDE + 4] = root * abs(root)
        z[i, BESIDE + 5] = warmth * root
        z[i, BESIDE + 6] = warmth * opening * root
        z[i, BESIDE + 7] = warmth * root * abs(root)
        if plan.n:
            first_U = basis(plan.knots_U, U, in_U, slope)
            at[i] = first_U * n_s + basis(plan.knots_s, s, in_s, slope)
            for k in range(4):
                z[i, k], z[i, 4 + k] = in_U[k], in_s[k]
    return z, at


@inner
def _gather(
    points: Floats,
    z: Floats,
    at: np.ndarray,
    n_s: int,
    band: int,
    A: Floats,
    C: Floats,
    rhs: Floats,
) -> None:
    """Sum the points up: the band, the border's columns and the right-hand side.

    ``A[k * band + d]`` is element (k + d, k).
    """
    m = C.shape[1]
    for i in range(len(points)):
        weight, Q, place = points[i, 0], points[i, 5], at[i]
        s_0, s_1, s_2, s_3 = z[i, 4], z[i, 5], z[i, 6], z[i, 7]
        for u in range(4):
            weighted = weight * z[i, u]
            for v in range(4):
                here, value = place + u * n_s + v, weighted * z[i, 4 + v]
                for k in range(m):
                    C[here, k] += value * z[i, BESIDE + FIVE_TERMS + k]
                rhs[here] += value * Q
                to = here * band
                for q in range(v, 4):
                    A[to + q - v] += value * z[i, u] * z[i, 4 + q]
                for r in range(u + 1, 4):
                    product = value * z[i, r]
                    ahead = to + (r - u) * n_s - v
                    A[ahead] += product * s_0
                    A[ahead + 1] += product * s_1
                    A[ahead + 2] += product * s_2
                    A[ahead + 3] += product * s_3


@inner
def _gather_border(points: Floats, z: Floats, first: int, D: Floats, rhs: Floats) -> None:
    m = len(rhs)
    if m == 0:
        return
    for i in range(len(points)):
        for k in range(m):
            weighted = points[i, 0] * z[i, BESIDE + first + k]
            rhs[k] += weighted * points[i, 5]
            for j in range(m):
                D[k, j] += weighted * z[i, BESIDE + first + j]


@inner
def _border_ridge(column: int) -> float:
    return BORDER_RIDGE if column < FIVE_TERMS else TREND_RIDGE


@inner
def _add_prior(A: Floats, band: int, rough_U: Floats, rough_s: Floats) -> None:
    n_U, n_s = len(rough_U), len(rough_s)
    for i in range(n_U):
        for j in range(n_s):
            here = (i * n_s + j) * band
            A[here] += RIDGE
            for k in range(i, min(i + 3, n_U)):
                A[here + (k - i) * n_s] += rough_U[i, k]
            for k in range(j, min(j + 3, n_s)):
                A[here + k - j] += rough_s[j, k]


@inner
def _prior_terms(
    rough_U: Floats,
    rough_s: Floats,
    theta: Floats,
    Z: Floats,
    band: int,
    mixed: Floats,
    corner: Floats,
) -> tuple[float, float]:
    """The prior's squares at theta, and the trace of prior times inverse information."""
    n_U, n_s = len(rough_U), len(rough_s)
    spread_out = np.zeros(mixed.shape)
    for i in range(len(mixed)):
        for b in range(BORDER):
            for a in range(BORDER):
                spread_out[i, a] += mixed[i, b] * corner[b, a]
    penalty, trace = 0.0, 0.0
    for i in range(n_U):
        for j in range(n_s):
            here = i * n_s + j
            trace += RIDGE * _inverse_at(Z, band, mixed, spread_out, here, here)
            for k in range(max(0, i - 2), i + 1):
                share = rough_U[i, k] * (1.0 if k == i else 2.0)
                there = k * n_s + j
                penalty += share * theta[here] * theta[there]
                trace += share * _inverse_at(Z, band, mixed, spread_out, here, there)
            for k in range(max(0, j - 2), j + 1):
                share = rough_s[j, k] * (1.0 if k == j else 2.0)
                there = i * n_s + k
                penalty += share * theta[here] * theta[there]
                trace += share * _inverse_at(Z, band, mixed, spread_out, here, there)
    return penalty, trace


@inner
def _inverse_at(Z: Floats, band: int, mixed: Floats, spread_out: Floats, i: int, k: int) -> float:
    """Element (i, k), i - k within the band, of the whole inverse's spline block."""
    total: float = Z[i * (2 * band - 1) + band - 1 + k - i]
    for a in range(BORDER):
        total += spread_out[i, a] * mixed[k, a]
    return total


@inner
def _solve(
    A: Floats,
    band: int,
    C: Floats,
    D: Floats,
    rhs: Floats,
    rhs_border: Floats,
    first: int,
    theta: Floats,
    Z: Floats,
    mixed: Floats,
    corner: Floats,
) -> bool:
    n, m = C.shape
    if not _factorise(A, n, band):
        return False
    Y = np.empty((n, m + 1))
    for i in range(n):
        Y[i, m] = rhs[i]
        for k in range(m):
            Y[i, k] = C[i, k]
    _substitute(A, band, Y)
    for i in range(n):
        for k in range(m):
            rhs_border[k] -= C[i, k] * Y[i, m]
            for j in range(m):
                D[k, j] -= C[i, k] * Y[i, j]
    if not _invert(D):
        return False
    for k in range(m):
        for j in range(m):
            theta[n + first + k] += D[k, j] * rhs_border[j]
            corner[first + k, first + j] = D[k, j]
    for i in range(n):
        theta[i] = Y[i, m]
        for k in range(m):
            theta[i] -= Y[i, k] * theta[n + first + k]
            mixed[i, first + k] = Y[i, k]
    _invert_band(A, n, band, Z)
    return True


@inner
def _factorise(A: Floats, n: int, band: int) -> bool:
    """Cholesky in place; A[k * band + d] is element (k + d, k) of the matrix, then the factor."""
    column = np.empty(band)
    for j in range(n):
        at = j * band
        if not A[at] > 0.0:
            return False
        high = min(band, n - j)
        pivot = math.sqrt(A[at])
        A[at] = pivot
        for d in range(1, high):
            A[at + d] /= pivot
            column[d] = A[at + d]
        for a in range(1, high):
            factor, below = column[a], at + a * band
            for d in range(high - a):
                A[below + d] -= factor * column[a + d]
    return True


@inner
def _substitute(L: Floats, band: int, Y: Floats) -> None:
    """Solve L·Lᵀ·X = Y in place."""
    n, m = Y.shape
    for j in range(n):
        for k in range(m):
            Y[j, k] /= L[j * band]
        for d in range(1, min(band, n - j)):
            for k in range(m):
                Y[j + d, k] -= L[j * band + d] * Y[j, k]
    for j in range(n - 1, -1, -1):
        for d in range(1, min(band, n - j)):
            for k in range(m):
                Y[j, k] -= L[j * band + d] * Y[j + d, k]
        for k in range(m):
            Y[j, k] /= L[j * band]


@inner
def _invert_band(L: Floats, n: int, band: int, Z: Floats) -> None:
    """Elements of (L·Lᵀ)⁻¹ within the band: Takahashi's equations.

    Z[k * (2·band - 1) + band - 1 + i - k] is element (k, i), on either side of the diagonal.
    """
    middle, width = band - 1, 2 * band - 1
    found = np.empty(band)
    for j in range(n - 1, -1, -1):
        high, pivot = min(band, n - j), L[j * band]
        found[:] = 0.0
        for a in range(1, high):
            factor, known = L[j * band + a], (j + a) * width + middle - a
            for d in range(1, high):
                found[d] -= factor * Z[known + d]
        corner = 1.0 / pivot
        for d in range(1, high):
            found[d] /= pivot
            corner -= L[j * band + d] * found[d]
            Z[j * width + middle + d] = found[d]
            Z[(j + d) * width + middle - d] = found[d]
        Z[j * width + middle] = corner / pivot


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
