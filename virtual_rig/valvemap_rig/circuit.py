"""The circuit around the valve: pump, relief valve, load valve, tank, flow meter.

::

    pump, relief    the pump supplies at most Q_pump; the excess flow passes the relief valve,
                    p1 = p0 - override·Q/Q_pump. If the valve demands more than Q_pump, p1 falls
                    until its flow equals Q_pump.
    load valve      p2 = its set point, at least its own pressure p_a + R·Q²
    tank            T1 = tank temperature; T2 = T1 + throttling heat

The oil temperature T is measured at the valve's inlet, as ISO 10770-1 requires (T1); the scenario
may place the sensor downstream (T2). The flow meter is downstream of the valve and measures at p2
and T2; the pump's limit refers to tank pressure and T1.

The operating point is the root, in p1, of the valve's flow minus the supply's flow. Both are
monotone, so the root is unique, and its bracket is known. Brent's method finds it for each sample.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valvemap_rig import kernels
from valvemap_rig.condition import AS_NEW, Condition
from valvemap_rig.oil import Oil, density, throttling_heat
from valvemap_rig.oil import numbers as oil_numbers
from valvemap_rig.parameters import Parameters, parameter
from valvemap_rig.records import CIRCUIT, Floats, Numbers, Setting
from valvemap_rig.valvistor import Valvistor, pilot_opening, poppet_state
from valvemap_rig.valvistor import numbers as valve_numbers

_LOAD = "own choice for a proportional relief valve"


class Circuit(Parameters):
    """Data sheet of supply, load valve and tank."""

    p0_bar: float = parameter(
        200.0, "bar", "supply pressure while no oil is taken", "paper, sec. 2.2", ge=10, le=400
    )
    Q_pump_l_min: float = parameter(
        200.0, "l/min", "most that the pump gives", "paper, sec. 2.2", ge=1, le=2000
    )
    relief_override_bar: float = parameter(
        3.0,
        "bar",
        "p0 minus the pressure at which the relief valve shuts",
        "own choice for a pilot-operated relief valve",
        ge=0.01,
        le=100,
    )
    load_minimum_bar: float = parameter(3.0, "bar", "lowest p2, no flow", _LOAD, ge=0, le=50)
    load_resistance_bar: float = parameter(
        8.0,
        "bar",
        "what full pump flow adds to the lowest p2",
        _LOAD,
        ge=0,
        le=100,
    )
    tank_C: float = parameter(
        40.0, "°C", "temperature of the tank", "paper, sec. 2.2", ge=-10, le=100
    )
    tank_drift_K: float = parameter(
        1.0,
        "K",
        "amplitude of its slow drift",
        "own choice for a cooler that switches",
        ge=0,
        le=20,
    )
    tank_drift_period_s: float = parameter(
        900.0,
        "s",
        "period of its slow drift",
        "own choice for a cooler that switches",
        ge=10,
        le=1e6,
    )


class Bench(Parameters):
    """One valve, its oil and its circuit; several valves stand on a bench each."""

    valve: Valvistor = Valvistor()
    oil: Oil = Oil()
    circuit: Circuit = Circuit()


class OperatingPoint(NamedTuple):
    """Steady operating points of a bench, all arrays of shape (N,).

    ``p1``, ``p2`` in bar; ``Q`` in l/min at the flow meter; ``T1``, ``T2`` the oil temperature
    upstream and downstream of the valve, °C; ``x_MP`` the poppet's stroke, mm.
    """

    p1: Floats
    p2: Floats
    Q: Floats
    T1: Floats
    T2: Floats
    x_MP: Floats

    @property
    def dp(self) -> Floats:
        """Pressure drop p1 - p2, bar."""
        return self.p1 - self.p2


def operating_point(
    bench: Bench, y: Floats, p2_set: Floats, T: Floats, edge: Floats, gap: ArrayLike = 0.0
) -> OperatingPoint:
    """Return the steady operating points of a bench.

    Parameters
    ----------
    y : (N,) array
        Opening of the pilot, 0 … 1.
    p2_set : (N,) array
        Set point of the load valve, bar.
    T : (N,) array
        Oil temperature at the inlet, °C.
    edge : (N,) array
        Flow coefficient of the main edge relative to the new valve.
    gap : (N,) array
        Flow coefficient of a gap worn into the main edge, l/min per √bar.

    Examples
    --------
    >>> bench = Bench()
    >>> one = np.ones(2)
    >>> point = operating_point(bench, one, np.array([180.0, 0.0]), 40 * one, one)
    >>> point.p1.round(0), point.Q.round(0)
    (array([198.,  78.]), array([102., 200.]))
    """
    gap = np.broadcast_to(np.asarray(gap, np.float64), y.shape)
    columns = (np.ascontiguousarray(column, np.float64) for column in (y, p2_set, T, edge, gap))
    p1, p2 = kernels.settled(
        valve_numbers(bench.valve),
        oil_numbers(bench.oil),
        numbers(bench.circuit),
        Setting(*columns),
    )
    state = poppet_state(bench.valve, bench.oil, y, p1, p2, T, edge, gap)
    T2 = T + throttling_heat(bench.oil, p1 - p2, density(bench.oil, p1, T))
    return OperatingPoint(p1, p2, _metered(bench.oil, state.Q, p1, p2, T, T2), T, T2, state.x_MP)


def true_flow(
    bench: Bench, U: ArrayLike, dp: ArrayLike, T: ArrayLike = 40.0, worn: Condition = AS_NEW
) -> Floats:
    """Return the valve's map Q = f(U, dp, T) at the flow meter, without noise or hysteresis.

    It holds at full supply pressure; where the pump's limit lowers p1, the lower density changes Q
    by less than 0.4 %.

    Parameters
    ----------
    U, dp, T : array-likes that broadcast to (N,)
        Signal (%), pressure drop (bar), oil temperature at the inlet (°C).
    worn
        Condition of the valve's main edge; its temperature rise is ignored.

    Examples
    --------
    >>> true_flow(Bench(), 50, [0, 50, 100]).round(0)
    array([  0.,  86., 122.])
    """
    (u, drop, celsius), shape = _raveled(U, dp, T)
    p1 = np.full(u.shape, bench.circuit.p0_bar)
    p2 = p1 - drop
    y = pilot_opening(bench.valve, u)
    edge, gap = np.full(u.shape, worn.edge_factor), np.full(u.shape, worn.gap)
    Q = poppet_state(bench.valve, bench.oil, y, p1, p2, celsius, edge, gap).Q
    T2 = celsius + throttling_heat(bench.oil, drop, density(bench.oil, p1, celsius))
    return _metered(bench.oil, Q, p1, p2, celsius, T2).reshape(shape)


def largest_drop(bench: Bench, U: ArrayLike, T: ArrayLike = 40.0) -> Floats:
    """Return the largest pressure drop (bar) across the valve on this bench at signal U (%)."""
    (u, celsius), shape = _raveled(U, T)
    y = pilot_opening(bench.valve, u)
    point = operating_point(bench, y, np.zeros_like(u), celsius, np.ones_like(u))
    return point.dp.reshape(shape)


def reachable(bench: Bench, U: ArrayLike, dp: ArrayLike, T: ArrayLike = 40.0) -> NDArray[np.bool_]:
    """Return whether (U, dp) is within U's range, the pump limit and the lowest load pressure.

    >>> reachable(Bench(), [10, 100, 100], [150, 50, 150])
    array([ True,  True, False])
    """
    (u, drop, celsius), shape = _raveled(U, dp, T)
    inside = (u >= 0) & (u <= 100) & (drop >= 0) & (drop <= largest_drop(bench, u, celsius))
    return np.asarray(inside.reshape(shape))


def tank_temperature(circuit: Circuit, t: Floats) -> Floats:
    """Return the temperature (°C) of the tank at simulated time t (s)."""
    angle = 2 * np.pi * (t / circuit.tank_drift_period_s)
    return circuit.tank_C + circuit.tank_drift_K * np.sin(angle)


def _metered(oil: Oil, Q: Floats, p1: Floats, p2: Floats, T1: Floats, T2: Floats) -> Floats:
    """Convert Q at (p1, T1) to the meter's state (p2, T2), at equal mass flow."""
    return Q * density(oil, p1, T1) / density(oil, p2, T2)


def numbers(circuit: Circuit) -> Numbers:
    """Return the parameters of the circuit for the compiled loops."""
    row = (
        circuit.p0_bar,
        circuit.Q_pump_l_min,
        circuit.relief_override_bar,
        circuit.load_minimum_bar,
        circuit.load_resistance_bar,
    )
    return np.array([row], dtype=CIRCUIT)


def _raveled(*values: ArrayLike) -> tuple[tuple[Floats, ...], tuple[int, ...]]:
    """Broadcast to one shape; return contiguous, raveled copies and that shape."""
    columns = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in values))
    return tuple(np.array(column).ravel() for column in columns), columns[0].shape
