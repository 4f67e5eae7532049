"""Regressors of points of the memory, and their sums: the normal equations of a map.

A point's regressors are products of four values of a spline in U and four in s; beside them a
border of a few dense columns: eq. (7), and the trend with temperature.
"""

from typing import NamedTuple

import numpy as np

from valvemap.model.kernels.compiled import Index, inner, maker
from valvemap.model.kernels.grid import DIRECTION, MEAN_Q, MEAN_S, MEAN_T, MEAN_U, WEIGHT
from valvemap.model.kernels.spline import basis
from valvemap.model.kernels.surface import BORDER
from valvemap.model.kernels.surface import border as border_of
from valvemap.model.samples import Floats

ORDER = 4  # values of a cubic spline at a point that are not 0
PAIRS = 10  # of the four values in U, each with each


class RowsInS(NamedTuple):
    """What of the points' regressors hangs on s alone: the same for all shapes of one axis.

    Attributes
    ----------
    values : (N, 4 + 16)
        The spline's four values, then their products each with each.
    first : (N,)
        Place of the first of the four.
    """

    values: Floats
    first: np.ndarray


class Rows(NamedTuple):
    """Regressors of the points.

    Attributes
    ----------
    in_U : (N, 4)
        The four values of the spline in U.
    at : (N,)
        Place of the first spline parameter; the product of value u in U and v in s belongs to the
        parameter u·n_s + v behind it.
    in_s
        See `RowsInS`.
    border : (N, m)
        The columns of the border that are in use; all ~1.
    """

    in_U: Floats
    at: np.ndarray
    in_s: RowsInS
    border: Floats


@maker
def rows_in_s(points: Floats, knots_s: Floats) -> RowsInS:
    """Values of a spline in s at points, and their products."""
    N = len(points)
    values, first = np.empty((N, ORDER + ORDER * ORDER)), np.empty(N, np.int64)
    slope = np.empty(ORDER)
    for i in range(N):
        row = values[i]
        first[i] = basis(knots_s, points[i, MEAN_S], row[:ORDER], slope)
        for v in range(ORDER):
            for q in range(ORDER):
                row[ORDER + ORDER * v + q] = row[v] * row[q]
    return RowsInS(values, first)


@maker
def rows(
    points: Floats, in_s: RowsInS, knots_U: Floats, n_s: int, play: float, first: int, last: int
) -> Rows:
    """Regressors of points where U lags by ``play``, with the border's columns first to last."""
    N = len(points)
    in_U, at, border = np.empty((N, ORDER)), np.empty(N, np.int64), np.empty((N, last - first))
    slope, beside = np.empty(ORDER), np.empty(BORDER)
    for i in range(N):
        U = points[i, MEAN_U] - play * points[i, DIRECTION]
        at[i] = basis(knots_U, U, in_U[i], slope) * n_s + in_s.first[i]
        if last > first:
            border_of(U, points[i, MEAN_S], points[i, MEAN_T], beside)
            for k in range(last - first):
                border[i, k] = beside[first + k]
    return Rows(in_U, at, in_s, border)


@maker
def gather(
    points: Floats, rows: Rows, n_s: int, band: int, A: Floats, C: Floats, rhs: Floats
) -> None:
    """Sum the points up: the band, see `banded`, the border's columns and the right-hand side.

    Points between the same knots are summed up first, where their products stand in rows of 16. As
    a number that is read from an array it makes a loop that becomes a vector, unlike a constant.
    """
    m, values = C.shape[1], rows.in_s.values
    square = values.shape[1] - ORDER
    sums = np.zeros((len(rhs) // n_s - ORDER + 1) * n_s * PAIRS * square)
    is_seen = np.zeros(len(rhs), np.bool_)
    for i in range(len(points)):
        weight, place = points[i, WEIGHT], rows.at[i]
        is_seen[place] = True
        to = place * PAIRS * square
        for u in range(ORDER):
            weighted = weight * rows.in_U[i, u]
            for v in range(ORDER):
                here, value = place + u * n_s + v, weighted * values[i, v]
                rhs[here] += value * points[i, MEAN_Q]
                for k in range(m):
                    C[here, k] += value * rows.border[i, k]
            for r in range(u, ORDER):
                pair = weighted * rows.in_U[i, r]
                for e in range(square):
                    sums[Index(to + e)] += pair * values[i, Index(ORDER + e)]
                to += square
    for place in range(len(is_seen)):
        if is_seen[place]:
            _deal_out(sums, place, n_s, band, A)


@inner
def _deal_out(sums: Floats, place: int, n_s: int, band: int, A: Floats) -> None:
    """Add the products of the points between the same knots to the band."""
    at = place * PAIRS * ORDER * ORDER
    for u in range(ORDER):
        for r in range(u, ORDER):
            for v in range(ORDER):
                to = (place + u * n_s + v) * band + (r - u) * n_s - v
                for q in range(v if r == u else 0, ORDER):
                    A[Index(to + q)] += sums[Index(at + ORDER * v + q)]
            at += ORDER * ORDER


@inner
def gather_border(points: Floats, border: Floats, D: Floats, rhs: Floats) -> None:
    """... and the border's own square and right-hand side."""
    m = len(rhs)
    for i in range(len(points)):
        for k in range(m):
            weighted = points[i, WEIGHT] * border[i, k]
            rhs[k] += weighted * points[i, MEAN_Q]
            for j in range(m):
                D[k, j] += weighted * border[i, j]
