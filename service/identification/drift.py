"""Drift: a gain that moves slowly, and takes with it what was learnt where the valve is not now."""

from typing import Final

from service.identification.kernels import cells as memory
from service.identification.samples import Floats

CLEAR: Final = 5.0  # standard deviations from which on the gain has moved
LEAST: Final = 1e-3  # ... and share: less is a structure that does not quite fit
MOST: Final = 0.02  # share that is believed at a time


def gain(scalars: Floats) -> tuple[float, float]:
    """Share by which the map has to be raised, and its variance.

    ``γ = Σ e·Q̂ / Σ Q̂²`` over the last samples, with e what the meter shows beyond what the
    sample's own cell remembers: a misfit is the same whenever it comes back to its place. The
    variance is that of coloured noise, (1 + ρ)/(1 - ρ) times the white one's.
    """
    squares = float(scalars[memory.SQUARE_Q])
    if not squares > 0.0:
        return 0.0, 0.0
    rho = memory.colour(scalars)
    samples = max(float(scalars[memory.GAIN_WEIGHT]), 1.0)
    variance = scalars[memory.NOISE] * (1.0 + rho) / (1.0 - rho) / (samples * squares)
    found = float(scalars[memory.ERROR_Q]) / squares
    return min(max(found, -MOST), MOST), float(variance)
