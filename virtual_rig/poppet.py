"""The balance of the Valvistor as compiled loops; symbols and equations: see ``valvistor``.

Only square roots and the four operations: the same bits on every machine, in every batch.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from virtual_rig.oil import Floats


class Numbers(NamedTuple):
    """What the compiled loops need of a valve."""

    phi: float
    K_MP: float
    K_c: float
    K_PV_stroke: float
    x_0: float
    stroke: float
    bar_per_N: float
    preload: float
    rate: float
    cos_jet: float
    pilot_jet: float
    poppet_re: float
    slot_re: float
    C_d: float
    slot_width: float
    pilot_stroke: float
    pilot_leakage: float
    seat_leakage: float


_RHO_K = 860.0  # kg/m³, the density to which the flow coefficients K belong
_NU_LEAKAGE = 46.0  # mm²/s, the viscosity to which the leakages belong
_SEAT_SINE = math.sqrt(0.5)  # gap of a 45° seat over the stroke


@numba.njit(cache=True)
def balance(
    v: Numbers,
    y: Floats,
    p1: Floats,
    p2: Floats,
    rho: Floats,
    nu: Floats,
    nu_gap: Floats,
    edge: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Q, Q_PV (l/min), x_MP (mm) and p_c (bar) at N points; every array is contiguous float64.

    ``nu`` is the viscosity in the orifices, ``nu_gap`` that in the narrow gaps where oil leaks.
    """
    n = y.size
    Q, Q_PV, x_MP, p_c = np.zeros(n), np.zeros(n), np.zeros(n), np.empty(n)
    for i in range(n):
        dp = p1[i] - p2[i]
        p_c[i] = p1[i]
        if not dp > 0.0:
            continue
        w = _balance(v, y[i], p1[i], p2[i], rho[i], nu[i], nu_gap[i], edge[i])
        x_MP[i] = min(max(w, 0.0), v.stroke)
        p_c[i] = _control_pressure(v, w, p1[i], p2[i], rho[i], nu[i], edge[i])
        Q_PV[i] = _pilot_flow(v, y[i], p_c[i] - p2[i], rho[i], nu[i], nu_gap[i])
        seat = v.seat_leakage * dp * _NU_LEAKAGE / nu_gap[i]
        Q[i] = _main_flow(v, x_MP[i], dp, rho[i], nu[i], edge[i]) + Q_PV[i] + seat  # eq. (6)
    return Q, Q_PV, x_MP, p_c


@numba.njit(cache=True)
def _orifice(
    K: float, D_h: float, re_t: float, C_d: float, dp: float, rho: float, nu: float
) -> float:
    """Flow (l/min) by C_d(Re) = C_d∞/√(1 + Re_t/Re), solved for C_d over the flow number."""
    if dp <= 0.0 or K <= 0.0:
        return 0.0
    velocity = math.sqrt(2e5 * dp / rho)  # m/s
    turbulent = K * math.sqrt(dp * _RHO_K / rho)
    if re_t == 0.0:
        return turbulent
    flow_number = 1e3 * D_h * velocity / nu  # = Re/C_d
    b = re_t / (2.0 * C_d * flow_number)
    return turbulent / (math.sqrt(1.0 + b * b) + b)  # = turbulent·(√(1 + b²) - b)


@numba.njit(cache=True)
def _slot(v: Numbers, K: float, opening: float, dp: float, rho: float, nu: float) -> float:
    """Flow (l/min) over a rectangular slot; its hydraulic diameter is 4·area/perimeter."""
    D_h = 2.0 * v.slot_width * opening / (v.slot_width + opening) if opening > 0.0 else 0.0
    return _orifice(K, D_h, v.slot_re, v.C_d, dp, rho, nu)


@numba.njit(cache=True)
def _main_flow(v: Numbers, x: float, dp: float, rho: float, nu: float, edge: float) -> float:
    """Q_MP by eq. (4)."""
    return _orifice(v.K_MP * x * edge, 2.0 * x * _SEAT_SINE, v.poppet_re, v.C_d, dp, rho, nu)


@numba.njit(cache=True)
def _pilot_flow(v: Numbers, y: float, dp: float, rho: float, nu: float, nu_gap: float) -> float:
    """Q_PV over the pilot and its clearance."""
    y_jet = y / (1.0 + v.pilot_jet * dp)
    main = _slot(v, v.K_PV_stroke * y_jet, v.pilot_stroke * y_jet, dp, rho, nu)
    return main + v.pilot_leakage * dp * _NU_LEAKAGE / nu_gap


@numba.njit(cache=True)
def _control_pressure(
    v: Numbers, w: float, p1: float, p2: float, rho: float, nu: float, edge: float
) -> float:
    """p_c on the path w: poppet pressed on its seat (w < 0), floating, at its stop (w > stroke).

    Floating, p_c follows from the balance of forces, eq. (1). On the seat it may be anything
    above that, up to p1 at w = -1; at the stop anything below, down to p2 at w = stroke + 1.
    """
    x = min(max(w, 0.0), v.stroke)
    dp = p1 - p2
    jet = v.cos_jet * _main_flow(v, x, dp, rho, nu, edge) / 6e4 * math.sqrt(2e5 * rho * dp)
    force = v.preload + v.rate * x + jet
    floating = max(p2 + dp / v.phi - force * v.bar_per_N, p2)
    if w < 0.0:
        return floating - w * (p1 - floating)
    if w > v.stroke:
        return floating - (w - v.stroke) * (floating - p2)
    return floating


@numba.njit(cache=True)
def _surplus(
    v: Numbers,
    w: float,
    y: float,
    p1: float,
    p2: float,
    rho: float,
    nu: float,
    nu_gap: float,
    edge: float,
) -> float:
    """Q_PV - Q_c on the path: falls all the way from w = -1 to w = stroke + 1, eq. (2)."""
    p_c = _control_pressure(v, w, p1, p2, rho, nu, edge)
    opening = v.x_0 + min(max(w, 0.0), v.stroke)
    return _pilot_flow(v, y, p_c - p2, rho, nu, nu_gap) - _slot(
        v, v.K_c * opening, opening, p1 - p_c, rho, nu
    )


@numba.njit(cache=True)
def _balance(
    v: Numbers, y: float, p1: float, p2: float, rho: float, nu: float, nu_gap: float, edge: float
) -> float:
    """The one root of ``_surplus``, by Ridders' method: always bracketed, square roots only."""
    low, high = -1.0, v.stroke + 1.0
    f_low = _surplus(v, low, y, p1, p2, rho, nu, nu_gap, edge)
    f_high = _surplus(v, high, y, p1, p2, rho, nu, nu_gap, edge)
    if f_low <= 0.0:
        return low
    if f_high >= 0.0:
        return high
    w = low
    for _ in range(100):
        middle = 0.5 * (low + high)
        f_middle = _surplus(v, middle, y, p1, p2, rho, nu, nu_gap, edge)
        if f_middle == 0.0:
            return middle
        previous = w
        w = middle + (middle - low) * f_middle / math.sqrt(f_middle * f_middle - f_low * f_high)
        f_w = _surplus(v, w, y, p1, p2, rho, nu, nu_gap, edge)
        if f_w == 0.0 or abs(w - previous) < 1e-13:
            return w
        if f_middle > 0.0:
            low, f_low = middle, f_middle
        else:
            high, f_high = middle, f_middle
        if f_w > 0.0 and w > low:
            low, f_low = w, f_w
        elif f_w < 0.0 and w < high:
            high, f_high = w, f_w
    return w
