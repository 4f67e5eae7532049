"""What `Auto` knows: cells, the last samples, the shapes that compete and their maps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model import fit_budget as budget
from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import grid, ladder, lag, map_fit
from valvemap.model.kernels.surface import BORDER, PAIRS, TREND, Surface
from valvemap.model.map_shapes import (
    AXES,
    CELLS,
    MOST,
    MOST_S,
    MOST_U,
    PRESSURES,
    Shape,
    dp_top,
)
from valvemap.model.samples import Floats

Counts = NDArray[np.int64]

CHAMPION, CHALLENGER, EXPLORER = 0, 1, 2
FIRST_LOOK: Final = lag.ROWS  # samples kept before lags are looked for, up to half as many later
MAY_BE_UNKNOWN: Final = [  # places in the path of the lags: before the first sample, or map
    *(lag.U_EFFECT, lag.Q_METERED, lag.RIVAL_METERED),
    *(lag.Q_FIRST, lag.Q_SMOOTH, lag.MAP_FIRST, lag.MAP_SMOOTH),
]
LAGS_KEPT: Final = lag.LAG_U, lag.LAG_Q, lag.BEGAN_U, lag.BEGAN_Q, lag.SMOOTHING


@dataclass(frozen=True)
class AutoState(State):
    """What `Auto` knows; arrays of constant size.

    Attributes
    ----------
    cells : (640, 7) float32
        Weight and means of U, s, T, direction, Q and time of the samples of each cell that has a
        slot.
    slots : (1184,) uint16
        Which slot each cell of the grid has, see :mod:`kernels.grid`.
    recent : (704, 4) float32
        The last samples, for the search for lags, see :mod:`kernels.lag`.
    shapes : (3, 6), top : (1,)
        Shapes of champion, challenger and explorer, and the pressure their splines reach to, bar.
    knots_U, knots_s, coefficients, sizes : (2, …)
        The maps of champion and challenger, padded with 0; sizes (n_U, n_s).
    theta : (n + 8,)
        Parameters of the champion, padded with 0.
    inverse, mixed, corner
        The champion's inverse information, see :func:`kernels.map_fit.fit`; float32 but the last.
    scalars, counters
        See :mod:`kernels.cells`.
    progress : (3, 2)
        The explorer's starts so far, and of how many cells; how far challenger and explorer came
        in trying their neighbours, see :func:`map_search.climb`.
    """

    state_version: ClassVar[int] = 8  # 7: kept a slot for each cell of the grid

    cells: NDArray[np.float32]
    slots: NDArray[np.uint16]
    recent: NDArray[np.float32]
    shapes: Floats
    top: Floats
    knots_U: Floats
    knots_s: Floats
    coefficients: Floats
    sizes: Counts
    theta: Floats
    inverse: NDArray[np.float32]
    mixed: NDArray[np.float32]
    corner: Floats
    scalars: Floats
    counters: Counts
    progress: Counts

    def contents(self) -> Mapping[str, Contents]:
        """What may stand in them; places that kernels count by lie within their arrays."""
        every, path = slice(None), memory.LAGS
        scalars = Contents(self.scalars).within(-1.0, 1.0, memory.TOWARDS)
        scalars.or_nan([memory.LAST_U, memory.VARIANCE, memory.LEFT_U, memory.LAST_BUT_ONE])
        scalars.or_nan([path + k for k in MAY_BE_UNKNOWN])
        of_noise = [memory.NOISE, memory.NOISE_WEIGHT, memory.POWER, memory.VARIANCE]
        of_noise += [memory.DIFFER, memory.DIFFER_TWICE]
        scalars.within(0.0, where=of_noise)
        scalars.within(0.0, 1.0, memory.REACTS)
        scalars.within(0.0, where=[path + k for k in LAGS_KEPT])
        counters = Contents(self.counters).within(0, 1, [memory.FITTED, memory.FRESH])
        counters.any_time([memory.SUSPECT_TIME, memory.CHANGE_TIME, memory.CLOCK])
        counters.any_time([memory.LAGGING + lag.TIME, memory.LAGGING + lag.KEPT_TIME])
        counters.any_time([memory.NEXT_LOOK, memory.NEW_CELLS, memory.SPENT])
        counters.within(0, grid.SLOTS, memory.TAKEN)
        shapes = Contents(self.shapes).within(0.0, CELLS[-1], (every, ladder.CELLS_OF))
        shapes.within(0.0, len(AXES) - 1.0, (every, ladder.AXIS))
        shapes.within(0.0, ladder.MOST_DEAD, (every, ladder.DEAD_BAND))
        shapes.within(ladder.LEAST_FULL, 100.0, (every, ladder.SATURATION))
        shapes.within(0.0, ladder.MOST_PLAY, (every, ladder.PLAY))
        shapes.within(0.0, 1.0, (every, ladder.TREND))
        shapes.or_nan((every, [ladder.DEAD_BAND, ladder.SATURATION]))
        return {
            "cells": Contents(self.cells).within(0.0, where=(every, grid.WEIGHT)),
            "slots": Contents(self.slots).within(0, grid.SLOTS, slice(grid.PLACES)),
            "shapes": shapes,
            "top": Contents(self.top).within(PRESSURES[0], PRESSURES[-1]),
            "sizes": Contents(self.sizes).within(0, MOST),
            "scalars": scalars,
            "counters": counters,
        }

    def is_coherent(self) -> bool:
        """Whether shapes are steps of the ladder, and the maps as large as their shapes."""
        whole = [ladder.CELLS_OF, ladder.AXIS, ladder.TREND]
        known = (self.shapes[:, whole] == np.rint(self.shapes[:, whole])).all()
        if not grid.is_coherent(self.slots, int(self.counters[memory.TAKEN])):
            return False
        if not known or not np.isin(self.shapes[:, ladder.CELLS_OF], CELLS).all():
            return False
        return all(_is_of_its_shape(self, which) for which in (CHAMPION, CHALLENGER)) and (
            shape_of(self, EXPLORER).size <= MOST
        )


def empty(lag_U: float | None, lag_Q: float | None) -> AutoState:
    """State before the first sample; lags that are None are looked for."""
    scalars = np.zeros(memory.SCALARS)
    unknown = [memory.LAST_U, memory.VARIANCE, memory.LEFT_U, memory.LAST_BUT_ONE]
    scalars[unknown] = math.nan
    path = scalars[memory.LAGS :]
    path[MAY_BE_UNKNOWN] = math.nan
    path[lag.LAG_U], path[lag.LAG_Q] = path[[lag.BEGAN_U, lag.BEGAN_Q]] = lag_U or 0.0, lag_Q or 0.0
    counters = np.zeros(memory.COUNTERS, np.int64)
    counters[[memory.NEXT_FIT, memory.NEW_CELLS]] = budget.FIRST_FIT
    looked_for = lag_U is None or lag_Q is None
    counters[memory.NEXT_LOOK] = FIRST_LOOK if looked_for else np.iinfo(np.int64).max
    return AutoState(
        cells=np.zeros((grid.SLOTS, len(grid.COLUMNS)), np.float32),
        slots=np.zeros(grid.PLACES + grid.SLOTS, np.uint16),
        recent=np.zeros((lag.ROWS, 4), np.float32),
        shapes=np.stack([Shape().to_array()] * 3),
        top=np.array([dp_top(0.0)]),
        knots_U=np.zeros((2, MOST_U + 4)),
        knots_s=np.zeros((2, MOST_S + 4)),
        coefficients=np.zeros((2, 2 * MOST)),
        sizes=np.zeros((2, 2), np.int64),
        theta=np.zeros(MOST + BORDER),
        inverse=np.zeros((MOST, PAIRS), np.float32),
        mixed=np.zeros((MOST, TREND), np.float32),
        corner=np.zeros((BORDER, BORDER)),
        scalars=scalars,
        counters=counters,
        progress=np.zeros((3, 2), np.int64),
    )


def last_rows(state: AutoState) -> Floats:
    """The last samples kept, in the order of time."""
    kept = int(state.counters[memory.LAGGING + lag.KEPT_ROWS])
    rows = np.roll(state.recent, -(kept % lag.ROWS), axis=0) if kept >= lag.ROWS else state.recent
    return rows[:kept].astype(np.float64)


def shape_of(state: AutoState, which: int) -> Shape:
    """Shape of champion, challenger or explorer."""
    return Shape.from_array(state.shapes[which])


def surface_of(state: AutoState, which: int) -> Surface:
    """Map of champion or challenger as the kernels take it; 0 before the first fit."""
    n_U, n_s = state.sizes[which].tolist()
    if not n_U:
        return Surface(np.zeros(8), np.zeros(8), memory.NODES_T, np.zeros((4, 4, 2)), 0.0)
    table = state.coefficients[which, : 2 * n_U * n_s].reshape(n_U, n_s, 2)
    return Surface(
        state.knots_U[which, : n_U + 4],
        state.knots_s[which, : n_s + 4],
        memory.NODES_T,
        table,
        shape_of(state, which).play,
    )


def write_map(state: AutoState, which: int, shape: Shape, theta: Floats, top: float) -> None:
    """Write the map of champion or challenger as the kernels take it."""
    plan = shape.plan(top)
    n_U, n_s = len(plan.sites_U), len(plan.sites_s)
    table = np.empty((n_U, n_s, 2))
    map_fit.coefficients(plan, theta, table)
    state.sizes[which] = n_U, n_s
    state.knots_U[which, : n_U + 4], state.knots_s[which, : n_s + 4] = plan.knots_U, plan.knots_s
    state.coefficients[which, : table.size] = table.ravel()


def _is_of_its_shape(state: AutoState, which: int) -> bool:
    n_U, n_s = state.sizes[which].tolist()
    shape = shape_of(state, which)
    if not n_U:
        return not n_s and not shape.size
    plan = shape.plan(float(state.top[0]))
    return (
        shape.size <= MOST
        and (n_U, n_s) == (len(plan.sites_U), len(plan.sites_s))
        and np.array_equal(state.knots_U[which, : n_U + 4], plan.knots_U)
        and np.array_equal(state.knots_s[which, : n_s + 4], plan.knots_s)
    )
