"""The weight of a sample: whether the meter shows flow, how uncertain its place is."""

import math

from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_noise as noises
from valvemap.model.kernels import flow_oil as oil
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_recent as recent_rows
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.flow_basis import Axis, surface
from valvemap.model.kernels.flow_cells import (
    COUNT,
    MEAN_Q,
    MEAN_S,
    MEAN_U,
    REFUSALS,
    Cells,
)
from valvemap.model.kernels.flow_look import clipped
from valvemap.model.kernels.flow_memory import (
    A_GUESS,
    BEGAN,
    BLOCKED,
    DOUBTED,
    FLOW,
    PLACE_S,
    PLACE_U,
    TOTAL,
    USED,
    Memory,
    Room,
)
from valvemap.model.kernels.flow_stay import apart
from valvemap.model.samples import Floats


@inner
def shows_nothing(Q: float, at: Floats, cell: Cells, memory: Memory) -> bool:
    """Whether the meter shows no flow where it showed some: it, or the valve, is blocked.

    Such samples, and those of no flow that follow, tell nothing of the map.
    """
    scalars, counters = memory.scalars, memory.counters
    if Q * Q >= rules.LEAST_NOISES**2 * scalars[fits.VARIANCE]:  # noqa: SIM300
        return False
    if counters[BLOCKED]:
        return True
    is_mature = counters[USED] - counters[BEGAN] >= rules.MATURE
    if not (is_mature or cell[COUNT] >= rules.FEW):
        return False
    shown = abs(at[FLOW])
    if cell[COUNT] > 0.0:
        shown = min(shown, abs(float(cell[MEAN_Q])))
    least = rules.BLOCKED_FROM * math.sqrt(scalars[fits.SCALE])
    return bool(shown > least and is_surprising(shown, at, scalars))


@inner
def is_surprising(residual: float, at: Floats, scalars: Floats) -> bool:
    """Whether neither noise nor doubt about the map explains a residual."""
    doubt = at[TOTAL] + noises.of_sample(at[FLOW], scalars)
    return bool(residual * residual > rules.CLEAR * doubt)


@inner
def weigh_guess(residual: float, memory: Memory, at: Floats) -> None:
    """Weigh what the map said of a place never visited: the meter may end there."""
    scalars, counters = memory.scalars, memory.counters
    if counters[USED] - counters[BEGAN] < rules.LOOKS[0]:
        return
    noise = noises.of_sample(at[FLOW], scalars)
    square = residual * residual / (at[TOTAL] + noise)
    against = min(0.5 * (square - 1.0), rules.MOST_OF_GUESS)
    scalars[fits.REFUTED] = max(scalars[fits.REFUTED] + against, 0.0)
    if scalars[fits.REFUTED] >= rules.CLEAR:
        scalars[fits.REFUTED] = 0.0
        if counters[DOUBTED] == 0:
            counters[DOUBTED] = A_GUESS


@inner
def looseness(
    row: int, dp: float, p1: float, axis_U: Axis, axis_s: Axis, memory: Memory, room: Room
) -> float:  # fmt: skip
    """Variance of the flow by that of signals on the way from one value to the next."""
    path, of_u, of_s = memory.path, room.means[6], room.means[7]
    if paths.looks_ahead(path):
        _, of_U = recent_rows.commanded(row, memory)
        _, of_dp = recent_rows.between(row, paths.LEFT_DP, path[paths.HELD_P], memory)
        beside = paths.effective(dp + math.copysign(of_dp, dp), p1, path)
        of_u, of_s = of_u + of_U, of_s + abs(beside - paths.effective(dp, p1, path))
    square = _steepest(axis_U, axis_s, of_u, 0.0, memory, room) if of_u > 0.0 else 0.0
    return square + (_steepest(axis_U, axis_s, 0.0, of_s, memory, room) if of_s > 0.0 else 0.0)


@inner
def trust(
    residual: float, axis_U: Axis, axis_s: Axis, memory: Memory, gain: float, number: int,
    bent: float, rate: float, room: Room,
) -> float:  # fmt: skip
    """Probability that a sample is none that the meter invented, by the map or by its cell."""
    scalars, counters, cell = memory.scalars, memory.counters, memory.cells[number]
    if not cell[COUNT] > 0.0:  # a fit weighs a cell of one sample against all others
        noises.skip(scalars)
        return 1.0
    width = rules.OUTLIER_WIDTH * math.sqrt(scalars[fits.SCALE])
    at, variance = room.at, room.at[TOTAL]
    noise = noises.of_sample(at[FLOW], scalars)
    own = surface(axis_U, axis_s, memory.theta, cell[MEAN_U], cell[MEAN_S], room.work)
    off = gain * (oil.at_first(axis_s, memory, cell, room) - own)
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
    of_way = variance - bent  # of the map, from the cell's mean to the sample
    if cell[COUNT] > 0.0 and not paths.filters(memory.path):
        of_way *= apart(axis_U, axis_s, cell, number, room.at)
    if cell[COUNT] > 0.0 and of_way < noise:
        age = counters[USED] - counters[BEGAN]
        noises.note(error, weight, cell[COUNT], age, at[FLOW], rate, scalars)
    else:
        noises.skip(scalars)
    return weight


@inner
def _steepest(
    axis_U: Axis, axis_s: Axis, du: float, ds: float, memory: Memory, room: Room
) -> float:  # fmt: skip
    """Largest square of the difference between the flow at `room.at` and that beside it."""
    u, s, theta, work = room.at[PLACE_U], room.at[PLACE_S], memory.theta, room.work
    flow, most = surface(axis_U, axis_s, theta, u, s, work), 0.0
    for sign in (-1.0, 1.0):
        x, y = clipped(axis_U, u + sign * du)[0], clipped(axis_s, s + sign * ds)[0]
        most = max(most, abs(surface(axis_U, axis_s, theta, x, y, work) - flow))
    return most * most
