"""The Valvistor: a seat valve whose main poppet amplifies the flow of a small pilot valve.

Oil enters the control chamber (pressure p_c) through a slot in the main poppet that opens with its
stroke, and leaves it through the pilot valve. The pilot thus sets the stroke at which both flows
are equal. Numbers in brackets are the paper's equations, with corrected right-hand sides::

    (1)  p_c - p₂ = Δp/φ - (F_spring + F_flow)/(A₁ + A₂)          balance of forces
         F_spring = F₀ + k·x_MP
         F_flow   = cos ε · Q_MP·√(2·ρ·Δp)                        momentum of the jet, closes
    (2)  Q_c  = K_c·(x₀ + x_MP)·√(p₁ - p_c) = Q_PV                slot in the poppet
         Q_PV = K_PV·x_PV·√(p_c - p₂) + leakage                   pilot valve
         x_PV = y·s_PV/(1 + κ·(p_c - p₂))                         its magnet works against the jet
    (4)  Q_MP = K_MP·x_MP·√Δp                                     main poppet
    (6)  Q_T  = Q_MP + Q_PV + seat leakage

(3) and (5) follow from these without springs, jet forces and viscous friction:
x_MP = (Q_PV/K_c)·√(φ/((φ-1)·Δp)) - x₀ = K_PV·x_PV/(K_c·√(φ-1)) - x₀, which no longer depends
on Δp. On its seat (x_MP = 0) and at its stop the balance (1) does not hold: the stop carries the
rest of the force, and pilot and slot are merely in series.

Every orifice obeys C_d(Re) = C_d∞/√(1 + Re_t/Re): turbulent √Δp far above the transition number
Re_t, laminar (C_d ∝ √Re, flow ∝ Δp/ν) far below.

The curves deviate from √Δp because of forces that do not scale with Δp: the springs of poppet and
pilot, the magnet, and viscous friction. A jet force ∝ x·Δp alone would not cause a deviation, as
all other terms in (1) and (2) scale with Δp, too.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from valvemap_rig import kernels
from valvemap_rig.oil import Oil
from valvemap_rig.oil import numbers as oil_numbers
from valvemap_rig.parameters import Parameters, parameter
from valvemap_rig.records import VALVE, Floats, Numbers

_PAPER = "paper, nomenclature; size: own choice for 200 l/min near 80 bar"
_MERRITT = "Merritt 1967, Hydraulic Control Systems, ch. 3"
_DESIGN = "own choice for a seat valve of this size"


class Valvistor(Parameters):
    """Data sheet of one valve; the defaults are a valve of about 200 l/min at 100 % and 80 bar."""

    phi: float = parameter(
        2.0, "1", "area ratio φ = (A₁ + A₂)/A₁", "paper, eq. (1)", gt=1.05, le=10
    )
    K_MP: float = parameter(
        6.0, "l/(min·√bar·mm)", "flow coefficient of the main poppet", _PAPER, gt=0, le=100
    )
    K_c: float = parameter(
        0.3, "l/(min·√bar·mm)", "flow coefficient of the slot in the poppet", _PAPER, gt=0, le=10
    )
    K_PV: float = parameter(
        1.0, "l/(min·√bar·mm)", "flow coefficient of the pilot valve", _PAPER, gt=0, le=20
    )
    x_0_mm: float = parameter(
        0.15,
        "mm",
        "negative overlap x₀ of the slot",
        "paper, eq. (2); size: own choice",
        ge=0,
        le=2,
    )
    stroke_mm: float = parameter(
        4.0, "mm", "stroke of the poppet to its stop", _DESIGN, gt=0, le=50
    )
    pilot_stroke_mm: float = parameter(
        1.35, "mm", "stroke s_PV of the pilot at full signal, no jet", _DESIGN, gt=0, le=20
    )
    poppet_area_mm2: float = parameter(
        982.0, "mm²", "A₁ + A₂, here twice a seat of 25 mm", _DESIGN, gt=1, le=1e5
    )
    spring_preload_N: float = parameter(
        20.0, "N", "force F₀ of the spring on the closed poppet", _DESIGN, ge=0, le=1e4
    )
    spring_rate_N_mm: float = parameter(
        5.0, "N/mm", "rate k of the poppet's spring", _DESIGN, ge=0, le=1e4
    )
    jet_angle_deg: float = parameter(
        45.0, "°", "angle ε of the jet; 90 = no flow force", "the seat's cone, 45°", ge=0, le=90
    )
    pilot_jet_per_bar: float = parameter(
        6.0e-4,
        "1/bar",
        "closing of the pilot by its jet, κ",
        "own choice: 6 % at full drop",
        ge=0,
        le=2e-3,
    )
    dead_band_percent: float = parameter(
        2.5, "%", "signal at which the pilot begins to open", _DESIGN, ge=0, le=50
    )
    saturation_percent: float = parameter(
        98.0, "%", "signal at which the pilot is fully open", _DESIGN, gt=50, le=100
    )
    hysteresis_percent: float = parameter(
        0.4,
        "%",
        "width of the loop between rising and falling signal; 0 = none",
        "own choice: the paper's valve has little",
        ge=0,
        le=20,
    )
    pilot_lag_s: float = parameter(
        0.0,
        "s",
        "time constant of the pilot; 0 = steady state in every sample",
        "own choice: quasi-static data",
        ge=0,
        le=10,
    )
    spool_hz: float = parameter(
        0.0,
        "Hz",
        "natural frequency of the spool; 0 = it follows at once",
        "own choice: quasi-static data",
        ge=0,
        le=500,
    )
    spool_damping: float = parameter(
        0.7, "1", "damping ratio of the spool", "own choice: little overshoot", ge=0.05, le=5
    )
    poppet_transition_re: float = parameter(
        30.0,
        "1",
        "Re_t of the main poppet (chamfered seat)",
        "own choice above the sharp slit's",
        ge=0,
        le=5000,
    )
    slot_transition_re: float = parameter(
        15.0,
        "1",
        "Re_t of slot and pilot: (0.611/0.157)²",
        "sharp slit, " + _MERRITT,
        ge=0,
        le=5000,
    )
    discharge_coefficient: float = parameter(
        0.61, "1", "C_d∞, relates flow number and Re", "sharp edge, " + _MERRITT, gt=0.1, le=1
    )
    pilot_leakage_l_min_bar: float = parameter(
        6.0e-4,
        "l/(min·bar)",
        "leakage of the closed pilot per bar at 46 mm²/s",
        _DESIGN,
        ge=0,
        le=0.1,
    )
    seat_leakage_l_min_bar: float = parameter(
        3.0e-4, "l/(min·bar)", "leakage of the main seat per bar at 46 mm²/s", _DESIGN, ge=0, le=0.1
    )


class PoppetState(NamedTuple):
    """State of the valve at N points, all arrays of shape (N,).

    ``Q`` is the total flow at p1 and T (l/min), ``Q_PV`` the pilot's part of it,
    ``x_MP`` the poppet's stroke (mm), ``p_c`` the pressure in the control chamber (bar).
    """

    Q: Floats
    Q_PV: Floats
    x_MP: Floats
    p_c: Floats


def pilot_opening(valve: Valvistor, U: Floats) -> Floats:
    """Return the pilot's opening y (0 … 1) at signal U (%): dead band, line, saturation.

    >>> pilot_opening(Valvistor(), np.array([0.0, 2.5, 50.25, 98.0, 100.0]))
    array([0. , 0. , 0.5, 1. , 1. ])
    """
    span = valve.saturation_percent - valve.dead_band_percent
    return np.clip((U - valve.dead_band_percent) / span, 0.0, 1.0)


def poppet_state(
    valve: Valvistor,
    oil: Oil,
    y: Floats,
    p1: Floats,
    p2: Floats,
    T: Floats,
    edge: Floats,
    gap: ArrayLike = 0.0,
) -> PoppetState:
    """Return the equilibrium of the valve at N points.

    Parameters
    ----------
    y : (N,) array
        Opening of the pilot, 0 … 1.
    p1, p2 : (N,) arrays
        Pressures upstream and downstream of the valve, bar; no flow if p2 >= p1.
    T : (N,) array
        Oil temperature at the inlet, °C.
    edge : (N,) array
        Flow coefficient of the main edge relative to the new valve (wear > 1).
    gap : (N,) array
        Flow coefficient of a gap worn into the main edge, l/min per √bar: open at any stroke.

    Examples
    --------
    >>> one = np.ones(1)
    >>> state = poppet_state(Valvistor(), Oil(), one, 200 * one, 120 * one, 40 * one, one)
    >>> state.Q.round(0), state.x_MP.round(1)
    (array([217.]), array([3.9]))
    """
    columns = [
        np.array(column, dtype=np.float64, order="C")
        for column in np.broadcast_arrays(y, p1, p2, T, edge, gap)
    ]
    return PoppetState(*kernels.balance(numbers(valve), oil_numbers(oil), *columns))


def numbers(valve: Valvistor) -> Numbers:
    """Return the parameters of a valve for the compiled loops; K defines the slots' widths."""
    K_per_mm = 0.06 * valve.discharge_coefficient * math.sqrt(2e5 / kernels.RHO_K)
    row = (
        valve.phi,
        valve.K_MP,
        valve.K_c,
        valve.K_PV,
        valve.x_0_mm,
        valve.stroke_mm,
        10.0 / valve.poppet_area_mm2,
        valve.spring_preload_N,
        valve.spring_rate_N_mm,
        math.cos(math.radians(valve.jet_angle_deg)) if valve.jet_angle_deg < 90 else 0.0,
        valve.pilot_jet_per_bar,
        valve.poppet_transition_re,
        valve.slot_transition_re,
        valve.discharge_coefficient,
        valve.K_c / K_per_mm,
        valve.K_PV / K_per_mm,
        valve.pilot_stroke_mm,
        valve.pilot_leakage_l_min_bar,
        valve.seat_leakage_l_min_bar,
    )
    return np.array([row], dtype=VALVE)
