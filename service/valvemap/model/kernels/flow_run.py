"""One pass over the samples: against the map and what moves, against the own cell, into the cell.

Cells hold samples as they would have been with gain and edge as they were at first, see
`flow_drift`: the map stays, only few numbers move.
"""

import math

import numpy as np

from valvemap.model.kernels import flow_begun as begins
from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_meter as meters
from valvemap.model.kernels import flow_noise as noises
from valvemap.model.kernels import flow_oil as oil
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_play as plays
from valvemap.model.kernels import flow_recent as recent_rows
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_slopes as slopes
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis, interval
from valvemap.model.kernels.flow_cells import (
    COUNT,
    cell_of,
    deposit,
    share_of,
)
from valvemap.model.kernels.flow_look import clipped, look, place
from valvemap.model.kernels.flow_memory import (
    A_CHANGE,
    ALARMED,
    BEGAN,
    BEGAN_TIME,
    BLOCKED,
    CENSORED,
    DOUBTED,
    FITTED,
    FLOW,
    LAST_TIME,
    LEARNT,
    MOVED,
    NEXT_FIT,
    PLACE_U,
    ROWS_SEEN,
    SAMPLES,
    SKIPPED,
    SLOPE,
    STAY_CELL,
    STAY_SIDE,
    STAYS,
    SURE,
    TOTAL,
    USED,
    Batch,
    Memory,
    Room,
)
from valvemap.model.kernels.flow_stay import (
    apart,
    begin_again,
    begin_stay,
    end_stay,
    note_stay,
)
from valvemap.model.kernels.flow_trust import (
    is_surprising,
    looseness,
    shows_nothing,
    trust,
    weigh_guess,
)
from valvemap.model.samples import Floats
from valvemap.vocabulary.statuses import Status

_OK, _WARMING_UP = int(Status.OK), int(Status.WARMING_UP)
_EXTRAPOLATING = int(Status.EXTRAPOLATING)
_REJECTED, _HELD = int(Status.REJECTED), int(Status.HELD)


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
        if max(abs(U), abs(dp), abs(Q), abs(batch.p1[i])) > rules.HUGE:
            batch.status[i] = _HELD
            continue
        alarmed = counters[ALARMED]
        batch.status[i] = _learn(i, batch, axis_U, axis_s, memory, room)
        if counters[ALARMED] > alarmed:  # may be the meter's end, reached for the first time
            counters[DOUBTED] = A_CHANGE
            counters[NEXT_FIT] = counters[USED]
        if counters[USED] >= counters[NEXT_FIT]:
            end_stay(axis_U, axis_s, memory, room)
            if plays.decide(memory.play):
                begin_again(memory)
            return i + 1
    return stop


@inner
def _learn(
    i: int, batch: Batch, axis_U: Axis, axis_s: Axis, memory: Memory, room: Room
) -> int:  # fmt: skip
    """Predict one sample, then learn from it; give its status."""
    counters, path, recent = memory.counters, memory.path, memory.recent
    s = paths.effective(batch.dp[i], batch.p1[i], path)
    if clipped(axis_U, batch.U[i])[1] or clipped(axis_s, s)[1]:
        _predict(i, memory.play[plays.SPOOL], s, batch, axis_U, axis_s, memory, room)
        return _EXTRAPOLATING
    row, step = _keep(i, batch, memory)
    if not paths.looks_ahead(path):
        U, dp, p1, Q = batch.U[i], batch.dp[i], batch.p1[i], batch.Q[i]
        return _learn_row(i, row, U, dp, p1, Q, step, batch, axis_U, axis_s, memory, room)
    while _is_due(memory):
        row = counters[LEARNT] % len(recent)
        U, _ = recent_rows.commanded(row, memory)
        dp, _ = recent_rows.between(row, paths.LEFT_DP, path[paths.HELD_P], memory)
        p1, _ = recent_rows.between(row, paths.LEFT_P1, path[paths.HELD_P], memory)
        Q, step = np.float64(recent[row, paths.LEFT_Q]), np.float64(recent[row, paths.STEP])
        _learn_row(i, row, U, dp, p1, Q, step, batch, axis_U, axis_s, memory, room)
        counters[LEARNT] += 1
    return _predict(i, batch.U[i], s, batch, axis_U, axis_s, memory, room)


@inner
def _predict(
    i: int, u: float, s: float, batch: Batch, axis_U: Axis, axis_s: Axis, memory: Memory,
    room: Room,
) -> int:  # fmt: skip
    """Predict a sample that is not learnt now; give its status."""
    u, r, at = clipped(axis_U, u)[0], clipped(axis_s, s)[0], room.at
    side = 0 if u >= 0.0 else 1
    if not memory.counters[FITTED]:
        return _WARMING_UP
    place(axis_U, memory, side, u, r, at)
    look(axis_U, axis_s, memory, side, u, oil.viscosity(memory, batch.T[i]), room, True)  # noqa: FBT003
    offset = memory.now[side, 0, drifts.ZERO] * memory.scalars[fits.ZERO_SCALE]
    batch.predicted[i] = paths.shown(at[FLOW] + offset, memory.path)
    batch.residual[i] = batch.Q[i] - batch.predicted[i]
    known = at[TOTAL] < rules.UNKNOWN**2 * memory.scalars[fits.SCALE]
    return _OK if known else _WARMING_UP


@inner
def _is_due(memory: Memory) -> bool:
    """Whether the oldest row that is not learnt has waited long enough, or must not wait longer."""
    counters, recent, age = memory.counters, memory.recent, 0.0
    behind, needed = 0, rules.BESIDE if memory.path[paths.NOISE_U] > 0.0 else 1
    if counters[LEARNT] >= counters[ROWS_SEEN]:
        return False
    at = counters[LEARNT] % len(recent)
    if counters[ROWS_SEEN] - counters[LEARNT] >= len(recent):
        return True
    for _ in range(recent_rows.ahead(at, memory)):
        at = at + 1 if at + 1 < len(recent) else 0
        age, behind = age + np.float64(recent[at, paths.STEP]), behind + 1
        if recent[at, paths.STEP] >= rules.GAP:
            return True
        if behind >= needed and age >= paths.waits(memory.path):
            return True
    return False


@inner
def _learn_row(
    i: int, row: int, U: float, dp: float, p1: float, Q: float, step: float, batch: Batch,
    axis_U: Axis, axis_s: Axis, memory: Memory, room: Room,
) -> int:  # fmt: skip
    """Predict and learn from a row as its signals were; give its status."""
    scalars, counters, at, path = memory.scalars, memory.counters, room.at, memory.path
    recent = memory.recent
    room.means[6:] = 0.0
    u, _ = clipped(axis_U, _follow(row, U, step, memory, room))
    known, side = False, 0 if u >= 0.0 else 1
    measured = paths.effective(dp, p1, path)
    r = clipped(axis_s, _true_root(axis_s, side, dp, p1, memory))[0]
    shift = r - clipped(axis_s, measured)[0]  # by the offset of dp
    place(axis_U, memory, side, u, r, at)
    if counters[USED] == 0:
        scalars[fits.FIRST_T] = batch.T[i] if abs(batch.T[i]) < rules.HUGE else math.nan
        scalars[fits.NOW_T] = math.nan
    beyond = 0.0  # flow that the meter shows beyond that of the place
    bent, own = 0.0, 1.0  # variance of that; of what the sample says, the share on its own cell
    loose = 0.0  # variance of the flow by that of signals on the way between two values
    rate = 0.0  # of the flow, l/min/s
    if paths.shows_past(path):
        if not _metered(axis_U, axis_s, row, u, memory, room):
            return _WARMING_UP
        u, r, beyond = room.means[0], clipped(axis_s, room.means[1] + shift)[0], room.means[2]
        own = _own(axis_U, axis_s, room.means)
        side = 0 if u >= 0.0 else 1
        place(axis_U, memory, side, u, r, at)
    if counters[FITTED]:
        look(axis_U, axis_s, memory, side, u, oil.viscosity(memory, batch.T[i]), room, True)  # noqa: FBT003
        bent = min(room.means[3], at[SURE]) if beyond != 0.0 else 0.0
        bent += (rules.BENT_BY_LAGS * beyond) ** 2
        if paths.looks_ahead(path) or room.means[6] + room.means[7] > 0.0:
            loose = looseness(row, dp, p1, axis_U, axis_s, memory, room)
        rate = _rate(at[FLOW] + beyond, step, scalars)
        loose += noises.of_timing(rate, scalars)
        at[SURE] += bent + loose
        at[TOTAL] += bent + loose
    beyond += memory.now[side, 0, drifts.ZERO] * scalars[fits.ZERO_SCALE]
    if counters[FITTED]:
        batch.predicted[i] = paths.shown(at[FLOW] + beyond, path)
        batch.residual[i] = Q - batch.predicted[i]
        known = at[TOTAL] < rules.UNKNOWN**2 * scalars[fits.SCALE]
    if abs(batch.T[i]) < rules.HUGE:
        scalars[fits.NOW_T] = batch.T[i]
    is_new = recent[row, paths.LEFT_Q] != recent[row - 1, paths.LEFT_Q]
    if path[paths.HELD_Q] > 0.0 and not is_new:
        return _OK if known else _WARMING_UP
    number = cell_of(axis_U, axis_s, at[PLACE_U], r)
    is_censored = paths.censored(Q, at[FLOW] + beyond if counters[FITTED] else Q, path)
    if counters[FITTED]:
        counters[BLOCKED] = shows_nothing(Q, at, memory.cells[number], memory)
        repeats = not is_new and is_surprising(batch.residual[i], at, scalars)
        is_censored = is_censored or repeats
    if is_censored or counters[BLOCKED]:
        counters[USED] += 1
        counters[CENSORED] += 1
        return _OK if known else _WARMING_UP
    Q -= beyond
    gain = 1.0 + memory.now[side, 0, drifts.GAIN]
    weight, stays = 1.0, counters[FITTED] and counters[STAY_CELL] == number
    if counters[FITTED]:
        residual = batch.residual[i]
        slope = at[SLOPE]
        weight = trust(residual, axis_U, axis_s, memory, gain, number, bent, rate, room)
        if memory.cells[number, COUNT] == 0.0:
            weigh_guess(residual, memory, at)
        is_young = counters[USED] - counters[BEGAN] < rules.PLAY_FROM
        is_other = counters[STAY_CELL] != number or counters[STAY_SIDE] != side
        if is_other or memory.stay[SAMPLES] >= rules.LONGEST_STAY:
            end_stay(axis_U, axis_s, memory, room)
        if memory.stay[SAMPLES] == 0.0:
            begin_stay(axis_U, axis_s, memory, gain, memory.cells[number], room)
            sensing = memory.chance[0, drifts.SENSING] + memory.chance[1, drifts.SENSING]
            offset, of_offset = memory.now[side, 0], memory.now[side, 1 + drifts.ZERO]
            is_none = offset[drifts.ZERO] ** 2 <= rules.SURE**2 * of_offset[drifts.ZERO]
            if sensing < rules.WORTH_SAYING and is_none:  # as flows were before it moved
                usual = math.sqrt(scalars[fits.SCALE])
                scalars[fits.ZERO_SCALE] = max(scalars[fits.ZERO_SCALE], usual)
        noise = noises.of_sample(at[FLOW], scalars)
        known_well = at[SURE] < noise + 2.0 * scalars[fits.MISFIT]
        has_play = path[paths.STICK] + path[paths.RELAYS] + path[paths.NEWS] == 0.0
        if weight > 0.5 and known_well and has_play and not is_young:
            visit = 0.0  # samples in this cell so far: all have the map's misfit in common
            if counters[STAY_CELL] == number:
                visit = (counters[STAYS] - 1) * rules.LONGEST_STAY + memory.stay[SAMPLES]
            doubt = (noise + at[SURE]) * max(visit / rules.SHORTEST_STAY, 1.0)
            doubt *= noises.spreads(scalars, 1.0)
            plays.weigh(memory.play, path[paths.LAGGED], residual, slope, doubt)
        distance = apart(axis_U, axis_s, memory.cells[number], number, at)
        if bent + loose <= rules.STEADY_FILTER * noise:
            note_stay(number, side, batch.t[i], residual, weight, distance, loose, memory, at)
        if counters[SKIPPED] and memory.stay[SAMPLES] >= rules.SHORTEST_STAY:
            end_stay(axis_U, axis_s, memory, room)
    share = 1.0 / min(scalars[fits.SCALE_WEIGHT] + 1.0, rules.NOISE_MEMORY)
    scalars[fits.SCALE_WEIGHT] += 1.0
    scalars[fits.SCALE] += share * (Q * Q - scalars[fits.SCALE])
    way = abs(u - scalars[fits.LAST_U]) / rules.WAY_U
    way += abs(r - scalars[fits.LAST_S]) / (rules.WAY_S * axis_s.breaks[-1])
    worth = 1.0 / noises.spreads(scalars, math.exp(-way))
    if abs(batch.T[i]) < rules.HUGE:
        learnt = min(counters[USED] - counters[BEGAN] + 1.0, batch.longest * len(memory.cells))
        scalars[fits.LEARNT_T] += (batch.T[i] - scalars[fits.LEARNT_T]) / learnt
    if counters[FITTED]:  # what a stay has in common: where gain and edge are
        shared = rules.SHARED * (at[MOVED] + bent + loose)
        noise = noises.of_sample(at[FLOW], scalars)
        weight *= min(1.0, noise / max(shared, 1e-300)) * own
    weight *= min(gain * gain, 1.0)  # of what was Q / gain at first, the noise is σ / gain
    if gain <= rules.LEAST_GAIN:
        weight, gain = 0.0, 1.0
    x, Q = oil.viscosity(memory, batch.T[i]), Q / gain
    cell, y, longest = memory.cells[number], oil.bend(x), batch.longest
    if stays:
        longest *= max(rules.APART / max(step, 1e-9), 1.0)
    if weight > 0.0 and cell[COUNT] == 0.0:
        begins.note(memory.begun[side], number)
    if weight > 0.0 and not paths.filters(path):
        before = np.float64(scalars[fits.LAST_S]) if stays else math.nan
        share = share_of(cell, weight, longest)
        slopes.note(memory.slopes, memory.cells, number, at[PLACE_U], r, Q, share, before)
    deposit(cell, at[PLACE_U], r, x, y, Q, weight, worth, longest)
    scalars[fits.LAST_U], scalars[fits.LAST_S] = u, r
    counters[USED] += 1
    if counters[BEGAN_TIME] == 0:
        counters[BEGAN_TIME] = batch.t[i]
    return _OK if known else _WARMING_UP


@inner
def _rate(flow: float, step: float, scalars: Floats) -> float:
    """How fast the flow changed before this sample, l/min/s: with it, noise of Δp were a rate."""
    rate = np.float64(scalars[fits.RATE]) if step < rules.GAP else 0.0
    scalars[fits.RATE] = (
        (flow - scalars[fits.FLOW_BEFORE]) / step if 0.0 < step < rules.GAP else 0.0
    )
    scalars[fits.FLOW_BEFORE] = flow
    return float(rate)


@inner
def _true_root(axis_s: Axis, side: int, dp: float, p1: float, memory: Memory) -> float:
    """Root of the Δp that counts without the sensors' offset."""
    offset = memory.now[side, 0, drifts.PRESSURE] * axis_s.breaks[-1] ** 2
    return float(paths.effective(dp - offset, p1, memory.path))


@inner
def _keep(i: int, batch: Batch, memory: Memory) -> tuple[int, float]:
    """Keep a sample as measured; give its row and the time since the one before."""
    counters, path, recent = memory.counters, memory.path, memory.recent
    newest = counters[ROWS_SEEN] % len(recent)
    step = 1e-9 * float(batch.t[i] - counters[LAST_TIME])
    fresh = path[paths.SEEN] == 0.0 or not 0.0 <= step < rules.GAP
    row = recent[newest]
    row[paths.STEP] = rules.GAP if fresh else step
    row[paths.LEFT_U], row[paths.LEFT_DP] = batch.U[i], batch.dp[i]
    row[paths.LEFT_P1], row[paths.LEFT_Q] = batch.p1[i], batch.Q[i]
    counters[ROWS_SEEN] += 1
    counters[LAST_TIME] = batch.t[i]
    path[paths.SEEN] = 1.0
    return newest, rules.GAP if fresh else step


@inner
def _follow(row: int, U: float, step: float, memory: Memory, room: Room) -> float:
    """Move the spool; give where it is."""
    path, recent = memory.path, memory.recent
    if path[paths.DEAD_U] > 0.0:
        ahead = recent_rows.ahead(row, memory)
        known = min(memory.counters[ROWS_SEEN], len(recent)) - ahead
        U, room.means[6] = paths.late(recent, row, known, ahead, path)
    return plays.follow(memory.play, paths.spool(U, step, step >= rules.GAP, path))


@inner
def _metered(axis_U: Axis, axis_s: Axis, row: int, u: float, memory: Memory, room: Room) -> bool:
    """Fill `room.means`; False: the last samples do not tell what the meter shows."""
    recent, ahead, least = memory.recent, recent_rows.ahead(row, memory), memory.scalars[fits.LEAST]
    recent[row, paths.SPOOL] = u
    known = min(memory.counters[ROWS_SEEN], len(recent)) - ahead
    return meters.metered(
        axis_U, axis_s, memory.theta, least, recent, row, known, ahead, memory.path, room.work,
        room.means,
    )  # fmt: skip


@inner
def _own(axis_U: Axis, axis_s: Axis, means: Floats) -> float:
    """Share of a cell's detail that a meter passes: 1 / √(1 + (ω·τ)²), ω = π·speed / size."""
    i, j = interval(axis_U, means[0]), interval(axis_s, means[1])
    du, ds = axis_U.breaks[i + 1] - axis_U.breaks[i], axis_s.breaks[j + 1] - axis_s.breaks[j]
    lost = max(means[4], 0.0) / (du * du) + max(means[5], 0.0) / (ds * ds)
    return float(1.0 / math.sqrt(1.0 + math.pi * math.pi * lost))
