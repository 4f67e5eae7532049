"""Coloured noise: how much less samples are worth that say the same again."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import cells as memory
from valvemap.model.kernels.grid import WEIGHT
from valvemap.model.samples import Floats

COLOURED: Final = 0.5  # correlation from which on neighbouring cells share their noise
ENOUGH: Final = 100.0  # samples from which on a correlation is believed


def reckon(cells: NDArray[np.float32], scalars: Floats) -> None:
    """Have the cells' weights stand for the correlation as it is known now; they are written.

    Before it was known, every sample counted as one of white noise.
    """
    if scalars[memory.COLOUR_WEIGHT] < ENOUGH:
        return
    rho = memory.colour(scalars)
    cells[:, WEIGHT] *= np.float32(_worth(rho, scalars) / _worth(scalars[memory.RECKONED], scalars))
    scalars[memory.RECKONED] = rho


def least_variance(scalars: Floats) -> float:
    """Variance of noise that neighbouring cells share, (l/min)²; 0 where they do not."""
    return float(scalars[memory.POWER]) if scalars[memory.RECKONED] > COLOURED else 0.0


def _worth(rho: float, scalars: Floats) -> float:
    again = rho * scalars[memory.STEADY]
    return float((1.0 - again) / (1.0 + again))
