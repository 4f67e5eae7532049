"""Hydraulic oil: viscosity, density and throttling heat.

::

    lg lg(ν + 0.7) = A - B·lg T           Walther; T in K, ν in mm²/s
    ρ(p, T) = ρ₁₅·(1 - α·(T - 15 °C))·(1 + 0.6·p/(1 + 1.7·p))        Dowson-Higginson; p in GPa
    ΔT = Δp/(ρ·c_p)                       throttling heat, about 6 K per 100 bar

The rise of viscosity with pressure is neglected (20 % per 100 bar, relevant only in laminar flow).
The throttling heat neglects the cooling by expansion, which would reduce it by about 20 %.
"""

import math

import numpy as np

from valvemap_rig import kernels
from valvemap_rig.parameters import Parameters, parameter
from valvemap_rig.records import OIL, Floats, Numbers

_TEXTBOOK = "textbook value for mineral oil"
_HLP = "own choice among HLP 46 oils"


class Oil(Parameters):
    """A mineral oil; the defaults are an HLP 46 (ISO VG 46, viscosity index near 100)."""

    nu_40_mm2_s: float = parameter(
        46.0, "mm²/s", "kinematic viscosity at 40 °C", "ISO 3448, VG 46", gt=1, le=1000
    )
    nu_100_mm2_s: float = parameter(
        6.8, "mm²/s", "kinematic viscosity at 100 °C", _HLP, gt=1, le=200
    )
    rho_15_kg_m3: float = parameter(
        875.0,
        "kg/m³",
        "density at 15 °C, no pressure",
        _HLP,
        ge=600,
        le=1300,
    )
    expansion_per_K: float = parameter(
        7.0e-4, "1/K", "thermal expansion α", _TEXTBOOK, ge=0, le=2e-3
    )
    heat_capacity_J_kg_K: float = parameter(
        1950.0,
        "J/(kg·K)",
        "specific heat c_p",
        _TEXTBOOK,
        ge=500,
        le=5000,
    )


def viscosity(oil: Oil, T: Floats) -> Floats:
    """Return the kinematic viscosity ν (mm²/s) at T (°C) by Walther's equation (ASTM D341).

    >>> viscosity(Oil(), np.array([20.0, 40.0, 100.0])).round(1)
    array([133.8,  46. ,   6.8])
    """
    return np.asarray(kernels.viscosity(*walther_constants(oil), T))


def walther_constants(oil: Oil) -> tuple[float, float]:
    """Return A and B of Walther's equation from the viscosities at 40 and 100 °C."""
    z_40, z_100 = (math.log10(math.log10(nu + 0.7)) for nu in (oil.nu_40_mm2_s, oil.nu_100_mm2_s))
    t_40, t_100 = (math.log10(celsius + 273.15) for celsius in (40.0, 100.0))
    B = (z_40 - z_100) / (t_100 - t_40)
    return z_40 + B * t_40, B


def density(oil: Oil, p: Floats, T: Floats) -> Floats:
    """Return the density ρ (kg/m³) at p (bar, gauge) and T (°C); Dowson and Higginson 1966.

    >>> density(Oil(), np.array([0.0, 200.0]), np.array([40.0, 40.0])).round(1)
    array([859.7, 869.7])
    """
    return np.asarray(kernels.density(oil.rho_15_kg_m3, oil.expansion_per_K, p, T))


def throttling_heat(oil: Oil, dp: Floats, rho: Floats) -> Floats:
    """Return the temperature rise (K) of oil of density ``rho`` at a pressure drop dp (bar).

    >>> throttling_heat(Oil(), np.array([100.0]), np.array([864.8])).round(2)
    array([5.93])
    """
    return np.asarray(kernels.throttling_heat(oil.heat_capacity_J_kg_K, dp, rho))


def numbers(oil: Oil) -> Numbers:
    """Return the parameters of the oil for the compiled loops."""
    A, B = walther_constants(oil)
    row = (A, B, oil.rho_15_kg_m3, oil.expansion_per_K, oil.heat_capacity_J_kg_K)
    return np.array([row], dtype=OIL)
