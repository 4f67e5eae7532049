"""What the memory holds: its cells as points of a map, from which sides U came to them.

And what of it is believed after a change.
"""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.cells import ASKING, NEAR_T, SETTLED_CELL
from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.kernels.grid import (
    CELLS_OF_A_PLACE,
    CELLS_S,
    CELLS_U,
    DIRECTION,
    MEAN_Q,
    MEAN_S,
    MEAN_T,
    MEAN_TIME,
    MEAN_U,
    NEXT,
    PLACES,
    WEIGHT,
    place,
    slot_at,
)
from valvemap.model.kernels.surface import Surface, value
from valvemap.model.samples import Floats

Cells = NDArray[np.float32]

AROUND = 5  # places to either side that speak for one: 15 % and 3 √bar or so, as SMOOTH_U, SMOOTH_S
FEWEST_PAIRS = 4  # of cells, around a place: the mean square of fewer is half chance
UNCHANGED = ASKING * 2.0 / SETTLED_CELL  # times σ²: what two means of so few samples differ by


@kernel
def points(cells: Cells) -> Floats:
    """Cells that hold samples (N, 7), as the kernels of the fit take them."""
    N = 0
    for i in range(len(cells)):
        N += cells[i, WEIGHT] > 0.0
    found, at = np.empty((N, cells.shape[1])), 0
    for i in range(len(cells)):
        if cells[i, WEIGHT] > 0.0:
            for k in range(cells.shape[1]):
                found[at, k] = cells[i, k]
            at += 1
    return found


@kernel
def shared(slots: NDArray[np.uint16], cells: Cells) -> float:
    """Share of the samples that lie where U came from either side, twice the lesser side's."""
    lesser, total = 0.0, 0.0
    for number in range(0, PLACES * CELLS_OF_A_PLACE, 2):
        falling, rising = 0.0, 0.0
        if slots[number // CELLS_OF_A_PLACE]:
            left, right = slot_at(number, slots), slot_at(number + 1, slots)
            falling = cells[left - 1, WEIGHT] if left else 0.0
            rising = cells[right - 1, WEIGHT] if right else 0.0
        lesser += min(falling, rising)
        total += falling + rising
    return lesser / total if total > 0.0 else 0.0


@kernel
def credit(
    slots: NDArray[np.uint16], cells: Cells, model: Surface, change: float, noise: float,
    points: Floats,
) -> None:  # fmt: skip
    """Have points of before a change count for a sample, where the places around show the same.

    A place shows what a change did to it where one of its cells was taught since ``change`` (s, by
    the cells' clock) and another one was not. ``points`` are written.
    """
    squares, pairs = np.zeros(PLACES), np.zeros(PLACES)
    if _compare_places(slots, cells, model, change, squares, pairs) < FEWEST_PAIRS:
        return
    for i in range(len(points)):
        if points[i, MEAN_TIME] < change and points[i, WEIGHT] < 1.0:
            at = place(points[i, MEAN_U], points[i, MEAN_S])
            square, count = _around(squares, at), _around(pairs, at)
            if count >= FEWEST_PAIRS and square <= UNCHANGED * noise * count:
                points[i, WEIGHT] = 1.0


@maker
def _compare_places(
    slots: NDArray[np.uint16], cells: Cells, model: Surface, change: float, squares: Floats,
    pairs: Floats,
) -> int:  # fmt: skip
    """Fill by how much the places changed, squared, and by how many pairs; all of these."""
    scratch, found = np.empty((4, 4)), 0
    for number in range(PLACES):
        old = int(slots[number])
        while old:
            before = cells[old - 1]
            new = int(slots[number]) if before[MEAN_TIME] < change else 0
            while new:
                after = cells[new - 1]
                taught = after[MEAN_TIME] >= change and after[WEIGHT] >= SETTLED_CELL
                if taught and abs(after[MEAN_T] - before[MEAN_T]) <= NEAR_T:
                    way = _off(model, after, scratch) - _off(model, before, scratch)
                    squares[number] += way * way
                    pairs[number] += 1.0
                    found += 1
                new = int(slots[PLACES + new - 1]) & NEXT
            old = int(slots[PLACES + old - 1]) & NEXT
    return found


@inner
def _around(values: Floats, at: int) -> float:
    """Sum over the places around one."""
    in_U, in_s, total = at // CELLS_S, at % CELLS_S, 0.0
    for i in range(max(in_U - AROUND, 0), min(in_U + AROUND + 1, CELLS_U)):
        for k in range(max(in_s - AROUND, 0), min(in_s + AROUND + 1, CELLS_S)):
            total += values[i * CELLS_S + k]
    return total


@inner
def _off(model: Surface, cell: Cells, scratch: Floats) -> float:
    """How far a cell lies off the map, which so carries cells of a place over to one another."""
    at, s, T = cell[MEAN_U] - model.play * cell[DIRECTION], cell[MEAN_S], cell[MEAN_T]
    said = value(model.knots_U, model.knots_s, model.nodes_T, model.theta, at, s, T, scratch)
    return float(cell[MEAN_Q] - said)
