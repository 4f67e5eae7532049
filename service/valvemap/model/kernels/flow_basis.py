"""Quadratic B-splines along one axis: values, means over a cell, second differences.

In interval i of ``breaks`` the functions i, i + 1, i + 2 are not zero; function i + b is there
table[i, b, 0] + table[i, b, 1]·y + table[i, b, 2]·y² with y = x - breaks[i].
"""

from typing import NamedTuple

import numpy as np

from valvemap.model.kernels.compiled import inner
from valvemap.model.samples import Floats, Singles


class Axis(NamedTuple):
    """Quadratic B-splines on m intervals, m + 2 of them.

    Attributes
    ----------
    breaks : (m + 1,)
    table : (m, 3, 3)
        Polynomials, see above.
    sites : (m + 2,)
        Where each function counts most (Greville): Σ sites·B = x.
    squares : (m + 2,)
        Coefficients of x·|x|, exact where 0 is a break or lies outside.
    bends : (m, 3)
        Second differences of coefficients, per root of distance: equal variance stands for a slope
        that wanders evenly along the axis.
    """

    breaks: Floats
    table: Floats
    sites: Floats
    squares: Floats
    bends: Floats


def axis(breaks: Floats) -> Axis:
    """Tables of an axis.

    Examples
    --------
    >>> even = axis(np.arange(4.0))
    >>> even.table[0, :, 0], even.sites
    (array([0.5, 0.5, 0. ]), array([-0.5,  0.5,  1.5,  2.5,  3.5]))
    """
    first, last = breaks[1] - breaks[0], breaks[-1] - breaks[-2]
    before, behind = breaks[0] - first * np.array([2.0, 1.0]), breaks[-1] + last * np.arange(1, 3)
    knots = np.concatenate([before, breaks, behind])
    m = len(breaks) - 1
    table = np.zeros((m, 3, 3))
    for i in range(m):
        k1, k2, k3, k4 = knots[i + 1 : i + 5]
        h = k3 - k2
        table[i, 0] = np.array([h * h, -2.0 * h, 1.0]) / ((k3 - k1) * h)
        table[i, 2, 2] = 1.0 / ((k4 - k2) * h)
        table[i, 1] = np.array([1.0, 0.0, 0.0]) - table[i, 0] - table[i, 2]
    low, high = knots[1:-2], knots[2:-1]
    sites = (low + high) / 2.0
    gaps = np.diff(sites)
    middle = (sites[2:] - sites[:-2]) / 2.0
    bends = np.stack([1.0 / gaps[:-1], -1.0 / gaps[:-1] - 1.0 / gaps[1:], 1.0 / gaps[1:]], axis=1)
    return Axis(
        np.ascontiguousarray(breaks),
        table,
        sites,
        np.where(sites < 0.0, -1.0, 1.0) * low * high,
        np.ascontiguousarray(bends / np.sqrt(middle)[:, None]),
    )


@inner
def interval(axis: Axis, x: float) -> int:
    """Interval in which x lies, the first or last where it lies outside."""
    low, high = 0, len(axis.breaks) - 2
    while low < high:
        middle = (low + high + 1) // 2
        if x >= axis.breaks[middle]:
            low = middle
        else:
            high = middle - 1
    return low


@inner
def values(axis: Axis, i: int, x: float, spread: float, out: Floats) -> None:
    """Means of the three functions of interval i over points of mean x and variance ``spread``."""
    y = x - axis.breaks[i]
    square = y * y + spread
    for b in range(3):
        row = axis.table[i, b]
        out[b] = row[0] + row[1] * y + row[2] * square


@inner
def slopes(axis: Axis, i: int, x: float, out: Floats) -> None:
    """Slopes of the three functions of interval i at x."""
    y = x - axis.breaks[i]
    for b in range(3):
        row = axis.table[i, b]
        out[b] = row[1] + 2.0 * row[2] * y


@inner
def surface(
    axis_U: Axis, axis_s: Axis, theta: Floats | Singles, u: float, s: float, work: Floats
) -> float:
    """Flow of the map ``theta`` (n_U·n_s,) at one point; ``work`` is (4, 3)."""
    i, j, n_s = interval(axis_U, u), interval(axis_s, s), len(axis_s.sites)
    values(axis_U, i, u, 0.0, work[0])
    values(axis_s, j, s, 0.0, work[1])
    return _summed(theta, i * n_s + j, n_s, work[0], work[1])


@inner
def surface_and_slopes(
    axis_U: Axis, axis_s: Axis, theta: Floats | Singles, u: float, s: float, work: Floats
) -> tuple[float, float, float]:
    """As `surface`, and how the flow rises there with U and with s."""
    i, j, n_s = interval(axis_U, u), interval(axis_s, s), len(axis_s.sites)
    values(axis_U, i, u, 0.0, work[0])
    values(axis_s, j, s, 0.0, work[1])
    slopes(axis_U, i, u, work[2])
    slopes(axis_s, j, s, work[3])
    first = i * n_s + j
    flow = _summed(theta, first, n_s, work[0], work[1])
    slope_U = _summed(theta, first, n_s, work[2], work[1])
    return flow, slope_U, _summed(theta, first, n_s, work[0], work[3])


@inner
def _summed(theta: Floats | Singles, first: int, n_s: int, over_U: Floats, over_s: Floats) -> float:
    """Sum of the nine coefficients from ``first`` on, times functions of U and of s."""
    total = 0.0
    for a in range(3):
        at, along = first + a * n_s, 0.0
        for b in range(3):
            along += over_s[b] * theta[at + b]
        total += over_U[a] * along
    return total


@inner
def between_sites(axis_U: Axis, axis_s: Axis, known: np.ndarray, u: float, s: float) -> float:
    """Of what is ``known`` (n_U·n_s,) at the sites: linear in between, constant outside."""
    i, p = _site(axis_U.sites, u)
    j, q = _site(axis_s.sites, s)
    n_s = len(axis_s.sites)
    at = i * n_s + j
    low = (1.0 - q) * known[at] + q * known[at + 1]
    high = (1.0 - q) * known[at + n_s] + q * known[at + n_s + 1]
    return float((1.0 - p) * low + p * high)


@inner
def _site(sites: Floats, x: float) -> tuple[int, float]:
    low, high = 0, len(sites) - 2
    while low < high:
        middle = (low + high + 1) // 2
        if x >= sites[middle]:
            low = middle
        else:
            high = middle - 1
    share = (x - sites[low]) / (sites[low + 1] - sites[low])
    return low, min(max(share, 0.0), 1.0)
