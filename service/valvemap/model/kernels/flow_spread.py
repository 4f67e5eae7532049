"""Standard deviation of the map at the sites: of its coefficients, and of what lies below knots."""

import math

from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.flow_basis import Axis, interval, values
from valvemap.model.samples import Floats, Singles


@inner
def spread(
    axis_U: Axis, axis_s: Axis, Z: Floats, lifted: Floats, root: float, theta: Singles,
    work: Floats, std: Singles,
) -> None:  # fmt: skip
    """Fill ``std`` (n_U·n_s,); see `flow_solve.Solution` for Z, lifted and root."""
    n_U, n_s = len(axis_U.sites), len(axis_s.sites)
    band = 2 * n_s + 3
    for i in range(n_U):
        u = min(max(axis_U.sites[i], axis_U.breaks[0]), axis_U.breaks[-1])
        at_U = interval(axis_U, u)
        values(axis_U, at_U, u, 0.0, work[0])
        for j in range(n_s):
            s = min(max(axis_s.sites[j], axis_s.breaks[0]), axis_s.breaks[-1])
            at_s = interval(axis_s, s)
            values(axis_s, at_s, s, 0.0, work[1])
            first, total, along = at_U * n_s + at_s, 0.0, 0.0
            for a in range(3):
                for b in range(3):
                    p, x = first + a * n_s + b, work[0, a] * work[1, b]
                    along += x * (root * axis_s.squares[at_s + b] - lifted[p])
                    here = p * (2 * band - 1) + band - 1
                    for c in range(3):
                        for d in range(3):
                            y = x * work[0, c] * work[1, d]
                            total += y * Z[here + (c - a) * n_s + d - b]
            knee = _knee_U(axis_U, n_s, theta, i, j) ** 2 + _knee_s(axis_s, theta, i, j) ** 2
            total += along * along + rules.BELOW_KNOTS**2 * knee
            std[i * n_s + j] = math.sqrt(max(total, 0.0))


@inner
def _knee_U(axis_U: Axis, n_s: int, theta: Singles, i: int, j: int) -> float:
    """Largest third difference along U nearby."""
    most = 0.0
    for k in range(max(i - 2, 0), min(i + 2, len(axis_U.sites) - 3)):
        at = k * n_s + j
        inside = theta[at + n_s] - theta[at + 2 * n_s]
        most = max(most, abs(theta[at + 3 * n_s] - theta[at] + 3.0 * inside))
    return most


@inner
def _knee_s(axis_s: Axis, theta: Singles, i: int, j: int) -> float:
    """Largest jump of the curvature along s nearby, times the squared distance of knots."""
    n_s, most = len(axis_s.sites), 0.0
    for k in range(max(j - 2, 0), min(j + 2, n_s - 3)):
        jump = _curvature(axis_s, theta, i * n_s, k + 1) - _curvature(axis_s, theta, i * n_s, k)
        most = max(most, abs(jump) * (axis_s.sites[k + 2] - axis_s.sites[k + 1]) ** 2)
    return most


@inner
def _curvature(axis_s: Axis, theta: Singles, row: int, k: int) -> float:
    """Second derivative along s, about."""
    bend = 0.0
    for b in range(3):
        bend += axis_s.bends[k, b] * theta[row + k + b]
    return bend / math.sqrt(0.5 * (axis_s.sites[k + 2] - axis_s.sites[k]))
