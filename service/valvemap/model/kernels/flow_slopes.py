"""How the flow goes with s within a cell, of cells in which samples follow each other.

A cell's row of the design is the mean over its samples, so what these say of a slope is lost. Where
a machine rests, thousands of samples lie in one cell, and the slope there is known from nowhere
else. With s' the s of the sample before,

    E (s' - s̄)·(Q - Q̄) = E (s' - s̄)·(s - s̄) · ∂Q/∂s + E (s' - s̄)·(U - Ū) · ∂Q/∂U

White noise of the sensors has no part in it: s' is an instrument (Söderström & Stoica 1983). Over
the root of the variance of s this is an observation of the variance σ² / samples.

Few cells have such samples, so they share few places: of two, the one with more samples keeps it.
"""

import math

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import (
    Axis,
    slopes,
    surface_and_slopes,
    values,
)
from valvemap.model.kernels.flow_cells import (
    COUNT,
    MEAN_Q,
    MEAN_S,
    MEAN_U,
    VAR_S,
    VAR_U,
    Cells,
)
from valvemap.model.samples import Floats

# Columns: number of the cell and 1, 0 where there is none; second moments of the s before.
OWNER, WITH_S, WITH_U, WITH_Q = 0, 1, 2, 3
COLUMNS, PLACES = 4, 61

Slopes = NDArray[np.float32]


@inner
def owns(known: Slopes, number: int) -> bool:
    """Whether a cell has a place, and its samples say something of the slope."""
    place = known[number % PLACES]
    return bool(place[OWNER] == number + 1 and place[WITH_S] > 0.0)


@inner
def note(
    known: Slopes, cells: Cells, number: int, u: float, s: float, Q: float, share: float,
    s_before: float,
) -> None:  # fmt: skip
    """Add a sample that its cell is about to take with a weight of ``share``.

    ``s_before`` is NaN where the sample before was not in this cell.
    """
    place, cell = known[number % PLACES], cells[number]
    owner, follows = int(place[OWNER]) - 1, math.isfinite(s_before)
    if owner != number:
        if not follows or (owner >= 0 and cells[owner, COUNT] >= cell[COUNT]):
            return
        place[:] = 0.0
        place[OWNER] = number + 1
    off, rest = s_before - cell[MEAN_S] if follows else 0.0, 1.0 - share
    place[WITH_S] = rest * (place[WITH_S] + share * off * (s - cell[MEAN_S]))
    place[WITH_U] = rest * (place[WITH_U] + share * off * (u - cell[MEAN_U]))
    place[WITH_Q] = rest * (place[WITH_Q] + share * off * (Q - cell[MEAN_Q]))


@inner
def design(
    axis_U: Axis, axis_s: Axis, cell: Cells, number: int, known: Slopes, work: Floats, row: Floats
) -> float:
    """Fill the nine values of the row as `flow_cells.design`; give what it says."""
    place, parts = known[number % PLACES], len(axis_s.breaks) - 1
    i, j, size = number // parts, number % parts, math.sqrt(cell[VAR_S])
    values(axis_U, i, cell[MEAN_U], cell[VAR_U], work[0])
    values(axis_s, j, cell[MEAN_S], cell[VAR_S], work[1])
    slopes(axis_U, i, cell[MEAN_U], work[2])
    slopes(axis_s, j, cell[MEAN_S], work[3])
    by_s, by_U = place[WITH_S] / size, place[WITH_U] / size
    for a in range(3):
        for b in range(3):
            row[3 * a + b] = by_s * work[0, a] * work[3, b] + by_U * work[2, a] * work[1, b]
    return float(place[WITH_Q] / size)


@lean_kernel
def shift(
    axis_U: Axis, axis_s: Axis, by: Floats, cells: Cells, known: Slopes, work: Floats
) -> None:
    """Add the surface of coefficients ``by`` (n_U·n_s,), as `flow_cells.shift`."""
    for k in range(PLACES):
        place = known[k]
        if place[OWNER] > 0.0:
            cell = cells[int(place[OWNER]) - 1]
            u, s = float(cell[MEAN_U]), float(cell[MEAN_S])
            _, by_U, by_s = surface_and_slopes(axis_U, axis_s, by, u, s, work)
            place[WITH_Q] += place[WITH_S] * by_s + place[WITH_U] * by_U
