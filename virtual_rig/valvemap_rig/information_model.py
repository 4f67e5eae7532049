"""The nodes of the rig, and the publication of a block of samples."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, TypeVar

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua import (
    Argument,
    Block,
    Declarations,
    HardenedServer,
    Role,
    Unit,
    Variable,
    add_method,
    add_object,
    add_type,
    add_variable,
)
from valvemap_rig.circuit import largest_drop
from valvemap_rig.command import STANDSTILL_S
from valvemap_rig.faults import described_sizes
from valvemap_rig.kernels import Floats
from valvemap_rig.machine import Machine
from valvemap_rig.machine_simulation import MachineBlock
from valvemap_rig.scenario import BUILTIN, Scenario, ValveBench, faultable
from valvemap_rig.simulation import MOST_LOAD_BAR, RigBlock, ValveBlock

GOOD = 0
VALVE_TYPE = "Types.RigValve"
_NOT_OF_ALL = (  # of a fleet's
    *("ReachableU", "ReachableDp", "InjectFault"),
    *("UCommand", "LoadCommand", "Heartbeat"),
)
_REACHABLE_U = np.linspace(0.0, 100.0, 21)

StartScenario = Callable[[str], None]
StopScenario = Callable[[], None]
InjectFault = Callable[[str, str, float, float], str | None]
CommandU = Callable[[str, float], None]
CommandLoad = Callable[[str, float], None]
Heartbeat = Callable[[str, int], None]
_Place = HardenedServer | Declarations
_Unit = TypeVar("_Unit", ValveBlock, MachineBlock)
Signals = tuple[list[Variable], Variable]  # U, p1, p2, Q, T; sequence
Updates = list[tuple[Variable, object, int, int]]


@dataclass(frozen=True)
class Actions:
    """Actions of operators: method calls, and writes of the two commands and ``Heartbeat``."""

    start_scenario: StartScenario
    stop_scenario: StopScenario
    inject_fault: InjectFault
    command_U: CommandU
    command_load: CommandLoad
    heartbeat: Heartbeat


@dataclass(frozen=True)
class RigStatus:
    """Status variables of the rig."""

    sample_count: Variable
    late_ticks: Variable
    lag: Variable
    overflows: Variable

    def updates(self, samples: int, late_ticks: int, lag_s: float, lost: int, now: int) -> Updates:
        """Return the updates of the status at ``now`` (UTC ns)."""
        return [
            (self.sample_count, samples, GOOD, now),
            (self.late_ticks, late_ticks, GOOD, now),
            (self.lag, max(lag_s, 0.0), GOOD, now),
            (self.overflows, lost, GOOD, now),
        ]


@dataclass(frozen=True)
class FleetNodes:
    """Changing nodes of a fleet.

    ``signals`` has the columns U, p1, p2, Q, T of the first valve, then of the next; ``sequences``
    has one column per valve.
    """

    status: RigStatus
    signals: Block
    sequences: Block


@dataclass(frozen=True)
class RigNodes(FleetNodes):
    """Changing nodes of a rig.

    ``of_valves`` are the variables of the blocks: U, p1, p2, Q, T, and Sequence of each valve.
    """

    scenario: Variable
    of_valves: Sequence[Signals]


_UNITS: Final = {
    "%": Unit.PERCENT,
    "bar": Unit.BAR,
    "l/min": Unit.LITRE_PER_MINUTE,
    "°C": Unit.DEGREE_CELSIUS,
    "mm": Unit.MILLIMETRE,
    "mm/s": Unit.MILLIMETRE_PER_SECOND,
}

NOTHING = RigBlock(np.empty(0, np.uint32), np.empty(0, np.int64), {})


def playable(scenario: Scenario) -> Mapping[str, Scenario]:
    """Return the scenarios of a rig: its own, and the built-in ones for what stands on it."""
    fitting = {
        name: built_in
        for name, built_in in BUILTIN.items()
        if bool(built_in.valves) == bool(scenario.valves)
    }
    return {**fitting, scenario.name: scenario} if scenario.valves else {scenario.name: scenario}


async def add_rig(server: HardenedServer, scenario: Scenario, actions: Actions) -> RigNodes:
    """Add all nodes of the rig below Objects/TestRig."""
    kind = _add_valve_type(server, scenario) if scenario.valves else None
    rig = await add_object(server, None, "TestRig", description="Test rig with proportional valves")
    await _add_methods(server, rig, scenario, actions)
    text = ua.VariantType.String
    names = [*playable(scenario)]
    await add_variable(
        server,
        rig,
        "Rig.Scenarios",
        names,
        type=text,
        dimensions=(0,),
        description="Names that StartScenario takes",
    )
    status = await _add_status(server, rig, scenario)
    running = await add_variable(
        server, rig, "Rig.Scenario", "", type=text, description="Running scenario, or empty"
    )
    valves = []
    for bench in scenario.valves:
        words = "Proportional valve on its bench"
        valve = await add_object(server, rig, bench.name, description=words, type_definition=kind)
        valves.append(await _add_valves_own(server, valve, bench, actions))
    for machine in scenario.machines:
        words = "4/3 valve with its cylinder"
        place = await add_object(server, rig, machine.name, description=words)
        valves.append(await _add_machines_own(server, place, machine, actions))
    return RigNodes(status, *_blocks(server, valves), scenario=running, of_valves=valves)


async def add_fleet(server: HardenedServer, scenario: Scenario, names: Sequence[str]) -> FleetNodes:
    """Add the nodes of a fleet, without methods and commands, below Objects/TestRig."""
    kind = _add_valve_type(server, scenario)
    rig = await add_object(server, None, "TestRig", description="Many valves, from a recording")
    status = await _add_status(server, rig, scenario)
    valves = []
    for name in names:
        words = "Valve from a recording"
        valve = await add_object(server, rig, name, description=words, type_definition=kind)
        valves.append(await _add_signals(server, valve, scenario.valves[0]))
    return FleetNodes(status, *_blocks(server, valves))


@dataclass(frozen=True)
class Columns:
    """A block of n samples, in the layout of the server's blocks.

    ``values``, ``times``, ``codes`` and ``present`` have a column for each signal of each valve and
    machine, ``sequences`` and ``t`` one for each. The signals of a sample share their timestamp.
    """

    values: Floats
    times: NDArray[np.int64]
    codes: NDArray[np.uint32]
    present: NDArray[np.bool_]
    sequences: NDArray[np.int64]
    t: NDArray[np.int64]


def columns_of(block: RigBlock, sequence_offset: int) -> Columns:
    """Convert a whole block to columns, of which single rows can be published."""
    units: list[ValveBlock | MachineBlock] = [*block.valves.values(), *block.machines.values()]
    t = np.stack([unit.t for unit in units], axis=1)
    sequence = (block.sequence.astype(np.int64) + sequence_offset) % 2**32
    every = [(unit, signal) for unit in units for signal in unit.status]
    return Columns(
        values=_columns([unit.column(signal) for unit, signal in every]),
        times=_columns([unit.t for unit, _ in every]),
        codes=_columns([unit.quality(signal)[0] for unit, signal in every]),
        present=_columns([unit.quality(signal)[1] for unit, signal in every]),
        sequences=np.repeat(sequence[:, None], len(units), axis=1),
        t=t,
    )


def publish(server: HardenedServer, nodes: RigNodes, columns: Columns, rows: slice) -> None:
    """Publish the given rows of a block.

    Signals that are not present are skipped; ``Sequence`` is always published.
    """
    server.write_block(
        nodes.signals,
        columns.values[rows],
        columns.times[rows],
        columns.codes[rows],
        columns.present[rows],
    )
    server.write_block(nodes.sequences, columns.sequences[rows], columns.t[rows])


def publish_fleet(
    server: HardenedServer, nodes: FleetNodes, samples: Floats, start: int, t: NDArray[np.int64]
) -> None:
    """Publish samples (n, valves, 5); the first has the number ``start``."""
    n, count = samples.shape[:2]
    server.write_block(nodes.signals, samples.reshape(n, -1), t)
    sequence = np.arange(start, start + n) % 2**32
    server.write_block(nodes.sequences, np.repeat(sequence[:, None], count, axis=1), t)


def part(block: RigBlock, start: int, stop: int) -> RigBlock:
    """Return samples ``start`` to ``stop`` of a block, as views."""
    if start == 0 and stop == len(block):
        return block
    chosen = slice(start, stop)
    return RigBlock(
        block.sequence[chosen],
        block.t[chosen],
        {name: _cut_unit(valve, chosen) for name, valve in block.valves.items()},
        {name: _cut_unit(machine, chosen) for name, machine in block.machines.items()},
    )


def _blocks(server: HardenedServer, valves: Sequence[Signals]) -> tuple[Block, Block]:
    return (
        server.add_block([variable for signals, _ in valves for variable in signals]),
        server.add_block([sequence for _, sequence in valves]),
    )


def _columns(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.stack(arrays, axis=1)


def _cut_unit(unit: _Unit, chosen: slice) -> _Unit:
    columns = {field.name: _cut(getattr(unit, field.name), chosen) for field in fields(unit)}
    return replace(unit, **columns)


def _cut(column: Any, chosen: slice) -> Any:  # noqa: ANN401 - an array, or arrays by signal
    if isinstance(column, Mapping):
        return {signal: array[chosen] for signal, array in column.items()}
    return column[chosen]


async def _add_status(server: HardenedServer, rig: ua.NodeId, scenario: Scenario) -> RigStatus:
    await add_variable(
        server,
        rig,
        "Rig.SampleRate",
        scenario.sample_rate_hz * scenario.time_factor,
        unit=Unit.HERTZ,
        value_range=(1.0, 100_000.0),
        description="Samples per second of real time",
    )
    return RigStatus(
        sample_count=await add_variable(
            server,
            rig,
            "Rig.SampleCount",
            0,
            type=ua.VariantType.UInt64,
            description="Samples published since the start of the server",
        ),
        late_ticks=await add_variable(
            server,
            rig,
            "Rig.LateTicks",
            0,
            type=ua.VariantType.UInt32,
            description="How often samples were published more than 0.1 s late",
        ),
        lag=await add_variable(
            server,
            rig,
            "Rig.Lag",
            0.0,
            unit=Unit.SECOND,
            value_range=(0.0, 86_400.0),
            description="By how much the newest sample was published late",
        ),
        overflows=await add_variable(
            server,
            rig,
            "Rig.Overflows",
            0,
            type=ua.VariantType.UInt64,
            description="Notifications that clients lost because their queues were full",
        ),
    )


async def _add_methods(
    server: HardenedServer, rig: ua.NodeId, scenario: Scenario, actions: Actions
) -> None:
    names = ", ".join(playable(scenario))
    await add_method(
        server,
        rig,
        "Rig.StartScenario",
        actions.start_scenario,
        inputs=[Argument("name", f"One of: {names}", type=ua.VariantType.String)],
        required=Role.OPERATOR,
        description="Start a scenario from its beginning",
    )
    await add_method(
        server,
        rig,
        "Rig.StopScenario",
        actions.stop_scenario,
        required=Role.OPERATOR,
        description="Stop the running scenario; the last values become Uncertain",
    )


def _add_valve_type(server: HardenedServer, scenario: Scenario) -> ua.NodeId:
    """Add the ObjectType of the valves, using the code that adds the valves."""

    def nothing(*_: object) -> None:
        """Do nothing: methods of the type are never called."""

    async def declare(place: Declarations, own: ua.NodeId) -> None:
        nobody = Actions(*(nothing,) * 6)
        await _add_valves_own(place, own, scenario.valves[0], nobody)

    return add_type(
        server,
        VALVE_TYPE,
        "RigValveType",
        declare,
        description="A proportional valve on its bench, or of a recording.",
        optional=_NOT_OF_ALL,
    )


async def _add_valves_own(
    server: _Place, valve: ua.NodeId, bench: ValveBench, actions: Actions
) -> Signals:
    """Add the components of a valve, or the declarations of its type."""
    prefix, circuit = valve.Identifier, bench.circuit
    reach = largest_drop(bench, _REACHABLE_U)
    for last, values, unit, high, description in (
        ("ReachableU", _REACHABLE_U, Unit.PERCENT, 100.0, "Control signals of ReachableDp"),
        (
            "ReachableDp",
            reach,
            Unit.BAR,
            circuit.p0_bar,
            "Largest pressure drop that the bench can put on the valve at each ReachableU",
        ),
    ):
        await add_variable(
            server,
            valve,
            f"{prefix}.{last}",
            values,
            unit=unit,
            value_range=(0.0, high),
            dimensions=(len(values),),
            description=description,
        )
    await _add_commands(server, valve, bench, actions)
    return await _add_signals(server, valve, bench)


async def _add_machines_own(
    server: HardenedServer, place: ua.NodeId, machine: Machine, actions: Actions
) -> Signals:
    """Add the components of a machine."""
    await _add_commands(server, place, machine, actions)
    signals = [
        await add_variable(
            server,
            place,
            f"{machine.name}.{row.name}",
            None,
            unit=_UNITS[row.unit],
            value_range=_with_margin(row.low, row.high),
            instrument_range=_with_margin(row.low, row.high),
            description=row.meaning,
        )
        for row in machine.rows
    ]
    return signals, await _add_sequence(server, place)


async def _add_commands(
    server: _Place, place: ua.NodeId, unit: ValveBench | Machine, actions: Actions
) -> None:
    """Add what operators write and call."""
    prefix, name, of = place.Identifier, unit.name, faultable(unit)
    low, words = -100.0, "Control signal from outside; taken by a controller with lead 'external'"
    if isinstance(unit, ValveBench):
        low, words = 0.0, "Control signal from outside; taken by the scenario 'external'"
    await add_method(
        server,
        place,
        f"{prefix}.InjectFault",
        lambda kind, size, duration: actions.inject_fault(name, kind, size, duration),
        inputs=[
            Argument(
                "kind",
                f"One of: {of.sentence}",
                type=ua.VariantType.String,
            ),
            Argument(
                "size",
                described_sizes(of.kinds),
            ),
            Argument(
                "duration",
                "Simulated time; 0 = for good",
                unit=Unit.SECOND,
                value_range=(0.0, 1e9),
            ),
        ],
        outputs=[
            Argument(
                "effect",
                "Effect of the fault and its duration, as a sentence",
                type=ua.VariantType.String,
            )
        ],
        required=Role.OPERATOR,
        description="Make something go wrong with this valve, its oil or its sensors",
    )
    await add_variable(
        server,
        place,
        f"{prefix}.UCommand",
        0.0,
        unit=Unit.PERCENT,
        value_range=(low, 100.0),
        writable_by=Role.OPERATOR,
        on_write=lambda U: actions.command_U(name, U),
        description=words,
    )
    if isinstance(unit, ValveBench):
        await add_variable(
            server,
            place,
            f"{prefix}.LoadCommand",
            0.0,
            unit=Unit.BAR,
            value_range=(0.0, MOST_LOAD_BAR),
            writable_by=Role.OPERATOR,
            on_write=lambda load: actions.command_load(name, load),
            description="Set point of p2 from outside; taken by the scenario 'external'",
        )
    await add_variable(
        server,
        place,
        f"{prefix}.Heartbeat",
        0,
        type=ua.VariantType.UInt32,
        writable_by=Role.OPERATOR,
        on_write=lambda count: actions.heartbeat(name, count),
        description="Counts while somebody stands behind the commands; when it stands still for "
        f"{STANDSTILL_S:g} s or goes back to 0, the rig's own apply again; 0 = commands by hand",
    )


def _with_margin(low: float, high: float) -> tuple[float, float]:
    """Return a range that noise around its ends does not leave."""
    margin = 0.05 * (high - low)
    return low - margin, high + margin


async def _add_signals(server: _Place, valve: ua.NodeId, bench: ValveBench) -> Signals:
    p0, Q = bench.circuit.p0_bar, bench.circuit.Q_pump_l_min
    signals = [
        await add_variable(
            server,
            valve,
            f"{valve.Identifier}.{last}",
            None,
            unit=unit,
            value_range=(-0.05 * high, 1.05 * high),  # noise around zero is within the range
            instrument_range=(-0.05 * high, 1.05 * high),
            description=description,
        )
        for last, unit, high, description in (
            ("U", Unit.PERCENT, 100.0, "Control signal"),
            ("p1", Unit.BAR, p0, "Pressure upstream of the valve"),
            ("p2", Unit.BAR, p0, "Pressure downstream of the valve"),
            ("Q", Unit.LITRE_PER_MINUTE, Q, "Flow through the valve"),
            ("Temperature", Unit.DEGREE_CELSIUS, 100.0, "Oil temperature"),
        )
    ]
    return signals, await _add_sequence(server, valve)


async def _add_sequence(server: _Place, place: ua.NodeId) -> Variable:
    return await add_variable(
        server,
        place,
        f"{place.Identifier}.Sequence",
        None,
        type=ua.VariantType.UInt32,
        description="Number of the sample, modulo 2^32; a jump is a loss",
    )
