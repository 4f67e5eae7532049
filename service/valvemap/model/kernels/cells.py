"""One pass over the samples: through the lags, against the map and the cells, into the cell.

U goes through the lag of its effect, Q is held against the map through the meter's lag, and what
remains is held against the mean of the sample's own cell (see :mod:`kernels.grid`), then learnt.
"""

import math
from typing import NamedTuple

import numpy as np

from valvemap.model.kernels import grid, lag
from valvemap.model.kernels.compiled import inner, lean_kernel, spliced
from valvemap.model.kernels.grid import (
    DIRECTION,
    MEAN_Q,
    MEAN_S,
    MEAN_T,
    MEAN_TIME,
    MEAN_U,
    WEIGHT,
)
from valvemap.model.kernels.surface import T_REFERENCE, T_UNIT, Surface, value
from valvemap.model.samples import Floats, Times
from valvemap.vocabulary.statuses import Status

# Places in `scalars`: of the path, the noise, the competition, the watch for changes, the lags.
LAST_U, TOWARDS = 0, 1
NOISE, NOISE_WEIGHT, POWER, COLOUR, LAST_RESIDUAL, LEFT_U, LEFT_S = 2, 3, 4, 5, 6, 7, 8
CHAMPION_SQUARES, CHALLENGER_SQUARES, EXCITATION, VARIANCE = 9, 10, 11, 12
MORE, LESS, WILDER, SLOW, LAST_Z, SUSPECT_SUM, CHANGE_SIZE = 13, 14, 15, 16, 17, 18, 19
RATE_WEIGHT, ERROR_Q, SQUARE_Q, GAIN_VARIANCE, STAY, RATE = 20, 21, 22, 23, 24, 25
COLOUR_WEIGHT, RECKONED, STEADY = 26, 27, 28  # the last two: see `_worth`
DIFFER, DIFFER_TWICE, LAST_BUT_ONE = 29, 30, 31  # see `_know_colour`
REFERENCE = 32  # from here on, as wide as a cell: see `_watch`
REACTS = REFERENCE + len(grid.COLUMNS)  # 1 where U reacts to the noise, see `jitter`
LAGS = REACTS + 1  # from here on see `lag`
SCALARS = LAGS + lag.SCALARS

# Places in `counters`.
USED, NEXT_FIT, OPENED, ALARMS, FITTED, NEW_CELLS = 0, 1, 2, 3, 4, 5
SPENT, NEXT_LOOK, TOO_FAST = 6, 7, 8
SUSPECT_SAMPLE, SUSPECT_TIME, CHANGE_SAMPLE, CHANGE_TIME, FRESH = 9, 10, 11, 12, 13
MAY_ASK, FIT_AT, COMPARED, WATCHED = 14, 15, 16, 17
TAKEN, CLOCK, ENTERED = 18, 19, 20  # CLOCK, ns: the time from which the cells' times count
BEGAN = 21  # USED when the map began anew behind other lags
LAGGING = 22  # from here on see `lag`
COUNTERS = LAGGING + lag.COUNTERS

PLAY = 4  # place of the play in a shape
NODES_T = np.array([T_REFERENCE, T_REFERENCE + T_UNIT])
HUGE = 1e9  # of any signal: beyond it squares leave the range of numbers
LEAST_PLAY = 0.1  # %: way of U that turns its direction while no play is known
KNOWN = 1.0  # samples in a cell from which on another one is held against it ...
NEAR_T = 10.0  # K: ... if it is not farther from their mean: the map may not know the trend yet
NEW = 0.02  # samples' weight below which a cell counts as new
NOISE_KNOWN = 64.0  # samples held against their cells before a change is looked for
NOISE_MEMORY = 1000.0  # samples over which noise is averaged
COLOUR_MEMORY = 2000.0  # samples over which the noise's correlation is averaged
RATE_MEMORY = 10_000.0  # samples over which a gain that drifts is looked at
OLDEST = 600.0  # s: a cell is carried on by no more than that, a machine may have stood still
COLOUR_DOUBT = 8.0  # 4 standard errors of a correlation that differences tell, times √samples
MOST_COLOUR = 0.97  # correlation of successive errors, at most
SETTLED_CELL = 4.0  # samples in a cell from which on its error tells of colour and drift
SMOOTH_U, SMOOTH_S = 15.0, 3.0  # %, √bar: over what ways a map says the same again
KNOWN_MAP = 256  # samples from which on a map says enough to tell the colour of noise
YOUNG = 1000  # samples for which a map is too young to say what the meter's lag makes of it
PLAIN_S = 0.7  # √bar: below it the map is too steep in s for a cell to tell a change
STEEP = 0.4  # ... and so it is where it changes by more than that share of the flow: closing edges
FITTING = 4.0  # σ that a cell may lie off the map and still tell a change or the noise's colour
CARRIED = 0.5  # share of the way from a cell's mean to a sample that a poor map may have wrong
FOLLOWED = 0.5  # ... and share of what a cell lies off the map, where that is more than FITTING
OFFSET_DOUBT = 0.1  # share of what the map says of the meter's lag that may be wrong
CLIP = 8.0  # σ at which an outlier is cut before it is taken in
NOISE_CLIP = 3.0  # σ at which it is cut before it counts as noise
SLOW_MEMORY = 1000.0  # samples: what lies off for so long is drift, not a change
MOST_OF_A_STAY = 30.0  # σ that a stay in one cell may add: two of them make an alarm ...
LONG_STAY = 256  # samples of a stay after which what the cell holds now is taken for known
SURE = 12.0  # samples in a cell from which on one stay may do so
SHIFT, WILD, FAR, ALARM_LEVEL = 1.5, 2.25, 5.0, 50.0  # σ: slack of the CUSUMs, cut, alarm
ASKING = 1.5  # mean square of the residuals over the noise that asks for a fit
KEPT = 0.01  # samples' weight that a cell keeps when the valve has changed
SETTLE = 32  # samples from a change to the next fit
EXCITED = 3.0  # parameters that the samples must determine for a status of OK

_OK, _WARMING_UP, _UNEXCITED = int(Status.OK), int(Status.WARMING_UP), int(Status.UNEXCITED)
_REJECTED, _HELD = int(Status.REJECTED), int(Status.HELD)


class Memory(NamedTuple):
    """One valve's arrays that samples change; see `AutoState`."""

    cells: Floats
    slots: np.ndarray
    recent: Floats
    scalars: Floats
    counters: np.ndarray


class Fleet(NamedTuple):
    """The arrays of M valves, with a leading axis M; see `AutoState`."""

    cells: Floats
    slots: np.ndarray
    recent: Floats
    scalars: Floats
    counters: np.ndarray
    knots_U: Floats
    knots_s: Floats
    coefficients: Floats
    sizes: np.ndarray
    shapes: Floats


class Batch(NamedTuple):
    """Samples, and what is said of them; all (N,)."""

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
def run_many(
    segment: int, row: int, batch: Batch, members: Times, starts: Times, stops: Times,
    longest: float, fleet: Fleet, scratch: Floats,
) -> tuple[int, int]:  # fmt: skip
    """Take samples of many valves in, from ``row`` of a segment on, until one of them is due.

    ``longest`` bounds the weight of a cell: then its mean is exponential, λ = 1 - 1/longest.
    ``scratch`` is (4, 4).

    Returns
    -------
    segment, row
        Whose fit or look is due, and where to go on afterwards; ``len(members)`` at the end.
    """
    for k in range(segment, len(members)):
        m = members[k]
        memory = Memory(
            fleet.cells[m], fleet.slots[m], fleet.recent[m], fleet.scalars[m], fleet.counters[m]
        )
        champion, challenger = surface(fleet, m, 0), surface(fleet, m, 1)
        row = run(
            row if k == segment else starts[k],
            stops[k],
            batch,
            longest,
            memory,
            champion,
            challenger,
            scratch,
        )
        if is_due(memory.counters):
            return k, row
    return len(members), 0


@spliced
def surface(fleet: Fleet, m: int, which: int) -> Surface:
    """The map of a valve's champion (0) or challenger (1)."""
    n_U, n_s = fleet.sizes[m, which, 0], fleet.sizes[m, which, 1]
    return Surface(
        fleet.knots_U[m, which, : n_U + 4],
        fleet.knots_s[m, which, : n_s + 4],
        NODES_T,
        fleet.coefficients[m, which, : n_U * n_s * 2].reshape((n_U, n_s, 2)),
        fleet.shapes[m, which, PLAY],
    )


@spliced
def run(
    start: int, stop: int, batch: Batch, longest: float, memory: Memory, champion: Surface,
    challenger: Surface, scratch: Floats,
) -> int:  # fmt: skip
    """Take samples ``start`` … ``stop`` - 1 in until a fit or a look is due; give the next one."""
    scalars, counters = memory.scalars, memory.counters
    for i in range(start, stop):
        U, dp, Q = batch.U[i], batch.dp[i], batch.Q[i]
        batch.predicted[i] = batch.residual[i] = math.nan
        if not (batch.usable[i] and math.isfinite(U + dp + Q)):
            batch.status[i] = _REJECTED
            continue
        if max(abs(U), abs(dp), abs(Q)) > HUGE:
            batch.status[i] = _HELD
            continue
        s = math.copysign(math.sqrt(abs(dp)), dp)
        T = batch.T[i]
        if not (math.isfinite(T) and abs(T) < HUGE):
            T = T_REFERENCE
        lag.keep(batch.t[i], U, s, Q, memory.recent, counters[LAGGING:])
        batch.status[i] = _take(
            i, batch, U, s, T, Q, longest, memory, champion, challenger, scratch
        )
        counters[USED] += 1
        if max(scalars[MORE], scalars[LESS], scalars[WILDER]) > ALARM_LEVEL:
            _open(memory)
        if _asks(scalars, counters):
            counters[NEXT_FIT] = counters[USED]
        if is_due(counters):
            return i + 1
    return stop


@lean_kernel
def is_due(counters: np.ndarray) -> bool:
    """Whether a new fit is due, or a look at the lags."""
    return bool(
        counters[USED] >= counters[NEXT_FIT]
        or counters[NEW_CELLS] <= 0
        or counters[LAGGING + lag.KEPT_ROWS] >= counters[NEXT_LOOK]
    )


@inner
def _asks(scalars: Floats, counters: np.ndarray) -> bool:
    """Whether the residuals since the last fit are so large that they ask for another one."""
    if counters[USED] < counters[MAY_ASK] or scalars[NOISE_WEIGHT] < NOISE_KNOWN:
        return False
    samples = counters[USED] - counters[FIT_AT]
    return bool(scalars[CHAMPION_SQUARES] > ASKING * scalars[NOISE] * samples)


@spliced
def _take(
    i: int, batch: Batch, U: float, s: float, T: float, Q: float, longest: float, memory: Memory,
    champion: Surface, challenger: Surface, scratch: Floats,
) -> int:  # fmt: skip
    """One sample: through the lags, against the map, into its cell; its status."""
    scalars, counters = memory.scalars, memory.counters
    path = scalars[LAGS:]
    lags, direction = path[lag.LAG_Q] > 0.0, scalars[TOWARDS]
    if counters[FRESH] and lags:  # what the lag shows is the map before
        _begin_anew(champion, challenger, T, direction, path, scratch)
    counters[FRESH] = 0
    lag.follow(batch.t[i], U, s, path, counters[LAGGING:])
    U, at_U, at_s = path[lag.U_EFFECT], path[lag.U_SMOOTH], path[lag.S_SMOOTH]
    direction = follow(U, champion.play, scalars)
    clock = 1e-9 * (batch.t[i] - counters[CLOCK])
    weight = grid.known(grid.number(U, s, T, direction), memory.slots, memory.cells)
    if counters[USED] - counters[OPENED] < YOUNG:
        weight = 0.0
    settled = lag.belongs(s, weight, path)
    is_known = lag.is_known(path)
    status, forecast, learnt = _WARMING_UP, 0.0, Q
    if counters[FITTED]:
        status = _OK if scalars[EXCITATION] >= EXCITED else _UNEXCITED
        mapped = _of(champion, U, s, T, direction, scratch)
        said = lag.metered(mapped, lag.Q_METERED, path)
        rival = lag.metered(_of(challenger, U, s, T, direction, scratch), lag.RIVAL_METERED, path)
        batch.predicted[i], batch.residual[i] = said, Q - said
        if settled:
            scalars[CHAMPION_SQUARES] += (Q - said) ** 2
            scalars[CHALLENGER_SQUARES] += (Q - rival) ** 2
        forecast = said
        if lags:
            forecast = _of(champion, at_U, at_s, T, direction, scratch)
            lag.curved(mapped, forecast, path)
            lagged = _of(champion, path[lag.U_METERED], path[lag.S_METERED], T, direction, scratch)
            path[lag.OFFSET] = said - lagged
            if is_known and scalars[NOISE_WEIGHT] >= NOISE_KNOWN:
                most = CLIP * math.sqrt(max(scalars[VARIANCE], scalars[NOISE]))
                learnt = said + min(max(Q - said, -most), most)
            Q -= said - forecast  # as a meter without a lag would show it, were the map right
    doubt = 0.0
    if lags:
        learnt = lag.uncover(learnt, path)
        doubt = abs(path[lag.CURVED])
        if is_known:
            learnt -= path[lag.CURVED]
            doubt *= OFFSET_DOUBT
    if not settled:
        counters[TOO_FAST] += 1
        return status
    here = grid.slot_of(
        grid.number(at_U, at_s, T, direction),
        champion.play,
        memory.slots,
        memory.cells,
        counters[TAKEN : TAKEN + 1],
    )
    cell = memory.cells[here]
    near = abs(T - cell[MEAN_T]) <= NEAR_T
    if counters[FITTED] and cell[WEIGHT] >= KNOWN and near:
        taken = _compare(
            champion,
            cell,
            Q,
            forecast,
            batch.t[i],
            clock,
            doubt,
            here,
            (at_U, at_s, T, direction),
            memory,
            scratch,
        )
        learnt = learnt if lags else taken
    if cell[WEIGHT] < NEW:
        counters[NEW_CELLS] -= 1
    worth = _worth(at_U, at_s, scalars)
    if doubt > 0.0 and scalars[NOISE_WEIGHT] >= NOISE_KNOWN:
        worth *= scalars[NOISE] / max(scalars[NOISE] + doubt * doubt, 1e-30)
    grid.learn(cell, worth, longest, at_U, at_s, T, direction, learnt, clock)
    return status


@lean_kernel
def follow(U: float, play: float, scalars: Floats) -> float:
    """Direction of U from -1 (falling) to 1 (rising); to turn it takes a way of twice the play."""
    last: float = scalars[LAST_U]
    step = U - last if math.isfinite(last) else 0.0
    towards: float = min(max(scalars[TOWARDS] + step / max(play, LEAST_PLAY), -1.0), 1.0)
    scalars[LAST_U], scalars[TOWARDS] = U, towards
    return towards


@inner
def _begin_anew(
    champion: Surface, challenger: Surface, T: float, direction: float, path: Floats,
    scratch: Floats,
) -> None:  # fmt: skip
    """Have a new map stand for what the one before has shown behind the lags."""
    U, s = path[lag.U_METERED], path[lag.S_METERED]
    path[lag.Q_METERED] = _of(champion, U, s, T, direction, scratch) + path[lag.OFFSET]
    path[lag.RIVAL_METERED] = _of(challenger, U, s, T, direction, scratch) + path[lag.OFFSET]
    first = _of(champion, path[lag.U_FIRST], path[lag.S_FIRST], T, direction, scratch)
    smooth = _of(champion, path[lag.U_SMOOTH], path[lag.S_SMOOTH], T, direction, scratch)
    path[lag.MAP_FIRST], path[lag.MAP_SMOOTH] = first + path[lag.CURVED], smooth + path[lag.CURVED]


@inner
def _of(surface: Surface, U: float, s: float, T: float, direction: float, scratch: Floats) -> float:
    at, knots_U, knots_s = U - surface.play * direction, surface.knots_U, surface.knots_s
    return value(knots_U, knots_s, surface.nodes_T, surface.theta, at, s, T, scratch)


@inner
def _compare(
    model: Surface, cell: Floats, Q: float, forecast: float, t: int, clock: float, doubt: float,
    here: int, at: tuple[float, float, float, float], memory: Memory, scratch: Floats,
) -> float:  # fmt: skip
    """Hold a sample against its own cell: noise without misfit, change of the valve, outliers.

    The model only carries the cell's mean over to the sample's point, and a known drift to its
    time, so what it cannot represent cancels (and where it is far off, as in a region that is new
    to it, that is doubt: a change must be larger).
    What is taken in is clipped at 8 σ; a cell that stands farther off the model than the
    sample does was spoilt itself, and starts afresh.
    """
    scalars, counters, s = memory.scalars, memory.counters, at[1]
    at_mean: float = _of(model, cell[MEAN_U], cell[MEAN_S], cell[MEAN_T], cell[DIRECTION], scratch)
    grown = min(clock - cell[MEAN_TIME], OLDEST) * forecast
    error = Q - (cell[MEAN_Q] + forecast - at_mean) - scalars[RATE] * grown
    whitening = math.sqrt(cell[WEIGHT] / (cell[WEIGHT] + 1.0))
    sigma, is_known = math.sqrt(scalars[NOISE]), lag.is_known(scalars[LAGS:])
    if scalars[NOISE_WEIGHT] < NOISE_KNOWN:
        _know_noise(error * whitening, NOISE_MEMORY, scalars)
        return Q
    if is_known and counters[USED] - counters[OPENED] >= YOUNG:
        _enter(model, cell, forecast, here, at, memory, scratch)
        known = scalars[REFERENCE : REFERENCE + len(cell)]
        at_known = _of(
            model, known[MEAN_U], known[MEAN_S], known[MEAN_T], known[DIRECTION], scratch
        )
        carried, astray = forecast - at_known, abs(known[MEAN_Q] - at_known)
        steep = abs(carried) > STEEP * max(abs(known[MEAN_Q]), abs(forecast))
        if s >= PLAIN_S and known[WEIGHT] >= KNOWN and not steep:
            poor = max(1.0 - scalars[NOISE] / max(scalars[VARIANCE], 1e-30), 0.0)
            doubt = math.hypot(doubt, CARRIED * poor * carried)
            most = MOST_OF_A_STAY
            if astray > FITTING * sigma:  # the map has followed a change already, or never fitted
                doubt = math.hypot(doubt, FOLLOWED * astray)
            elif known[WEIGHT] >= SURE:
                most = ALARM_LEVEL if CARRIED * abs(carried) <= sigma else most
                if scalars[STAY] >= MOST_OF_A_STAY:  # how well the map carries is seen around
                    around = _weight_around(model, at, here, memory, scratch)
                    most = math.inf if around >= SURE else most
            off = Q - (known[MEAN_Q] + carried)
            off -= scalars[RATE] * min(clock - known[MEAN_TIME], OLDEST) * forecast
            whitened = off * math.sqrt(known[WEIGHT] / (known[WEIGHT] + 1.0))
            _watch(whitened / max(math.hypot(sigma, doubt), 1e-9), off, t, most, scalars, counters)
    calm = max(scalars[MORE], scalars[LESS], scalars[WILDER]) < 0.25 * ALARM_LEVEL
    since = counters[USED] - counters[OPENED]
    if is_known and since >= KNOWN_MAP and cell[WEIGHT] >= SETTLED_CELL:
        _know_rate(error + scalars[RATE] * grown, grown, scalars)
        if calm and abs(cell[MEAN_Q] - at_mean) <= FITTING * sigma:  # neither change nor misfit
            _know_colour(error, counters[USED] - counters[COMPARED], scalars)
            counters[COMPARED] = counters[USED]
    bound = CLIP * sigma / whitening
    if calm:
        limit = NOISE_CLIP * sigma
        longest = min(max(0.25 * since, NOISE_KNOWN), NOISE_MEMORY)
        _know_noise(min(max(error * whitening, -limit), limit), longest, scalars)
    plain = Q - cell[MEAN_Q]  # a map that is wild between few cells must not teach them itself
    error = plain if abs(plain) < abs(error) else error
    if abs(error) <= bound:
        return Q
    if abs(Q - forecast) < 0.5 * abs(cell[MEAN_Q] - at_mean):
        cell[WEIGHT] = 0.0
        return Q
    if abs(cell[MEAN_Q] - at_mean) > bound:  # the map cannot judge here
        return Q
    taken: float = Q - error + math.copysign(bound, error)
    return taken


@inner
def _know_noise(error: float, longest: float, scalars: Floats) -> None:
    """Mean square over as many samples at most: few while the map is young and far off."""
    scalars[NOISE_WEIGHT] = min(scalars[NOISE_WEIGHT] + 1.0, longest)
    scalars[NOISE] += (error**2 - scalars[NOISE]) / scalars[NOISE_WEIGHT]


@inner
def _know_colour(error: float, ago: int, scalars: Floats) -> None:
    """Mean square of the errors against the cells, and mean product of successive ones.

    A misfit cancels in them, so what is coloured is the noise; but for a map so poor that it
    carries a cell's mean over wrongly, which half of the mean squares of differences, of errors one
    and two samples apart, tell: from such a misfit, which is smooth, they are free. ``ago``:
    samples since the one before.
    """
    limit = NOISE_CLIP * math.sqrt(max(scalars[NOISE], scalars[POWER]))
    error = min(max(error, -limit), limit)
    last = scalars[LAST_RESIDUAL]
    if ago == 1:
        scalars[COLOUR_WEIGHT] = min(scalars[COLOUR_WEIGHT] + 1.0, COLOUR_MEMORY)
        share = 1.0 / scalars[COLOUR_WEIGHT]
        scalars[POWER] += (error * error - scalars[POWER]) * share
        scalars[COLOUR] += (error * last - scalars[COLOUR]) * share
        if math.isfinite(scalars[LAST_BUT_ONE]):
            one, two = 0.5 * (error - last) ** 2, 0.5 * (error - scalars[LAST_BUT_ONE]) ** 2
            scalars[DIFFER] += (one - scalars[DIFFER]) * share
            scalars[DIFFER_TWICE] += (two - scalars[DIFFER_TWICE]) * share
        scalars[LAST_BUT_ONE] = last
    else:
        scalars[LAST_BUT_ONE] = math.nan
    scalars[LAST_RESIDUAL] = error


@inner
def _know_rate(error: float, grown: float, scalars: Floats) -> None:
    """Mean of the error against a cell times its age and the flow, and of their square."""
    limit = CLIP * math.sqrt(scalars[NOISE])
    error = min(max(error, -limit), limit)
    scalars[RATE_WEIGHT] = min(scalars[RATE_WEIGHT] + 1.0, RATE_MEMORY)
    scalars[ERROR_Q] += (error * grown - scalars[ERROR_Q]) / scalars[RATE_WEIGHT]
    scalars[SQUARE_Q] += (grown * grown - scalars[SQUARE_Q]) / scalars[RATE_WEIGHT]


@lean_kernel
def colour(scalars: Floats) -> float:
    """Correlation of successive residuals, 0 to .99."""
    if not scalars[POWER] > 0.0:
        return 0.0
    rho: float = scalars[COLOUR] / scalars[POWER]
    if scalars[DIFFER] > 0.0:  # of noise of correlation ρ, σ²·(1 - ρ), and 1 + ρ times as much
        doubt = COLOUR_DOUBT / math.sqrt(scalars[COLOUR_WEIGHT])
        rho = min(rho, scalars[DIFFER_TWICE] / scalars[DIFFER] - 1.0 + doubt)
    return min(max(rho, 0.0), MOST_COLOUR)


@inner
def _worth(U: float, s: float, scalars: Floats) -> float:
    """How much of a white sample's worth a sample is: coloured noise says the same again.

    A direction of regressors whose correlation from sample to sample is ρₓ, under noise of
    correlation ρₑ, is learnt from N samples as well as from N·(1 - ρₓρₑ)/(1 + ρₓρₑ) white ones. ρₑ
    is what all weights are reckoned with (RECKONED), ρₓ on average STEADY.
    """
    way = max(abs(U - scalars[LEFT_U]) / SMOOTH_U, abs(s - scalars[LEFT_S]) / SMOOTH_S)
    scalars[LEFT_U], scalars[LEFT_S] = U, s
    if not math.isfinite(way):
        return 1.0
    near = math.exp(-way)
    scalars[STEADY] += (near - scalars[STEADY]) / COLOUR_MEMORY
    again: float = scalars[RECKONED] * near
    return (1.0 - again) / (1.0 + again)


@inner
def _enter(
    model: Surface, cell: Floats, forecast: float, here: int,
    at: tuple[float, float, float, float], memory: Memory, scratch: Floats,
) -> None:  # fmt: skip
    """Keep what a cell held when U and s came into it: it follows what it is held against.

    Of a cell that is new that is little, or what it is held against itself: there the map speaks.
    """
    scalars, counters = memory.scalars, memory.counters
    stayed = counters[USED] - counters[ENTERED]
    if here != counters[WATCHED]:
        scalars[STAY] = 0.0
    elif stayed < LONG_STAY:
        return
    counters[WATCHED], counters[ENTERED] = here, counters[USED]
    for column in range(len(cell)):
        scalars[REFERENCE + column] = cell[column]
    if cell[WEIGHT] >= SETTLED_CELL:
        return
    weight = min(_weight_around(model, at, here, memory, scratch), SETTLED_CELL)
    if weight > cell[WEIGHT]:
        scalars[REFERENCE + WEIGHT], scalars[REFERENCE + MEAN_Q] = weight, forecast
        scalars[REFERENCE + MEAN_U], scalars[REFERENCE + MEAN_S] = at[0], at[1]
        scalars[REFERENCE + MEAN_T], scalars[REFERENCE + DIRECTION] = at[2], at[3]
        scalars[REFERENCE + MEAN_TIME] = 0.0  # that of the last fit


@inner
def _weight_around(
    model: Surface, at: tuple[float, float, float, float], here: int, memory: Memory,
    scratch: Floats,
) -> float:  # fmt: skip
    """How many samples' mean the map is as good as, by how far the cells around lie off it.

    0 where there are none to either side: then it goes beyond what it knows. The sample's own cell
    (``here``) does not count, nor do those that were taught since a change is suspected. A map of
    as many parameters as cells follows these wherever they lie, and says nothing between them: so
    its misfit is taken for that of generalised cross-validation.
    """
    U, s, T, _ = at
    suspected = 1e-9 * (memory.counters[SUSPECT_TIME] - memory.counters[CLOCK])
    lower, higher, below, above = False, False, False, False
    squares, total = 0.0, 0.0
    middle = grid.place(U, s)
    in_U, in_s = middle // grid.CELLS_S, middle % grid.CELLS_S
    for i in range(max(in_U - 1, 0), min(in_U + 2, grid.CELLS_U)):
        for k in range(max(in_s - 1, 0), min(in_s + 2, grid.CELLS_S)):
            link = int(memory.slots[i * grid.CELLS_S + k]) & grid.NEXT
            while link:
                slot, link = link - 1, int(memory.slots[grid.PLACES + link - 1]) & grid.NEXT
                cell = memory.cells[slot]
                if slot == here or cell[WEIGHT] < SETTLED_CELL or cell[MEAN_TIME] > suspected:
                    continue
                if abs(T - cell[MEAN_T]) > NEAR_T:
                    continue
                said = _of(
                    model, cell[MEAN_U], cell[MEAN_S], cell[MEAN_T], cell[DIRECTION], scratch
                )
                squares += cell[WEIGHT] * (cell[MEAN_Q] - said) ** 2
                total += cell[WEIGHT]
                lower, higher = lower or cell[MEAN_U] < U, higher or cell[MEAN_U] > U
                below, above = below or cell[MEAN_S] < s, above or cell[MEAN_S] > s
    if not (lower and higher and below and above):
        return 0.0
    free = max(1.0 - memory.scalars[EXCITATION] / max(memory.counters[TAKEN], 1), 0.0)
    samples: float = memory.scalars[NOISE] * total * free * free / max(squares, 1e-30)
    return samples


@inner
def _watch(
    z: float, error: float, t: int, most: float, scalars: Floats, counters: np.ndarray
) -> None:
    """CUSUM of the whitened error: more flow than the cells remember, less, or more scatter.

    A stay in one cell adds ``most`` at most.
    """
    rho = colour(scalars)
    white = (z - rho * scalars[LAST_Z]) / math.sqrt(1.0 - rho * rho)
    scalars[LAST_Z] = min(max(z, -FAR), FAR)
    clipped = min(max(white, -FAR), FAR)
    scalars[SLOW] += (clipped - scalars[SLOW]) / SLOW_MEMORY
    clipped -= scalars[SLOW]
    left = max(most - scalars[STAY], 0.0)
    scalars[MORE] = max(0.0, scalars[MORE] + min(clipped - SHIFT, left))
    scalars[LESS] = max(0.0, scalars[LESS] + min(-clipped - SHIFT, left))
    scalars[WILDER] = max(0.0, scalars[WILDER] + min(abs(clipped) - WILD, left))
    scalars[STAY] += max(abs(clipped) - SHIFT, 0.0)
    scalars[SUSPECT_SUM] += error
    if scalars[MORE] + scalars[LESS] + scalars[WILDER] == 0.0:
        scalars[SUSPECT_SUM] = 0.0
        counters[SUSPECT_SAMPLE], counters[SUSPECT_TIME] = counters[USED] + 1, t


@inner
def _open(memory: Memory) -> None:
    """Open the memory: the valve has changed, what was learnt stays as a faint prior."""
    cells, scalars, counters = memory.cells, memory.scalars, memory.counters
    for i in range(len(cells)):
        cells[i, WEIGHT] = KEPT * min(cells[i, WEIGHT], 1.0)
    counters[ALARMS] += 1
    counters[CHANGE_SAMPLE], counters[CHANGE_TIME] = (
        counters[SUSPECT_SAMPLE],
        counters[SUSPECT_TIME],
    )
    samples = max(counters[USED] - counters[SUSPECT_SAMPLE], 1)
    scalars[CHANGE_SIZE] = scalars[SUSPECT_SUM] / samples
    scalars[MORE] = scalars[LESS] = scalars[WILDER] = scalars[SLOW] = scalars[SUSPECT_SUM] = 0.0
    scalars[NOISE_WEIGHT] = scalars[RATE_WEIGHT] = scalars[ERROR_Q] = 0.0
    scalars[RATE] = 0.0
    counters[OPENED] = counters[USED]
    counters[SPENT] = 0
    counters[NEXT_FIT] = counters[USED] + SETTLE
    counters[NEW_CELLS] = SETTLE
