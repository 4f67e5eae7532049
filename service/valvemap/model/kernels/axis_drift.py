"""What moves at the edges of an axis while its map stays: `flow_drift`, one filter for each edge.

A row of line A tells of the edge PA or AT, one of line B of PB or BT: of the one that passes more.
Successive rows of one edge are a stay, which counts as one observation of its gain a and shift e.
Its variance holds the noise of stays, that of the map there, and the doubt about the line's other
edge. Rows are summed as those of the map without a and e; a row far off counts less, unless gain
and edge are in doubt themselves.
"""

import math
from typing import Final, NamedTuple

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner
from valvemap.model.samples import Floats, Times

MANY, ERROR, FLOW, SLOPE, OTHER, MEAN = range(6)  # places of a stay; the mean row follows
NOISE, STAYS = 0, 1  # places of a line's noise
EDGES: Final = 4


class Moving(NamedTuple):
    """Filters of the four edges, and what they learn from.

    Attributes
    ----------
    x, P, chance, now
        As of `flow_drift.Drift`, for each edge.
    stay : (4, MEAN + knots)
        Sums of the running stay: rows, residual, flow, slope by e, the other edge's flow squared,
        regressors.
    last : (4,)
        Time of the last stay, UTC ns; 0: there was none.
    noise : (2, 2)
        Of each line: variance of a stay times its rows, (l/min)², and the number of stays.
    known : (4, knots, knots)
        Covariance of the map of each edge.
    """

    x: Floats
    P: Floats
    chance: Floats
    now: Floats
    stay: Floats
    last: Times
    noise: Floats
    known: Floats


@inner
def weight_of_row(
    moving: Moving, line: int, row: Floats, theta: Floats, e: float, t: int, changes_per_s: float,
    room: Floats, by: Floats,
) -> float:  # fmt: skip
    """Add a filtered row of a line to the stay of its edge; return the row's weight, 0 … 1.

    The row ends with the flow's derivatives by the shift of both edges. The edges of line A are 0
    and 1, those of B 2 and 3.
    """
    n, knots = len(theta), moving.known.shape[1]
    first, second = 2 * line * knots, (2 * line + 1) * knots
    of_first = of_second = 0.0
    for j in range(knots):
        of_first += theta[first + j] * row[first + j]
        of_second += theta[second + j] * row[second + j]
    own = 0 if abs(of_first) >= abs(of_second) else 1
    of_own, of_other = (of_first, of_second) if own == 0 else (of_second, of_first)
    edge, other = 2 * line + own, 2 * line + 1 - own
    if moving.stay[other, MANY] > 0.0:
        _end_stay(moving, other, t, changes_per_s, room, by)
    now = moving.now[edge]
    unmoved = of_own / max(1.0 + now[0, drifts.GAIN], 0.05)
    slope = row[n + 1 + own]
    of_map = _of_map(moving.known[edge], row, edge * knots)
    doubt = unmoved * unmoved * now[1 + drifts.GAIN, drifts.GAIN]
    doubt += slope * slope * now[1 + drifts.EDGE, drifts.EDGE]
    doubt += 2.0 * unmoved * slope * now[1 + drifts.GAIN, drifts.EDGE]
    variance = moving.noise[line, NOISE] + of_map + max(doubt, 0.0)
    stay = moving.stay[edge]
    stay[MANY] += 1.0
    stay[ERROR] += e
    stay[FLOW] += unmoved
    stay[SLOPE] += slope
    stay[OTHER] += of_other * of_other
    for j in range(knots):
        stay[MEAN + j] += row[edge * knots + j]
    if stay[MANY] >= rules.LONGEST_STAY:
        _end_stay(moving, edge, t, changes_per_s, room, by)
    if moving.noise[line, STAYS] < rules.FEWEST_STAYS:
        return 1.0
    return min(1.0, rules.MOST_STAY * math.sqrt(variance) / max(abs(e), 1e-12)) ** 2


@inner
def _of_map(known: Floats, row: Floats, at: int) -> float:
    """Variance of the map at a row."""
    total = 0.0
    for j in range(len(known)):
        value = row[at + j]
        if value == 0.0:
            continue
        for k in range(len(known)):
            total += value * known[j, k] * row[at + k]
    return max(total, 0.0)


@inner
def _end_stay(
    moving: Moving, edge: int, t: int, changes_per_s: float, room: Floats,
    by: Floats,
) -> None:  # fmt: skip
    """Let the filter of an edge learn from its stay."""
    stay, line = moving.stay[edge], edge // 2
    other = 2 * line + 1 - edge % 2
    many = stay[MANY]
    residual = stay[ERROR] / many
    for j in range(len(stay)):
        stay[j] /= many
    of_map = _of_map(moving.known[edge], stay, MEAN)
    of_other = stay[OTHER] * moving.now[other, 1 + drifts.GAIN, drifts.GAIN]
    noise = moving.noise[line]
    if noise[STAYS] >= rules.FEWEST_STAYS:
        before = moving.last[edge]
        dt = min(max(1e-9 * float(t - before), 0.0), rules.OLDEST) if before != 0 else 0.0
        by[:] = 0.0
        by[drifts.GAIN], by[drifts.EDGE] = stay[FLOW], stay[SLOPE]
        drift = drifts.Drift(
            moving.x[edge], moving.P[edge], moving.chance[edge], moving.now[edge], room
        )
        jumps = min(dt * changes_per_s, 0.1)
        variance = noise[NOISE] / many + of_map + of_other
        over = min(dt / rules.AFTER_JUMP, 0.5)
        drifts.step(drift, dt, jumps, over, rules.ODDS * jumps, residual, by, variance)
        moving.last[edge] = t
    square = many * max(residual * residual - of_map, 0.0)
    if noise[STAYS] >= rules.FEWEST_STAYS:
        square = min(square, rules.MOST_STAY**2 * noise[NOISE])
    noise[STAYS] = min(noise[STAYS] + 1.0, rules.STAY_MEMORY)
    noise[NOISE] += (square - noise[NOISE]) / noise[STAYS]
    stay[:] = 0.0
