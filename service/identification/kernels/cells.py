"""The memory of a map: a grid of cells, each with the mean of the samples that fell into it."""

import math

import numpy as np
from numba import njit

from service.identification.kernels.surface import T_REFERENCE, Surface, value
from service.identification.samples import Floats, Status

CELLS_U, CELLS_S, CELLS_T = 40, 20, 3
S_TOP = 20.0
COLUMNS = WEIGHT, MEAN_U, MEAN_S, MEAN_T, DIRECTION, MEAN_Q = 0, 1, 2, 3, 4, 5

HELD_U, NOISE, NOISE_WEIGHT, ALARM, CHAMPION_SQUARES, CHALLENGER_SQUARES = 0, 1, 2, 3, 4, 5
EXCITATION, VARIANCE = 6, 7
SCALARS = 8
USED, NEXT_FIT, OPENED, ALARMS, MOVE, FITTED, NEW_CELLS, IDLE = 0, 1, 2, 3, 4, 5, 6, 7
COUNTERS = 8

HUGE = 1e9
KNOWN = 2.0
NOISE_KNOWN = 64.0
NOISE_MEMORY = 1000.0
PLAIN_S = 0.7
CLIP = 8.0
DRIFT, ALARM_CLIP, ALARM_LEVEL = 2.5, 6.0, 120.0
KEPT = 0.01
SETTLE = 32
EXCITED = 3.0

_OK, _WARMING_UP, _UNEXCITED = int(Status.OK), int(Status.WARMING_UP), int(Status.UNEXCITED)
_REJECTED, _HELD = int(Status.REJECTED), int(Status.HELD)


@njit(cache=True, error_model="numpy")
def run(
    start: int,
    U: Floats,
    dp: Floats,
    T: Floats,
    Q: Floats,
    usable: np.ndarray,
    longest: float,
    cells: Floats,
    champion: Surface,
    challenger: Surface,
    scalars: Floats,
    counters: np.ndarray,
    predicted: Floats,
    residual: Floats,
    status: np.ndarray,
) -> int:
    """Take samples in from ``start`` on until the next fit is due; give the next sample's place.

    ``longest`` bounds the weight of a cell: then its mean is exponential, λ = 1 - 1/longest.
    """
    for i in range(start, len(U)):
        predicted[i] = residual[i] = math.nan
        if not (usable[i] and math.isfinite(U[i] + dp[i] + Q[i])):
            status[i] = _REJECTED
            continue
        if max(abs(U[i]), abs(dp[i]), abs(Q[i])) > HUGE:
            status[i] = _HELD
            continue
        s = math.copysign(math.sqrt(abs(dp[i])), dp[i])
        warmth = T[i] if math.isfinite(T[i]) and abs(T[i]) < HUGE else T_REFERENCE
        direction = follow(U[i], champion.play, scalars)
        cell = cells[place(U[i], s, warmth, direction)]
        flow, status[i] = Q[i], _WARMING_UP
        if counters[FITTED]:
            status[i] = _OK if scalars[EXCITATION] >= EXCITED else _UNEXCITED
            forecast = _of(champion, U[i], s, warmth, direction)
            predicted[i], residual[i] = forecast, flow - forecast
            scalars[CHAMPION_SQUARES] += residual[i] ** 2
            scalars[CHALLENGER_SQUARES] += (flow - _of(challenger, U[i], s, warmth, direction)) ** 2
            if cell[WEIGHT] >= KNOWN:
                flow = _compare(champion, cell, flow, forecast, s, scalars)
        if cell[WEIGHT] < 1.0:
            counters[NEW_CELLS] -= 1
        _learn(cell, longest, U[i], s, warmth, direction, flow)
        counters[USED] += 1
        if scalars[ALARM] > ALARM_LEVEL:
            _open(cells, scalars, counters)
        if is_due(counters):
            return i + 1
    return len(U)


@njit(cache=True, error_model="numpy")
def is_due(counters: np.ndarray) -> bool:
    """Whether enough samples, or enough new cells, came in for a new fit."""
    return bool(counters[USED] >= counters[NEXT_FIT] or counters[NEW_CELLS] <= 0)


@njit(cache=True, error_model="numpy")
def follow(U: float, play: float, scalars: Floats) -> float:
    """Direction of U from -1 (falling) to 1 (rising): where U stands in the play it drags along."""
    half = max(play, 0.1)
    held: float = scalars[HELD_U]
    if not math.isfinite(held):
        held = U
    held = min(max(held, U - half), U + half)
    scalars[HELD_U] = held
    return (U - held) / half


@njit(cache=True, error_model="numpy")
def place(U: float, s: float, T: float, direction: float) -> int:
    """Which cell a point falls into; cells in s are narrow near 0, where the flow is laminar."""
    in_U = min(max(int(U * (CELLS_U / 100.0)), 0), CELLS_U - 1)
    in_s = min(int(CELLS_S * (min(max(s, 0.0), S_TOP) / S_TOP) ** (2.0 / 3.0)), CELLS_S - 1)
    in_T = 0 if T < 30.0 else (1 if T < 50.0 else 2)
    rising = 1 if direction > 0.0 else 0
    return ((in_U * CELLS_S + in_s) * CELLS_T + in_T) * 2 + rising


@njit(cache=True, error_model="numpy")
def _of(surface: Surface, U: float, s: float, T: float, direction: float) -> float:
    at = U - surface.play * direction
    return value(surface.knots_U, surface.knots_s, surface.nodes_T, surface.theta, at, s, T)


@njit(cache=True, error_model="numpy")
def _compare(
    model: Surface, cell: Floats, Q: float, forecast: float, s: float, scalars: Floats
) -> float:
    """Hold a sample against its own cell: noise without misfit, change of the valve, outliers.

    The model only carries the cell's mean over to the sample's point, so what it cannot represent
    cancels. What is taken in is clipped at 8 σ.
    """
    at_mean = _of(model, cell[MEAN_U], cell[MEAN_S], cell[MEAN_T], cell[DIRECTION])
    error = Q - (cell[MEAN_Q] + forecast - at_mean)
    error_2 = error**2 * cell[WEIGHT] / (cell[WEIGHT] + 1.0)
    if scalars[NOISE_WEIGHT] >= NOISE_KNOWN:
        sigma = math.sqrt(scalars[NOISE])
        error_2 = min(error_2, (CLIP * sigma) ** 2)
        if s >= PLAIN_S:
            step = min(math.sqrt(error_2) / max(sigma, 1e-9), ALARM_CLIP) - DRIFT
            scalars[ALARM] = max(0.0, scalars[ALARM] + step)
        bound = CLIP * sigma * math.sqrt(1.0 + 1.0 / cell[WEIGHT])
        Q += min(max(error, -bound), bound) - error
    scalars[NOISE_WEIGHT] = min(scalars[NOISE_WEIGHT] + 1.0, NOISE_MEMORY)
    scalars[NOISE] += (error_2 - scalars[NOISE]) / scalars[NOISE_WEIGHT]
    return Q


@njit(cache=True, error_model="numpy")
def _learn(
    cell: Floats, longest: float, U: float, s: float, T: float, direction: float, Q: float
) -> None:
    weight = min(cell[WEIGHT] + 1.0, longest)
    cell[WEIGHT] = weight
    cell[MEAN_U] += (U - cell[MEAN_U]) / weight
    cell[MEAN_S] += (s - cell[MEAN_S]) / weight
    cell[MEAN_T] += (T - cell[MEAN_T]) / weight
    cell[DIRECTION] += (direction - cell[DIRECTION]) / weight
    cell[MEAN_Q] += (Q - cell[MEAN_Q]) / weight


@njit(cache=True, error_model="numpy")
def _open(cells: Floats, scalars: Floats, counters: np.ndarray) -> None:
    """Open the memory: the valve has changed, what was learnt stays as a faint prior."""
    for i in range(len(cells)):
        cells[i, WEIGHT] = KEPT * min(cells[i, WEIGHT], 1.0)
    scalars[ALARM] = 0.0
    counters[ALARMS] += 1
    counters[OPENED] = counters[USED]
    counters[NEXT_FIT] = counters[USED] + SETTLE
    counters[NEW_CELLS] = SETTLE
    counters[IDLE] = 0
