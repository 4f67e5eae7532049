"""Drift: a gain that moves slowly, and takes with it what was learnt some time ago."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from service.identification.kernels import cells as memory
from service.identification.kernels.grid import MEAN_Q, MEAN_TIME, WEIGHT
from service.identification.samples import Floats

CLEAR: Final = 4.0  # standard deviations from which on a gain moves
MOST: Final = 1e-3  # 1/s: faster is a change, not a drift


def rate(scalars: Floats) -> tuple[float, float]:
    """Share of the flow by which the map moves in a second, and its variance.

    ``β = Σ e·a·Q̂ / Σ (a·Q̂)²`` over the last samples, with e what the meter shows beyond what the
    sample's own cell remembers, and a how long ago that was, s: a misfit is the same whenever it
    comes back to its place. The variance is that of coloured noise, (1 + ρ)/(1 - ρ) times the
    white one's.
    """
    squares = float(scalars[memory.SQUARE_Q])
    if not squares > 0.0:
        return 0.0, 0.0
    rho = memory.colour(scalars)
    samples = max(float(scalars[memory.RATE_WEIGHT]), 1.0)
    variance = scalars[memory.NOISE] * (1.0 + rho) / (1.0 - rho) / (samples * squares)
    found = float(scalars[memory.ERROR_Q]) / squares
    return min(max(found, -MOST), MOST), float(variance)


def set_clock(cells: NDArray[np.float32], scalars: Floats, by: float) -> None:
    """Have the cells' times count from ``by`` s later on, and take the drift for what it is now."""
    cells[cells[:, WEIGHT] > 0.0, MEAN_TIME] -= by
    scalars[memory.REFERENCE + MEAN_TIME] -= by
    found, variance = rate(scalars)
    is_clear = found**2 > CLEAR**2 * variance
    scalars[memory.RATE] = found if is_clear else 0.0
    ages = _ages(cells.astype(np.float64))
    doubt = variance if is_clear else max(found**2 - variance, 0.0)  # what noise does not make
    weight = cells[:, WEIGHT] / max(float(cells[:, WEIGHT].sum()), 1e-30)
    scalars[memory.GAIN_VARIANCE] = doubt * float(weight @ ages**2)


def carried(points: Floats, scalars: Floats) -> Floats:
    """Points of the memory as they would be measured now."""
    points[:, MEAN_Q] *= 1.0 + scalars[memory.RATE] * _ages(points)
    return points


def _ages(points: Floats) -> Floats:
    return (-points[:, MEAN_TIME]).clip(0.0, memory.OLDEST)
