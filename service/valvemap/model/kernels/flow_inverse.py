"""The inverse of a map of `FlowMap` in U: exact for each piece, without sampling.

At one Δp and T the flow is gain·F(p) + leakage on either side of U = 0, with F a quadratic between
two knots and the place p linear in U, see `flow_look`.
"""

import math

import numpy as np

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_oil as oil
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.kernels.flow_basis import Axis, interval, values
from valvemap.model.kernels.flow_look import clipped
from valvemap.model.kernels.flow_memory import FITTED, OF, PLACE_S, Memory, Room
from valvemap.model.samples import Floats, Singles
from valvemap.vocabulary.statuses import InverseStatus

FALL = 0.05  # of the map's span; a smaller fall at an end of U is ignored where Q is out of reach
TOLERANCE = 1e-13  # of the flow; rounding

_OK, _ABOVE, _BELOW = (
    int(InverseStatus.OK),
    int(InverseStatus.ABOVE_REACH),
    int(InverseStatus.BELOW_REACH),
)
_NOT_MONOTONE, _UNIDENTIFIED = int(InverseStatus.NOT_MONOTONE), int(InverseStatus.UNIDENTIFIED)

# Places in `found`: U and the slope there; extremes, ends and slopes at the ends of the whole map.
AT, RISE, HIGHEST, LOWEST, FIRST, FIRST_RISE, LAST, LAST_RISE = 0, 1, 2, 3, 4, 5, 6, 7


@kernel
def invert(
    axis_U: Axis, axis_s: Axis, memory: Memory, Q: Floats, dp: Floats, T: Floats, U: Floats,
    unclipped: Floats, slope: Floats, status: np.ndarray, room: Room,
) -> None:  # fmt: skip
    """Fill U (the smallest on a rising branch), U without its bounds, dQ/dU and the status."""
    along, found = np.empty(len(axis_U.sites)), np.empty(8)
    low, high = axis_U.breaks[0], axis_U.breaks[-1]
    for i in range(len(Q)):
        U[i] = unclipped[i] = slope[i] = math.nan
        status[i] = _UNIDENTIFIED
        if not memory.counters[FITTED]:
            continue
        s, _ = clipped(axis_s, paths.effective(dp[i], math.inf, memory.path))
        _section(axis_s, memory.theta, s, room, along)
        room.at[PLACE_S] = s
        found[AT], found[HIGHEST], found[LOWEST] = math.nan, -math.inf, math.inf
        found[FIRST] = math.nan
        x = oil.viscosity(memory, T[i])
        if low < 0.0:
            _search(axis_U, axis_s, memory, 1, low, min(high, 0.0), x, Q[i], along, room, found)
        if high > 0.0:
            _search(axis_U, axis_s, memory, 0, max(low, 0.0), high, x, Q[i], along, room, found)
        dip = FALL * (found[HIGHEST] - found[LOWEST])
        if math.isfinite(found[AT]):
            status[i], U[i], slope[i] = _OK, found[AT], found[RISE]
            unclipped[i] = U[i]
        elif found[HIGHEST] < Q[i] and found[LAST] >= found[HIGHEST] - dip:
            status[i], U[i], slope[i] = _ABOVE, high, found[LAST_RISE]
            unclipped[i] = high + (Q[i] - found[LAST]) / slope[i]
        elif found[LOWEST] > Q[i] and found[FIRST] <= found[LOWEST] + dip:
            status[i], U[i], slope[i] = _BELOW, low, found[FIRST_RISE]
            unclipped[i] = low + (Q[i] - found[FIRST]) / slope[i]
        else:
            status[i] = _NOT_MONOTONE


@inner
def _section(axis_s: Axis, theta: Singles, s: float, room: Room, along: Floats) -> None:
    """Fill the map's coefficients along U at one s."""
    j, n_s = interval(axis_s, s), len(axis_s.sites)
    values(axis_s, j, s, 0.0, room.work[1])
    for i in range(len(along)):
        along[i] = 0.0
        for b in range(3):
            along[i] += room.work[1, b] * theta[i * n_s + j + b]


@inner
def _search(
    axis_U: Axis, axis_s: Axis, memory: Memory, side: int, start: float, stop: float,
    x: float, Q: float, along: Floats, room: Room, found: Floats,
) -> None:  # fmt: skip
    """Go through the pieces of one side of U = 0, in the order of U."""
    now, at, breaks = memory.now[side], room.at, axis_U.breaks
    z, of_valve = at[OF + drifts.LEVELS : OF + drifts.RATES], 1.0 + now[0, drifts.GAIN]
    oil.effects_at(axis_s, memory, 0.0, at[PLACE_S], x, z)
    leakage = of_valve * oil.warm(memory, side, z)
    oil.effects_at(axis_s, memory, 1.0, at[PLACE_S], x, z)
    gain = of_valve * (1.0 + oil.warm(memory, side, z)) - leakage
    end = max(abs(breaks[-1] if side == 0 else breaks[0]), 1e-9)
    edge = now[0, drifts.EDGE]
    rate = 1.0 + edge / end if side == 0 else 1.0 - edge / end
    towards = math.copysign(1.0, at[PLACE_S]) * (1.0 if side == 0 else -1.0)
    bound = towards * memory.scalars[fits.LEAST]
    u = start
    p = start * rate - edge
    while u < stop:
        i = interval(axis_U, p)
        if p < breaks[0]:
            q = breaks[0]
        elif p >= breaks[-1]:
            q = math.inf
        else:
            q = breaks[i + 1]
        ahead = stop if not rate > 0.0 else min((q + edge) / rate, stop)
        if ahead <= u:  # rounding
            ahead = min(u + 1e-9 * end, stop)
        if stop - ahead < 1e-9 * end:  # no piece that is nothing but rounding
            ahead = stop
        behind = ahead * rate - edge
        _piece(
            axis_U, i, min(max(p, breaks[0]), breaks[-1]), min(max(behind, breaks[0]), breaks[-1]),
            u, ahead, gain, leakage, towards, bound, Q, along, found,
        )  # fmt: skip
        u, p = ahead, max(behind, q) if ahead < stop else behind


@inner
def _piece(
    axis_U: Axis, i: int, p: float, q: float, u: float, v: float, gain: float, leakage: float,
    towards: float, bound: float, Q: float, along: Floats, found: Floats,
) -> None:  # fmt: skip
    """One quadratic c + b·t + a·t² of the flow, t from 0 at U = u to 1 at U = v."""
    y, dy = p - axis_U.breaks[i], q - p
    f0 = f1 = f2 = 0.0
    for k in range(3):
        row, weight = axis_U.table[i, k], along[i + k]
        f0, f1, f2 = f0 + weight * row[0], f1 + weight * row[1], f2 + weight * row[2]
    c = gain * (f0 + y * (f1 + y * f2)) + leakage
    b, a = gain * (f1 + 2.0 * y * f2) * dy, gain * f2 * dy * dy
    limit = gain * bound + leakage  # flow does not run against Δp
    turn = min(max(-0.5 * b / a, 0.0), 1.0) if a != 0.0 else 1.0
    width = v - u
    raw, t0, before = c, 0.0, _bounded(c, limit, towards)
    if math.isnan(found[FIRST]):
        found[FIRST] = before
        found[FIRST_RISE] = b / width if before == c else 0.0
        tolerance = TOLERANCE * max(abs(before), abs(Q))
        if abs(before - Q) <= tolerance and found[FIRST_RISE] >= 0.0:
            found[AT], found[RISE] = u, found[FIRST_RISE]
    elif math.isnan(found[AT]) and found[LAST] < Q <= before:  # a jump between two sides
        found[AT], found[RISE] = u, b / width
    for part in range(2):
        t1 = turn if part == 0 else 1.0
        raw = c + t1 * (b + t1 * a)
        after = _bounded(raw, limit, towards)
        if t1 > t0:
            tolerance = TOLERANCE * max(abs(after), abs(Q))
            if math.isnan(found[AT]) and before < Q <= after + tolerance:
                t = _root(c - Q, b, a, t0, t1)
                found[AT], found[RISE] = u + t * width, (b + 2.0 * t * a) / width
        found[HIGHEST] = max(found[HIGHEST], before, after)
        found[LOWEST] = min(found[LOWEST], before, after)
        t0, before = t1, after
    found[LAST] = before
    found[LAST_RISE] = (b + 2.0 * a) / width if before == raw else 0.0


@inner
def _bounded(flow: float, limit: float, towards: float) -> float:
    return max(flow, limit) if towards > 0.0 else min(flow, limit)


@inner
def _root(c: float, b: float, a: float, low: float, high: float) -> float:
    """Where c + b·t + a·t² rises through 0, of a piece that is monotone from low to high."""
    root, t = math.sqrt(max(b * b - 4.0 * a * c, 0.0)), high
    if b >= 0.0 and b + root > 0.0:
        t = -2.0 * c / (b + root)
    elif a != 0.0:
        t = (root - b) / (2.0 * a)
    return min(max(t, low), high)
