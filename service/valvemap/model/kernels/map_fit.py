"""The fit of a map: least squares of a cubic tensor spline and a few dense columns to points.

The normal equations of a spline have the bandwidth 3·n_s + 3 (the parameters of one U stand
together), so a fit costs n·bandwidth², and of the inverse only the same band is needed
(Takahashi's equations). A few dense columns ("border") stand beside the band: eq. (7), and the
trend with temperature.
"""

import math
from typing import NamedTuple

import numpy as np

from valvemap.model.kernels import ladder
from valvemap.model.kernels.banded import factorise, invert, invert_band, substitute
from valvemap.model.kernels.compiled import Index, inner, kernel, maker
from valvemap.model.kernels.grid import MEAN_Q, WEIGHT
from valvemap.model.kernels.map_rows import (
    ORDER,
    Rows,
    RowsInS,
    gather,
    gather_border,
    rows,
    rows_in_s,
)
from valvemap.model.kernels.surface import APART, BORDER, FIVE_TERMS
from valvemap.model.samples import Floats

RIDGE = 1e-6  # samples' worth of information on each spline parameter: keeps the factor positive
BORDER_RIDGE = 1e-9  # the same on eq. (7)'s terms, which few samples determine
TREND_RIDGE = 1e-3  # the same on the trend with T, which samples of one T do not determine
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


@maker
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
    inverse, mixed, corner : (n, PAIRS), (n, BORDER), (BORDER, BORDER)
        Are filled: with (B C; Cᵀ D) the information, of B⁻¹ what points are concerned with (column
        APART·u + v: the parameters that lie u before in U, v in s), B⁻¹·C and (D - Cᵀ·B⁻¹·C)⁻¹.

    Returns
    -------
    rss, penalty, fall, n_effective
        Weighted squares of the residuals, of the prior's, of the map's falls where U rises;
        parameters that the points determine (NaN: the information is not positive).
    """
    n, n_s = plan.n, len(plan.sites_s)
    band = 3 * n_s + 4
    Z = np.zeros(n * (2 * band - 1))
    found = fit_rows(points, rows_in_s(points, plan.knots_s), plan, theta, Z, mixed, corner)
    inverse[:] = 0.0
    for i in range(n):
        for u in range(4):
            for v in range(-3, 4):
                before = u * n_s + v
                if 0 <= before <= i:
                    inverse[i, u * APART + v] = Z[i * (2 * band - 1) + band - 1 - before]
    return found


@kernel
def fit_rows(
    points: Floats,
    in_s: RowsInS,
    plan: Plan,
    theta: Floats,
    Z: Floats,
    mixed: Floats,
    corner: Floats,
) -> tuple[float, float, float, float]:
    """`fit` where the regressors in s are known; the band of B⁻¹ as `banded.invert_band` has it."""
    n, first, last = plan.n, plan.first, plan.last
    n_s, m = len(plan.sites_s), last - first
    band = 3 * n_s + 4
    theta[:] = 0.0
    mixed[:] = 0.0
    corner[:] = 0.0
    A, C, D = np.zeros(n * band), np.zeros((n, m)), np.zeros((m, m))
    rhs, rhs_border = np.zeros(n), np.zeros(m)
    z = rows(points, in_s, plan.knots_U, n_s, plan.play, first, last)
    if n:
        gather(points, z, n_s, band, A, C, rhs)
        _add_prior(A, band, plan.rough_U, plan.rough_s)
    gather_border(points, z.border, D, rhs_border)
    for k in range(m):
        D[k, k] += _border_ridge(first + k)
    if not _solve(A, band, C, D, rhs, rhs_border, first, theta, Z, mixed, corner):
        return math.nan, math.nan, math.nan, math.nan
    penalty, prior_trace = 0.0, 0.0
    if n:
        penalty, prior_trace = _prior_terms(plan, theta, Z, band, mixed, corner)
    for k in range(first, last):
        prior_trace += _border_ridge(k) * corner[k, k]
    table = np.empty((len(plan.sites_U), n_s, 2))
    coefficients(plan, theta, table)
    left = _residual_squares(points, z, n, n_s, theta, first)
    return left, penalty, FALLING * _fall(table), n + m - prior_trace


@inner
def _residual_squares(
    points: Floats, z: Rows, n: int, n_s: int, theta: Floats, first: int
) -> float:
    """Weighted squares of what the map leaves."""
    left = 0.0
    for i in range(len(points)):
        error = points[i, MEAN_Q]
        if n:
            for u in range(ORDER):
                here, along = z.at[i] + u * n_s, 0.0
                for v in range(ORDER):
                    along += z.in_s.values[i, v] * theta[Index(here + v)]
                error -= z.in_U[i, u] * along
        for k in range(z.border.shape[1]):
            error -= z.border[i, k] * theta[n + first + k]
        left += points[i, WEIGHT] * error * error
    return left


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


@maker
def _prior_terms(
    plan: Plan, theta: Floats, Z: Floats, band: int, mixed: Floats, corner: Floats
) -> tuple[float, float]:
    """The prior's squares at theta, and the trace of prior times inverse information."""
    rough_U, rough_s = plan.rough_U, plan.rough_s
    n_U, n_s = len(rough_U), len(rough_s)
    first, last = plan.first, plan.last
    spread_out = np.zeros(mixed.shape)
    for i in range(len(mixed)):
        for b in range(first, last):
            for a in range(first, last):
                spread_out[i, a] += mixed[i, b] * corner[b, a]
    penalty, trace = 0.0, 0.0
    for i in range(n_U):
        for j in range(n_s):
            here = i * n_s + j
            trace += RIDGE * _inverse_at(Z, band, mixed, spread_out, here, here, first, last)
            for k in range(max(0, i - 2), i + 1):
                share = rough_U[i, k] * (1.0 if k == i else 2.0)
                there = k * n_s + j
                penalty += share * theta[here] * theta[there]
                trace += share * _inverse_at(Z, band, mixed, spread_out, here, there, first, last)
            for k in range(max(0, j - 2), j + 1):
                share = rough_s[j, k] * (1.0 if k == j else 2.0)
                there = i * n_s + k
                penalty += share * theta[here] * theta[there]
                trace += share * _inverse_at(Z, band, mixed, spread_out, here, there, first, last)
    return penalty, trace


@inner
def _inverse_at(
    Z: Floats,
    band: int,
    mixed: Floats,
    spread_out: Floats,
    i: int,
    k: int,
    first: int,
    last: int,
) -> float:
    """Element (i, k), i - k within the band, of the whole inverse's spline block."""
    total: float = Z[Index(i * (2 * band - 1) + band - 1 + k - i)]
    for a in range(first, last):
        total += spread_out[i, a] * mixed[k, a]
    return total


@maker
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
    if not factorise(A, n, band):
        return False
    Y = np.empty((m + 1, n))
    for i in range(n):
        Y[m, i] = rhs[i]
        for k in range(m):
            Y[k, i] = C[i, k]
    substitute(A, band, Y)
    for i in range(n):
        for k in range(m):
            rhs_border[k] -= C[i, k] * Y[m, i]
            for j in range(m):
                D[k, j] -= C[i, k] * Y[j, i]
    if not invert(D):
        return False
    for k in range(m):
        for j in range(m):
            theta[n + first + k] += D[k, j] * rhs_border[j]
            corner[first + k, first + j] = D[k, j]
    for i in range(n):
        theta[i] = Y[m, i]
        for k in range(m):
            theta[i] -= Y[k, i] * theta[n + first + k]
            mixed[i, first + k] = Y[k, i]
    invert_band(A, n, band, Z)
    return True
