"""Products of powers, point by point in fixed order."""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.samples import Floats

FACTORS = ("U", "s", "|s|", "dp", "|dp|", "T", "nu")


@kernel
def products(
    U: Floats, dp: Floats, T: Floats, exponents: np.ndarray, walther: tuple[float, float]
) -> Floats:
    """Rows (N, n): for each term the product of its :data:`FACTORS` to its ``exponents`` (n, 7)."""
    starts, places, powers = _spelt_out(exponents)
    has_viscosity = False
    for j in range(len(exponents)):
        has_viscosity |= exponents[j, 6] != 0
    rows = np.ones((len(U), len(exponents)))
    factor = np.empty(7)
    for i in range(len(U)):
        factor[0] = U[i]
        factor[2] = math.sqrt(abs(dp[i]))
        factor[1] = math.copysign(factor[2], dp[i])
        factor[3] = dp[i]
        factor[4] = abs(dp[i])
        factor[5] = T[i]
        if has_viscosity:
            factor[6] = _viscosity(T[i], walther)
        for j in range(len(exponents)):
            product = 1.0
            for q in range(starts[j], starts[j + 1]):
                x = factor[places[q]]
                product = product * x if powers[q] > 0 else product / x
            rows[i, j] = product
    return rows


@maker
def _spelt_out(exponents: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the start of each term's factors, the factors, and 1 or -1 to multiply or divide.

    Scanning the table of exponents at every point would cost more than the products.
    """
    starts = np.zeros(len(exponents) + 1, np.int64)
    q = 0
    for j in range(len(exponents)):
        for k in range(7):
            q += abs(exponents[j, k])
    places, powers = np.empty(q, np.int64), np.empty(q, np.int64)
    q = 0
    for j in range(len(exponents)):
        for k in range(7):
            for _ in range(abs(exponents[j, k])):
                places[q] = k
                powers[q] = 1 if exponents[j, k] > 0 else -1
                q += 1
        starts[j + 1] = q
    return starts, places, powers


@inner
def _viscosity(T: float, walther: tuple[float, float]) -> float:
    """Kinematic viscosity in mm²/s, ASTM D341: lg lg(nu + 0.7) = a - b·lg(T in K)."""
    a, b = walther
    if not -200.0 < T < 1000.0:
        return math.nan
    nu: float = 10.0 ** (10.0 ** (a - b * math.log10(T + 273.15))) - 0.7
    return nu
