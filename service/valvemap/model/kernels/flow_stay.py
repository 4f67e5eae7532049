"""Stays: successive samples in one cell, from which drift and sudden changes are learnt."""

import math

import numpy as np

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_noise as noises
from valvemap.model.kernels import flow_oil as oil
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_play as plays
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_wear as wears
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis, surface
from valvemap.model.kernels.flow_cells import (
    COUNT,
    MEAN_S,
    MEAN_U,
    REFUSALS,
)
from valvemap.model.kernels.flow_changes import tell
from valvemap.model.kernels.flow_drift import Drift
from valvemap.model.kernels.flow_memory import (
    AGAINST,
    ALARMED,
    APART,
    BEGAN,
    BEGAN_TIME,
    BY,
    CALM,
    CLOCK,
    FITTED,
    FLOW,
    KNOWN_COUNT,
    KNOWN_OFF,
    KNOWN_Z,
    LEARNT,
    LOOSE,
    NEXT_FIT,
    NEXT_START,
    NOISY,
    OF,
    OF_MAP,
    PAIR_CELL,
    PAIR_TIME,
    PLACE_S,
    PLACE_U,
    RESIDUAL,
    RIVAL_PARAMETERS,
    RIVAL_SUM,
    ROWS_SEEN,
    SAMPLES,
    SKIPPED,
    STAY_CELL,
    STAY_SIDE,
    STAY_TIME,
    STAYS,
    SURE,
    USED,
    Memory,
    Room,
)
from valvemap.model.samples import Floats, Singles


@inner
def begin_again(memory: Memory) -> None:
    """Forget the cells, as their U was that of another play; scales stay."""
    memory.cells[:] = memory.slopes[:] = 0.0
    memory.begun[:] = 0
    memory.counters[FITTED] = 0
    memory.counters[NEXT_FIT] = memory.counters[USED] + rules.FIRST_FIT
    memory.counters[BEGAN] = memory.counters[USED]
    memory.counters[PAIR_TIME] = memory.counters[BEGAN_TIME] = 0
    memory.scalars[fits.WITHIN : fits.COLOUR + 1] = 0.0
    memory.scalars[fits.SLOW :] = 0.0
    wears.forget(memory.wear)
    for side in range(2):
        drifts.forget(memory.x[side], memory.P[side], memory.chance[side], memory.now[side])


@lean_kernel
def forget_motion(memory: Memory) -> None:
    """Forget what moved in time."""
    memory.counters[ALARMED] = memory.counters[SKIPPED] = memory.counters[STAYS] = 0
    memory.counters[CALM] = memory.counters[USED] + rules.MATURE
    memory.stay[:KNOWN_COUNT] = memory.stay[LOOSE:] = 0.0
    wears.forget(memory.wear)
    for side in range(2):
        drifts.forget(memory.x[side], memory.P[side], memory.chance[side], memory.now[side])


@lean_kernel
def begin_replay(memory: Memory, rows: int, T: float) -> None:
    """Begin again, about to learn from the last ``rows`` samples once more.

    Sudden changes among them were found before, if they were certain.
    """
    begin_again(memory)
    counters, play = memory.counters, memory.play
    counters[CALM] = counters[USED]
    counters[USED] = max(counters[USED] - rows, 1)
    counters[BEGAN] = counters[USED]
    counters[NEXT_FIT] = counters[USED] + rules.FIRST_FIT
    counters[NEXT_START] = rules.SECOND_START
    counters[ROWS_SEEN] = counters[SKIPPED] = counters[STAYS] = counters[CLOCK] = 0
    counters[CLOCK + 1] = counters[LEARNT] = 0
    memory.scalars[fits.FIRST_T] = T
    memory.scalars[fits.SURPRISE] = memory.scalars[fits.STAYS_SEEN] = 0.0
    memory.scalars[fits.PAIR_PRODUCT : fits.PAIRS + 1] = 0.0
    memory.path[paths.SEEN] = 0.0
    memory.stay[:KNOWN_COUNT] = memory.stay[LOOSE:] = 0.0
    play[plays.SEEN] = play[plays.SLOPES] = play[plays.ERRORS] = 0.0
    play[plays.GAINS :] = 0.0


@inner
def begin_stay(
    axis_U: Axis, axis_s: Axis, memory: Memory, gain: float, cell: Singles, room: Room
) -> None:
    """Note what the cell knows: later it knows the stay's own samples."""
    memory.stay[KNOWN_COUNT], memory.stay[KNOWN_OFF] = cell[COUNT], 0.0
    if cell[COUNT] > 0.0:
        own = surface(axis_U, axis_s, memory.theta, cell[MEAN_U], cell[MEAN_S], room.work)
        flow, z = oil.at_first(axis_s, memory, cell, room), memory.stay[KNOWN_Z:]
        memory.stay[KNOWN_OFF] = gain * (flow - own)
        oil.effects_of(axis_s, memory, gain * flow, cell, z)
        z[oil.EFFECTS - 1] *= gain


@inner
def apart(axis_U: Axis, axis_s: Axis, cell: Singles, number: int, at: Floats) -> float:
    """Squared distance of a sample from its cell's mean, in sizes of the cell."""
    parts = len(axis_s.breaks) - 1
    i, j = number // parts, number % parts
    du = (at[PLACE_U] - cell[MEAN_U]) / (axis_U.breaks[i + 1] - axis_U.breaks[i])
    ds = (at[PLACE_S] - cell[MEAN_S]) / (axis_s.breaks[j + 1] - axis_s.breaks[j])
    return float(du * du + ds * ds)


@inner
def note_stay(
    number: int, side: int, t: int, residual: float, weight: float, distance: float, loose: float,
    memory: Memory, at: Floats,
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
    stay[RESIDUAL] += residual - at[AGAINST]  # as the cell is compared: with the map as fitted
    for k in range(drifts.RATES):
        stay[BY + k] += at[OF + k]
    stay[OF_MAP] += at[SURE]
    stay[APART] += distance
    stay[LOOSE] += loose
    stay[NOISY] += noises.of_sample(at[FLOW], memory.scalars)


@inner
def end_stay(axis_U: Axis, axis_s: Axis, memory: Memory, room: Room) -> None:
    """Let the drift learn from the stay that ends."""
    counters, scalars, stay = memory.counters, memory.scalars, memory.stay
    many = stay[SAMPLES]
    variance = stay[NOISY] / max(many, 1.0)
    noise = noises.of_stay(many, variance, scalars) + stay[LOOSE] / max(many, 1.0) ** 2
    if paths.filters(memory.path):  # the filter's errors are common to a stay
        noise = max(noise, rules.STAY_BEHIND_FILTER * variance)
    if counters[FITTED] and counters[STAY_CELL] < len(memory.cells):
        cell = memory.cells[counters[STAY_CELL]]
        is_refused = counters[SKIPPED] and many > 0.0
        if not is_refused or counters[STAYS] == 1:  # a visit counts once: it may be a change
            cell[REFUSALS] = cell[REFUSALS] + 1.0 if is_refused else 0.0
    if many > 0.0 and stay[KNOWN_COUNT] >= rules.VISITED and not paths.filters(memory.path):
        _note_pair(noise + variance / stay[KNOWN_COUNT], variance, memory)
    is_sure = stay[OF_MAP] < many * variance or stay[KNOWN_COUNT] >= rules.SURE_CELL
    age = 1e-9 * float(counters[STAY_TIME] - counters[BEGAN_TIME])
    learnt = counters[USED] - counters[BEGAN]
    is_settled = age >= rules.SETTLED_FOR or learnt >= rules.MATURE
    is_sure = is_sure and learnt >= rules.SETTLED_MAP
    if many > 0.0 and is_sure and stay[KNOWN_COUNT] >= rules.VISITED:
        side = counters[STAY_SIDE]
        of_cell, off = variance / stay[KNOWN_COUNT], stay[KNOWN_OFF]
        # Where a cell's mean is known, the map errs oppositely at its ends, half a cell away.
        of_cell += 4.0 * stay[APART] / many * stay[OF_MAP] / many
        of_map = max(stay[OF_MAP] / many, off * off - of_cell)  # a map that the cell refutes
        share = of_map / (of_map + of_cell)
        residual = stay[RESIDUAL] / many - share * off
        drift = Drift(
            memory.x[side], memory.P[side], memory.chance[side], memory.now[side], room.drift
        )
        by = stay[BY : BY + drifts.RATES]
        for k in range(drifts.RATES):
            by[k] /= many
        for k in range(oil.EFFECTS):  # the law tells of the difference to the cell
            by[drifts.LEVELS + k] -= stay[KNOWN_Z + k]
        law = rules.OTHER_LAW * oil.warm(memory, side, by[drifts.LEVELS :])
        alike = _alike(memory)
        noise += alike * law * law
        noise += by[drifts.EDGE] * by[drifts.EDGE] * _may_lag_behind(memory, axis_U)
        doubt = counters[STAYS] * (noise + share * of_cell)
        if is_settled:
            tell(axis_U, axis_s, drift, residual, by, doubt, memory, room)
        elif alike == 1.0:  # stays of one oil have the error of a young map in common
            drifts.learn_of_T(drift, residual, by, doubt)
    stay[:KNOWN_COUNT] = stay[LOOSE:] = 0.0


@inner
def _note_pair(doubt: float, variance: float, memory: Memory) -> None:
    """Compare the errors of two stays in different cells, longer apart than any lag lasts.

    Each counts in standard deviations of the noise where it is, times the mean one.

    Noise that is as coloured as it seems would have a part of them in common.
    """
    counters, scalars, stay = memory.counters, memory.scalars, memory.stay
    now, before = counters[STAY_TIME], counters[PAIR_TIME]
    apart_s = 1e-9 * float(now - before)
    if before != 0 and 0.0 <= apart_s < 2.0 * rules.METER_LASTS:
        return
    error, most = stay[RESIDUAL] / stay[SAMPLES] - stay[KNOWN_OFF], math.sqrt(doubt)
    error = min(max(error, -rules.MOST_STAY * most), rules.MOST_STAY * most)
    error *= math.sqrt(scalars[fits.VARIANCE] / variance)
    if before != 0 and counters[PAIR_CELL] != counters[STAY_CELL]:
        keep, other = 1.0 - 1.0 / rules.STAY_MEMORY, scalars[fits.PAIR_ERROR]
        square = 0.5 * (error * error + other * other)
        alike = scalars[fits.SLOW] * math.exp(-max(apart_s, 0.0) / rules.METER_LASTS)
        for place in (fits.PAIR_PRODUCT, fits.PAIR_SQUARE, fits.PAIRS):
            scalars[place] *= keep
        scalars[fits.PAIR_PRODUCT] += error * other - alike * square
        scalars[fits.PAIR_SQUARE] += square
        scalars[fits.PAIRS] += 1.0
    scalars[fits.PAIR_ERROR] = error
    counters[PAIR_CELL], counters[PAIR_TIME] = counters[STAY_CELL], now


@inner
def _may_lag_behind(memory: Memory, axis_U: Axis) -> float:
    """Variance of an edge's shift, %², by the likeliest hysteresis that is not in use yet.

    The cell and the stay may be of one branch each.
    """
    rivals, most = memory.rivals, 0.0
    in_use = memory.play[plays.HALF] + memory.path[paths.STICK] + memory.path[paths.RELAYS]
    for row in range(len(rivals)):
        half = -in_use
        for k in (paths.PLAY, paths.STICK, paths.RELAYS):
            half += np.float64(rivals[row, RIVAL_PARAMETERS + k])
        likely = 1.0 - math.exp(-max(np.float64(rivals[row, RIVAL_SUM]), 0.0))
        most = max(most, 2.0 * likely * half * half)
    end = axis_U.breaks[-1] if memory.counters[STAY_SIDE] == 0 else axis_U.breaks[0]
    half_cell = 0.5 * (axis_U.breaks[1] - axis_U.breaks[0])
    to_end = abs(end) - abs(memory.cells[memory.counters[STAY_CELL], MEAN_U])
    return float(most * (end / max(to_end, half_cell)) ** 2)  # an edge shifts full opening by none


@inner
def _alike(memory: Memory) -> float:
    """Number of stays, of this oil: they have an error of the law in common."""
    scalars, x = memory.scalars, oil.viscosity(memory, memory.scalars[fits.NOW_T])
    if abs(x - scalars[fits.STAY_X]) > rules.SAME_OIL:
        scalars[fits.STAY_X], scalars[fits.ALIKE] = x, 0.0
    scalars[fits.ALIKE] += 1.0
    return float(scalars[fits.ALIKE])
