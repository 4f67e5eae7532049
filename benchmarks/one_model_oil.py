"""Rows of `benchmarks.one_model` of oils and laminar edges that are drawn by the seed.

Q = K·o(U)·(√(Δp + h²) - h) + k·Δp/ν,   h = h₄₀·ν^p,   ν by Walther, 1 for VG 46 at 40 °C
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.one_model_rows import Row
from valvemap_rig.oil import Oil, viscosity

KINDS: Final = (  # viscosity at 40 and 100 °C, mm²/s: VG 32, 46, 68, water-glycol
    *((32.0, 5.4), (46.0, 6.8)),
    *((68.0, 8.7), (46.0, 10.5)),
)
PASSES: Final = {  # samples, 100 Hz
    "up and down": 120_000,
    "up": 120_000,
    "at work": 120_000,
    "up and down in ten minutes": 60_000,
}
ASKED: Final = 22, 30, 40, 50, 60  # °C


def temperature(kind, N, rng):
    """Temperature of the oil."""
    x = np.arange(N) / N
    if kind == "up":
        return 20.0 + 40.0 * (1.0 - np.exp(-3.0 * x)) / (1.0 - np.exp(-3.0))
    if kind == "at work":  # warm soon, then it wanders by 4 °C
        walk = np.cumsum(rng.standard_normal(N // 1000 + 2))
        walk = np.interp(np.arange(N), 1000.0 * np.arange(len(walk)), walk)
        walk -= np.linspace(walk[0], walk[-1], N)
        return 22.0 + (28.0 + 4.0 * walk / walk.std()) * (1.0 - np.exp(-8.0 * x))
    return 20.0 + 40.0 * np.sin(np.pi * x) ** 2


def drawn(kind, asked, seed):
    """A valve and an oil, asked at one temperature."""
    N, rng = PASSES[kind], np.random.default_rng([seed, sorted(PASSES).index(kind)])
    at_40, at_100 = KINDS[seed % len(KINDS)]
    T = temperature(kind, N, rng)
    valve = partial(
        laminar, Oil(nu_40_mm2_s=at_40, nu_100_mm2_s=at_100), rng.uniform(2.0, 9.0),
        rng.uniform(1.0, 1.5), rng.uniform(8.0, 15.0), rng.uniform(0.2, 1.0),
        rng.choice([0.5, 1.0]), rng.choice([0.0, rng.uniform(0.002, 0.01)]),
    )  # fmt: skip
    U, dp = c.cycle(seed, N)
    samples = c.samples_of(U, dp, valve(U, dp, T) + c.white(seed, N), T)
    return Row(samples, (N,), (partial(valve, T=float(asked)),), T=float(asked))


def laminar(oil, edge, power, gain, half_40, by_nu, leakage, U, dp, T):
    """Flow behind an edge that is laminar at small Δp, and past closed lands."""
    nu = viscosity(oil, np.asarray(T, np.float64)) / 46.0
    opening, half = np.clip((U - edge) / (100.0 - edge), 0.0, 1.0) ** power, half_40 * nu**by_nu
    return gain * opening * (np.sqrt(dp + half**2) - half) + leakage * dp / nu


OILS: Final[Mapping[str, Callable[[int], Row]]] = {
    f"drawn oil {kind}, asked at {T}": partial(drawn, kind, T) for kind in PASSES for T in ASKED
}
