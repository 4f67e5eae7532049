"""Certified error of a lookup table: a bound over its whole domain, by branch and bound.

In a cell of the table, u and v in [0, 1] are the shares along r and dp, U(u, v) is bilinear and
dp(v) linear. The table's error in flow is::

    F(u, v) = Q̂(U(u, v), √dp(v)) - Q(u, v),   Q(u, v) = low(v) + r(u)·(high(v) - low(v))

On a box with centre c and half widths a, b, Taylor's theorem bounds it::

    |F| <= |F(c)| + a·|F_u(c)| + b·|F_v(c)| + (a²·|F_uu| + 2ab·|F_uv| + b²·|F_vv|)/2

with the largest second derivatives over the box, which follow from those of the map
(:class:`~valvemap.model.map_pieces.MapPieces`). Where a slope of the map jumps, the mean value
theorem does: |F(c)| + a·max|F_u| + b·max|F_v|. Boxes whose bound is too large are split.

The error in U follows from it. The exact U is the smallest on a rising branch of the map (for a
demand below its least flow, 0). With C(U) = ∫ min dQ̂/dU dU over the box's pressure drops, no U
delivers Q before C first reaches C(U) - F, if F > 0, and one does before C next reaches C(U) - F,
if F < 0; the ends of F over a box are its value at the centre, plus and minus the rest of the
bound. Rectangles on which the map only falls hold no such U. Where the map falls with U, the least
slope of a whole rectangle is far below the map's: boxes that matter are bounded again by the slopes
on parts of the rectangles.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.map_pieces import MapPieces
from valvemap.model.polynomials import Indices
from valvemap.model.samples import Floats

SLACK: Final = 1.05  # of the largest error found at a centre: a bound below is not refined
DEEPEST: Final = 12  # splits of a cell along each axis
MOST: Final = 200_000  # boxes at a time
ROWS: Final = 2_048  # boxes per batch
END: Final = 100.0  # % of U
ROUNDING: Final = 1e-4  # % and l/min; literals have 12 digits


@dataclass(frozen=True)
class Cells:
    """Cells of a table, each field (N,): U at the corners (u, v), and coefficients in u and v."""

    U00: Floats
    U01: Floats
    U10: Floats
    U11: Floats
    r: Floats
    dr: Floats
    dp: Floats
    ddp: Floats
    low: Floats
    dlow: Floats
    span: Floats
    dspan: Floats

    def __getitem__(self, rows: object) -> Self:
        return type(self)(**{name: x[rows] for name, x in vars(self).items()})

    def s(self, v: Floats) -> tuple[Floats, Floats, Floats]:
        """√dp, and its first and second derivative by v."""
        s = np.sqrt(self.dp + self.ddp * v)
        return s, self.ddp / (2.0 * s), self.ddp**2 / (4.0 * s**3)

    def largest(self) -> Floats | float:
        """Prior knowledge of a cell's error, l/min."""
        return np.inf


@dataclass(frozen=True)
class CellsOfFlow(Cells):
    """Cells of a table of the flow, over U and s: dp and ddp are s and its step.

    ``curved`` (N,): (ΔU²·max|∂²Q/∂U²| + Δs²·max|∂²Q/∂s²|)/8, which bounds the error of a cell
    without a kink; infinite with one.
    """

    curved: Floats

    def largest(self) -> Floats | float:
        """Prior knowledge of a cell's error, l/min."""
        return self.curved

    def s(self, v: Floats) -> tuple[Floats, Floats, Floats]:
        """S, and its first and second derivative by v."""
        s = self.dp + self.ddp * v
        return s, self.ddp + 0.0 * s, 0.0 * s


@dataclass(frozen=True)
class _Boxes:
    """Parts of cells: centre and half widths in u and v."""

    cells: Cells
    u: Floats
    a: Floats
    v: Floats
    b: Floats

    def __getitem__(self, rows: object) -> "_Boxes":
        rest = (getattr(self, name)[rows] for name in ("u", "a", "v", "b"))
        return _Boxes(self.cells[rows], *rest)

    def split(self) -> "_Boxes":
        """Return the four quarters of each box."""
        rows = np.repeat(np.arange(len(self.u)), 4)
        left, down = (np.tile(x, len(self.u)) for x in ([-0.5, -0.5, 0.5, 0.5], [-0.5, 0.5] * 2))
        old = self[rows]
        u, v = old.u + left * old.a, old.v + down * old.b
        return _Boxes(old.cells, u, old.a / 2.0, v, old.b / 2.0)


def certified_errors(cells: Cells, pieces: MapPieces, tolerance_U: float) -> tuple[float, float]:
    """Return bounds of the errors in U (%) and in flow (l/min) over all cells.

    Parameters
    ----------
    tolerance_U
        %; a box whose error in U is below is not refined for it. Infinite: of a table of the flow,
        whose error in U is none.
    """
    half = np.full(len(cells.r), 0.5)
    boxes, found, worst_U, worst_Q = _Boxes(cells, half, half, half, half), 0.0, 0.0, 0.0
    for depth in range(DEEPEST + 1):
        bounds, centre, U_error = _bounds(boxes, pieces, tolerance_U)
        found = max(found, float(centre.max(initial=0.0)))
        rough = (bounds > SLACK * found + ROUNDING) | (U_error > tolerance_U)
        if depth == DEEPEST or 4 * int(rough.sum()) > MOST:
            rough[:] = False
        worst_Q = max(worst_Q, float(bounds[~rough].max(initial=0.0)))
        worst_U = max(worst_U, float(U_error[~rough].max(initial=0.0)))
        if not rough.any():
            break
        boxes = boxes[rough].split()
    return worst_U + ROUNDING, worst_Q + ROUNDING


def _bounds(boxes: _Boxes, pieces: MapPieces, tolerance_U: float) -> tuple[Floats, Floats, Floats]:
    """Return each box's bound of |F|, |F| at its centre, and one of the error in U.

    An error in U below the tolerance may be less sharp.
    """
    c, u, v, a, b = boxes.cells, boxes.u, boxes.v, boxes.a, boxes.b
    ends_u, ends_v = np.stack([u - a, u + a]), np.stack([v - b, v + b])
    by_u, by_v = c.U10 - c.U00, c.U01 - c.U00
    twist = c.U11 - c.U10 - c.U01 + c.U00
    corners = (
        c.U00 + by_u * ends_u[:, None] + by_v * ends_v[None] + twist * ends_u[:, None] * ends_v
    )
    low_U, high_U = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    s, s_v, s_vv = c.s(ends_v)
    slopes, bends, kinked = pieces.over(low_U, high_U, s[0], s[1])
    middle, by_s, _ = c.s(v)
    Q, in_U, in_s = pieces.at(c.U00 + by_u * u + by_v * v + twist * u * v, middle)
    r, span = c.r + c.dr * u, c.span + c.dspan * v
    signed = Q - (c.low + c.dlow * v + r * span)
    F = np.abs(signed)
    U_u, U_v = by_u + twist * ends_v, by_v + twist * ends_u  # at both ends
    Q_u, Q_v = c.dr * (c.span + c.dspan * ends_v), c.dlow + (c.r + c.dr * ends_u) * c.dspan
    F_u = np.abs(in_U * (by_u + twist * v) - c.dr * span)
    F_v = np.abs(in_U * (by_v + twist * u) + in_s * by_s - c.dlow - r * c.dspan)
    most_u, most_v, most_s = np.abs(U_u).max(axis=0), np.abs(U_v).max(axis=0), s_v.max(axis=0)
    F_uu = bends[0] * most_u**2
    twisted = np.abs(slopes[:2] * twist - c.dr * c.dspan).max(axis=0)
    F_uv = bends[0] * most_u * most_v + bends[1] * most_u * most_s + twisted
    F_vv = bends[0] * most_v**2 + 2 * bends[1] * most_v * most_s + bends[2] * most_s**2
    F_vv = F_vv + np.abs(slopes[2:]).max(axis=0) * s_vv.max(axis=0)
    smooth = F + a * F_u + b * F_v + (a * a * F_uu + 2 * a * b * F_uv + b * b * F_vv) / 2.0
    steep_u = _largest(_product(slopes[:2], U_u), Q_u)
    by_both = _product(slopes[:2], U_v) + _product(slopes[2:], s_v)
    plain = F + a * steep_u + b * _largest(by_both, Q_v)
    bounds = np.minimum(np.where(kinked, plain, np.minimum(smooth, plain)), c.largest())
    bounds = bounds + pieces.slack
    if not np.isfinite(tolerance_U):
        return bounds, F, 0.0 * F
    reach = bounds - F  # by which F may differ from that at the centre
    ends_F = signed - reach, signed + reach
    error_U = _error_in_U(pieces, low_U, high_U, s, ends_F)
    rough = np.flatnonzero(error_U > tolerance_U)
    for rows in np.split(rough, range(ROWS, len(rough), ROWS)):
        part = low_U[rows], high_U[rows], s[:, rows], (ends_F[0][rows], ends_F[1][rows])
        error_U[rows] = _error_in_U(pieces.fine, *part)
    corners = (
        c.low
        + c.dlow * ends_v[:, None]
        + (c.r + c.dr * ends_u) * (c.span + c.dspan * ends_v[:, None])
    )
    beyond = _beyond_reach(pieces, (low_U, high_U), s, corners)
    bounds, F, error_U = (np.where(beyond, 0.0, x) for x in (bounds, F, error_U))
    return bounds, F, error_U


def _beyond_reach(
    pieces: MapPieces, U: tuple[Floats, Floats], s: Floats, Q: Floats
) -> NDArray[np.bool_]:
    """Whether the map is extended, and all U and all demanded flows are beyond the same end.

    There both the table's U and the exact one are limited to that end.
    """
    found = np.zeros(len(U[0]), np.bool_)
    if pieces.U[-1] <= END:
        return found
    for end, sign, nearest in ((0.0, -1.0, U[1]), (END, 1.0, U[0])):
        at = np.full_like(nearest, end)
        middle = (s[0] + s[1]) / 2.0
        flow, _, _ = pieces.at(at, middle)
        slopes, _, _ = pieces.over(at, at, s[0], s[1])
        most = sign * flow + np.abs(slopes[2:]).max(axis=0) * (s[1] - s[0]) / 2.0
        demand = (sign * Q).min(axis=(0, 1))
        found |= (sign * nearest >= sign * end) & (demand >= most + pieces.slack)
    return found


def _product(x: Floats, y: Floats) -> Floats:
    """Product of intervals, each (2, N)."""
    all_four = np.stack([x[0] * y[0], x[0] * y[1], x[1] * y[0], x[1] * y[1]])
    return np.stack([all_four.min(axis=0), all_four.max(axis=0)])


def _largest(x: Floats, y: Floats) -> Floats:
    """Largest |x - y| of an interval x and the values between both y."""
    low, high = y.min(axis=0), y.max(axis=0)
    return np.asarray(np.maximum(np.abs(x[0] - high), np.abs(x[1] - low)))


def _error_in_U(
    pieces: MapPieces, low_U: Floats, high_U: Floats, s: Floats, F: tuple[Floats, Floats]
) -> Floats:
    """Return bounds of the error in U of boxes, from the ends of each box's F."""
    too_little, too_much = np.maximum(-F[0], 0.0), np.maximum(F[1], 0.0)
    slopes = pieces.least_slopes(s[0], s[1])
    risen = np.cumsum(slopes * np.diff(pieces.U), axis=1)
    C = np.concatenate([np.zeros((len(low_U), 1)), risen], axis=1)
    rows = np.arange(len(low_U))

    def place(U: Floats) -> Indices:
        found = np.searchsorted(pieces.U, U, side="right") - 1
        return np.asarray(np.clip(found, 0, len(pieces.U) - 2))

    def at(U: Floats) -> Floats:
        i = place(U)
        return np.asarray(C[rows, i] + slopes[rows, i] * (U - pieces.U[i]))

    def first(level: Floats, behind: Floats) -> Floats:
        """First U behind another where C reaches a level; 100 where it does not."""
        reached = (level[:, None] <= C) & (behind[:, None] <= pieces.U)
        i = np.where(reached.any(axis=1), reached.argmax(axis=1), len(pieces.U) - 1)
        j = np.maximum(i - 1, 0)
        with np.errstate(all="ignore"):
            within = pieces.U[j] + (level - C[rows, j]) / slopes[rows, j]
        inside = np.isfinite(within) & (i > 0)
        return np.asarray(np.where(inside, np.clip(within, pieces.U[j], pieces.U[i]), pieces.U[i]))

    def first_rise(level: Floats) -> Floats:
        """First U from 0 on where C may have reached a level on a rising branch, or below reach."""
        begins, ends = C[:, :-1], C[:, 1:]
        may = pieces.may_rise(s[0], s[1])
        open_ = (pieces.U >= 0.0) & (low_U[:, None] >= pieces.U)
        dip = np.where(open_, C, np.inf).min(axis=1)
        zero = place(np.zeros(1))[0]  # U = 0 answers a demand below the least flow
        may[:, zero] |= (lowest_C - dip <= too_much) & (begins[:, zero] >= level)
        reached = (np.maximum(begins, ends) >= level[:, None]) & may & (pieces.U[1:] > 0.0)
        i = np.where(reached.any(axis=1), reached.argmax(axis=1), len(pieces.U) - 2)
        with np.errstate(all="ignore"):
            within = pieces.U[i] + (level - C[rows, i]) / slopes[rows, i]
        at_once = (begins[rows, i] >= level) | ~np.isfinite(within)
        return np.maximum(np.where(at_once, pieces.U[i], within), 0.0)

    inside = (pieces.U[:-1] < high_U[:, None]) & (pieces.U[1:] > low_U[:, None])
    falls = np.minimum(np.where(inside, slopes, 0.0).min(axis=1), 0.0) * (high_U - low_U)
    lowest_C, highest_C = at(low_U) + falls, at(high_U) - falls
    most = first(highest_C + too_little, high_U) - low_U
    return np.maximum(most, high_U - first_rise(lowest_C - too_much))
