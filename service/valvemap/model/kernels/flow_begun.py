"""Cells that began while a sudden change was not excluded: it may have come before them.

A change is found where something was known before. What is first seen between a change and that is
taken for how the valve was, and would be off by the change: such cells begin again.
"""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.flow_cells import Cells

# Columns: how many cells, then the numbers of the last of them.
MANY, PLACES = 0, 24
COLUMNS = PLACES + 1

Begun = NDArray[np.int32]


@inner
def note(begun: Begun, number: int) -> None:
    """Add a cell that is about to have its first sample."""
    begun[1 + begun[MANY] % PLACES] = number
    begun[MANY] += 1


@inner
def confirm(begun: Begun, number: int) -> None:
    """Trust all of them, as a stay in this cell excludes a change, unless it is one of them."""
    for k in range(min(begun[MANY], PLACES)):
        if begun[1 + k] == number:
            return
    begun[MANY] = 0


@inner
def forget(begun: Begun, cells: Cells) -> None:
    """Empty these cells."""
    for k in range(min(begun[MANY], PLACES)):
        cells[begun[1 + k]] = 0.0
    begun[MANY] = 0
