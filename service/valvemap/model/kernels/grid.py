"""The grid of cells: where a sample belongs, and which slot of the memory its cell has.

The grid divides (U, √dp) into places, and each place by temperature and direction of U into six
cells. A cell gets a slot with its first sample. There are fewer slots than cells, as no machine
visits all of them: once all slots are taken, the two cells of a place that know least become one.

``slots`` (PLACES + SLOTS,) holds for each place one more than the first of its slots, 0 for none;
then for each slot a link: which of the place's six cells it serves, and the next slot of the place.
"""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Floats

CELLS_U, CELLS_S, CELLS_T = 32, 17, 3  # 3.1 % of U by 0.3 to 1.8 √bar by 20 K
PLACES = CELLS_U * CELLS_S
CELLS_OF_A_PLACE = 2 * CELLS_T
SLOTS = 640  # more than there are places, so that each may have one; 18 kB
S_TOP = 20.0  # √bar: the grid reaches to 400 bar
COLD, WARM = 30.0, 50.0  # °C: where cells are divided
OF_DIRECTION, OF_LOOP = 0.1, 100.0  # cost of merging both directions, of merging 20 K: 1
NEXT, SERVED = 1023, 10  # bits of a slot's link: one more than the next slot; cells that it serves
OF_ONE_DIRECTION = 0b010101
COLUMNS = WEIGHT, MEAN_U, MEAN_S, MEAN_T, DIRECTION, MEAN_Q, MEAN_TIME = 0, 1, 2, 3, 4, 5, 6


@inner
def number(U: float, s: float, T: float, direction: float) -> int:
    """Which cell a point falls into; those of both directions stand side by side."""
    in_T = 0 if T < COLD else (1 if T < WARM else 2)
    return (place(U, s) * CELLS_T + in_T) * 2 + (1 if direction > 0.0 else 0)


@inner
def place(U: float, s: float) -> int:
    """Which place a point falls into; those of one U stand side by side.

    Places in s are narrow near 0, where the flow is laminar; the first is for reversed flow.
    """
    in_U = int(min(max(U * (CELLS_U / 100.0), 0.0), CELLS_U - 1.0))
    share = min(max(s, 0.0), 0.999 * S_TOP) / S_TOP
    in_s = 1 + int((CELLS_S - 1) * share ** (2.0 / 3.0)) if s >= 0.0 else 0
    return in_U * CELLS_S + in_s


@inner
def slot_at(number: int, slots: np.ndarray) -> int:
    """One more than the slot of a cell; 0 for none."""
    wanted = 1 << (SERVED + number % CELLS_OF_A_PLACE)
    at = int(slots[number // CELLS_OF_A_PLACE])
    while at:
        link = int(slots[PLACES + at - 1])
        if link & wanted:
            return at
        at = link & NEXT
    return 0


@inner
def known(number: int, slots: np.ndarray, cells: Floats) -> float:
    """Weight of a cell, or of its like at another temperature if that is larger."""
    most, alike = 0.0, OF_ONE_DIRECTION << (SERVED + number % 2)
    at = int(slots[number // CELLS_OF_A_PLACE])
    while at:
        link = int(slots[PLACES + at - 1])
        if link & alike:
            most = max(most, cells[at - 1, WEIGHT])
        at = link & NEXT
    return most


@inner
def slot_of(number: int, play: float, slots: np.ndarray, cells: Floats, taken: np.ndarray) -> int:
    """Slot of a cell, which it is given if it has none: a free one, or one that merging frees.

    ``taken`` (1,) counts the slots in use. Where a hysteresis is known (``play`` > 0), directions
    are the last to be made one; otherwise temperatures are.
    """
    slot = slot_at(number, slots) - 1
    if slot >= 0:
        return slot
    if taken[0] < SLOTS:
        slot = int(taken[0])
        taken[0] += 1
    else:
        slot = _merge(OF_LOOP if play > 0.0 else OF_DIRECTION, slots, cells)
    place, kind = number // CELLS_OF_A_PLACE, number % CELLS_OF_A_PLACE
    slots[PLACES + slot] = (1 << (SERVED + kind)) + int(slots[place])
    slots[place] = slot + 1
    return slot


@kernel
def is_coherent(slots: np.ndarray, taken: int) -> bool:
    """Whether each slot in use serves cells of one place, and no cell has two."""
    found, seen = 0, np.zeros(SLOTS, np.bool_)
    for place in range(PLACES):
        served, at = 0, int(slots[place])
        while at:
            if at > taken or seen[at - 1]:
                return False
            seen[at - 1] = True
            found += 1
            link = int(slots[PLACES + at - 1])
            if link >> SERVED == 0 or link >> SERVED & served:
                return False
            served |= link >> SERVED
            at = link & NEXT
    return found == taken


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
    """Make the two cells of a place one that cost least; give the slot set free.

    There is one, as there are more slots than places.
    """
    least, kept, freed, place = math.inf, 0, 0, 0
    for number in range(PLACES):
        if slots[number] == 0 or slots[PLACES + slots[number] - 1] & NEXT == 0:
            continue
        first = number * CELLS_OF_A_PLACE
        for i in range(first + 1, first + CELLS_OF_A_PLACE):
            other = slot_at(i, slots) - 1
            if other < 0:
                continue
            for k in range(first, i):
                one = slot_at(k, slots) - 1
                if one >= 0 and one != other:
                    cost = _cost(cells[one], cells[other], of_direction)
                    if cost < least:
                        least, kept, freed, place = cost, one, other, number
    total = cells[kept, WEIGHT] + cells[freed, WEIGHT]
    share = cells[freed, WEIGHT] / total if total > 0.0 else 0.0
    for column in range(1, cells.shape[1]):
        cells[kept, column] += (cells[freed, column] - cells[kept, column]) * share
        cells[freed, column] = 0.0
    cells[kept, WEIGHT], cells[freed, WEIGHT] = total, 0.0
    _hand_on(place, freed, kept, slots)
    return freed


@inner
def _hand_on(place: int, freed: int, kept: int, slots: np.ndarray) -> None:
    """Have the cells of a place that one slot served be served by another."""
    link, before = int(slots[PLACES + freed]), place
    while slots[before] & NEXT != freed + 1:
        before = PLACES + int(slots[before] & NEXT) - 1
    slots[before] = int(slots[before]) - (freed + 1) + (link & NEXT)
    slots[PLACES + kept] = int(slots[PLACES + kept]) | (link & ~NEXT)


@inner
def _cost(one: Floats, other: Floats, of_direction: float) -> float:
    """What is lost when two cells are made one; what was known before a change is worth little."""
    ways = (one[MEAN_T] - other[MEAN_T]) / (WARM - COLD), (one[DIRECTION] - other[DIRECTION]) / 2.0
    weights = min(one[WEIGHT], 1.0), min(other[WEIGHT], 1.0)
    cost: float = min(weights) * (ways[0] ** 2 + of_direction * ways[1] ** 2)
    return cost
