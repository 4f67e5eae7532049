"""Judges residuals: their recent size over their usual one, in cells that the map knows."""

import numpy as np

from valvemap.model.kernels.compiled import inlined
from valvemap.model.samples import Floats
from valvemap.pipeline.kernels.alarm_causes import add_up, forget_half, write_causes
from valvemap.pipeline.kernels.alarm_layout import (
    BLOCK_N,
    BLOCK_SUM,
    CELL,
    CELLS_S,
    CELLS_U,
    KNOWN,
    LARGE_SINCE,
    LARGE_UNTIL,
    Q_BEFORE,
    RATIO,
    RECENT,
    RECENT_N,
    RESIDUAL,
    SQUARES,
    USUAL,
    USUAL_N,
    USUAL_SQUARE,
    USUAL_SQUARE_N,
    Conditions,
    Senses,
    Watched,
)
from valvemap.pipeline.kernels.alarm_steps import step
from valvemap.vocabulary.signals import Signal

WIDTH_U, WIDTH_S = 10.0, 1.5  # %, √bar; size of the cells in which residuals are compared
BLOCK = 16.0  # residuals per average: a persistent error exceeds the averaged noise
RECENT_BLOCKS = 32.0  # blocks; memory of the recent mean square: 5 s at 100 Hz
USUAL_BLOCKS = 1_000.0  # blocks; memory of the usual mean square: minutes
ENOUGH_BLOCKS = 64.0  # blocks until the usual mean square is known
SETTLED_BLOCKS = 400.0  # blocks until the map has converged and residuals are the valve's: minutes
PLACE_MEMORY = 1_000.0  # samples; memory of one cell
KNOWN_PLACE = 50.0  # samples until a cell's usual residual is known
OUTLIER = 25.0  # times the usual square; larger squares are clipped in the usual mean
LARGEST = 400.0  # times the usual square; larger blocks are clipped: a spike must not last seconds
NEGLIGIBLE = 0.0035  # of the flow's range; a smaller increase of the residuals is no alarm
CONFIRMED = 1.6  # times the usual; residuals that confirm a change
USUAL_SAMPLES = 5_000.0  # samples; memory of the usual mean square over all cells
AS_USUAL = 4.0  # times the usual square; a smaller block carries no information on causes

_U, _P1, _P2 = int(Signal.U), int(Signal.P1), int(Signal.P2)


@inlined
def look_at_residual(
    m: int,
    i: int,
    seen: Watched,
    rules: Floats,
    conditions: Conditions,
    senses: Senses,
    Q_span: float,
    shares: Floats,
) -> None:
    """Judge the ratio of the recent block-averaged residuals to their usual size.

    Only in known cells: in a new cell the map is an extrapolation.
    """
    t, e, predicted = seen.t[i], seen.residual[i], seen.predicted[i]
    U, dp, status = seen.values[i, _U], seen.values[i, _P1] - seen.values[i, _P2], seen.status[i]
    if seen.quality[i] == 2 or not (abs(e) < 1e100 and np.isfinite(U) and np.isfinite(dp)):
        return
    if status > 2 and status not in (4, 8):  # OK, WARMING_UP, UNEXCITED; FROZEN, UNRELIABLE
        return
    memory, weight = senses.memory[m], senses.weight[m]
    bias, square = senses.bias[m], senses.square[m]
    add_up(m, i, seen, senses)
    memory[SQUARES] += (e * e - memory[SQUARES]) / (BLOCK * RECENT_BLOCKS)
    row = min(max(U / WIDTH_U, 0.0), CELLS_U - 1.0)
    column = min(np.sqrt(abs(dp)) / WIDTH_S, CELLS_S - 1.0)
    c = int(row) * CELLS_S + int(column)
    if c != memory[CELL]:
        memory[CELL], memory[KNOWN] = c, weight[c] >= KNOWN_PLACE
    usual_now = memory[RATIO] <= rules[RESIDUAL, 1]
    if memory[KNOWN] and square[c] > 0.0:
        memory[BLOCK_SUM] += (e - bias[c]) / np.sqrt(square[c])
        memory[BLOCK_N] += 1.0
        if memory[BLOCK_N] >= BLOCK:
            if _take_block(memory, usual_now):
                forget_half(m, senses)
            enough = memory[USUAL_N] >= SETTLED_BLOCKS
            ratio = np.sqrt(memory[RECENT] / memory[USUAL]) if enough else 0.0
            times = senses.times[m]
            if ratio > CONFIRMED:
                times[LARGE_SINCE] = times[LARGE_SINCE] if memory[RATIO] > CONFIRMED else t
                times[LARGE_UNTIL] = t
            memory[RATIO] = ratio
            more = memory[SQUARES] - memory[USUAL_SQUARE]
            matters = more >= (NEGLIGIBLE * Q_span) ** 2
            if step(m, RESIDUAL, t, t, ratio if matters else 0.0, rules, conditions):
                conditions.detail[m, RESIDUAL, 0] = np.sqrt(memory[SQUARES])
                write_causes(m, RESIDUAL, conditions, senses, shares)
    if usual_now:
        memory[USUAL_SQUARE_N] = min(memory[USUAL_SQUARE_N] + 1.0, USUAL_SAMPLES)
        seldom = memory[USUAL_SQUARE_N] >= KNOWN_PLACE
        new = min(e * e, OUTLIER * memory[USUAL_SQUARE]) if seldom else e * e
        memory[USUAL_SQUARE] += (new - memory[USUAL_SQUARE]) / memory[USUAL_SQUARE_N]
    if usual_now or weight[c] < KNOWN_PLACE:
        weight[c] = min(weight[c] + 1.0, PLACE_MEMORY)
        most = OUTLIER * square[c] if weight[c] >= KNOWN_PLACE else 1e30
        bias[c] += (min(max(e, -np.sqrt(most)), np.sqrt(most)) - bias[c]) / weight[c]
        square[c] += (min(e * e, most) - square[c]) / weight[c]
    memory[Q_BEFORE] = predicted


@inlined
def _take_block(memory: Floats, usual_now: bool) -> bool:  # noqa: FBT001 - numba takes positions
    """End a block: update the recent and the usual mean square; True if the block is as usual."""
    mean = memory[BLOCK_SUM] / memory[BLOCK_N]
    memory[BLOCK_SUM] = memory[BLOCK_N] = 0.0
    new = mean * mean
    if memory[USUAL_N] >= ENOUGH_BLOCKS:
        new = min(new, LARGEST * memory[USUAL])
    memory[RECENT_N] = min(memory[RECENT_N] + 1.0, RECENT_BLOCKS)
    memory[RECENT] += (new - memory[RECENT]) / memory[RECENT_N]
    if usual_now:
        memory[USUAL_N] = min(memory[USUAL_N] + 1.0, USUAL_BLOCKS)
        memory[USUAL] += (new - memory[USUAL]) / memory[USUAL_N]
        memory[USUAL] = max(memory[USUAL], 1.0 / BLOCK)  # that of white noise
    return bool(new < AS_USUAL * memory[USUAL])
