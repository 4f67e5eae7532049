"""The nodes of the rig, and the publication of a block of samples."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

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
from valvemap_rig.faults import SIGNALS, FaultKind, described_sizes
from valvemap_rig.kernels import Floats
from valvemap_rig.scenario import BUILTIN, Scenario, ValveBench
from valvemap_rig.simulation import RigBlock, ValveBlock

GOOD = 0
VALVE_TYPE = "Types.RigValve"
_NOT_OF_ALL = ("ReachableU", "ReachableDp", "InjectFault", "UCommand", "Heartbeat")  # of a fleet's
_REACHABLE_U = np.linspace(0.0, 100.0, 21)

StartScenario = Callable[[str], None]
StopScenario = Callable[[], None]
InjectFault = Callable[[str, str, float, float], str | None]
CommandU = Callable[[str, float], None]
Heartbeat = Callable[[str, int], None]
_Place = HardenedServer | Declarations
Signals = tuple[list[Variable], Variable]  # U, p1, p2, Q, T; sequence
Updates = list[tuple[Variable, object, int, int]]


@dataclass(frozen=True)
class Actions:
    """Actions of operators: method calls, and writes of ``UCommand`` and ``Heartbeat``."""

    start_scenario: StartScenario
    stop_scenario: StopScenario
    inject_fault: InjectFault
    command_U: CommandU
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


NOTHING = RigBlock(np.empty(0, np.uint32), np.empty(0, np.int64), {})


async def add_rig(server: HardenedServer, scenario: Scenario, actions: Actions) -> RigNodes:
    """Add all nodes of the rig below Objects/TestRig."""
    kind = _add_valve_type(server, scenario)
    rig = await add_object(server, None, "TestRig", description="Test rig with proportional valves")
    await _add_methods(server, rig, scenario, actions)
    text = ua.VariantType.String
    names = [*dict.fromkeys((scenario.name, *BUILTIN))]
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

    ``values``, ``times``, ``codes`` and ``present`` have a column for each signal of each valve,
    ``sequences`` and ``t`` one for each valve. The signals of a sample share their timestamp.
    """

    values: Floats
    times: NDArray[np.int64]
    codes: NDArray[np.uint32]
    present: NDArray[np.bool_]
    sequences: NDArray[np.int64]
    t: NDArray[np.int64]


def columns_of(block: RigBlock, sequence_offset: int) -> Columns:
    """Convert a whole block to columns, of which single rows can be published."""
    valves = list(block.valves.values())
    t = np.stack([valve.t for valve in valves], axis=1)
    sequence = (block.sequence.astype(np.int64) + sequence_offset) % 2**32
    return Columns(
        values=_columns([getattr(valve, signal) for valve in valves for signal in SIGNALS]),
        times=np.repeat(t, len(SIGNALS), axis=1),
        codes=_columns([valve.status[signal] for valve in valves for signal in SIGNALS]),
        present=_columns([valve.present[signal] for valve in valves for signal in SIGNALS]),
        sequences=np.repeat(sequence[:, None], len(valves), axis=1),
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
    valves = {
        name: ValveBlock(
            **{
                field.name: _cut(getattr(samples, field.name), chosen)
                for field in fields(ValveBlock)
            }
        )
        for name, samples in block.valves.items()
    }
    return RigBlock(block.sequence[chosen], block.t[chosen], valves)


def _blocks(server: HardenedServer, valves: Sequence[Signals]) -> tuple[Block, Block]:
    return (
        server.add_block([variable for signals, _ in valves for variable in signals]),
        server.add_block([sequence for _, sequence in valves]),
    )


def _columns(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.stack(arrays, axis=1)


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
    names = ", ".join(dict.fromkeys((scenario.name, *BUILTIN)))
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
        nobody = Actions(nothing, nothing, nothing, nothing, nothing)
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
    prefix, name, circuit = valve.Identifier, bench.name, bench.circuit
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
    await add_method(
        server,
        valve,
        f"{prefix}.InjectFault",
        lambda kind, size, duration: actions.inject_fault(name, kind, size, duration),
        inputs=[
            Argument(
                "kind",
                f"One of: {', '.join(FaultKind)}; with .U, .p1, .p2, .Q or .T behind that of a "
                "sensor",
                type=ua.VariantType.String,
            ),
            Argument(
                "size",
                described_sizes(),
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
        valve,
        f"{prefix}.UCommand",
        0.0,
        unit=Unit.PERCENT,
        value_range=(0.0, 100.0),
        writable_by=Role.OPERATOR,
        on_write=lambda U: actions.command_U(name, U),
        description="Control signal from outside; taken by the scenario 'external'",
    )
    await add_variable(
        server,
        valve,
        f"{prefix}.Heartbeat",
        0,
        type=ua.VariantType.UInt32,
        writable_by=Role.OPERATOR,
        on_write=lambda count: actions.heartbeat(name, count),
        description="Counts while somebody stands behind UCommand; when it stands still for "
        f"{STANDSTILL_S:g} s or goes back to 0, U is the rig's own again; 0 = UCommand by hand",
    )
    return await _add_signals(server, valve, bench)


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
            ("p1", Unit.BAR, p0, "Pressure before the valve"),
            ("p2", Unit.BAR, p0, "Pressure behind the valve"),
            ("Q", Unit.LITRE_PER_MINUTE, Q, "Flow through the valve"),
            ("Temperature", Unit.DEGREE_CELSIUS, 100.0, "Oil temperature"),
        )
    ]
    sequence = await add_variable(
        server,
        valve,
        f"{valve.Identifier}.Sequence",
        None,
        type=ua.VariantType.UInt32,
        description="Number of the sample, modulo 2^32; a jump is a loss",
    )
    return signals, sequence
