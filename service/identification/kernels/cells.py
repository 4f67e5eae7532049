"""The memory of a map: a grid of cells, each with the mean of the samples that fell into it."""

import math

import numpy as np

from service.identification.kernels.compiled import inner, kernel
from service.identification.kernels.surface import T_REFERENCE, Surface, value
from service.identification.samples import Floats, Status

CELLS_U, CELLS_S, CELLS_T = 40, 21, 3
S_TOP = 20.0
COLUMNS = WEIGHT, MEAN_U, MEAN_S, MEAN_T, DIRECTION, MEAN_Q = 0, 1, 2, 3, 4, 5

LAST_U, TOWARDS, NOISE, NOISE_WEIGHT, CHAMPION_SQUARES, CHALLENGER_SQUARES = 0, 1, 2, 3, 4, 5
EXCITATION, VARIANCE, MORE, LESS, WILDER = 6, 7, 8, 9, 10
SCALARS = 11
USED, NEXT_FIT, OPENED, ALARMS, FITTED, NEW_CELLS = 0, 1, 2, 3, 4, 5
COUNTERS = 6

HUGE = 1e9
LEAST_PLAY = 0.1
KNOWN = 1.0
NOISE_KNOWN = 64.0
NOISE_MEMORY = 1000.0
PLAIN_S = 0.7
FITTING = 4.0
CLIP = 8.0
NOISE_CLIP = 3.0
SHIFT, WILD, FAR, ALARM_LEVEL = 1.5, 2.25, 5.0, 50.0
KEPT = 0.01
SETTLE = 32
EXCITED = 3.0

_OK, _WARMING_UP, _UNEXCITED = int(Status.OK), int(Status.WARMING_UP), int(Status.UNEXCITED)
_REJECTED, _HELD = int(Status.REJECTED), int(Status.HELD)


@kernel
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
    scratch = np.empty((4, 4))
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
            forecast = _of(champion, U[i], s, warmth, direction, scratch)
            predicted[i], residual[i] = forecast, flow - forecast
            scalars[CHAMPION_SQUARES] += residual[i] ** 2
            miss = flow - _of(challenger, U[i], s, warmth, direction, scratch)
            scalars[CHALLENGER_SQUARES] += miss**2
            if cell[WEIGHT] >= KNOWN:
                flow = _compare(champion, cell, flow, forecast, s, scalars, scratch)
        if cell[WEIGHT] < 1.0:
            counters[NEW_CELLS] -= 1
        _learn(cell, longest, U[i], s, warmth, direction, flow)
        counters[USED] += 1
        if max(scalars[MORE], scalars[LESS], scalars[WILDER]) > ALARM_LEVEL:
            _open(cells, scalars, counters)
        if is_due(counters):
            return i + 1
    return len(U)


@kernel
def is_due(counters: np.ndarray) -> bool:
    """Whether enough samples, or enough new cells, came in for a new fit."""
    return bool(counters[USED] >= counters[NEXT_FIT] or counters[NEW_CELLS] <= 0)


@kernel
def follow(U: float, play: float, scalars: Floats) -> float:
    """Direction of U from -1 (falling) to 1 (rising); to turn it takes a way of twice the play."""
    last: float = scalars[LAST_U]
    step = U - last if math.isfinite(last) else 0.0
    towards: float = min(max(scalars[TOWARDS] + step / max(play, LEAST_PLAY), -1.0), 1.0)
    scalars[LAST_U], scalars[TOWARDS] = U, towards
    return towards


@kernel
def place(U: float, s: float, T: float, direction: float) -> int:
    """Which cell a point falls into; those of both directions stand side by side.

    Cells in s are narrow near 0, where the flow is laminar; the first is for reversed flow.
    """
    in_U = int(min(max(U * (CELLS_U / 100.0), 0.0), CELLS_U - 1.0))
    share = min(max(s, 0.0), 0.999 * S_TOP) / S_TOP
    in_s = 1 + int((CELLS_S - 1) * share ** (2.0 / 3.0)) if s >= 0.0 else 0
    in_T = 0 if T < 30.0 else (1 if T < 50.0 else 2)
    rising = 1 if direction > 0.0 else 0
    return ((in_U * CELLS_S + in_s) * CELLS_T + in_T) * 2 + rising


@inner
def _of(surface: Surface, U: float, s: float, T: float, direction: float, scratch: Floats) -> float:
    at, knots_U, knots_s = U - surface.play * direction, surface.knots_U, surface.knots_s
    return value(knots_U, knots_s, surface.nodes_T, surface.theta, at, s, T, scratch)


@inner
def _compare(
    model: Surface,
    cell: Floats,
    Q: float,
    forecast: float,
    s: float,
    scalars: Floats,
    scratch: Floats,
) -> float:
    """Hold a sample against its own cell: noise without misfit, change of the valve, outliers.

    The model only carries the cell's mean over to the sample's point, so what it cannot represent
    cancels (and where it is far off, as in a region that is new to it, no change is looked for).
    What is taken in is clipped at 8 σ; a cell that stands farther off the model than the
    sample does was spoilt itself, and starts afresh.
    """
    at_mean: float = _of(model, cell[MEAN_U], cell[MEAN_S], cell[MEAN_T], cell[DIRECTION], scratch)
    error = Q - (cell[MEAN_Q] + forecast - at_mean)
    whitening = math.sqrt(cell[WEIGHT] / (cell[WEIGHT] + 1.0))
    sigma = math.sqrt(scalars[NOISE])
    if scalars[NOISE_WEIGHT] < NOISE_KNOWN:
        _know_noise(error * whitening, scalars)
        return Q
    if s >= PLAIN_S and abs(cell[MEAN_Q] - at_mean) <= FITTING * sigma:
        _watch(error * whitening / max(sigma, 1e-9), scalars)
    bound = CLIP * sigma / whitening
    if max(scalars[MORE], scalars[LESS], scalars[WILDER]) < 0.25 * ALARM_LEVEL:
        limit = NOISE_CLIP * sigma
        _know_noise(min(max(error * whitening, -limit), limit), scalars)
    if abs(error) <= bound:
        return Q
    if abs(Q - forecast) < 0.5 * abs(cell[MEAN_Q] - at_mean):
        cell[WEIGHT] = 0.0
        return Q
    taken: float = Q - error + math.copysign(bound, error)
    return taken


@inner
def _know_noise(error: float, scalars: Floats) -> None:
    scalars[NOISE_WEIGHT] = min(scalars[NOISE_WEIGHT] + 1.0, NOISE_MEMORY)
    scalars[NOISE] += (error**2 - scalars[NOISE]) / scalars[NOISE_WEIGHT]


@inner
def _watch(z: float, scalars: Floats) -> None:
    """CUSUM of the whitened error: more flow than the cells remember, less, or more scatter."""
    clipped = min(max(z, -FAR), FAR)
    scalars[MORE] = max(0.0, scalars[MORE] + clipped - SHIFT)
    scalars[LESS] = max(0.0, scalars[LESS] - clipped - SHIFT)
    scalars[WILDER] = max(0.0, scalars[WILDER] + abs(clipped) - WILD)


@inner
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


@inner
def _open(cells: Floats, scalars: Floats, counters: np.ndarray) -> None:
    """Open the memory: the valve has changed, what was learnt stays as a faint prior."""
    for i in range(len(cells)):
        cells[i, WEIGHT] = KEPT * min(cells[i, WEIGHT], 1.0)
    scalars[MORE] = scalars[LESS] = scalars[WILDER] = 0.0
    scalars[NOISE_WEIGHT] = 0.0
    counters[ALARMS] += 1
    counters[OPENED] = counters[USED]
    counters[NEXT_FIT] = counters[USED] + SETTLE
    counters[NEW_CELLS] = SETTLE
