"""The fits of one valve of `Auto`: which shape is champion, and how far the challenger climbs."""

import math
from typing import Final, NamedTuple

import numpy as np

from valvemap.model import coloured_noise, drift, jitter
from valvemap.model import fit_budget as budget
from valvemap.model.auto_state import (
    CHALLENGER,
    CHAMPION,
    EXPLORER,
    FIRST_LOOK,
    AutoState,
    last_rows,
    surface_of,
    write_map,
)
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import grid, held, lag
from valvemap.model.kernels import surface as kernel
from valvemap.model.kernels.climb import IDLE
from valvemap.model.map_search import (
    RICH,
    STARTS,
    Fit,
    climb,
    fit,
    fresh_start,
    is_better,
    is_resting,
    variety,
)
from valvemap.model.map_shapes import AXES, MOST, Shape, Variety, dp_top
from valvemap.model.samples import Floats

STARTED: Final = 0
ENOUGH_CELLS: Final = 24  # cells from which on shapes are compared
RESTING_STEPS: Final = 2  # neighbours tried at a fit once all were tried in vain
RESTED: Final = 60  # neighbours tried in vain from which on fits are rare
POOR: Final = 3.0  # times the noise's variance that a poor map leaves
WORSE: Final = 1.02**2  # how much larger a challenger's squares may be that becomes champion
SPIKE, FEW = 30.0, 3.0  # usual misfits, samples: farther off and of fewer, a cell is a spike
NEW_START: Final = 1.25  # growth of the known cells that has the search start anew


class Ground(NamedTuple):
    """What shapes are compared on: points up to a pressure, and what these can tell."""

    points: Floats
    top: float  # bar
    varied: Variety
    least: float  # σ² at least, (l/min)²
    most_steps: int  # of a climb
    is_poor: bool  # whether the map leaves far more than the noise


def refit(state: AutoState, most_steps: int) -> None:
    """Promote the challenger if it did well, let it climb, fit both; written in place."""
    scalars, counters, progress = state.scalars, state.counters, state.progress
    points = _points_now(state)
    if not len(points):
        budget.next_fit(counters, 0, at_rest=False)
        return
    top = dp_top(float(points[:, grid.MEAN_S].max()))
    champion, challenger, explorer = (Shape.from_array(shape) for shape in state.shapes)
    if scalars[memory.CHALLENGER_SQUARES] <= WORSE * scalars[memory.CHAMPION_SQUARES]:
        champion = challenger
    if counters[memory.NEW_CELLS] <= 0:
        progress[CHALLENGER, IDLE] = 0
    if len(points) > NEW_START * progress[STARTED, 1]:
        progress[STARTED] = 0, len(points)
    if len(points) >= ENOUGH_CELLS:
        path = scalars[memory.LAGS :]
        shared = held.shared(state.slots, state.cells)
        varied = variety(shared, points, float(path[lag.LAG_U] + path[lag.LAG_Q]))
        least = coloured_noise.least_variance(scalars)
        is_poor = bool(scalars[memory.VARIANCE] > POOR * scalars[memory.NOISE])
        ground = Ground(points, top, varied, least, most_steps, is_poor)
        challenger, explorer = _climbed(state, ground, challenger, explorer)
    best = fit(points, champion, top)
    rival = best if challenger == champion else fit(points, challenger, top)
    budget.spend(counters, 2 * _cost(points, challenger))
    freedom = max(len(points) - best.n_effective, 1.0)
    scalars[memory.VARIANCE] = max(best.rss / freedom, scalars[memory.NOISE], scalars[memory.POWER])
    scalars[memory.EXCITATION] = best.n_effective
    scalars[[memory.CHAMPION_SQUARES, memory.CHALLENGER_SQUARES]] = 0.0
    at_rest = champion == challenger and progress[CHALLENGER, IDLE] > RESTED
    at_rest = at_rest and not drift.is_sure(scalars)
    budget.next_fit(counters, len(points), at_rest=at_rest)
    if counters[memory.NEXT_LOOK] == FIRST_LOOK:
        counters[memory.NEXT_LOOK] += budget.scattered(counters, FIRST_LOOK // 2)
    counters[[memory.FITTED, memory.FRESH]] = 1
    state.shapes[:] = [x.to_array() for x in (champion, challenger, explorer)]
    _publish(state, champion, best, top)
    write_map(state, CHALLENGER, challenger, rival.theta, top)


def _points_now(state: AutoState) -> Floats:
    """The cells to be fitted, with all that time and noise have made of them until now."""
    scalars, counters = state.scalars, state.counters
    now = counters[memory.LAGGING + lag.TIME]
    ahead = drift.set_clock(state.cells, scalars, 1e-9 * float(now - counters[memory.CLOCK]))
    counters[memory.CLOCK] = now
    if (reacts := jitter.reacts(last_rows(state))) is not None:
        scalars[memory.REACTS] = reacts
    coloured_noise.reckon(state.cells, scalars)
    return _trusted(state, ahead)


def _publish(state: AutoState, champion: Shape, best: Fit, top: float) -> None:
    n = champion.size
    state.top[0] = top
    state.theta[:] = 0.0
    state.theta[:n], state.theta[MOST:] = best.theta[:n], best.theta[n:]
    state.inverse[:n], state.mixed[:n], state.corner[:] = best.inverse, best.mixed, best.corner
    state.inverse[n:], state.mixed[n:] = 0.0, 0.0
    write_map(state, CHAMPION, champion, best.theta, top)


def _climbed(
    state: AutoState, ground: Ground, challenger: Shape, explorer: Shape
) -> tuple[Shape, Shape]:
    """Let the challenger climb; once it rests on a summit, the explorer, from other starts."""
    points, top, varied, least, most_steps, is_poor = ground
    progress, counters = state.progress, state.counters
    rich, rich_elsewhere = np.zeros((2, RICH))  # of these points, no results yet
    resting = is_resting(challenger, varied, progress[CHALLENGER])
    steps = budget.steps(counters, _cost(points, challenger), most_steps, poor=is_poor)
    steps = min(steps, RESTING_STEPS) if resting else steps
    if steps < 1:
        return challenger, explorer
    challenger = climb(points, challenger, top, varied, steps, progress[CHALLENGER], least, rich)
    budget.spend(counters, (steps + 2) * _cost(points, challenger))
    if not resting or progress[STARTED, 0] > len(STARTS):
        return challenger, explorer
    if is_resting(explorer, varied, progress[EXPLORER]) or not progress[STARTED, 0]:
        explorer = fresh_start(progress[STARTED, 0], challenger)
        progress[STARTED, 0] += 1
        progress[EXPLORER] = 0
    steps = budget.steps(counters, _cost(points, explorer), most_steps, poor=False)
    if steps < 1:
        return challenger, explorer
    explorer = climb(
        points, explorer, top, varied, steps, progress[EXPLORER], least, rich_elsewhere
    )
    budget.spend(counters, (steps + 5) * _cost(points, explorer))
    if progress[EXPLORER, IDLE] and is_better(points, explorer, challenger, top, least, rich):
        challenger = explorer
        progress[CHALLENGER] = 0
    return challenger, explorer


def _trusted(state: AutoState, ahead: float) -> Floats:
    """Cells that hold samples, as they will be in ``ahead`` s.

    But for those of a few samples far off all others: spikes.
    """
    points = drift.carried(held.points(state.cells), state.scalars, ahead)
    if not state.counters[memory.FITTED] or not len(points):
        return points
    if state.counters[memory.ALARMS]:
        _credit(state, points)
    misfit = kernel.misfit(surface_of(state, CHAMPION), points)
    usual = max(
        float(np.partition(misfit, len(misfit) // 2)[len(misfit) // 2]),
        math.sqrt(state.scalars[memory.NOISE]),
        1e-4 * float(np.abs(points[:, grid.MEAN_Q]).max()),
    )
    spiked = (misfit > SPIKE * usual) & (points[:, grid.WEIGHT] < FEW)
    return points[~spiked]


def _credit(state: AutoState, points: Floats) -> None:
    """Believe what was known before a change where it is seen to have stayed; written in place.

    All of the memory was opened: but a worn edge, say, leaves the rest of the map as it was, which
    between the few samples since the change the prior would bend.
    """
    change = 1e-9 * float(state.counters[memory.CHANGE_TIME] - state.counters[memory.CLOCK])
    noise = float(state.scalars[memory.NOISE])
    held.credit(state.slots, state.cells, surface_of(state, CHAMPION), change, noise, points)


def _cost(points: Floats, shape: Shape) -> int:
    band = 3 * (len(AXES[shape.axis]) + 2) + 4
    return budget.cost(len(points), shape.size, band)
