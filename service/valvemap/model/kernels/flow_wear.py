"""Wear of a part of an edge: an area of flow that grows along U, as a process in time.

    Q = g(u, s) + Σ w_k(t)·H_k(u)·s/s_top,      dw_k/dt = r_k(t)

with hats H_k on nodes along |U|, of which each has a level w and a rate r (l/min at the largest s;
per s). Stays give sums of normal equations, a matrix with a band. Every so often these sums settle:
nodes are independent before that, and their variances are those of the joint solution behind it.

The probability that anything wears follows from the likelihood of the sums, against that of
the field as it was a while ago. Where it is likelier than not, the map itself and all cells move by
the field, and cells know less by as much as it may have moved otherwise: it is 0 again then.
"""

import math

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.kernels.flow_basis import Axis, values
from valvemap.model.kernels.flow_cells import COUNT, MEAN_Q, MEAN_S, MEAN_U, WORTH, Cells
from valvemap.model.samples import Floats, Singles

NODES = 21  # along |U| of a side: 5 % apart, four cells

# Columns of a node: level, rate and their covariance; how much the variance of the level grew since
# it was 0; room for the step of the level; what the field was a while ago.
LEVEL, RATE, P_LEVEL, P_BOTH, P_RATE, GROWN, MOVED, FORMER = 0, 1, 2, 3, 4, 5, 6, 7
OWN, NEXT, SIDE = 8, 9, 10  # sums: matrix with itself, with the next node; right-hand side
BY_GAIN, BY_EDGE = 11, 12  # sums of the same by gain and edge
COLUMNS = 13

# Columns of the row behind the nodes: probability; scale, l/min; s and stays since it settled.
CHANCE, SCALE, SINCE, STAYS = 0, 1, 2, 3


@inner
def forget(wear: Floats) -> None:
    """Begin: nothing wears, or is about to."""
    wear[:] = 0.0
    for side in range(2):
        wear[side, NODES, CHANCE] = rules.ODDS


@kernel
def begin(wear: Floats) -> None:
    """`forget`, called from Python."""
    forget(wear)


@inner
def _place(axis_U: Axis, side: int, u: float) -> float:
    """Where a point lies among the nodes, 0 … NODES - 1."""
    end = axis_U.breaks[-1] if side == 0 else -axis_U.breaks[0]
    return float(min(max(u if side == 0 else -u, 0.0) / max(end, 1e-9), 1.0) * (NODES - 1))


@inner
def note(
    wear: Floats, axis_U: Axis, axis_s: Axis, side: int, u: float, s: float, off: float,
    by: Floats, now: Floats, variance: float,
) -> None:  # fmt: skip
    """Add a stay, ``off`` the map as it was at first but for offsets; ``by`` its derivatives.

    Gain and edge are ``now``; their motion until the sums settle is subtracted from the sums then.
    """
    nodes = wear[side]
    x = _place(axis_U, side, u)
    k = min(int(x), NODES - 2)
    share = s / axis_s.breaks[-1]
    left, right = (1.0 - x + k) * share, (x - k) * share
    for j in range(drifts.LEVELS):
        for i in range(drifts.LEVELS):
            variance += by[i] * by[j] * now[1 + i, j]
    expected, most = left * nodes[k, LEVEL] + right * nodes[k + 1, LEVEL], math.sqrt(variance)
    for j in range(drifts.OF_VALVE):
        expected += by[j] * now[0, j]
    variance *= max(abs(off - expected) / (rules.MOST_STAY * most), 1.0)
    nodes[k, OWN] += left * left / variance
    nodes[k + 1, OWN] += right * right / variance
    nodes[k, NEXT] += left * right / variance
    for part in range(2):
        weight = (right if part else left) / variance
        nodes[k + part, SIDE] += weight * off
        nodes[k + part, BY_GAIN] += weight * by[drifts.GAIN]
        nodes[k + part, BY_EDGE] += weight * by[drifts.EDGE]


@inner
def drop(wear: Floats, side: int) -> None:
    """Forget the sums: some are of before a sudden change of gain or edge."""
    wear[side, :NODES, OWN:] = 0.0


@inner
def is_due(head: Floats) -> bool:
    """Whether the sums are to settle."""
    many, since = head[STAYS] >= rules.WEAR_STAYS, head[SINCE] >= rules.WEAR_SETTLES
    return bool(head[SINCE] > 0.0 and (many or since))


@inner
def settle(wear: Floats, side: int, now: Floats, flow: float) -> None:
    """Advance the field and learn from the sums; ``flow`` is the scale of the first time."""
    nodes, head = wear[side, :NODES], wear[side, NODES]
    if head[SCALE] == 0.0:
        head[SCALE] = flow
        for k in range(NODES):
            nodes[k, P_RATE] = (rules.LEVELS[drifts.GAIN][0] * flow / 3600.0) ** 2
    _advance(nodes, head[SCALE], head[SINCE])
    change = min(head[SINCE] / rules.BETWEEN_DRIFTS, 0.1)
    chance = change * (1.0 - head[CHANCE]) + (1.0 - change) * head[CHANCE]
    gained = min(max(_learn(nodes, now), -rules.MOST_SAID), rules.MOST_SAID)
    odds = chance / (1.0 - chance) * math.exp(gained)
    head[CHANCE] = odds / (1.0 + odds)
    head[SINCE] = head[STAYS] = 0.0
    drop(wear, side)


@inner
def _advance(nodes: Floats, scale: float, dt: float) -> None:
    keep = math.exp(-dt / rules.PERSISTENCE)
    for k in range(NODES):
        node = nodes[k]
        grown = 2.0 * dt * node[P_BOTH] + dt * dt * node[P_RATE]
        grown += dt * (rules.LEVELS[drifts.GAIN][1] * scale) ** 2 / 3600.0
        node[LEVEL] += dt * node[RATE]
        node[GROWN] += max(grown, 0.0)
        node[P_LEVEL] += grown
        node[P_BOTH] = keep * (node[P_BOTH] + dt * node[P_RATE])
        node[P_RATE] = keep * keep * node[P_RATE]
        node[P_RATE] += (1.0 - keep * keep) * (rules.LEVELS[drifts.GAIN][0] * scale / 3600.0) ** 2
        node[RATE] *= keep
        node[FORMER] *= math.exp(-dt / rules.WEAR_RECALLED)


@inner
def _learn(nodes: Floats, now: Floats) -> float:
    """Solve (D + A)·w = D·m + b; give the log likelihood ratio to a field that stays as it was."""
    gained = 0.0
    for k in range(NODES):  # L·D'·Lᵀ: pivots in OWN, the factor in NEXT, the solution in MOVED
        node = nodes[k]
        known = 1.0 / max(node[P_LEVEL], 1e-300)
        right = node[SIDE] - node[BY_GAIN] * now[0, drifts.GAIN]
        right -= node[BY_EDGE] * now[0, drifts.EDGE]
        gained -= node[FORMER] * (right - 0.5 * node[OWN] * node[FORMER])
        if k < NODES - 1:
            gained += node[NEXT] * node[FORMER] * nodes[k + 1, FORMER]
        right += known * node[LEVEL]
        gained -= 0.5 * known * node[LEVEL] * node[LEVEL] - 0.5 * math.log(known)
        node[OWN] += known
        if k > 0:
            before = nodes[k - 1]
            factor = before[NEXT] / before[OWN]
            node[OWN] -= factor * before[NEXT]
            right -= factor * before[MOVED]
            before[NEXT] = factor
        node[MOVED] = right
        gained += 0.5 * right * right / node[OWN] - 0.5 * math.log(node[OWN])
    variance = 0.0
    for k in range(NODES - 1, -1, -1):
        node = nodes[k]
        level, own = node[MOVED] / node[OWN], 1.0 / node[OWN]
        if k < NODES - 1:
            level -= node[NEXT] * nodes[k + 1, MOVED]
            own += node[NEXT] * node[NEXT] * variance
        variance = own
        node[MOVED] = level
        share = node[P_BOTH] / max(node[P_LEVEL], 1e-300)
        left = min(variance / max(node[P_LEVEL], 1e-300), 1.0)
        node[RATE] += share * (level - node[LEVEL])
        node[P_RATE] -= share * node[P_BOTH] * (1.0 - left)
        node[P_BOTH] *= left
        node[P_LEVEL] *= left
        node[LEVEL] = level
    return gained


@inner
def move(
    wear: Floats, axis_U: Axis, axis_s: Axis, side: int, gain: float, theta: Singles, cells: Cells,
    scalars: Floats, work: Floats,
) -> None:  # fmt: skip
    """Move map and cells by the field, which is 0 afterwards."""
    nodes, n_s, parts = wear[side], len(axis_s.sites), len(axis_s.breaks) - 1
    top = axis_s.breaks[-1] * gain
    for k in range(NODES):
        nodes[k, MOVED] = min(nodes[k, GROWN], nodes[k, P_LEVEL])
    for i in range(len(axis_U.sites)):
        if _is_on(axis_U, side, axis_U.sites[i]):
            by = _between(nodes, LEVEL, _place(axis_U, side, axis_U.sites[i])) / top
            for j in range(n_s):
                theta[i * n_s + j] += by * axis_s.sites[j]
    for c in range(len(cells)):
        cell = cells[c]
        if cell[COUNT] > 0.0:
            i, by = c // parts, 0.0
            values(axis_U, i, cell[MEAN_U], 0.0, work[0])
            for a in range(3):
                if _is_on(axis_U, side, axis_U.sites[i + a]):
                    at = _place(axis_U, side, axis_U.sites[i + a])
                    by += work[0, a] * _between(nodes, LEVEL, at)
            cell[MEAN_Q] += by * cell[MEAN_S] / top
            if _is_on(axis_U, side, cell[MEAN_U]):
                x = _place(axis_U, side, cell[MEAN_U])
                grown = _between(nodes, MOVED, x) * (cell[MEAN_S] / axis_s.breaks[-1]) ** 2
                kept = 1.0 / (1.0 + grown * cell[COUNT] / max(scalars[fits.VARIANCE], 1e-300))
                cell[COUNT] *= kept
                cell[WORTH] *= kept
    for k in range(NODES):
        nodes[k, FORMER] -= nodes[k, LEVEL]
        nodes[k, LEVEL] = nodes[k, GROWN] = 0.0


@inner
def variance_at(wear: Floats, axis_U: Axis, axis_s: Axis, side: int, u: float, s: float) -> float:
    """Variance that the field gives the flow at a point: it may be there, and is not in the map."""
    nodes, x, share = wear[side], _place(axis_U, side, u), s / axis_s.breaks[-1]
    if not nodes[NODES, CHANCE] > rules.ODDS:
        return 0.0
    level = _between(nodes, LEVEL, x)
    return float(
        nodes[NODES, CHANCE] * share * share * (_between(nodes, P_LEVEL, x) + level * level)
    )


@inner
def _is_on(axis_U: Axis, side: int, u: float) -> bool:
    low, high = axis_U.breaks[0], axis_U.breaks[-1]
    return bool(u >= 0.0 or low >= 0.0) if side == 0 else bool(u < 0.0 or high <= 0.0)


@inner
def _between(nodes: Floats, column: int, x: float) -> float:
    k = min(int(x), NODES - 2)
    return float((1.0 - x + k) * nodes[k, column] + (x - k) * nodes[k + 1, column])
