"""Drift: a slow change of the gain, which also affects earlier samples in the memory."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import cells as memory
from valvemap.model.kernels.grid import MEAN_Q, MEAN_TIME, WEIGHT
from valvemap.model.samples import Floats

CLEAR: Final = 4.0  # standard deviations from which a gain is drifting
SURE: Final = 12.0  # standard deviations from which the drift is steady, so that the map leads it
LASTING: Final = 2.0  # s; correlation time of the rate
LONGEST_AHEAD: Final = 30.0  # s; longest extrapolation in time
MOST: Final = 1e-3  # 1/s; faster changes are abrupt


def rate(scalars: Floats) -> tuple[float, float]:
    """Relative rate of the flow, 1/s, and its variance.

    ``β = Σ e·a·Q̂ / Σ (a·Q̂)²`` over the last samples, with e the difference between the measured
    flow and the memory of the sample's cell, and a the age of that memory, s. A structural misfit
    cancels, since it is the same at each visit of a cell. The variance is that of white noise times
    (1 + ρ)/(1 - ρ) for coloured noise.
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
    """Move the cells' time origin ``by`` s later, and set the current drift; return the lead, s.

    A map is constant until the next fit, in about ``by`` s. If it drifts steadily, it is fitted for
    the middle of that time, which is the lead.
    """
    cells[cells[:, WEIGHT] > 0.0, MEAN_TIME] -= by
    scalars[memory.REFERENCE + MEAN_TIME] -= by
    found, variance = rate(scalars)
    is_clear = found**2 > CLEAR**2 * variance
    scalars[memory.RATE] = found if is_clear else 0.0
    ahead = min(by, LONGEST_AHEAD) / 2.0 if is_sure(scalars) else 0.0
    ages = _ages(cells.astype(np.float64))
    doubt = variance if is_clear else max(found**2 - variance, 0.0)  # squared rate beyond the noise
    weight = cells[:, WEIGHT] / max(float(cells[:, WEIGHT].sum()), 1e-30)
    scalars[memory.GAIN_VARIANCE] = doubt * float(weight @ ages**2) + (found * ahead) ** 2 / 3.0
    return ahead


def is_sure(scalars: Floats) -> bool:
    """Whether the map drifts steadily, so that it must be refitted soon."""
    found, variance = rate(scalars)
    return bool(found**2 > SURE**2 * variance > 0.0)


def carried(points: Floats, scalars: Floats, ahead: float) -> Floats:
    """Return the memory's points as expected in ``ahead`` s, with variances that grow with age.

    The rate may have been different before: it is taken for a random walk with steps of LASTING s.
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
