"""The flow through an edge of an axis as regressors: K(u)·√Δp, and a departure from √Δp.

K is a quadratic spline of the spool's position u. Gain and shift of the edge move it; its flow's
derivative by the shift is a column of its own.
"""

import math
from typing import Final

from valvemap.model.kernels.compiled import inlined
from valvemap.model.samples import Floats

ROOT: Final = 10.0  # √bar; where the departure from √Δp changes its sign


@inlined
def add_edge(
    table: Floats, breaks: Floats, y: float, drop: float, sign: float, moved: Floats,
    theta: Floats, row: Floats, at: int, by_shift: int,
) -> None:  # fmt: skip
    """Add an edge's regressors at its own spool position y ≥ 0 (%) and drop (bar).

    ``moved`` has gain and shift of the edge; the flow's derivative by the shift is added at
    ``by_shift``.
    """
    s, y = _root(drop), min(y, 100.0)
    scale, rest = sign * (1.0 + moved[0]), 1.0 - 0.01 * y
    u = max(y - moved[1] * rest, 0.0)
    low = _interval(breaks, u)
    off = u - breaks[low]
    _basis(table, low, off, scale * s, row, at)
    row[at + len(breaks) + 1] += scale * 0.01 * u * s * (abs(s) / ROOT - 1.0)
    row[by_shift] -= scale * s * rest * _rise(table, low, off, theta, at)


@inlined
def _basis(table: Floats, low: int, y: float, scale: float, row: Floats, at: int) -> None:
    """Add the three spline functions at u, times ``scale``, to a row from ``at`` on."""
    for b in range(3):
        row[at + low + b] += scale * (
            table[low, b, 0] + y * (table[low, b, 1] + y * table[low, b, 2])
        )


@inlined
def _rise(table: Floats, low: int, y: float, theta: Floats, at: int) -> float:
    """Slope of the spline at u."""
    rise = 0.0
    for b in range(3):
        rise += theta[at + low + b] * (table[low, b, 1] + 2.0 * y * table[low, b, 2])
    return rise


@inlined
def _interval(breaks: Floats, u: float) -> int:
    low, high = 0, len(breaks) - 2
    while low < high:
        middle = (low + high + 1) // 2
        if u >= breaks[middle]:
            low = middle
        else:
            high = middle - 1
    return low


@inlined
def _root(drop: float) -> float:
    return math.copysign(math.sqrt(abs(drop)), drop)
