"""Coloured noise: effective weight of correlated samples."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import cells as memory
from valvemap.model.kernels.grid import WEIGHT
from valvemap.model.samples import Floats

COLOURED: Final = 0.5  # correlation from which neighbouring cells share their noise
ENOUGH: Final = 100.0  # samples from which the estimated correlation is used


def reckon(cells: NDArray[np.float32], scalars: Floats) -> None:
    """Rescale the cells' weights, in place, to the current estimate of the correlation.

    Before the first estimate, samples are weighted as in white noise.
    """
    if scalars[memory.COLOUR_WEIGHT] < ENOUGH:
        return
    rho = memory.colour(scalars)
    cells[:, WEIGHT] *= np.float32(_worth(rho, scalars) / _worth(scalars[memory.RECKONED], scalars))
    scalars[memory.RECKONED] = rho


def least_variance(scalars: Floats) -> float:
    """Variance of the noise that neighbouring cells share, (l/min)²; 0 if it is not shared."""
    return float(scalars[memory.POWER]) if scalars[memory.RECKONED] > COLOURED else 0.0


def _worth(rho: float, scalars: Floats) -> float:
    again = rho * scalars[memory.STEADY]
    return float((1.0 - again) / (1.0 + again))
