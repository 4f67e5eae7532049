"""What the memory holds: its cells as points of a map, and from which sides U came to them."""

import numpy as np
from numpy.typing import NDArray

from service.identification.kernels.compiled import kernel
from service.identification.kernels.grid import CELLS_OF_A_PLACE, PLACES, WEIGHT, slot_at
from service.identification.samples import Floats

Cells = NDArray[np.float32]


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
