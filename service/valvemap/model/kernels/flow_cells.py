"""What is remembered: per cell of the grid the means and second moments of its samples.

A cell lies between two knots of U and two of s. Its row of the design is the mean of the basis over
its samples, not the basis at their mean.
"""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis, interval, surface, values
from valvemap.model.samples import Floats

# Columns: samples; what they are worth in white noise; means; second central moments.
COUNT, WORTH, MEAN_U, MEAN_S, MEAN_Q, VAR_U, VAR_S = 0, 1, 2, 3, 4, 5, 6
REFUSALS = 7  # samples in a row that were refused as outliers
MEAN_X, MEAN_BEND = 8, 9  # of what the oil was, see `flow_oil`
COLUMNS = 10

Cells = NDArray[np.float32]


@inner
def cell_of(axis_U: Axis, axis_s: Axis, u: float, s: float) -> int:
    """Number of the cell in which a point lies."""
    return interval(axis_U, u) * (len(axis_s.breaks) - 1) + interval(axis_s, s)


@inner
def deposit(
    cell: Cells, u: float, s: float, x: float, bend: float, Q: float, weight: float, worth: float,
    memory: float,
) -> None:  # fmt: skip
    """Add a sample of some weight (1: regular, 0: an outlier), worth ``worth`` white ones."""
    if weight <= 0.0:
        return
    kept, total = _remembered(cell, weight, memory)
    share = weight / total
    du, ds = u - cell[MEAN_U], s - cell[MEAN_S]
    rest = 1.0 - share
    cell[COUNT] = total
    cell[WORTH] = kept * cell[WORTH] + weight * worth
    cell[VAR_U] = rest * (cell[VAR_U] + share * du * du)
    cell[VAR_S] = rest * (cell[VAR_S] + share * ds * ds)
    cell[MEAN_X] += share * (x - cell[MEAN_X])
    cell[MEAN_BEND] += share * (bend - cell[MEAN_BEND])
    cell[MEAN_U] += share * du
    cell[MEAN_S] += share * ds
    cell[MEAN_Q] += share * (Q - cell[MEAN_Q])


@inner
def share_of(cell: Cells, weight: float, memory: float) -> float:
    """Share that a sample will have in the means of its cell."""
    return weight / _remembered(cell, weight, memory)[1]


@inner
def _remembered(cell: Cells, weight: float, memory: float) -> tuple[float, float]:
    """Share of what a cell knows that it keeps, and what it then knows in samples."""
    before = float(cell[COUNT])
    kept = 1.0 if before + weight <= memory else max(1.0 - weight / memory, 0.0)
    return kept, kept * before + weight


@lean_kernel
def shift(axis_U: Axis, axis_s: Axis, by: Floats, cells: Cells, work: Floats) -> None:
    """Add the surface of coefficients ``by`` (n_U·n_s,) to all cells; ``work`` is (4, 3)."""
    for c in range(len(cells)):
        if cells[c, COUNT] > 0.0:
            u, s = float(cells[c, MEAN_U]), float(cells[c, MEAN_S])
            cells[c, MEAN_Q] += surface(axis_U, axis_s, by, u, s, work)


@inner
def design(axis_U: Axis, axis_s: Axis, cell: Cells, number: int, work: Floats, row: Floats) -> int:
    """Fill the nine values of a cell's row; give the first parameter that they belong to.

    Value 3·a + b belongs to parameter a·n_s + b behind the first. ``work`` is (4, 3).
    """
    parts = len(axis_s.breaks) - 1
    i, j = number // parts, number % parts
    values(axis_U, i, cell[MEAN_U], cell[VAR_U], work[0])
    values(axis_s, j, cell[MEAN_S], cell[VAR_S], work[1])
    for a in range(3):
        for b in range(3):
            row[3 * a + b] = work[0, a] * work[1, b]
    return i * len(axis_s.sites) + j
