"""The inverse for speed: the signal that gives a cylinder a speed at the pressures of the moment.

At a signal U the lines get Q_A(U) and Q_B(U). They would keep the piston's force if::

    S(U) = w_A·|Q_A(U)| + w_B·|Q_B(U)| = w_A·(A_A·|v| ± g) + w_B·(A_B·|v| ± g)

with g = c·(p_A - p_B) and w = A/V, which is how much a line's flow changes the force per second.
Where only one edge meters, it has nearly all of S; where the pressures are steady, both lines ask
for the same U. S rises with U, so that a table over the spool's position is searched for it.

U is the spool's position in the middle of the loop: who knows the direction in which U changes adds
half the play.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valvemap.model.axis import AxisGeometry
from valvemap.model.axis_fit import AxisFit
from valvemap.model.kernels.axis_edges import ROOT
from valvemap.model.samples import Codes, Flags, Floats
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.statuses import InverseStatus

STEP_PERCENT: Final = 0.5  # of the table over the spool's position
HALVES: Final = (128, 64, 32, 16, 8, 4, 2, 1)  # cells; steps of the search in the table
_RATED_BAR: Final = 70.0  # bar; drop at which an edge's uncertainty is judged
_KNOWN_SHARE: Final = 0.05  # standard deviation over flow up to which an edge is known
_KNOWN_L_MIN: Final = 0.3  # l/min; or this
_WIDE: Final = 1.96  # standard deviations of the interval

Places = NDArray[np.intp]


@dataclass(frozen=True)
class AxisTable:
    """The four edges over the spool's position ``y`` (n,), %.

    ``K``, ``departure``, ``spread`` (4, n), l/min/√bar: Q = K·s + departure·s·(|s|/10 - 1) with
    s = ±√|dp|, and K's standard deviation; ``known`` (4,), %: position up to which an edge is
    identified; ``leakage``, l/min/bar; ``play_percent``, width of the loop.
    """

    geometry: AxisGeometry
    y: Floats
    K: Floats
    departure: Floats
    spread: Floats
    known: Floats
    leakage: float
    play_percent: float

    def flow(self, dp: float) -> Floats:
        """Return each edge's flow at a drop of dp > 0 (bar) over it, (4, n), l/min."""
        s = np.sqrt(dp)
        return np.asarray(s * (self.K + self.departure * (s / ROOT - 1.0)))


class AxisAnswer(NamedTuple):
    """Answers of :func:`invert`, (N,): U and its interval (%), status, metering edge (0 … 3)."""

    U: Floats
    lower: Floats
    upper: Floats
    status: Codes
    edge: Codes


def axis_table(found: AxisFit) -> AxisTable:
    """Return the table of a fit."""
    y = np.arange(0.0, 100.0 + STEP_PERCENT / 2.0, STEP_PERCENT)
    rated = np.sqrt(_RATED_BAR)
    at_root, at_twice = (
        np.stack([found.flow(edge, y, s * s) / s for edge in EDGES]) for s in (ROOT, 2.0 * ROOT)
    )
    flow = np.stack([found.flow(edge, y, _RATED_BAR) for edge in EDGES])
    std = np.stack([found.flow_std(edge, y, _RATED_BAR) for edge in EDGES])
    unknown = std > np.maximum(_KNOWN_SHARE * np.abs(flow), _KNOWN_L_MIN)
    first = np.where(unknown.any(axis=1), unknown.argmax(axis=1), len(y)) - 1
    return AxisTable(
        geometry=found.regression.geometry,
        y=y,
        K=at_root,
        departure=at_twice - at_root,
        spread=std / rated,
        known=y[np.maximum(first, 0)],
        leakage=found.leakage[0],
        play_percent=found.regression.play_percent,
    )


def invert(
    table: AxisTable,
    v: ArrayLike,
    pA: ArrayLike,
    pB: ArrayLike,
    pS: ArrayLike,
    pT: ArrayLike,
    x: ArrayLike | None = None,
) -> AxisAnswer:
    """Return the signal for a speed.

    Parameters
    ----------
    table : AxisTable
    v
        Speed, mm/s; > 0 extends.
    pA, pB, pS, pT
        Pressures, bar.
    x
        Position, mm; None: mid-stroke. It weighs the lines only.

    Returns
    -------
    AxisAnswer
        with U NaN where the status is UNIDENTIFIED or NOT_FINITE, ± 100 % where ABOVE_REACH.
    """
    g = table.geometry
    place = 0.5 * g.stroke_mm if x is None else x
    columns = [np.asarray(column, np.float64) for column in (v, pA, pB, pS, pT, place)]
    raw = np.stack([column.ravel() for column in np.broadcast_arrays(*columns)])
    finite = np.isfinite(raw).all(axis=0)
    v_, pA_, pB_, pS_, pT_, x_ = np.where(finite, raw, 0.0)
    w_A, w_B = line_weights(g, x_)
    gap = table.leakage * (pA_ - pB_)
    wanted = w_A * (6e-3 * g.A_A * v_ + gap) + w_B * (6e-3 * g.A_B * v_ + gap)
    out = wanted >= 0.0
    edge_A, edge_B = np.where(out, 0, 1), np.where(out, 3, 2)
    s_A = _root(np.where(out, pS_ - pA_, pA_ - pT_))
    s_B = _root(np.where(out, pB_ - pT_, pS_ - pB_))
    of_A = (w_A * s_A)[:, None] * (
        table.K[edge_A] + table.departure[edge_A] * (np.abs(s_A) / ROOT - 1.0)[:, None]
    )
    of_B = (w_B * s_B)[:, None] * (
        table.K[edge_B] + table.departure[edge_B] * (np.abs(s_B) / ROOT - 1.0)[:, None]
    )
    std = np.abs(w_A * s_A)[:, None] * table.spread[edge_A]
    std = std + np.abs(w_B * s_B)[:, None] * table.spread[edge_B]
    S, need = of_A + of_B, np.abs(wanted)
    y, reached, k = _crossing(table.y, S, need)
    least, _, _ = _crossing(table.y, S + _WIDE * std, need)
    most, _, _ = _crossing(table.y, S - _WIDE * std, need)
    rows = np.arange(len(y))
    rise_A, rise_B = of_A[rows, k + 1] - of_A[rows, k], of_B[rows, k + 1] - of_B[rows, k]
    known = np.minimum(table.known[edge_A], table.known[edge_B])
    status = np.full(len(y), int(InverseStatus.OK), np.uint8)
    status[y > known] = InverseStatus.EXTRAPOLATING
    status[~reached] = InverseStatus.ABOVE_REACH
    status[known <= 0.0] = InverseStatus.UNIDENTIFIED
    status[~finite] = InverseStatus.NOT_FINITE
    y = np.where(need == 0.0, 0.0, y)
    sign = np.where(out, 1.0, -1.0)
    none = (status == InverseStatus.UNIDENTIFIED) | (status == InverseStatus.NOT_FINITE)
    U, one, other = (np.where(none, np.nan, sign * part) for part in (y, least, most))
    return AxisAnswer(
        U,
        np.minimum(one, other),
        np.maximum(one, other),
        status,
        np.where(rise_A >= rise_B, edge_A, edge_B).astype(np.uint8),
    )


def line_weights(geometry: AxisGeometry, x: Floats) -> tuple[Floats, Floats]:
    """Return A/V of both lines at position x (mm), cm²/l."""
    V_A = geometry.dead_A_l + 1e-4 * geometry.A_A * x
    V_B = geometry.dead_B_l + 1e-4 * geometry.A_B * (geometry.stroke_mm - x)
    return geometry.A_A / V_A, geometry.A_B / V_B


def _crossing(y: Floats, S: Floats, need: Floats) -> tuple[Floats, Flags, Places]:
    """Return where S (N, n) crosses ``need`` (N,), whether it does, and the cell.

    The search halves the cells, as the exported function block does; S rises but for noise.
    """
    rows, k = np.arange(len(S)), np.zeros(len(S), np.intp)
    for step in HALVES:
        ahead = np.minimum(k + step, len(y) - 2)
        k = np.where((k + step <= len(y) - 2) & (S[rows, ahead] < need), ahead, k)
    low, high = S[rows, k], S[rows, k + 1]
    reached = high >= need
    rise = np.where(high > low, high - low, 1.0)
    share = np.where(high > low, np.clip((need - low) / rise, 0.0, 1.0), 0.0)
    return np.where(reached, y[k] + share * (y[k + 1] - y[k]), y[-1]), reached, k


def _root(drop: Floats) -> Floats:
    return np.copysign(np.sqrt(np.abs(drop)), drop)
