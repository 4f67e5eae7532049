"""Simulation of a machine: from a state to the next block of samples, the same for any division."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap_rig import machine_kernels as kernels
from valvemap_rig.directional import numbers as valve_numbers
from valvemap_rig.directional import true_edge_flow
from valvemap_rig.fault_effects import (
    Faults,
    clock_error_ns,
    edge_factor,
    sensor_faults,
    still_felt,
    temperature_rise,
    total_size,
)
from valvemap_rig.faults import EDGES, FaultKind
from valvemap_rig.kernels import NU_LEAKAGE
from valvemap_rig.machine import SENSOR_OF, Machine
from valvemap_rig.machine import numbers as machine_numbers
from valvemap_rig.machine_programme import forces, moves
from valvemap_rig.oil import viscosity
from valvemap_rig.records import Floats
from valvemap_rig.sensors import SensorMemory, measure

_STATE: Final = {name: place for place, name in enumerate(kernels.STATES)}
_TABLE_U: Final = np.linspace(-100.0, 100.0, 401)


@dataclass(frozen=True)
class MachineState:
    """State of a machine between blocks: ``plant`` holds the ``STATES``; none before sample 0."""

    U: float
    faults: Faults
    plant: tuple[float, ...] | None = None
    sensors: Mapping[str, SensorMemory] = field(default_factory=dict)


@dataclass(frozen=True)
class MachineBlock:
    """N samples of one machine, all arrays of shape (N,).

    ``t`` (int64, UTC ns) is the source time; ``shown``, ``status`` and ``present`` go by signal.
    ``truth`` has the signals without noise, and the ``STATES``.
    """

    t: NDArray[np.int64]
    shown: Mapping[str, Floats]
    status: Mapping[str, NDArray[np.uint32]]
    present: Mapping[str, NDArray[np.bool_]]
    truth: Mapping[str, Floats]

    def column(self, signal: str) -> Floats:
        """Return a signal as its sensor shows it."""
        return self.shown[signal]

    def quality(self, signal: str) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
        """Return a signal's status, and whether it is sent."""
        return self.status[signal], self.present[signal]


def conditions(faults: Faults, index: NDArray[np.int64], rate: float) -> Floats:
    """Return the ``CONDITIONS`` of a machine at N samples, (N, 9)."""
    edges = [edge_factor(faults, index, rate, edge) for edge in EDGES]
    leakage = total_size(faults, FaultKind.LEAKAGE, index, rate)
    air = 0.01 * total_size(faults, FaultKind.AIR, index, rate)
    shares = [
        np.clip(1.0 + 0.01 * total_size(faults, kind, index, rate), 0.05, 20.0)
        for kind in (FaultKind.SUPPLY, FaultKind.FRICTION, FaultKind.LOAD)
    ]
    return np.stack([*edges, np.clip(1.0 + leakage, 0.0, 100.0), air, *shares], axis=1)


def advance_machine(
    machine: Machine,
    state: MachineState,
    index: NDArray[np.int64],
    t: NDArray[np.int64],
    rate: float,
    seed: int,
) -> tuple[MachineState, MachineBlock]:
    """Compute the samples ``index`` at the source times ``t``, both (N,)."""
    name, supply = machine.name, machine.supply
    T = supply.tank_C + supply.tank_drift_K * np.sin(
        2.0 * np.pi * index / rate / supply.tank_drift_period_s
    )
    T = T + temperature_rise(state.faults, index, rate)
    work = machine.repeats or name
    x_set, v_set = moves(machine.programme, machine.cylinder.stroke_mm, index, rate, seed, work)
    load = forces(machine.load, index, machine.programme.period_s, rate, seed, work)
    plant = np.array(state.plant or _at_rest(machine, x_set), dtype=np.float64)
    states, U, Q = kernels.play_through(
        valve_numbers(machine.valve),
        machine_numbers(machine),
        plant,
        1e-3 * x_set,
        _lead(machine, v_set, state.U),
        load,
        conditions(state.faults, index, rate),
        NU_LEAKAGE / viscosity(machine.oil, T),
        1.0 / rate,
        machine.controller is not None,
    )
    truth = {state_name: states[:, place] for state_name, place in _STATE.items()}
    truth |= {"U": U, "QA": Q[:, 0], "QB": Q[:, 1], "T": T, "load": load, "xSet": x_set}
    truth |= {"pP": truth["pS"], "vSet": v_set, "x": 1e3 * truth["x"], "v": 1e3 * truth["v"]}
    memories, shown, status, present = dict(state.sensors), {}, {}, {}
    for row in machine.rows:
        faults = sensor_faults(state.faults, row.name, index, rate, seed, name)
        status[row.name], present[row.name] = faults.status, faults.present
        if row.sensor is None:
            shown[row.name] = truth[row.name]
            continue
        memories[row.name], shown[row.name] = measure(
            getattr(machine.sensors, row.sensor),
            truth[row.name],
            faults,
            memories.get(row.name, SensorMemory()),
            1.0 / rate,
            seed,
            f"{name}.{SENSOR_OF.get(row.name, row.name)}",
            int(index[0]) if index.size else 0,
        )
    block = MachineBlock(
        t=t + clock_error_ns(state.faults, index, rate),
        shown=shown,
        status=status,
        present=present,
        truth=truth,
    )
    if index.size == 0:
        return state, block
    after = replace(
        state,
        faults=still_felt(state.faults, int(index[-1]) + 1, rate),
        plant=tuple(plant.tolist()),
        sensors=memories,
    )
    return after, block


def _at_rest(machine: Machine, x_set: Floats) -> tuple[float, ...]:
    """Return the state at standstill on the first set position, both chambers under pressure."""
    x = 1e-3 * float(x_set[0]) if x_set.size else 0.5e-3 * machine.cylinder.stroke_mm
    p0 = machine.supply.p0_bar
    areas = machine.cylinder.A_A_cm2, machine.cylinder.A_B_cm2
    pB = 0.4 * p0
    pA = (machine.load.mean_N / 10.0 + areas[1] * pB) / areas[0]
    return (0.0, 0.0, x, 0.0, max(pA, 5.0), pB, p0, machine.supply.tank_bar, 0.0, 0.0)


def _lead(machine: Machine, v_set: Floats, U: float) -> Floats:
    controller = machine.controller
    if controller is None or controller.lead == "external":
        return np.full(v_set.shape, U)
    if controller.lead == "none":
        return np.zeros(v_set.shape)
    return np.interp(v_set, _table(machine), _TABLE_U)


def _table(machine: Machine) -> Floats:
    """Return the speed (mm/s) of the new valve at ``_TABLE_U``, without load, strictly rising.

    Each direction has two throttles in series: A_A·p_A = A_B·p_B gives the speed in closed form.
    """
    valve, cylinder, supply = machine.valve, machine.cylinder, machine.supply
    A, B, p = cylinder.A_A_cm2, cylinder.A_B_cm2, supply.p0_bar
    size = np.abs(_TABLE_U)
    K = {edge: true_edge_flow(valve, edge, size, 1.0) for edge in EDGES}
    tiny = 1e-9 * (1.0 + size)  # l/min/√bar; keeps the table rising inside the overlap
    out = np.sqrt(A * p / (A**3 / (K["PA"] + tiny) ** 2 + B**3 / (K["BT"] + tiny) ** 2))
    back = np.sqrt(B * p / (B**3 / (K["PB"] + tiny) ** 2 + A**3 / (K["AT"] + tiny) ** 2))
    return np.asarray(np.sign(_TABLE_U) * np.where(_TABLE_U > 0, out, back) * 1e3 / 6.0)
