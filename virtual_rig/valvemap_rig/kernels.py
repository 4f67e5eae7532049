"""The rig's equations as compiled loops; symbols and sources: ``oil``, ``valvistor``, ``circuit``.

They are in one file because numba's cache does not detect changes of kernels in other files. Every
value depends only on its arguments, by operations in fixed order, so the result is the same bit for
bit in any block.
"""

import math

import numba
import numpy as np

from valvemap_rig.records import Floats, N, Numbers, Point, Record, Setting

RHO_K = 860.0  # kg/m³, the density to which the flow coefficients K belong
NU_LEAKAGE = 46.0  # mm²/s, the viscosity to which the leakages belong
SEAT_SINE = math.sqrt(0.5)  # gap of a 45° seat over the stroke

ROOT_BAR = 1e-10  # absolute tolerance of a root in p1, bar …
ROOT_SHARE = 4.0 * float(np.finfo(np.float64).eps)  # … and relative tolerance
MOST_STEPS = 1000  # iterations of a root search; about 12 are usual, bisection takes 60


@numba.njit(cache=True)
def balance(
    valve: Numbers,
    oil: Numbers,
    y: Floats,
    p1: Floats,
    p2: Floats,
    T: Floats,
    edge: Floats,
    gap: Floats,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return Q, Q_PV (l/min), x_MP (mm) and p_c (bar) of the valve at N points."""
    n = y.size
    Q, Q_PV, x_MP, p_c = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        Q[i], Q_PV[i], x_MP[i], p_c[i] = _valve(
            valve[0], oil[0], y[i], p1[i], p2[i], T[i], edge[i], gap[i]
        )
    return Q, Q_PV, x_MP, p_c


@numba.njit(cache=True)
def excess(p1: N, valve: Numbers, oil: Numbers, circuit: Numbers, at: Setting) -> N:
    """Return the valve's flow minus the supply's flow at p1, l/min at tank pressure.

    It increases with p1, from -Q_pump at 0 bar to the valve's flow at p0.
    """
    o, c = oil[0], circuit[0]
    p2 = load_pressure(circuit, p1, at.p2_set)
    Q, _, _, _ = _valve(valve[0], o, at.y, p1, p2, at.T, at.edge, at.gap)
    return Q * compression(p1) - c.Q_pump * supply_share(circuit, p1)


@numba.njit(cache=True)
def settled(
    valve: Numbers, oil: Numbers, circuit: Numbers, points: Setting
) -> tuple[Floats, Floats]:
    """Return p1 and p2 (bar) at which the valve's flow equals the supply's, at N points."""
    n, c = points.y.size, circuit[0]
    p1, p2 = np.empty(n), np.empty(n)
    shut = c.p0 - c.override
    for i in range(n):
        y, p2_set, T = points.y[i], points.p2_set[i], points.T[i]
        at = Setting(y, p2_set, T, points.edge[i], points.gap[i])
        # If the valve takes more than the pump's flow with the relief valve closed, p1 is lower.
        if excess(shut, valve, oil, circuit, at) > 0:
            p1[i] = _supply_pressure(0.0, shut, valve, oil, circuit, at)
        else:
            p1[i] = _supply_pressure(shut, c.p0, valve, oil, circuit, at)
        p2[i] = load_pressure(circuit, p1[i], p2_set)
    return p1, p2


@numba.njit(cache=True)
def _supply_pressure(
    low: N, high: N, valve: Numbers, oil: Numbers, circuit: Numbers, at: Setting
) -> N:
    """Return the root of `excess` between two pressures by Brent's method (1973, ch. 4), or NaN.

    ``b`` is the best point, ``a`` the one before it, ``c`` the other end of the bracket.
    """
    a, b, c = low, high, 0.0
    f_a = excess(a, valve, oil, circuit, at)
    f_b = excess(b, valve, oil, circuit, at)
    f_c = 0.0
    if f_a == 0.0:
        return a
    if not f_a * f_b <= 0.0:
        return math.nan
    before = step = 0.0
    for _ in range(MOST_STEPS):
        if f_a != 0.0 and f_b != 0.0 and (f_a < 0.0) != (f_b < 0.0):
            c, f_c = a, f_a
            before = step = b - a
        if abs(f_c) < abs(f_b):
            a, b, c = b, c, b
            f_a, f_b, f_c = f_b, f_c, f_b
        delta = (ROOT_BAR + ROOT_SHARE * abs(b)) / 2.0
        half = (c - b) / 2.0
        if f_b == 0.0 or abs(half) < delta:
            return b
        trial = math.inf
        if abs(before) > delta and abs(f_b) < abs(f_a):
            trial = _trial(a, b, c, f_a, f_b, f_c)
        if 2.0 * abs(trial) < min(abs(before), 3.0 * abs(half) - delta):
            before, step = step, trial
        else:
            before = step = half
        a, f_a = b, f_b
        b += step if abs(step) > delta else math.copysign(delta, half)
        f_b = excess(b, valve, oil, circuit, at)
    return math.nan


@numba.njit(cache=True)
def _trial(a: N, b: N, c: N, f_a: N, f_b: N, f_c: N) -> N:
    """Return the step from b to the zero of a secant or inverse parabola; infinity if none."""
    if a == c:
        return -f_b * (b - a) / (f_b - f_a)
    to_a, to_c = (f_a - f_b) / (a - b), (f_c - f_b) / (c - b)
    slope = to_c * to_a * (f_c - f_a)
    return -f_b * (f_c * to_c - f_a * to_a) / slope if slope != 0.0 else math.inf


@numba.njit(cache=True)
def supply_share(circuit: Numbers, p1: N) -> N:
    """Return the share of the pump's flow that does not pass the relief valve at p1."""
    c = circuit[0]
    return min(max((c.p0 - p1) / c.override, 0.0), 1.0)


@numba.njit(cache=True)
def load_pressure(circuit: Numbers, p1: N, p2_set: N) -> N:
    """Return p2: the set point, at least the load valve's own pressure, at most p1."""
    c = circuit[0]
    share = supply_share(circuit, p1)
    return min(max(p2_set, c.load_minimum + c.load_resistance * share * share), p1)


@numba.njit(cache=True)
def viscosity(A: N, B: N, T: N) -> N:
    """Return ν (mm²/s) at T (°C) by Walther."""
    return 10.0 ** (10.0 ** (A - B * np.log10(T + 273.15))) - 0.7


@numba.njit(cache=True)
def compression(p: N) -> N:
    """Return the density at p (bar) relative to p = 0, by Dowson and Higginson."""
    p_GPa = 1e-4 * p
    return 1.0 + 0.6 * p_GPa / (1.0 + 1.7 * p_GPa)


@numba.njit(cache=True)
def density(rho_15: N, expansion: N, p: N, T: N) -> N:
    """Return ρ (kg/m³) at p (bar) and T (°C)."""
    return rho_15 * (1.0 - expansion * (T - 15.0)) * compression(p)


@numba.njit(cache=True)
def throttling_heat(heat_capacity: N, dp: N, rho: N) -> N:
    """Return the rise of temperature (K) across a throttle with pressure drop dp (bar)."""
    return dp * 1e5 / (rho * heat_capacity)


@numba.njit(cache=True)
def _valve(v: Record, o: Record, y: N, p1: N, p2: N, T: N, edge: N, gap: N) -> tuple[N, N, N, N]:
    dp = p1 - p2
    if not dp > 0.0:
        return 0.0, 0.0, 0.0, p1
    rho = density(o.rho_15, o.expansion, p1, T)
    nu = viscosity(o.A, o.B, T)
    T_gap = T + 0.5 * throttling_heat(o.heat_capacity, dp, rho)
    nu_gap = viscosity(o.A, o.B, T_gap)
    at = Point(y, p1, p2, rho, nu, nu_gap, edge)
    w = _position(v, at)
    x_MP = min(max(w, 0.0), v.stroke)
    p_c = _control_pressure(v, w, at)
    Q_PV = _pilot_flow(v, p_c, at)
    seat = v.seat_leakage * dp * NU_LEAKAGE / nu_gap
    worn = gap * math.sqrt(dp * RHO_K / rho)  # turbulent, and open at any stroke
    Q = _main_flow(v, x_MP, at) + Q_PV + seat + worn  # eq. (6)
    return Q, Q_PV, x_MP, p_c


@numba.njit(cache=True)
def _position(v: Record, at: Point) -> N:
    """Return the unique root of ``_surplus``, in the region of the three where its sign changes."""
    f_seat, f_stop = _surplus(v, 0.0, at), _surplus(v, v.stroke, at)
    if f_seat <= 0.0:  # the pilot flow is too small to lift the poppet off its seat
        low, high, f_high = -1.0, 0.0, f_seat
        f_low = _surplus(v, low, at)
    elif f_stop >= 0.0:  # the pilot flow holds the poppet at its stop
        low, high, f_low = v.stroke, v.stroke + 1.0, f_stop
        f_high = _surplus(v, high, at)
    else:
        low, high, f_low, f_high = 0.0, v.stroke, f_seat, f_stop
    if f_low <= 0.0:
        return low
    if f_high >= 0.0:
        return high
    return _root(v, low, high, f_low, f_high, at)


@numba.njit(cache=True)
def _root(v: Record, low: N, high: N, f_low: N, f_high: N, at: Point) -> N:
    """Return a root by Ridders' method, from a bracket with a change of sign."""
    w = low
    for _ in range(100):
        middle = 0.5 * (low + high)
        f_middle = _surplus(v, middle, at)
        if f_middle == 0.0:
            return middle
        previous = w
        w = middle + (middle - low) * f_middle / math.sqrt(f_middle * f_middle - f_low * f_high)
        f_w = _surplus(v, w, at)
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


@numba.njit(cache=True)
def _surplus(v: Record, w: N, at: Point) -> N:
    """Return Q_PV - Q_c, eq. (2); it decreases from w = -1 to w = stroke + 1."""
    p_c = _control_pressure(v, w, at)
    opening = v.x_0 + min(max(w, 0.0), v.stroke)
    into_chamber = _slot(v, v.K_c, v.slot_width, opening, at.p1 - p_c, at.rho, at.nu)
    return _pilot_flow(v, p_c, at) - into_chamber


@numba.njit(cache=True)
def _control_pressure(v: Record, w: N, at: Point) -> N:
    """Return p_c at w: poppet on its seat (w < 0), floating, or at its stop (w > stroke).

    Floating, p_c follows from the balance of forces, eq. (1). On the seat it is higher, up to p1 at
    w = -1; at the stop it is lower, down to p2 at w = stroke + 1.
    """
    x = min(max(w, 0.0), v.stroke)
    dp = at.p1 - at.p2
    jet = v.cos_jet * _main_flow(v, x, at) / 6e4 * math.sqrt(2e5 * at.rho * dp)
    force = v.preload + v.rate * x + jet
    floating = max(at.p2 + dp / v.phi - force * v.bar_per_N, at.p2)
    if w < 0.0:
        return floating - w * (at.p1 - floating)
    if w > v.stroke:
        return floating - (w - v.stroke) * (floating - at.p2)
    return floating


@numba.njit(cache=True)
def _main_flow(v: Record, x: N, at: Point) -> N:
    """Return Q_MP at a stroke x (mm), eq. (4)."""
    K, D_h, dp = v.K_MP * x * at.edge, 2.0 * x * SEAT_SINE, at.p1 - at.p2
    return _orifice(K, D_h, v.poppet_re, v.C_d, dp, at.rho, at.nu)


@numba.njit(cache=True)
def _pilot_flow(v: Record, p_c: N, at: Point) -> N:
    """Return Q_PV through the pilot and its gap, from p_c to p2."""
    dp = p_c - at.p2
    x_PV = v.pilot_stroke * at.y / (1.0 + v.pilot_jet * dp)
    return (
        _slot(v, v.K_PV, v.pilot_width, x_PV, dp, at.rho, at.nu)
        + v.pilot_leakage * dp * NU_LEAKAGE / at.nu_gap
    )


@numba.njit(cache=True)
def _slot(v: Record, K: N, width: N, opening: N, dp: N, rho: N, nu: N) -> N:
    """Return the flow (l/min) through a rectangular slot with D_h = 4·area/perimeter."""
    if opening <= 0.0:
        return 0.0
    D_h = 2.0 * width * opening / (width + opening)
    return _orifice(K * opening, D_h, v.slot_re, v.C_d, dp, rho, nu)


@numba.njit(cache=True)
def _orifice(K: N, D_h: N, re_t: N, C_d: N, dp: N, rho: N, nu: N) -> N:
    """Return the flow (l/min) by C_d(Re) = C_d∞/√(1 + Re_t/Re), solved by the flow number."""
    if dp <= 0.0 or K <= 0.0:
        return 0.0
    turbulent = K * math.sqrt(dp * RHO_K / rho)
    if re_t == 0.0:
        return turbulent
    flow_number = 1e3 * D_h * math.sqrt(2e5 * dp / rho) / nu  # = Re/C_d
    b = re_t / (2.0 * C_d * flow_number)
    return turbulent / (math.sqrt(1.0 + b * b) + b)  # = turbulent·(√(1 + b²) - b)
