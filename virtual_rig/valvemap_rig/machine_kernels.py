"""The equations of a machine as a compiled loop; symbols and sources: ``directional``, ``machine``.

Between two samples the states follow Runge-Kutta's method of 4th order at `STEP_S`. The stiffest
part, a throttle near zero pressure drop on a small volume, has a rate of about 5,000 1/s: the
method is stable up to 2.78/STEP_S = 13,900 1/s.
"""

import math
from typing import Final

import numba
import numpy as np

from valvemap_rig.records import Floats, N, Numbers, Record

STEP_S: Final = 2e-4  # s; see above
DROP_BAR: Final = 0.05  # bar; below it a throttle is laminar, so that Q(dp) has a finite slope
EDGES: Final = ("PA", "AT", "PB", "BT")
STATES: Final = ("spool", "spool_speed", "x", "v", "pA", "pB", "pS", "pT", "play", "integral")
CONDITIONS: Final = ("PA", "AT", "PB", "BT", "leakage", "air", "supply", "friction", "load")

DIRECTIONAL = np.dtype(
    [(f"{name}_{edge}", np.float64) for edge in EDGES for name in ("K", "overlap", "linear", "n")]
    + [(name, np.float64) for name in ("half_play", "omega", "zeta", "slew", "leakage")]
)
MACHINE = np.dtype(
    [
        (name, np.float64)
        for name in (
            "A_A",
            "A_B",
            "stroke",
            "dead_A",
            "dead_B",
            "beta",
            "air",
            "leakage",
            "mass",
            "viscous",
            "coulomb",
            "stribeck",
            "stop",
            "p0",
            "Q_pump",
            "droop",
            "supply_volume",
            "tank",
            "tank_resistance",
            "k_p",
            "k_i",
            "band",
        )
    ]
)

_LITRE = 1.0 / 60.0  # l/s per l/min
_STRIBECK_M_S = 0.02  # m/s; speed at which the static part of the friction has fallen to 1/e
_STICK_M_S = 0.002  # m/s; below it friction is viscous, so that it has a finite slope
_ABSOLUTE_BAR = 1.013  # bar; the gauges' zero
_LEAST_BAR = 0.02  # bar absolute; vapour
_STOP_DAMPING = 2e4  # N/(m/s) of an end stop


@numba.njit(cache=True)
def opening(K: N, overlap: N, linear: N, n: N, signal: N) -> N:
    """Return the flow coefficient (l/min/√bar) of an edge at its own signal ≥ 0 (%)."""
    if signal <= overlap:
        return 0.0
    u = min((signal - overlap) / (100.0 - overlap), 1.0)
    return K * (linear * u + (1.0 - linear) * u**n)


@numba.njit(cache=True)
def throttle(K: N, dp: N) -> N:
    """Return the flow K·√dp of either sign, laminar near zero."""
    return K * dp / math.sqrt(math.sqrt(dp * dp + DROP_BAR * DROP_BAR))


@numba.njit(cache=True)
def edge_flows(v: Record, c: Floats, spool: N, pS: N, pT: N, pA: N, pB: N) -> tuple[N, N, N, N]:
    """Return the flows PA, AT, PB, BT (l/min) in the direction of their names."""
    return (
        throttle(c[0] * opening(v.K_PA, v.overlap_PA, v.linear_PA, v.n_PA, spool), pS - pA),
        throttle(c[1] * opening(v.K_AT, v.overlap_AT, v.linear_AT, v.n_AT, -spool), pA - pT),
        throttle(c[2] * opening(v.K_PB, v.overlap_PB, v.linear_PB, v.n_PB, -spool), pS - pB),
        throttle(c[3] * opening(v.K_BT, v.overlap_BT, v.linear_BT, v.n_BT, spool), pB - pT),
    )


@numba.njit(cache=True)
def _rates(y: Floats, dy: Floats, v: Record, m: Record, c: Floats, U: N, load: N, nu: N) -> None:
    """Write the derivatives of the eight mechanical and hydraulic states, per second."""
    spool, speed, x, velocity = y[0], y[1], y[2], y[3]
    pA, pB, pS, pT = y[4], y[5], y[6], y[7]
    dy[0] = min(max(speed, -v.slew), v.slew)
    dy[1] = v.omega * v.omega * (U - spool) - 2.0 * v.zeta * v.omega * speed
    if abs(speed) > v.slew and dy[1] * speed > 0.0:
        dy[1] = 0.0
    PA, AT, PB, BT = edge_flows(v, c, spool, pS, pT, pA, pB)
    spool_gap = v.leakage * (pA - pB) * nu
    piston_gap = m.leakage * c[4] * (pA - pB) * nu
    Q_A = PA - AT - spool_gap - piston_gap
    Q_B = PB - BT + spool_gap + piston_gap
    V_A = m.dead_A + 0.1 * m.A_A * x  # l, with cm² and m
    V_B = m.dead_B + 0.1 * m.A_B * (m.stroke - x)
    dy[4] = (Q_A - 6.0 * m.A_A * velocity) * _LITRE / (V_A * _compliance(m, c[5], pA))
    dy[5] = (Q_B + 6.0 * m.A_B * velocity) * _LITRE / (V_B * _compliance(m, c[5], pB))
    force = 10.0 * (m.A_A * pA - m.A_B * pB) - load * c[8]
    static = m.coulomb + m.stribeck * math.exp(-((velocity / _STRIBECK_M_S) ** 2))
    force -= c[7] * (static * math.tanh(velocity / _STICK_M_S) + m.viscous * velocity)
    if x < 0.0:
        force += -m.stop * x - _STOP_DAMPING * min(velocity, 0.0)
    elif x > m.stroke:
        force -= m.stop * (x - m.stroke) + _STOP_DAMPING * max(velocity, 0.0)
    dy[2] = velocity
    dy[3] = force / m.mass
    supplied = min(max((m.p0 * c[6] - pS) / m.droop, -1.0), 1.0) * m.Q_pump
    dy[6] = (supplied - PA - PB) * _LITRE * m.beta / m.supply_volume
    drained = (pT - m.tank) / m.tank_resistance
    dy[7] = (AT + BT - drained) * _LITRE * m.beta / m.supply_volume


@numba.njit(cache=True)
def _compliance(m: Record, air: N, p: N) -> N:
    """Return 1/β of oil, hose and free air at p (bar gauge), 1/bar."""
    absolute = max(p + _ABSOLUTE_BAR, _LEAST_BAR)
    return 1.0 / m.beta + (m.air + air) * _ABSOLUTE_BAR / (absolute * absolute)


@numba.njit(cache=True)
def play_through(
    valve: Numbers,
    machine: Numbers,
    state: Floats,
    x_set: Floats,
    lead: Floats,
    load: Floats,
    conditions: Floats,
    thinness: Floats,
    period: float,
    closed_loop: bool,  # noqa: FBT001 - of a compiled loop
) -> tuple[Floats, Floats, Floats]:
    """Return the states at N samples, the commands given at them (%), and Q_A, Q_B (N, 2).

    Parameters
    ----------
    state
        The ``STATES`` at the next sample; it is advanced in place.
    x_set
        Set position (m), used in closed loop.
    lead
        Command (%) added to the controller's, or the whole command in open loop.
    load
        Force against extension (N); ``thinness`` the leakage's factor of viscosity.
    conditions
        ``CONDITIONS`` at each sample, (N, 9).
    """
    v, m = valve[0], machine[0]
    count = lead.size
    states, U, Q = np.empty((count, state.size)), np.empty(count), np.empty((count, 2))
    steps = max(1, math.ceil(period / STEP_S))
    h = period / steps
    k1, k2, k3, k4, z = (np.empty(8), np.empty(8), np.empty(8), np.empty(8), np.empty(8))
    for i in range(count):
        c = conditions[i]
        states[i] = state
        pA, pB = state[4], state[5]
        PA, AT, PB, BT = edge_flows(v, c, state[0], state[6], state[7], pA, pB)
        gap = v.leakage * (pA - pB) * thinness[i]
        Q[i, 0] = PA - AT - gap
        Q[i, 1] = PB - BT + gap
        command = lead[i]
        if closed_loop:
            error = 1e3 * (x_set[i] - state[2])  # mm
            if abs(error) > m.band:
                state[9] = min(max(state[9] + m.k_i * error * period, -30.0), 30.0)
            command += m.k_p * error + state[9]
        command = min(max(command, -100.0), 100.0)
        U[i] = command
        state[8] = min(max(state[8], command - v.half_play), command + v.half_play)
        for _ in range(steps):
            y = state[:8]
            _rates(y, k1, v, m, c, state[8], load[i], thinness[i])
            z[:] = y + 0.5 * h * k1
            _rates(z, k2, v, m, c, state[8], load[i], thinness[i])
            z[:] = y + 0.5 * h * k2
            _rates(z, k3, v, m, c, state[8], load[i], thinness[i])
            z[:] = y + h * k3
            _rates(z, k4, v, m, c, state[8], load[i], thinness[i])
            for j in range(8):
                state[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
            state[1] = min(max(state[1], -v.slew), v.slew)
            state[4] = max(state[4], _LEAST_BAR - _ABSOLUTE_BAR)
            state[5] = max(state[5], _LEAST_BAR - _ABSOLUTE_BAR)
    return states, U, Q
