"""An axis's equations as filtered rows of a regression, summed sample by sample in fixed order.

Over the interval between two samples the mean of each term is known: of the speed from the two
positions, of ṗ from the two pressures, of an edge's basis from the spool's course in `PARTS` parts.
All terms of a row then pass the same low-pass of 2nd order (state-variable filter), so that
nothing is differentiated and left bare, and the equation holds for the filtered terms as for the
bare ones. An interval that is left out is left out of every term. The noise of the position where
it ends then stays in the filter, so that rows begin again once it has faded.

Columns: for the edges PA, AT, PB, BT ``knots`` spline functions and one for the departure from √Δp,
then 1/β, c at 40 °C and free air. Where the speed is measured: its zero, by how much the piston is
not at its assumed place, over β, and two parts of the force. Then two delays against the pressures.

The piston's signal may be shown late by τ, and U by τ_U. To first order, with the coefficients θ::

    A·ẋ = Σ X·θ - τ·d/dt(Σ X·θ) + τ_U·∂Q/∂y·ẏ

The filter has the derivative of its output, so that d/dt takes no differences.

A measured speed v is known at the samples, and its mean over the interval h between them is
(Euler-Maclaurin)::

    (v₀ + v₁)/2 - h/12·(v̇₁ - v̇₀)      v̇₁ - v̇₀ = μ·Δ(A_A·p_A - A_B·p_B)

μ is 1/mass where load and friction stay the same within the interval, as where the load changes at
the samples, and less where they follow the pressures. Dry friction does so while the piston creeps:
μ is one coefficient while it slides, and another while it creeps.
"""

import math
from typing import Final

import numpy as np

from valvemap.model.kernels import axis_drift as moves
from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.axis_drift import Moving
from valvemap.model.kernels.axis_edges import add_edge
from valvemap.model.kernels.axis_oil import thinness
from valvemap.model.kernels.axis_spool import held
from valvemap.model.kernels.compiled import Index, inner, kernel
from valvemap.model.samples import Codes, Flags, Floats, Times

PARTS: Final = 4  # parts of an interval; a spool of 100 Hz then moves by a quarter of its way
COMMON: Final = 9  # columns after those of the edges:
COMPLIANCE, LEAKAGE, AIR, ZERO, PLACE, FORCE, CREEP, PISTON, COMMAND = range(COMMON)
ATMOSPHERE_BAR: Final = 1.013
PER_COMPLIANCE: Final = 1e-4  # 1/bar; unit of the coefficient 1/β: 1 is 1 GPa
PER_LEAKAGE: Final = 1e-2  # l/min/bar; unit of the coefficient c
PER_FORCE: Final = 10.0  # mm/s² of 1 t per cm²·bar; unit of the coefficients μ: 1 is 1/t
PER_AIR: Final = 1e-2  # unit of the coefficient of the free air: 1 %
PER_DELAY: Final = 1e-2  # s; unit of the coefficients of the delays

USED, GAP, MISSING, LOW_PRESSURE, END_STOP = range(5)

MEMORY: Final = (
    *("held", "spool", "speed"),  # "held" is the lower end of where the play may be, see "upper"
    *("U", "x", "pA", "pB", "pS", "pT"),
    *("known", "settling", "withheld", "thinness", "upper", "v"),
)
CREEP_MM_S: Final = 5.0  # mm/s; where half of an interval's force counts as of a creeping piston
PLAY_KNOWN: Final = 0.1  # %; up to this the place in the play is known
_RENEWED: Final = 100  # rows; forgetting is applied at every hundredth one


@inner
def _sum_row(
    M: Floats, b: Floats, squares: Floats, row: Floats, first: int, own: int, line: int,
    weight: float,
) -> None:  # fmt: skip
    """Add a row of a line to its sums: ``own`` columns from ``first`` on, and the common ones."""
    n, common = Index(len(b)), Index(len(b) - COMMON)
    begin, end = Index(first), Index(first + own)
    y = row[n]
    squares[line] += weight * y * y
    for j in range(begin, end):
        value = weight * row[j]
        if value != 0.0:
            b[j] += value * y
            for k in range(begin, j + Index(1)):
                M[j, k] += value * row[k]
    for j in range(common, n):
        value = weight * row[j]
        if value != 0.0:
            b[j] += value * y
            for k in range(begin, end):
                M[j, k] += value * row[k]
            for k in range(common, j + Index(1)):
                M[j, k] += value * row[k]


@inner
def _smooth(row: Floats, stages: Floats, share: float, first: int, past: int) -> None:
    """Low-pass the columns from ``first`` to ``past`` - 1 of a row by both stages of the filter."""
    for j in range(Index(first), Index(past)):
        stages[0, j] += share * (row[j] - stages[0, j])
        stages[1, j] += share * (stages[0, j] - stages[1, j])


@inner
def _set_piston_delay(
    row: Floats, before: Floats, theta: Floats, columns: Times, per_s: float
) -> None:  # fmt: skip
    """Set the column of the piston's delay: how fast what the other columns add up to changes.

    ``row`` and ``before`` are the two stages of the filter; ``per_s`` is the rate of the second.
    """
    piston, rise = Index(len(theta) - COMMON + PISTON), 0.0
    for p in range(len(columns)):
        j = columns[p]
        if j != piston:
            rise += theta[j] * (before[j] - row[j])
    row[piston] = -PER_DELAY * per_s * rise


@inner
def _speed_by_map(rows: Floats, theta: Floats, places: Times, A_A: float, A_B: float) -> float:
    """Return the piston's speed (mm/s) that both lines' flows leave it; noise goes by 1/area.

    It is the mean one of the interval: the sensor's zero, and what the mean of its values at both
    ends is off, are no part of it.
    """
    flow, common = 0.0, rows.shape[1] - 3 - COMMON
    for line in range(2):
        area = A_A if line == 0 else -A_B
        for p in range(places.shape[1]):
            column = places[line, p] - common
            if column < ZERO or column == PLACE:
                flow += area * theta[places[line, p]] * rows[line, places[line, p]]
    return flow / (6e-3 * (A_A * A_A + A_B * A_B))


@kernel
def axis_rows(
    t: Times,
    signals: Floats,
    left_out: Flags,
    last: Times,
    memory: Floats,
    filtered: Floats,
    M: Floats,
    b: Floats,
    squares: Floats,
    counts: Times,
    theta: Floats,
    errors: Floats,
    score: Floats,
    scores: Floats,
    moving: Moving,
    table: Floats,
    breaks: Floats,
    geometry: Floats,
    settings: Floats,
    places: Times,
    status: Codes,
    residual: Floats,
    speeds: Floats,
) -> None:
    """Advance the state of an axis by N samples.

    Parameters
    ----------
    t, signals
        UTC ns (N,), and U, x, pA, pB, pS, pT, T, v (N, 8) in %, mm, bar, °C and mm/s. Without T,
        that of the last sample with one holds; without any, 40 °C. Without v, the speed is that of
        the position.
    left_out
        Intervals to leave out beside those that cannot be used (N,); they count as gaps.
    last, memory, filtered
        Time of the last sample (1,); ``MEMORY``; the filter's two stages per line (2, 2, n + 3).
    M, b, squares, counts
        Information (n, n; lower triangle) and (n,); Σy² per line and the rows' weight (3,); number
        of intervals used, and of intervals by reason (6,). Every ``stride``-th one is a row.
    theta, errors
        Coefficients (n,) for the residuals; sums of them: Σe², Σ of squares of block sums, the
        running block's sums and length, rows in blocks, per line (2, 5).
    score, scores
        Σ row·e of the running block (n,), and Σ of its squares over the blocks (n, n).
    moving
        What moves at the edges, and what it is learnt from.
    geometry
        A_A, A_B (cm²), stroke (mm), V_A and V_B at their shortest (l).
    settings
        Sampling period (s), half the play (%), the spool's transition (2, 2) and input (2,), the
        filter's share per sample, forgetting per row, lowest pressure (bar), margin at the stops
        (mm), longest gap (s), settling intervals, length of a block (rows), stride, intervals
        without a row after one that is left out, Walther's a and b of the oil, sudden changes
        expected of an edge per second (0: none is followed).
    places
        Columns of line A and of line B, (2, ·): those of its edges side by side, then `COMMON`.
    status, residual
        Out: reason (N,), and residuals of both lines (N, 2), l/min.
    speeds
        Out: the piston's speed over the interval (N, 2), mm/s: as measured, and as it is by the
        coefficients. NaN where the interval is left out.
    """
    n, common, own = len(b), len(b) - COMMON, places.shape[1] - COMMON
    knots = len(breaks) + 2  # m + 2 functions on m intervals, and the departure
    half = settings[1]
    share, forget, stride = settings[8], settings[9], int(settings[15])
    per_s = share / ((1.0 - share) * settings[0])
    A_A, A_B, stroke = geometry[0], geometry[1], geometry[2]
    rows, now, moved = np.zeros((2, n + 3)), np.empty(6), np.zeros((moves.EDGES, 2))
    changes_per_s = settings[19]
    room, by = (
        np.zeros((2, drifts.MODELS, drifts.STATES + 1, drifts.STATES)),
        np.zeros(drifts.STATES),
    )
    for i in range(len(t)):
        for k in range(6):
            now[k] = signals[i, k]
        dt = 1e-9 * (t[i] - last[0])
        reason = USED
        finite = True
        for k in range(6):
            finite = finite and math.isfinite(now[k])
        thin = thinness(signals[i, 6], settings[17], settings[18])
        if math.isfinite(thin):
            memory[12] = thin
        residual[i, 0] = math.nan
        residual[i, 1] = math.nan
        speeds[i, 0] = math.nan
        speeds[i, 1] = math.nan
        if not finite:
            status[i] = MISSING
            counts[1 + MISSING] += 1
            continue  # as if it had not come: too long an interval is a gap
        if memory[9] == 0.0 or dt <= 0.0 or dt > settings[12]:
            memory[0], memory[1], memory[2] = now[0] - half, now[0], 0.0
            memory[13] = now[0] + half
            memory[10] = settings[13]
            reason = GAP
        rows[:] = 0.0
        if reason == USED:
            pA, pB, pS, pT = memory[5], memory[6], memory[7], memory[8]
            memory[0] = held(memory[0], memory[3], half)
            memory[13] = held(memory[13], memory[3], half)
            if memory[13] - memory[0] > PLAY_KNOWN:
                memory[10] = settings[13]  # U has not yet shown where in its play the spool is
            if changes_per_s > 0.0:
                for k in range(moves.EDGES):
                    moved[k, 0] = moving.now[k, 0, drifts.GAIN]
                    moved[k, 1] = moving.now[k, 0, drifts.EDGE]
            for part in range(PARTS):
                before, speed = memory[1], memory[2]
                off = before - memory[0]
                memory[1] = memory[0] + settings[2] * off + settings[3] * speed
                memory[2] = settings[4] * off + settings[5] * speed
                y = 0.5 * (before + memory[1])
                w = (part + 0.5) / PARTS
                a, c = pA + w * (now[2] - pA), pB + w * (now[3] - pB)
                s, d = pS + w * (now[4] - pS), pT + w * (now[5] - pT)
                share_of, of_A, of_B = 1.0 / PARTS, rows[0], rows[1]
                shifts_A, shifts_B = of_A[n + 1] + of_A[n + 2], of_B[n + 1] + of_B[n + 2]
                if y > 0.0:
                    add_edge(table, breaks, y, s - a, share_of, moved[0], theta, of_A, 0, n + 1)
                    at = 3 * knots
                    add_edge(table, breaks, y, c - d, -share_of, moved[3], theta, of_B, at, n + 2)
                else:
                    at = knots
                    add_edge(table, breaks, -y, a - d, -share_of, moved[1], theta, of_A, at, n + 2)
                    at = 2 * knots
                    add_edge(table, breaks, -y, s - c, share_of, moved[2], theta, of_B, at, n + 1)
                # a shift moves |y| by -(1 - |y|/100), the delay moves y by ẏ
                moves_y = math.copysign((memory[1] - before) * PARTS / dt, (memory[1] - before) * y)
                by_delay = -PER_DELAY * moves_y / max(1.0 - 0.01 * abs(y), 0.01)
                of_A[common + COMMAND] += by_delay * (of_A[n + 1] + of_A[n + 2] - shifts_A)
                of_B[common + COMMAND] += by_delay * (of_B[n + 1] + of_B[n + 2] - shifts_B)
            if memory[10] > 0.0:
                memory[10] -= 1.0
                reason = GAP
            elif (
                min(memory[4], now[1]) < settings[11]
                or max(memory[4], now[1]) > stroke - settings[11]
            ):
                reason = END_STOP
            elif min(pA, pB, now[2], now[3]) < settings[10]:
                reason = LOW_PRESSURE
            elif left_out[i]:
                reason = GAP
        memory[11] = max(memory[11] - 1.0, 0.0) if reason == USED else settings[16]
        if reason == USED:
            x = 0.5 * (memory[4] + now[1])
            drop = 0.5 * (pA + now[2] - pB - now[3]) * (memory[12] if memory[12] > 0.0 else 1.0)
            v = 0.5 * (memory[14] + signals[i, 7])
            if math.isfinite(v):
                rows[0, common + ZERO], rows[1, common + ZERO] = 6e-3 * A_A, -6e-3 * A_B
                per_mm = 6e-3 * PER_COMPLIANCE / dt  # l/min a cm² and bar
                rows[0, common + PLACE] = -per_mm * A_A * (now[2] - pA)
                rows[1, common + PLACE] = per_mm * A_B * (now[3] - pB)
                force = A_A * (now[2] - pA) - A_B * (now[3] - pB)
                slides = v * v / (v * v + CREEP_MM_S * CREEP_MM_S)
                bent = 6e-3 * PER_FORCE * dt / 12.0 * force
                for column, part in ((FORCE, slides), (CREEP, 1.0 - slides)):
                    rows[0, common + column] = A_A * part * bent
                    rows[1, common + column] = -A_B * part * bent
            else:
                v = (now[1] - memory[4]) / dt
            rows[0, n] = 6e-3 * A_A * v
            rows[1, n] = -6e-3 * A_B * v
            for line in range(2):
                if line == 0:
                    V, before, after = geometry[3] + 1e-4 * A_A * x, pA, now[2]
                    rows[0, common + LEAKAGE] = -PER_LEAKAGE * drop
                else:
                    V, before, after = geometry[4] + 1e-4 * A_B * (stroke - x), pB, now[3]
                    rows[1, common + LEAKAGE] = PER_LEAKAGE * drop
                taken = 60.0 * V * (after - before) / dt
                square = (before + ATMOSPHERE_BAR) * (after + ATMOSPHERE_BAR)  # exact for air
                rows[line, common + COMPLIANCE] = -PER_COMPLIANCE * taken
                rows[line, common + AIR] = -PER_AIR * taken * ATMOSPHERE_BAR / square
            speeds[i, 0] = v
            speeds[i, 1] = _speed_by_map(rows, theta, places, A_A, A_B)
            counts[0] += 1
            is_row = counts[0] % stride == 0 and memory[11] == 0.0
            if forget < 1.0 and counts[0] % _RENEWED == 0:
                factor = forget**_RENEWED
                for j in range(n):
                    b[j] *= factor
                    for k in range(j + 1):
                        M[j, k] *= factor
                        scores[j, k] *= factor
                for k in range(3):
                    squares[k] *= factor
                for line in range(2):
                    errors[line, 0] *= factor
                    errors[line, 1] *= factor
                    errors[line, 4] *= factor
            for line in range(2):
                row, second = rows[line], filtered[line, 1]
                _smooth(row, filtered[line], share, places[line, 0], places[line, 0] + own)
                _smooth(row, filtered[line], share, common, n + 3)
                if not is_row:
                    continue
                _set_piston_delay(second, filtered[line, 0], theta, places[line], per_s)
                e, weight = second[n], 1.0
                for p in range(places.shape[1]):
                    e -= theta[places[line, p]] * second[places[line, p]]
                if changes_per_s > 0.0:
                    jumps_per_s = changes_per_s if counts[0] >= rules.MATURE else 0.0
                    weight = moves.weight_of_row(
                        moving, line, second, theta, e, t[i], jumps_per_s, room, by
                    )
                _sum_row(M, b, squares, second, places[line, 0], own, line, weight)
                residual[i, line] = e
                for p in range(places.shape[1]):
                    score[places[line, p]] += weight * e * second[places[line, p]]
                e *= math.sqrt(weight)
                errors[line, 0] += e * e
                errors[line, 2] += e
                errors[line, 3] += 1.0
                if errors[line, 3] >= settings[14]:
                    errors[line, 1] += errors[line, 2] * errors[line, 2]
                    errors[line, 4] += errors[line, 3]
                    errors[line, 2] = 0.0
                    errors[line, 3] = 0.0
            if is_row:
                squares[2] += 1.0
                if errors[0, 3] == 0.0:
                    for j in range(n):
                        for k in range(j + 1):
                            scores[j, k] += score[j] * score[k]
                    score[:] = 0.0
        status[i] = reason
        counts[1 + reason] += 1
        last[0] = t[i]
        memory[9] = 1.0
        memory[14] = signals[i, 7]
        for k in range(6):
            memory[3 + k] = now[k]
