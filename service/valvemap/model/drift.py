"""Drift: a gain that moves slowly, and takes with it what was learnt some time ago."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import cells as memory
from valvemap.model.kernels.grid import MEAN_Q, MEAN_TIME, WEIGHT
from valvemap.model.samples import Floats

CLEAR: Final = 4.0  # standard deviations from which on a gain moves
SURE: Final = 12.0  # ... and from which on it moves all the time: the map is made for later
LASTING: Final = 2.0  # s that a rate lasts before it is another one
LONGEST_AHEAD: Final = 30.0  # s for which a map is made for later, at most
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


def set_clock(cells: NDArray[np.float32], scalars: Floats, by: float) -> float:
    """Have the cells' times count from ``by`` s later on, and take the drift for what it is now.

    A map stands still until the next fit, in about ``by`` s: where it surely drifts it is made for
    the middle of that. Returned is how much later that is, s.
    """
    cells[cells[:, WEIGHT] > 0.0, MEAN_TIME] -= by
    scalars[memory.REFERENCE + MEAN_TIME] -= by
    found, variance = rate(scalars)
    is_clear = found**2 > CLEAR**2 * variance
    scalars[memory.RATE] = found if is_clear else 0.0
    ahead = min(by, LONGEST_AHEAD) / 2.0 if is_sure(scalars) else 0.0
    ages = _ages(cells.astype(np.float64))
    doubt = variance if is_clear else max(found**2 - variance, 0.0)  # what noise does not make
    weight = cells[:, WEIGHT] / max(float(cells[:, WEIGHT].sum()), 1e-30)
    scalars[memory.GAIN_VARIANCE] = doubt * float(weight @ ages**2) + (found * ahead) ** 2 / 3.0
    return ahead


def is_sure(scalars: Floats) -> bool:
    """Whether the map surely drifts, so that it must not stand still for long."""
    found, variance = rate(scalars)
    return bool(found**2 > SURE**2 * variance > 0.0)


def carried(points: Floats, scalars: Floats, ahead: float) -> Floats:
    """Points of the memory as they would be measured in ``ahead`` s, the older the more in doubt.

    A rate that is found now may have been another one before: a walk of steps of LASTING s.
    """
    rate_now = scalars[memory.RATE]
    if not rate_now:
        return points
    ages = _ages(points) + ahead
    points[:, MEAN_Q] *= 1.0 + rate_now * ages
    if is_sure(scalars):
        walked = rate_now**2 * LASTING * ages * points[:, MEAN_Q] ** 2
        points[:, WEIGHT] /= 1.0 + points[:, WEIGHT] * walked / max(scalars[memory.NOISE], 1e-30)
    return points


def _ages(points: Floats) -> Floats:
    return (-points[:, MEAN_TIME]).clip(0.0, memory.OLDEST)
