"""One pass over the samples: against the map and what moves, against the own cell, into the cell.

Cells hold samples as they would have been with gain and edge as they were at first, see
`flow_drift`: the map stays, only few numbers move.
"""

import math
from typing import NamedTuple

import numpy as np

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_play as plays
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis, between_sites, slope_U, surface
from valvemap.model.kernels.flow_cells import (
    COUNT,
    MEAN_Q,
    MEAN_S,
    MEAN_U,
    REFUSALS,
    Cells,
    cell_of,
    deposit,
)
from valvemap.model.kernels.flow_drift import Drift
from valvemap.model.samples import Floats, Singles, Status, Times

# Places in `counters`.
USED, NEXT_FIT, FITTED, FITS, NEXT_START = 0, 1, 2, 3, 4
CLOCK = 5  # ns; of the last stay on either side of U = 0: two places
STAY_CELL, STAY_SIDE, STAY_TIME, SKIPPED = 7, 8, 9, 10
CHANGES, CHANGE_SAMPLE, CHANGE_TIME, ALARMED, STAYS, BEGAN = 11, 12, 13, 14, 15, 16
# STAYS: of one visit; BEGAN: samples when the map began again
COUNTERS = 17

# Places in `stay`: samples; sums of residuals, derivatives and variances of the map.
SAMPLES, RESIDUAL, OF_MAP = 0, 1, 2
APART = 3  # sum of squared distances from the cell's mean, in cells
BY = 4  # sums of derivatives, drifts.STATES places
KNOWN_COUNT, KNOWN_OFF, CHANGE_SIZE, STAY = 12, 13, 14, 15  # what the cell knew when the stay began

_OK, _WARMING_UP = int(Status.OK), int(Status.WARMING_UP)
_EXTRAPOLATING = int(Status.EXTRAPOLATING)
_REJECTED, _HELD = int(Status.REJECTED), int(Status.HELD)


class Memory(NamedTuple):
    """One valve's arrays; see `FlowMapState`."""

    cells: Cells
    theta: Floats
    std: Singles
    scalars: Floats
    counters: np.ndarray
    x: Floats
    P: Floats
    chance: Floats
    now: Floats
    stay: Floats
    play: Floats


class Batch(NamedTuple):
    """Samples, and what is found of them; all (N,)."""

    t: Times
    U: Floats
    dp: Floats
    T: Floats
    Q: Floats
    usable: np.ndarray
    predicted: Floats
    residual: Floats
    status: np.ndarray


class Room(NamedTuple):
    """Room to work in: (4, 3); see `Drift`; (AT,)."""

    work: Floats
    drift: Floats
    at: Floats


# Places in `Room.at`: what the map says at one point.
FLOW, SURE, TOTAL, PLACE_U, PLACE_S, SLOPE, WARM, OF = 0, 1, 2, 3, 4, 5, 6, 7
AT = OF + drifts.STATES  # from OF on derivatives by the states of `flow_drift`; WARM: flow due to T


@lean_kernel
def run(
    start: int, stop: int, batch: Batch, axis_U: Axis, axis_s: Axis, memory: Memory, room: Room
) -> int:
    """Learn from samples ``start`` … ``stop`` - 1 until a fit is due; give the next one."""
    counters = memory.counters
    for i in range(start, stop):
        U, dp, Q = batch.U[i], batch.dp[i], batch.Q[i]
        batch.predicted[i] = batch.residual[i] = math.nan
        if not (batch.usable[i] and math.isfinite(U + dp + Q)):
            batch.status[i] = _REJECTED
            continue
        if max(abs(U), abs(dp), abs(Q)) > rules.HUGE:
            batch.status[i] = _HELD
            continue
        s = math.copysign(math.sqrt(abs(dp)), dp)
        batch.status[i] = _learn(i, batch, U, s, Q, axis_U, axis_s, memory, room)
        if counters[USED] >= counters[NEXT_FIT]:
            _end_stay(memory, room)
            if plays.decide(memory.play):
                begin_again(memory)
            return i + 1
    return stop


@inner
def begin_again(memory: Memory) -> None:
    """Forget the cells, as their U was that of another play; scales stay."""
    memory.cells[:] = 0.0
    memory.counters[FITTED] = 0
    memory.counters[NEXT_FIT] = memory.counters[USED] + rules.FIRST_FIT
    memory.counters[BEGAN] = memory.counters[USED]
    memory.scalars[fits.WITHIN : fits.COLOUR + 1] = 0.0
    for side in range(2):
        drifts.forget(memory.x[side], memory.P[side], memory.chance[side], memory.now[side])


@inner
def _learn(
    i: int, batch: Batch, U: float, s: float, Q: float, axis_U: Axis, axis_s: Axis, memory: Memory,
    room: Room,
) -> int:  # fmt: skip
    """Predict one sample, then learn from it; give its status."""
    scalars, counters, at = memory.scalars, memory.counters, room.at
    _, is_beyond = clipped(axis_U, U)
    r, is_beyond_s = clipped(axis_s, s)
    spool = memory.play[plays.SPOOL] if is_beyond or is_beyond_s else plays.follow(memory.play, U)
    u, _ = clipped(axis_U, spool)
    known, side = False, 0 if U >= 0.0 else 1
    place(axis_U, memory, side, u, r, at)
    if counters[USED] == 0:
        scalars[fits.FIRST_T] = batch.T[i]
    at[WARM] = 0.0
    if counters[FITTED]:
        look(axis_U, axis_s, memory, side, u, viscosity(memory, batch.T[i]), room)
        batch.predicted[i], batch.residual[i] = at[FLOW], Q - at[FLOW]
        known = at[TOTAL] < rules.UNKNOWN**2 * scalars[fits.SCALE]
    if is_beyond or is_beyond_s:
        return _EXTRAPOLATING
    gain = 1.0 + memory.now[side, 0, drifts.GAIN]
    number = cell_of(axis_U, axis_s, at[PLACE_U], r)
    weight = 1.0
    if counters[FITTED]:
        residual = batch.residual[i]
        slope = at[SLOPE]
        weight = _trust(residual, axis_U, axis_s, memory, gain, memory.cells[number], room)
        is_young = counters[USED] - counters[BEGAN] < rules.PLAY_FROM
        is_other = counters[STAY_CELL] != number or counters[STAY_SIDE] != side
        if is_other or memory.stay[SAMPLES] >= rules.LONGEST_STAY:
            _end_stay(memory, room)
        if memory.stay[SAMPLES] == 0.0:
            _begin_stay(axis_U, axis_s, memory, gain, memory.cells[number], room)
        known_well = at[SURE] < scalars[fits.VARIANCE] + 2.0 * scalars[fits.MISFIT]
        if weight > 0.5 and known_well and not is_young:
            visit = 0.0  # samples in this cell so far: all have the map's misfit in common
            if counters[STAY_CELL] == number:
                visit = (counters[STAYS] - 1) * rules.LONGEST_STAY + memory.stay[SAMPLES]
            doubt = (scalars[fits.VARIANCE] + at[SURE]) * max(visit / rules.SHORTEST_STAY, 1.0)
            plays.weigh(memory.play, U, residual, slope, doubt)
        apart = _apart(axis_U, axis_s, memory.cells[number], number, at)
        _note_stay(number, side, batch.t[i], residual, weight, apart, memory, at)
        if counters[SKIPPED] and memory.stay[SAMPLES] >= rules.SHORTEST_STAY:
            _end_stay(memory, room)
    share = 1.0 / min(scalars[fits.SCALE_WEIGHT] + 1.0, rules.NOISE_MEMORY)
    scalars[fits.SCALE_WEIGHT] += 1.0
    scalars[fits.SCALE] += share * (Q * Q - scalars[fits.SCALE])
    way = abs(u - scalars[fits.LAST_U]) / rules.WAY_U
    way += abs(r - scalars[fits.LAST_S]) / (rules.WAY_S * axis_s.breaks[-1])
    alike = scalars[fits.COLOUR] * math.exp(-way)
    worth = (1.0 - alike) / (1.0 + alike)
    if counters[FITTED]:  # what a stay has in common: where gain and edge are
        shared = rules.SHARED * (at[TOTAL] - at[SURE])
        weight *= min(1.0, scalars[fits.VARIANCE] / max(shared, 1e-300))
    deposit(
        memory.cells[number], at[PLACE_U], r, (Q - at[WARM]) / gain, weight, worth, rules.MEMORY
    )
    scalars[fits.LAST_U], scalars[fits.LAST_S] = u, r
    counters[USED] += 1
    return _OK if known else _WARMING_UP


@inner
def clipped(axis: Axis, x: float) -> tuple[float, bool]:
    """Nearest point of the axis, and whether x lies too far beyond it to count there."""
    low, high = axis.breaks[0], axis.breaks[-1]
    slack = rules.BEYOND * (high - low)
    return min(max(x, low), high), x < low - slack or x > high + slack


@inner
def place(axis_U: Axis, memory: Memory, side: int, u: float, r: float, at: Floats) -> None:
    """Where a point lies on the map as it was at first."""
    end = abs(axis_U.breaks[-1] if side == 0 else axis_U.breaks[0])
    shifted = u - memory.now[side, 0, drifts.EDGE] * max(1.0 - abs(u) / max(end, 1e-9), 0.0)
    at[PLACE_U] = min(max(shifted, axis_U.breaks[0]), axis_U.breaks[-1])
    at[PLACE_S] = r


@inner
def look(
    axis_U: Axis, axis_s: Axis, memory: Memory, side: int, u: float, thinner: float, room: Room
) -> None:
    """Fill what the map says at a place: flow, derivatives, variances without and with drift."""
    at, now = room.at, memory.now[side]
    gain = 1.0 + now[0, drifts.GAIN]
    end = abs(axis_U.breaks[-1] if side == 0 else axis_U.breaks[0])
    flow = surface(axis_U, axis_s, memory.theta, at[PLACE_U], at[PLACE_S], room.work)
    slope = slope_U(axis_U, axis_s, memory.theta, at[PLACE_U], at[PLACE_S], room.work)
    along = math.copysign(1.0, at[PLACE_S]) * (1.0 if side == 0 else -1.0)
    least = memory.scalars[fits.LEAST]
    if flow * along < least:  # flow does not run against Δp but for an offset of the meter
        flow, slope = least * along, 0.0
    spread = between_sites(axis_U, axis_s, memory.std, at[PLACE_U], at[PLACE_S])
    for k in range(drifts.STATES):
        at[OF + k] = 0.0
    at[OF + drifts.GAIN] = flow
    at[SLOPE] = gain * slope
    at[OF + drifts.EDGE] = -gain * slope * max(1.0 - abs(u) / max(end, 1e-9), 0.0)
    _warm(axis_s, memory, flow, thinner, at)
    for k in range(drifts.RATES, drifts.STATES):
        at[WARM] += at[OF + k] * now[0, k]
    at[FLOW] = gain * flow + at[WARM]
    at[SURE] = gain * gain * (spread * spread + memory.scalars[fits.MISFIT])
    moved = 0.0
    for k in range(drifts.STATES):
        for j in range(drifts.STATES):
            moved += at[OF + k] * at[OF + j] * now[1 + k, j]
    at[TOTAL] = at[SURE] + max(moved, 0.0)


@inner
def _warm(axis_s: Axis, memory: Memory, flow: float, thinner: float, at: Floats) -> None:
    """Derivatives by the effects of T: gain, laminar flow by √ν and ν, leakage by 1/ν."""
    top, s = axis_s.breaks[-1], at[PLACE_S]
    laminar = rules.STRONG * flow * rules.LAMINAR * top / (abs(s) + rules.LAMINAR * top)
    at[WARM] = 0.0
    nu = 1.0 + thinner
    at[OF + drifts.RATES] = math.log(nu) * flow
    at[OF + drifts.RATES + 1] = (math.sqrt(nu) - 1.0) * laminar
    at[OF + drifts.RATES + 2] = thinner * laminar
    leakage = s * abs(s) / (top * top) * math.sqrt(memory.scalars[fits.SCALE])
    at[OF + drifts.RATES + 3] = (1.0 / nu - 1.0) * leakage


@inner
def viscosity(memory: Memory, T: float) -> float:
    """How much thicker the oil is than at the first sample, as a share; 0 where T is not known."""
    first = memory.scalars[fits.FIRST_T]
    if not (math.isfinite(T) and math.isfinite(first)):
        return 0.0
    return math.exp(min(max(rules.THINNING * (first - T), -2.0), 2.0)) - 1.0


@inner
def _trust(
    residual: float, axis_U: Axis, axis_s: Axis, memory: Memory, gain: float, cell: Singles,
    room: Room,
) -> float:  # fmt: skip
    """Probability that a sample is none that the meter invented, by the map or by its cell."""
    scalars, counters = memory.scalars, memory.counters
    if not cell[COUNT] > 0.0:  # a fit weighs a cell of one sample against all others
        scalars[fits.LAST_ERROR] = 0.0
        return 1.0
    width = rules.OUTLIER_WIDTH * math.sqrt(scalars[fits.SCALE])
    noise, variance = scalars[fits.VARIANCE], room.at[TOTAL]
    own = surface(axis_U, axis_s, memory.theta, cell[MEAN_U], cell[MEAN_S], room.work)
    off = gain * (cell[MEAN_Q] - own)
    error = residual - off
    by_map = fits.outlier_weight(residual * residual, noise + variance, width)
    doubt = noise * (1.0 + 1.0 / cell[COUNT]) + scalars[fits.MISFIT]
    weight = max(by_map, fits.outlier_weight(error * error, doubt, width))
    if cell[REFUSALS] >= rules.REFUSED:
        cell[:] = 0.0
        weight = 1.0
    elif cell[COUNT] < rules.FEW and by_map > 0.5:
        doubt = noise / cell[COUNT] + variance
        if fits.outlier_weight(off * off, doubt, width / cell[COUNT]) < rules.DOUBTED:
            cell[:] = 0.0
    if cell[COUNT] > 0.0 and variance < noise:
        _note_error(error, weight, cell[COUNT], counters[USED] - counters[BEGAN], scalars)
    else:
        scalars[fits.LAST_ERROR] = 0.0
    return weight


@inner
def _note_error(error: float, weight: float, count: float, age: int, scalars: Floats) -> None:
    """Add an error against the sample's own cell to the noise's variance and correlation."""
    rest = 1.0 - 1.0 / min(max(0.5 * age, 50.0), rules.NOISE_MEMORY)  # early maps were worse
    part = count / (count + 1.0)
    scalars[fits.WITHIN] = rest * scalars[fits.WITHIN] + weight * part * error * error
    scalars[fits.WITHIN_WEIGHT] = rest * scalars[fits.WITHIN_WEIGHT] + weight
    last = scalars[fits.LAST_ERROR]
    scalars[fits.LAST_ERROR] = weight * error if count >= rules.COLOUR_FROM else 0.0
    if last != 0.0 and count >= rules.COLOUR_FROM:
        scalars[fits.NEXT] = rest * scalars[fits.NEXT] + weight * error * last
        scalars[fits.NEXT_WEIGHT] = rest * scalars[fits.NEXT_WEIGHT] + weight
        many, variance = scalars[fits.NEXT_WEIGHT], scalars[fits.WITHIN]
        rho = scalars[fits.NEXT] / many * scalars[fits.WITHIN_WEIGHT] / max(variance, 1e-300)
        sure = rho * rho * many > rules.SURE_COLOUR**2
        scalars[fits.COLOUR] = min(max(rho, 0.0), rules.MOST_COLOUR) if sure else 0.0


@inner
def _begin_stay(
    axis_U: Axis, axis_s: Axis, memory: Memory, gain: float, cell: Singles, room: Room
) -> None:
    """Note what the cell knows: later it knows the stay's own samples."""
    memory.stay[KNOWN_COUNT], memory.stay[KNOWN_OFF] = cell[COUNT], 0.0
    if cell[COUNT] > 0.0:
        own = surface(axis_U, axis_s, memory.theta, cell[MEAN_U], cell[MEAN_S], room.work)
        memory.stay[KNOWN_OFF] = gain * (cell[MEAN_Q] - own)


@inner
def _apart(axis_U: Axis, axis_s: Axis, cell: Singles, number: int, at: Floats) -> float:
    """Squared distance of a sample from its cell's mean, in sizes of the cell."""
    parts = len(axis_s.breaks) - 1
    i, j = number // parts, number % parts
    du = (at[PLACE_U] - cell[MEAN_U]) / (axis_U.breaks[i + 1] - axis_U.breaks[i])
    ds = (at[PLACE_S] - cell[MEAN_S]) / (axis_s.breaks[j + 1] - axis_s.breaks[j])
    return float(du * du + ds * ds)


@inner
def _note_stay(
    number: int, side: int, t: int, residual: float, weight: float, apart: float, memory: Memory,
    at: Floats,
) -> None:  # fmt: skip
    """Add a sample to the stay in its cell; a single one that is refused is left out."""
    counters, stay = memory.counters, memory.stay
    if stay[SAMPLES] == 0.0:
        counters[STAYS] = counters[STAYS] + 1 if number == counters[STAY_CELL] else 1
    counters[STAY_CELL], counters[STAY_SIDE], counters[STAY_TIME] = number, side, t
    if weight < 0.5 and counters[SKIPPED] == 0:
        counters[SKIPPED] = 1
        return
    counters[SKIPPED] = 0 if weight >= 0.5 else 1
    stay[SAMPLES] += 1.0
    stay[RESIDUAL] += residual
    for k in range(drifts.STATES):
        stay[BY + k] += at[OF + k]
    stay[OF_MAP] += at[SURE]
    stay[APART] += apart


@inner
def _end_stay(memory: Memory, room: Room) -> None:
    """Let the drift learn from the stay that ends."""
    counters, scalars, stay = memory.counters, memory.scalars, memory.stay
    many = stay[SAMPLES]
    rho = scalars[fits.COLOUR]
    noise = scalars[fits.VARIANCE] * min((1.0 + rho) / (1.0 - rho) / max(many, 1.0), 1.0)
    alike = rho**many
    noise *= (1.0 + alike) / (1.0 - alike)  # the stay before has noise in common
    if counters[FITTED] and counters[STAY_CELL] < len(memory.cells):
        cell = memory.cells[counters[STAY_CELL]]
        cell[REFUSALS] = cell[REFUSALS] + 1.0 if counters[SKIPPED] and many > 0.0 else 0.0
    is_sure = stay[OF_MAP] < many * scalars[fits.VARIANCE]
    is_sure = is_sure and counters[USED] - counters[BEGAN] >= rules.SETTLED_MAP
    if many > 0.0 and is_sure and stay[KNOWN_COUNT] >= rules.VISITED:
        side, now = counters[STAY_SIDE], counters[STAY_TIME]
        last = counters[CLOCK + side]
        dt = min(max(1e-9 * float(now - last), 0.0), rules.OLDEST) if last != 0 else 0.0
        counters[CLOCK + side] = now
        of_cell, off = scalars[fits.VARIANCE] / stay[KNOWN_COUNT], stay[KNOWN_OFF]
        of_cell += stay[APART] / many * stay[OF_MAP] / many
        of_map = max(stay[OF_MAP] / many, off * off - of_cell)  # a map that the cell refutes
        share = of_map / (of_map + of_cell)
        residual = stay[RESIDUAL] / many - share * off
        drift = Drift(
            memory.x[side], memory.P[side], memory.chance[side], memory.now[side], room.drift
        )
        by = stay[BY : BY + drifts.STATES]
        for k in range(drifts.STATES):
            by[k] /= many
        young = counters[USED] - counters[BEGAN] < rules.MATURE
        jumps = 0.0 if young else min(dt / rules.BETWEEN_JUMPS, 0.1)
        drifts.step(
            drift, dt, jumps, residual, by, counters[STAYS] * (noise + share * of_cell)
        )  # fmt: skip
        jumped = drift.chance[drifts.OTHER_GAIN] + drift.chance[drifts.OTHER_EDGE]
        if jumped > rules.CERTAIN and not counters[ALARMED]:
            counters[ALARMED] = 1
            counters[CHANGES] += 1
            counters[CHANGE_SAMPLE], counters[CHANGE_TIME] = counters[USED], now
            stay[CHANGE_SIZE] = residual
        elif jumped < rules.OVER and 1e-9 * float(now - counters[CHANGE_TIME]) > rules.AFTER_JUMP:
            counters[ALARMED] = 0
    stay[:KNOWN_COUNT] = 0.0


@lean_kernel
def evaluate(
    axis_U: Axis, axis_s: Axis, memory: Memory, U: Floats, dp: Floats, T: Floats, Q: Floats,
    spread: Floats,
    room: Room,
) -> None:  # fmt: skip
    """Flow and its standard deviation at N points; NaN where a point or the map is not known."""
    at = room.at
    for i in range(len(U)):
        Q[i] = spread[i] = math.nan
        if not (memory.counters[FITTED] and math.isfinite(U[i] + dp[i])):
            continue
        s = math.copysign(math.sqrt(abs(dp[i])), dp[i])
        u, _ = clipped(axis_U, U[i])
        r, _ = clipped(axis_s, s)
        side = 0 if U[i] >= 0.0 else 1
        place(axis_U, memory, side, u, r, at)
        look(axis_U, axis_s, memory, side, u, viscosity(memory, T[i]), room)
        if at[TOTAL] < rules.UNKNOWN**2 * memory.scalars[fits.SCALE]:
            Q[i], spread[i] = at[FLOW], math.sqrt(at[TOTAL])
