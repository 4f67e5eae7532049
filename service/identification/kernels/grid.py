"""The grid of cells: where a sample belongs, and which slot of the memory its cell has.

The grid divides (U, √dp) into places, and each place by temperature and direction of U into six
cells. A cell gets a slot with its first sample. There are fewer slots than cells, as no machine
visits all of them: once all slots are taken, the two cells of a place that know least become one.
"""

import math

import numpy as np

from service.identification.kernels.compiled import inner
from service.identification.samples import Floats

CELLS_U, CELLS_S, CELLS_T = 32, 17, 3  # 3.1 % of U by 0.3 to 1.8 √bar by 20 K
PLACES = CELLS_U * CELLS_S
CELLS_OF_A_PLACE = 2 * CELLS_T
SLOTS = 640  # more than there are places, so that each may have one; 18 kB
S_TOP = 20.0  # √bar: the grid reaches to 400 bar
COLD, WARM = 30.0, 50.0  # °C: where cells are divided
OF_DIRECTION, OF_LOOP = 0.1, 100.0  # cost of merging both directions, of merging 20 K: 1
COLUMNS = WEIGHT, MEAN_U, MEAN_S, MEAN_T, DIRECTION, MEAN_Q, MEAN_TIME = 0, 1, 2, 3, 4, 5, 6


@inner
def number(U: float, s: float, T: float, direction: float) -> int:
    """Which cell a point falls into; those of both directions stand side by side.

    Cells in s are narrow near 0, where the flow is laminar; the first is for reversed flow.
    """
    in_U = int(min(max(U * (CELLS_U / 100.0), 0.0), CELLS_U - 1.0))
    share = min(max(s, 0.0), 0.999 * S_TOP) / S_TOP
    in_s = 1 + int((CELLS_S - 1) * share ** (2.0 / 3.0)) if s >= 0.0 else 0
    in_T = 0 if T < COLD else (1 if T < WARM else 2)
    return ((in_U * CELLS_S + in_s) * CELLS_T + in_T) * 2 + (1 if direction > 0.0 else 0)


@inner
def known(number: int, slots: np.ndarray, cells: Floats) -> float:
    """Weight of a cell, or of its like at another temperature if that is larger."""
    most, first = 0.0, number - number % CELLS_OF_A_PLACE + number % 2
    for at in range(first, first + CELLS_OF_A_PLACE, 2):
        if slots[at]:
            most = max(most, cells[int(slots[at]) - 1, WEIGHT])
    return most


@inner
def slot_of(number: int, play: float, slots: np.ndarray, cells: Floats, taken: np.ndarray) -> int:
    """Slot of a cell, which it is given if it has none: a free one, or one that merging frees.

    ``taken`` (1,) counts the slots in use. Where a hysteresis is known (``play`` > 0), directions
    are the last to be made one; otherwise temperatures are.
    """
    slot = int(slots[number]) - 1
    if slot >= 0:
        return slot
    if taken[0] < SLOTS:
        slot = int(taken[0])
        taken[0] += 1
    else:
        slot = _merge(OF_LOOP if play > 0.0 else OF_DIRECTION, slots, cells)
        slot = slot if slot >= 0 else _beside(number, slots)
    slots[number] = slot + 1
    return slot


@inner
def learn(
    cell: Floats, worth: float, longest: float, U: float, s: float, T: float, direction: float,
    Q: float, t: float,
) -> None:  # fmt: skip
    """Take a sample into a cell, whose weight ``longest`` bounds: then its mean is exponential."""
    weight = min(cell[WEIGHT] + worth, longest)
    share = min(worth / weight, 1.0)
    cell[WEIGHT] = weight
    cell[MEAN_U] += (U - cell[MEAN_U]) * share
    cell[MEAN_S] += (s - cell[MEAN_S]) * share
    cell[MEAN_T] += (T - cell[MEAN_T]) * share
    cell[DIRECTION] += (direction - cell[DIRECTION]) * share
    cell[MEAN_Q] += (Q - cell[MEAN_Q]) * share
    cell[MEAN_TIME] += (t - cell[MEAN_TIME]) * share


@inner
def _merge(of_direction: float, slots: np.ndarray, cells: Floats) -> int:
    """Make the two cells of a place one that cost least; give the slot set free, or -1 for none."""
    least, kept, freed, place = math.inf, -1, -1, 0
    for first in range(0, len(slots), CELLS_OF_A_PLACE):
        for i in range(first + 1, first + CELLS_OF_A_PLACE):
            for k in range(first, i):
                if slots[i] and slots[k] and slots[i] != slots[k]:
                    one, other = int(slots[k]) - 1, int(slots[i]) - 1
                    cost = _cost(cells[one], cells[other], of_direction)
                    if cost < least:
                        least, kept, freed, place = cost, one, other, first
    if freed < 0:
        return -1
    total = cells[kept, WEIGHT] + cells[freed, WEIGHT]
    share = cells[freed, WEIGHT] / total if total > 0.0 else 0.0
    for column in range(1, cells.shape[1]):
        cells[kept, column] += (cells[freed, column] - cells[kept, column]) * share
        cells[freed, column] = 0.0
    cells[kept, WEIGHT], cells[freed, WEIGHT] = total, 0.0
    for at in range(place, place + CELLS_OF_A_PLACE):
        if slots[at] == freed + 1:
            slots[at] = kept + 1
    return freed


@inner
def _cost(one: Floats, other: Floats, of_direction: float) -> float:
    """What is lost when two cells are made one; what was known before a change is worth little."""
    ways = (one[MEAN_T] - other[MEAN_T]) / (WARM - COLD), (one[DIRECTION] - other[DIRECTION]) / 2.0
    weights = min(one[WEIGHT], 1.0), min(other[WEIGHT], 1.0)
    cost: float = min(weights) * (ways[0] ** 2 + of_direction * ways[1] ** 2)
    return cost


@inner
def _beside(number: int, slots: np.ndarray) -> int:
    """Slot of any cell of the same place; there is one, as no place is left that has two."""
    first = number - number % CELLS_OF_A_PLACE
    for at in range(first, first + CELLS_OF_A_PLACE):
        if slots[at]:
            return int(slots[at]) - 1
    return 0
