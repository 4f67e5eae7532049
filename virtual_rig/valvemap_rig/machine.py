"""A machine: supply, 4/3 valve, hoses, cylinder, mass, friction, load; its signals and sensors.

::

    V_A·κ(p_A)·ṗ_A = Q_PA - Q_AT - c·(p_A - p_B) - A_A·ẋ       V_A = V_0A + A_A·x
    V_B·κ(p_B)·ṗ_B = Q_PB - Q_BT + c·(p_A - p_B) + A_B·ẋ       V_B = V_0B + A_B·(L - x)
    m·ẍ = A_A·p_A - A_B·p_B - load - friction(ẋ) + end stops
    κ(p) = 1/β + a·p_0/p²                                      oil and hoses, free air (absolute p)
    pump: Q_pump·(p_0 - p_S)/droop within ± Q_pump             tank line: p_T = p_tank + R·Q_T

Friction is Coulomb's, with a static part (Stribeck) and a viscous one. A scenario ``directional``
has a flow meter in each line (Q_A, Q_B, at the valve's ports); a scenario ``axis`` has the piston's
position instead. Position x is 0 with the piston retracted; a load > 0 is against extension.
"""

import math
from typing import Annotated, Final, Literal, NamedTuple

import numpy as np
from pydantic import Field

from valvemap_rig import machine_kernels as kernels
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.machine_programme import Load, Programme
from valvemap_rig.oil import Oil
from valvemap_rig.parameters import Parameters, parameter
from valvemap_rig.records import Numbers
from valvemap_rig.sensors import Sensor

Lead = Literal["none", "table", "external"]

_CYLINDER = "own choice: a cylinder of a mobile machine"
_HOSES = "own choice: 10 m of hose and pipe each"
_SUPPLY = "own choice: a pressure-compensated pump"
_TUNED = "tuned for this machine"


class Cylinder(Parameters):
    """Data sheet of cylinder, moved mass and hoses."""

    piston_mm: float = parameter(63.0, "mm", "diameter of the piston", _CYLINDER, gt=5, le=1000)
    rod_mm: float = parameter(45.0, "mm", "diameter of the rod", _CYLINDER, ge=0, le=990)
    stroke_mm: float = parameter(800.0, "mm", "between the end stops", _CYLINDER, gt=10, le=1e4)
    dead_A_l: float = parameter(1.2, "l", "hose and chamber A at x = 0", _HOSES, gt=0.01, le=100)
    dead_B_l: float = parameter(1.2, "l", "the same of B, extended", _HOSES, gt=0.01, le=100)
    bulk_modulus_GPa: float = parameter(
        0.9, "GPa", "β of oil and hoses", "textbook value with hoses", ge=0.05, le=3
    )
    air_percent: float = parameter(
        0.05, "%", "free air at atmospheric pressure", "own choice: vented well", ge=0, le=20
    )
    leakage_l_min_bar: float = parameter(
        0.002, "l/(min·bar)", "across the piston at 46 mm²/s", _CYLINDER, ge=0, le=1
    )
    mass_kg: float = parameter(1500.0, "kg", "moved mass", _CYLINDER, ge=50, le=1e5)
    viscous_N_s_m: float = parameter(2500.0, "N·s/m", "viscous friction", _CYLINDER, ge=0, le=1e6)
    coulomb_N: float = parameter(500.0, "N", "friction of the seals", _CYLINDER, ge=0, le=1e5)
    stribeck_N: float = parameter(300.0, "N", "more of it at a standstill", _CYLINDER, ge=0, le=1e5)

    @property
    def A_A_cm2(self) -> float:
        """Area of the piston."""
        return math.pi / 400 * self.piston_mm**2

    @property
    def A_B_cm2(self) -> float:
        """Annular area on the rod's side."""
        return math.pi / 400 * (self.piston_mm**2 - self.rod_mm**2)


class Supply(Parameters):
    """Data sheet of pump, tank line and tank."""

    p0_bar: float = parameter(180.0, "bar", "pressure without flow", _SUPPLY, ge=10, le=400)
    Q_pump_l_min: float = parameter(110.0, "l/min", "most of the pump", _SUPPLY, ge=1, le=2000)
    droop_bar: float = parameter(15.0, "bar", "drop up to full flow", _SUPPLY, ge=1, le=200)
    volume_l: float = parameter(2.0, "l", "of supply and tank line each", _SUPPLY, ge=0.5, le=100)
    tank_bar: float = parameter(2.0, "bar", "p_T without flow", _SUPPLY, ge=0, le=50)
    tank_resistance: float = parameter(
        0.04, "bar/(l/min)", "of the tank line", _SUPPLY, ge=0.02, le=2
    )
    tank_C: float = parameter(40.0, "°C", "temperature of the oil", _SUPPLY, ge=-10, le=100)
    tank_drift_K: float = parameter(1.0, "K", "amplitude of its drift", _SUPPLY, ge=0, le=20)
    tank_drift_period_s: float = parameter(900.0, "s", "period of it", _SUPPLY, ge=10, le=1e6)


class Controller(Parameters):
    """A position controller: PI with a dead band, and a lead."""

    lead: Lead = Field(
        default="none",
        description="none: PI alone; table: speed to U of the new valve without load; external: "
        "UCommand is added to the PI's",
    )
    k_p_percent_mm: float = parameter(0.9, "%/mm", "proportional", _TUNED, ge=0, le=100)
    k_i_percent_mm_s: float = parameter(1.0, "%/(mm·s)", "integral", _TUNED, ge=0, le=100)
    band_mm: float = parameter(0.3, "mm", "no integration below", _TUNED, ge=0, le=100)


class MachineSensors(Parameters):
    """The sensors: ± 250 bar transducers, meters of 0.4 l/min, a 5 µm encoder, a Pt100."""

    U: Sensor = Sensor(quantum=0.01)
    pP: Sensor = Sensor(noise=0.05, quantum=0.01)
    pT: Sensor = Sensor(noise=0.05, quantum=0.01)
    pA: Sensor = Sensor(noise=0.05, quantum=0.01)
    pB: Sensor = Sensor(noise=0.05, quantum=0.01)
    QA: Sensor = Sensor(noise=0.4, quantum=0.01)
    QB: Sensor = Sensor(noise=0.4, quantum=0.01)
    x: Sensor = Sensor(noise=0.005, quantum=0.001)
    T: Sensor = Sensor(noise=0.02, quantum=0.01)


class SignalRow(NamedTuple):
    """One published signal: last part of its NodeId, sensor, unit, range and meaning."""

    name: str
    sensor: str | None
    unit: str
    low: float
    high: float
    meaning: str


class Machine(Parameters):
    """A 4/3 valve and the cylinder it moves."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,63}$")] = "Spool"
    measures: Literal["flows", "position"] = Field(
        default="flows", description="a meter in each line, or the position of the piston"
    )
    valve: DirectionalValve = DirectionalValve()
    cylinder: Cylinder = Cylinder()
    supply: Supply = Supply()
    oil: Oil = Oil()
    sensors: MachineSensors = MachineSensors()
    programme: Programme = Programme()
    load: Load = Load()
    repeats: str | None = Field(
        default=None, description="machine whose moves and loads it repeats; none: it has its own"
    )
    controller: Controller | None = Field(
        default=Controller(lead="table"), description="none: UCommand drives the valve"
    )

    @property
    def takes_commands(self) -> bool:
        """Whether UCommand has an effect."""
        return self.controller is None or self.controller.lead == "external"

    @property
    def rows(self) -> tuple[SignalRow, ...]:
        """The published signals."""
        p, Q = self.supply.p0_bar, self.supply.Q_pump_l_min
        stroke = self.cylinder.stroke_mm
        top = self.programme.speed_mm_s
        U = SignalRow("U", "U", "%", -100.0, 100.0, "Control signal; > 0 opens PA and BT")
        pressures = tuple(
            SignalRow(name, sensor, "bar", 0.0, 1.5 * p, f"Pressure {words}")
            for name, sensor, words in (
                ("pP" if self.measures == "flows" else "pS", "pP", "of the supply, at port P"),
                ("pT", "pT", "in the tank line, at port T"),
                ("pA", "pA", "in line A"),
                ("pB", "pB", "in line B"),
            )
        )
        T = SignalRow("T", "T", "°C", 0.0, 100.0, "Oil temperature")
        if self.measures == "flows":
            meters = tuple(
                SignalRow(f"Q{line}", f"Q{line}", "l/min", -1.5 * Q, 1.5 * Q, words)
                for line, words in (
                    ("A", "Flow out of port A; < 0 into it"),
                    ("B", "Flow out of port B; < 0 into it"),
                )
            )
            return (U, *pressures, *meters, T)
        return (
            U,
            *pressures,
            SignalRow("x", "x", "mm", 0.0, stroke, "Position of the piston; 0 retracted"),
            T,
            SignalRow("xSet", None, "mm", 0.0, stroke, "Set position"),
            SignalRow("vSet", None, "mm/s", -top, top, "Set speed"),
        )

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the published signals."""
        return tuple(row.name for row in self.rows)


SENSOR_OF: Final = {"pS": "pP"}


def numbers(machine: Machine) -> Numbers:
    """Return the parameters of a machine for the compiled loop."""
    cylinder, supply = machine.cylinder, machine.supply
    controller = machine.controller or Controller()
    row = (
        cylinder.A_A_cm2,
        cylinder.A_B_cm2,
        1e-3 * cylinder.stroke_mm,
        cylinder.dead_A_l,
        cylinder.dead_B_l,
        1e4 * cylinder.bulk_modulus_GPa,
        0.01 * cylinder.air_percent,
        cylinder.leakage_l_min_bar,
        cylinder.mass_kg,
        cylinder.viscous_N_s_m,
        cylinder.coulomb_N,
        cylinder.stribeck_N,
        5e7,
        supply.p0_bar,
        supply.Q_pump_l_min,
        supply.droop_bar,
        supply.volume_l,
        supply.tank_bar,
        supply.tank_resistance,
        controller.k_p_percent_mm,
        controller.k_i_percent_mm_s,
        controller.band_mm,
    )
    return np.array([row], dtype=kernels.MACHINE)
