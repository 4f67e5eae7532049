"""Simulation of the rig: from a scenario and a state to the next block of samples.

The same scenario and commands give the same samples bit for bit, for any division into blocks.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from valvemap_rig.blocks import RigBlock, ValveBlock
from valvemap_rig.circuit import operating_point, tank_temperature
from valvemap_rig.dynamics import lag, play, second_order
from valvemap_rig.excitation import External, drive
from valvemap_rig.fault_effects import (
    ActiveFault,
    Faults,
    clock_error_ns,
    edge_factor,
    sensor_faults,
    spool_frequency,
    still_felt,
    temperature_rise,
    worn_gap,
)
from valvemap_rig.faults import SIGNALS, Fault, Signal
from valvemap_rig.machine_simulation import MachineState, advance_machine
from valvemap_rig.records import Floats
from valvemap_rig.scenario import Scenario, ScenarioError, ValveBench
from valvemap_rig.sensors import SensorMemory, measure
from valvemap_rig.valvistor import pilot_opening

MOST_FAULTS = 200
MOST_LOAD_BAR = 400.0


@dataclass(frozen=True)
class Commands:
    """Commands of an operator before a block: signals (%), loads and faults, by valve name.

    ``load`` is the set point of p2 (bar), NaN for the excitation's own. Faults start with the
    block's first sample; their ``start_s`` is ignored.
    """

    U: Mapping[str, float] = field(default_factory=dict)
    load: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[tuple[str, Fault], ...] = ()


@dataclass(frozen=True)
class ValveState:
    """State of one valve between blocks; ``load`` (bar) is NaN while none is commanded."""

    U: float
    faults: Faults
    load: float = float("nan")
    hysteresis: float = float("nan")
    pilot: float = float("nan")
    spool: tuple[float, float] = (float("nan"), 0.0)  # %, %/s; where it is at the next sample
    sensors: Mapping[Signal, SensorMemory] = field(
        default_factory=lambda: {signal: SensorMemory() for signal in SIGNALS}
    )


@dataclass(frozen=True)
class RigState:
    """Number of the next sample, time of sample 0 (UTC ns), states of valves and machines."""

    index: int
    start_ns: int
    valves: Mapping[str, ValveState]
    machines: Mapping[str, MachineState] = field(default_factory=dict)

    def faults_of(self, name: str) -> Faults:
        """Return the active faults of a valve or machine."""
        return (self.machines[name] if name in self.machines else self.valves[name]).faults


def initial(scenario: Scenario, start_ns: int) -> RigState:
    """Return the state before the first sample, at ``start_ns`` (UTC; rounded to 100 ns)."""

    def faults_of(name: str) -> Faults:
        return tuple(
            ActiveFault(fault, round(fault.start_s * scenario.sample_rate_hz))
            for fault in scenario.faults
            if fault.valve in (None, name)
        )

    U = own_command(scenario)
    return RigState(
        index=0,
        start_ns=start_ns // 100 * 100,
        valves={b.name: ValveState(U=U, faults=faults_of(b.name)) for b in scenario.valves},
        machines={m.name: MachineState(U=0.0, faults=faults_of(m.name)) for m in scenario.machines},
    )


def own_command(scenario: Scenario) -> float:
    """Return the control signal (%) without an external command."""
    excitation = scenario.excitation
    return excitation.U_start_percent if isinstance(excitation, External) else 0.0


def advance(
    scenario: Scenario, state: RigState, n: int, commands: Commands | None = None
) -> tuple[RigState, RigBlock]:
    """Compute the next n samples, or fewer at the end of the scenario.

    Raises
    ------
    ScenarioError
        if a command names an unknown valve, a U outside 0 … 100 % (a machine: ± 100 %), a load
        outside 0 … 400 bar, or too many faults.

    Examples
    --------
    >>> from valvemap_rig.scenario import BUILTIN
    >>> state = initial(BUILTIN["demo"], start_ns=0)
    >>> state, block = advance(BUILTIN["demo"], state, 3)
    >>> block.sequence, block.t
    (array([0, 1, 2], dtype=uint32), array([       0, 10000000, 20000000]))
    """
    if commands is not None:
        state = _obeyed(state, commands)
    if scenario.samples is not None:
        n = min(n, scenario.samples - state.index)
    index = np.arange(state.index, state.index + n)
    t = _source_time(scenario, state.start_ns, index)
    results = {
        bench.name: _advance_valve(scenario, bench, state.valves[bench.name], index, t)
        for bench in scenario.valves
    }
    rate, seed = scenario.sample_rate_hz, scenario.seed
    moved = {
        machine.name: advance_machine(machine, state.machines[machine.name], index, t, rate, seed)
        for machine in scenario.machines
    }
    block = RigBlock(
        sequence=(index % 2**32).astype(np.uint32),
        t=t,
        valves={name: valve_block for name, (_, valve_block) in results.items()},
        machines={name: machine_block for name, (_, machine_block) in moved.items()},
    )
    after = replace(
        state,
        index=state.index + n,
        valves={name: valve for name, (valve, _) in results.items()},
        machines={name: machine for name, (machine, _) in moved.items()},
    )
    return after, block


def is_over(scenario: Scenario, state: RigState) -> bool:
    """Return whether the scenario has ended."""
    return scenario.samples is not None and state.index >= scenario.samples


def _advance_valve(
    scenario: Scenario,
    bench: ValveBench,
    state: ValveState,
    index: NDArray[np.int64],
    t: NDArray[np.int64],
) -> tuple[ValveState, ValveBlock]:
    rate, seed, name = scenario.sample_rate_hz, scenario.seed, bench.name
    period = 1.0 / rate
    U, p2_set = drive(scenario.excitation, index, rate, bench.circuit.p0_bar, seed, name, state.U)
    if isinstance(scenario.excitation, External) and math.isfinite(state.load):
        p2_set = np.full(len(index), state.load)
    held = play(U, bench.valve.hysteresis_percent, state.hysteresis)
    pilot = lag(held, bench.valve.pilot_lag_s, period, state.pilot)
    moved, spool = pilot, state.spool
    if bench.valve.spool_hz:
        hz = spool_frequency(state.faults, bench.valve.spool_hz, index, rate)
        moved, spool = second_order(pilot, hz, bench.valve.spool_damping, period, spool)
    T = tank_temperature(bench.circuit, index / rate) + temperature_rise(state.faults, index, rate)
    edge = edge_factor(state.faults, index, rate)
    gap = worn_gap(state.faults, index, rate)
    point = operating_point(
        bench, pilot_opening(bench.valve, np.clip(moved, 0.0, 100.0)), p2_set, T, edge, gap
    )

    truths: dict[Signal, Floats] = {
        "U": U,
        "p1": point.p1,
        "p2": point.p2,
        "Q": point.Q,
        "T": point.T1 if scenario.sensors.T_at == "inlet" else point.T2,
    }
    memories, shown, status, present = {}, {}, {}, {}
    for signal, truth in truths.items():
        faults = sensor_faults(state.faults, signal, index, rate, seed, name)
        start = int(index[0]) if index.size else 0
        memories[signal], shown[signal] = measure(
            getattr(scenario.sensors, signal),
            truth,
            faults,
            state.sensors[signal],
            period,
            seed,
            f"{name}.{signal}",
            start,
        )
        status[signal], present[signal] = faults.status, faults.present
    block = ValveBlock(
        t=t + clock_error_ns(state.faults, index, rate),
        **shown,
        status=status,
        present=present,
        U_true=U,
        dp_true=point.dp,
        T_true=point.T1,
        Q_true=point.Q,
    )
    if index.size == 0:
        return state, block
    after = ValveState(
        U=state.U,
        faults=still_felt(state.faults, int(index[-1]) + 1, rate),
        hysteresis=float(held[-1]),
        pilot=float(pilot[-1]),
        spool=spool,
        sensors=memories,
    )
    return after, block


def _source_time(scenario: Scenario, start_ns: int, index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the source time of each sample; a time factor shortens the intervals."""
    spacing = 1e7 / (scenario.sample_rate_hz * scenario.time_factor)  # in ticks of 100 ns
    return np.asarray(start_ns + np.rint(index * spacing).astype(np.int64) * 100)


def _obeyed(state: RigState, commands: Commands) -> RigState:
    units: dict[str, ValveState | MachineState] = {**state.valves, **state.machines}
    for name, U in commands.U.items():
        unit = _unit(units, name)
        low = -100 if isinstance(unit, MachineState) else 0
        if not low <= U <= 100:
            raise ScenarioError(f"{name}: U command must be within {low} … 100 %, not {U!r}")
        units[name] = replace(unit, U=float(U))
    for name, load in commands.load.items():
        unit = _unit(units, name)
        if isinstance(unit, MachineState) or not (math.isnan(load) or 0 <= load <= MOST_LOAD_BAR):
            raise ScenarioError(
                f"{name}: a load command is for a valve, 0 … {MOST_LOAD_BAR:g} bar, not {load!r}"
            )
        units[name] = replace(unit, load=float(load))
    for name, fault in commands.faults:
        unit = _unit(units, name)
        faults = (*unit.faults, ActiveFault(fault, state.index))
        if len(faults) > MOST_FAULTS:
            raise ScenarioError(f"{name}: more than {MOST_FAULTS} faults at once")
        units[name] = replace(unit, faults=faults)
    return replace(
        state,
        valves={name: unit for name, unit in units.items() if isinstance(unit, ValveState)},
        machines={name: unit for name, unit in units.items() if isinstance(unit, MachineState)},
    )


def _unit(units: Mapping[str, ValveState | MachineState], name: str) -> ValveState | MachineState:
    if name not in units:
        raise ScenarioError(f"{name}: no such valve; allowed are {', '.join(units)}")
    return units[name]
