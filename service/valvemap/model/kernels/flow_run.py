"""One pass over the samples: against the map, against the own cell, into the cell."""

import math
from typing import NamedTuple

import numpy as np

from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis, between_sites, surface
from valvemap.model.kernels.flow_cells import (
    COUNT,
    MEAN_Q,
    MEAN_S,
    MEAN_U,
    Cells,
    cell_of,
    deposit,
)
from valvemap.model.samples import Floats, Singles, Status, Times

# Places in `counters`.
USED, NEXT_FIT, FITTED, FITS, CLOCK, NEXT_START = 0, 1, 2, 3, 4, 5
COUNTERS = 8

_OK, _WARMING_UP, _EXTRAPOLATING = (
    int(Status.OK),
    int(Status.WARMING_UP),
    int(Status.EXTRAPOLATING),
)
_REJECTED, _HELD = int(Status.REJECTED), int(Status.HELD)


class Memory(NamedTuple):
    """One valve's arrays; see `FlowMapState`."""

    cells: Cells
    theta: Floats
    std: Singles
    scalars: Floats
    counters: np.ndarray


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


@lean_kernel
def run(
    start: int, stop: int, batch: Batch, axis_U: Axis, axis_s: Axis, memory: Memory, work: Floats
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
        batch.status[i] = _learn(i, batch, U, s, Q, axis_U, axis_s, memory, work)
        if counters[USED] >= counters[NEXT_FIT]:
            return i + 1
    return stop


@inner
def is_due(counters: np.ndarray) -> bool:
    """Whether a fit is due."""
    return bool(counters[USED] >= counters[NEXT_FIT])


@inner
def _learn(
    i: int, batch: Batch, U: float, s: float, Q: float, axis_U: Axis, axis_s: Axis, memory: Memory,
    work: Floats,
) -> int:  # fmt: skip
    """Predict one sample, then learn from it; give its status."""
    cells, theta, std, scalars, counters = memory
    u, is_beyond = clipped(axis_U, U)
    r, is_beyond_s = clipped(axis_s, s)
    known, variance = False, math.nan
    if counters[FITTED]:
        flow = surface(axis_U, axis_s, theta, u, r, work)
        spread = between_sites(axis_U, axis_s, std, u, r)
        variance = spread * spread + scalars[fits.MISFIT]
        batch.predicted[i], batch.residual[i] = flow, Q - flow
        known = variance < rules.UNKNOWN**2 * scalars[fits.SCALE]
    if is_beyond or is_beyond_s:
        return _EXTRAPOLATING
    number = cell_of(axis_U, axis_s, u, r)
    cell = cells[number]
    weight = 1.0
    if counters[FITTED] and cell[COUNT] > 0.0:
        width = rules.OUTLIER_WIDTH * math.sqrt(scalars[fits.SCALE])
        noise, residual = scalars[fits.VARIANCE], batch.residual[i]
        off = cell[MEAN_Q] - surface(axis_U, axis_s, theta, cell[MEAN_U], cell[MEAN_S], work)
        error = residual - off
        by_map = fits.outlier_weight(residual * residual, noise + variance, width)
        doubt = noise * (1.0 + 1.0 / cell[COUNT]) + scalars[fits.MISFIT]
        weight = max(by_map, fits.outlier_weight(error * error, doubt, width))
        if cell[COUNT] < rules.FEW and by_map > 0.5:
            doubt = noise / cell[COUNT] + variance
            if fits.outlier_weight(off * off, doubt, width / cell[COUNT]) < rules.DOUBTED:
                cell[:] = 0.0
        if cell[COUNT] > 0.0 and variance < noise:
            _note_error(error, weight, cell[COUNT], counters[USED], scalars)
        else:
            scalars[fits.LAST_ERROR] = 0.0
    share = 1.0 / min(scalars[fits.SCALE_WEIGHT] + 1.0, rules.NOISE_MEMORY)
    scalars[fits.SCALE_WEIGHT] += 1.0
    scalars[fits.SCALE] += share * (Q * Q - scalars[fits.SCALE])
    way = abs(u - scalars[fits.LAST_U]) / rules.WAY_U
    way += abs(r - scalars[fits.LAST_S]) / (rules.WAY_S * axis_s.breaks[-1])
    alike = scalars[fits.COLOUR] * math.exp(-way)
    deposit(cell, u, r, Q, weight, (1.0 - alike) / (1.0 + alike), rules.MEMORY)
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


@lean_kernel
def evaluate(
    axis_U: Axis, axis_s: Axis, memory: Memory, U: Floats, dp: Floats, Q: Floats, spread: Floats,
    work: Floats,
) -> None:  # fmt: skip
    """Flow and its standard deviation at N points; NaN where a point or the map is not known."""
    scalars = memory.scalars
    for i in range(len(U)):
        Q[i] = spread[i] = math.nan
        if not (memory.counters[FITTED] and math.isfinite(U[i] + dp[i])):
            continue
        s = math.copysign(math.sqrt(abs(dp[i])), dp[i])
        u, _ = clipped(axis_U, U[i])
        r, _ = clipped(axis_s, s)
        own = between_sites(axis_U, axis_s, memory.std, u, r)
        variance = own * own + scalars[fits.MISFIT]
        if variance < rules.UNKNOWN**2 * scalars[fits.SCALE]:
            Q[i] = surface(axis_U, axis_s, memory.theta, u, r, work)
            spread[i] = math.sqrt(variance)
