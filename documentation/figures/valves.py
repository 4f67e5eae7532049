"""Valves of the figures: flow maps, and samples of them with the noise of a flow meter."""

from collections.abc import Callable
from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Samples

SIGMA: Final = 0.4  # l/min: noise of the flow meter
PERIOD: Final = 10_000_000  # ns: 100 Hz
T_OIL: Final = 40.0  # °C
FULL: Final = 14.0  # l/min per √bar, of the open valve
Flow = Callable[[Floats, Floats], Floats]


def even(U: Floats, dp: Floats) -> Floats:
    """Flow of a valve that eq. (7) describes, l/min.

    >>> even(np.array([50.0]), np.array([100.0]))
    array([70.])
    """
    return FULL * U / 100.0 * np.sqrt(dp)


def dead_band(U: Floats, dp: Floats) -> Floats:
    """Flow of a valve with a dead band up to 8 % and saturation from 90 %, l/min."""
    return FULL * np.clip((U - 8.0) / 82.0, 0.0, 1.0) * np.sqrt(dp)


def s_shape(U: Floats, dp: Floats) -> Floats:
    """Flow of a valve whose edge opens and closes softly, l/min."""
    u = U / 100.0
    return FULL * u**2 * (3.0 - 2.0 * u) * np.sqrt(dp)


def at(flow: Flow, U: Floats, dp: Floats, seed: int = 0, sigma: float = SIGMA) -> Samples:
    """Return samples of a valve at given points, 100 Hz."""
    noise = np.random.default_rng(seed).normal(0.0, sigma, len(U))
    t = np.arange(len(U)) * PERIOD
    return Samples.of(t, U, dp, 0.0 * dp, flow(U, dp) + noise, T_OIL + 0.0 * U)


def scattered(
    N: int,
    flow: Flow,
    U: tuple[float, float] = (0.0, 100.0),
    dp: tuple[float, float] = (2.0, 200.0),
    seed: int = 0,
) -> Samples:
    """Return samples anywhere in a region of U (%) and dp (bar)."""
    rng = np.random.default_rng([seed, 1])
    return at(flow, rng.uniform(*U, N), rng.uniform(*dp, N), seed)


def sorted_levels(flow: Flow, levels: int = 11, of_each: int = 500, seed: int = 0) -> Samples:
    """Return structured samples: U rises step by step, at each the load varies."""
    U = np.repeat(np.linspace(0.0, 100.0, levels), of_each)
    dp = np.random.default_rng([seed, 2]).uniform(2.0, 200.0, len(U))
    return at(flow, U, dp, seed)


def sweeps(N: int, flow: Flow, seed: int = 0) -> Samples:
    """Return slow sweeps: from sample to sample the flow hardly changes."""
    n = np.arange(N)
    U = 50.0 + 49.0 * np.sin(2.0 * np.pi * n / 2_300.0)
    dp = 100.0 + 90.0 * np.sin(2.0 * np.pi * n / 730.0)
    return at(flow, U, dp, seed)


def warm(points: Floats) -> Floats:
    """Return the oil temperature at N points, °C."""
    return np.full(points.shape, T_OIL)
