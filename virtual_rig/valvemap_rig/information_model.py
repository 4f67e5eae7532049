"""The nodes of the rig: its status, its scenarios, its valves and machines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from asyncua import ua

from guarded_opcua import (
    Argument,
    Block,
    HardenedServer,
    Role,
    Unit,
    Variable,
    add_method,
    add_object,
    add_variable,
)
from valvemap_rig.scenario import BUILTIN, Scenario
from valvemap_rig.unit_nodes import (
    Actions,
    Signals,
    add_machine_parts,
    add_signals,
    add_valve_parts,
    add_valve_type,
)

GOOD = 0
Updates = list[tuple[Variable, object, int, int]]


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
    kind = add_valve_type(server, scenario) if scenario.valves else None
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
        valves.append(await add_valve_parts(server, valve, bench, actions))
    for machine in scenario.machines:
        words = "4/3 valve with its cylinder"
        place = await add_object(server, rig, machine.name, description=words)
        valves.append(await add_machine_parts(server, place, machine, actions))
    return RigNodes(status, *_blocks(server, valves), scenario=running, of_valves=valves)


async def add_fleet(server: HardenedServer, scenario: Scenario, names: Sequence[str]) -> FleetNodes:
    """Add the nodes of a fleet, without methods and commands, below Objects/TestRig."""
    kind = add_valve_type(server, scenario)
    rig = await add_object(server, None, "TestRig", description="Many valves, from a recording")
    status = await _add_status(server, rig, scenario)
    valves = []
    for name in names:
        words = "Valve from a recording"
        valve = await add_object(server, rig, name, description=words, type_definition=kind)
        valves.append(await add_signals(server, valve, scenario.valves[0]))
    return FleetNodes(status, *_blocks(server, valves))


def _blocks(server: HardenedServer, valves: Sequence[Signals]) -> tuple[Block, Block]:
    return (
        server.add_block([variable for signals, _ in valves for variable in signals]),
        server.add_block([sequence for _, sequence in valves]),
    )


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
