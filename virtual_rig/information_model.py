"""What the rig publishes: its nodes, and how a block of samples becomes updates of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from asyncua import ua

from service.opcua.hardened import (
    Argument,
    HardenedServer,
    Role,
    Unit,
    Variable,
    add_method,
    add_object,
    add_variable,
)
from virtual_rig.circuit import largest_drop
from virtual_rig.faults import FaultKind
from virtual_rig.scenario import BUILTIN, Scenario, ValveBench
from virtual_rig.simulation import RigBlock, ValveBlock

GOOD = 0
_REACHABLE_U = np.linspace(0.0, 100.0, 21)

StartScenario = Callable[[str], None]
StopScenario = Callable[[], None]
InjectFault = Callable[[str, str, float, float], None]
CommandU = Callable[[str, float], None]
Update = tuple[Variable, object, int, int]


@dataclass(frozen=True)
class Actions:
    """What operators can do, by method call and by writing ``UCommand``."""

    start_scenario: StartScenario
    stop_scenario: StopScenario
    inject_fault: InjectFault
    command_U: CommandU


@dataclass(frozen=True)
class ValveNodes:
    """The variables of one valve."""

    U: Variable
    p1: Variable
    p2: Variable
    Q: Variable
    T: Variable
    sequence: Variable
    U_command: Variable

    @property
    def signals(self) -> tuple[tuple[str, Variable], ...]:
        """The measured signals by their names in a block."""
        return (
            ("U", self.U),
            ("p1", self.p1),
            ("p2", self.p2),
            ("Q", self.Q),
            ("T", self.T),
        )


@dataclass(frozen=True)
class RigNodes:
    """The variables of the rig itself and of its valves."""

    scenario: Variable
    sample_count: Variable
    late_ticks: Variable
    lag: Variable
    overflows: Variable
    valves: Mapping[str, ValveNodes]


NOTHING = RigBlock(np.empty(0, np.uint32), np.empty(0, np.int64), {})


async def add_rig(server: HardenedServer, scenario: Scenario, actions: Actions) -> RigNodes:
    """Add all nodes of the rig below Objects/TestRig."""
    rig = await add_object(server, None, "TestRig", description="Test rig with proportional valves")
    await _add_methods(server, rig, scenario, actions)
    text, count = ua.VariantType.String, ua.VariantType.UInt32
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
    rate_range = (1.0, 100_000.0)
    await add_variable(
        server,
        rig,
        "Rig.SampleRate",
        scenario.sample_rate_hz * scenario.time_factor,
        unit=Unit.HERTZ,
        value_range=rate_range,
        description="Samples per second of real time",
    )
    return RigNodes(
        scenario=await add_variable(
            server, rig, "Rig.Scenario", "", type=text, description="Running scenario, or empty"
        ),
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
            type=count,
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
        valves={
            bench.name: await _add_valve(server, rig, bench, actions) for bench in scenario.valves
        },
    )


def updates(nodes: RigNodes, block: RigBlock, sequence_offset: int) -> list[Update]:
    """Turn a block into updates, sample by sample; one sample's signals share their time.

    A signal that is not present is left out; ``Sequence`` never is.
    """
    columns = []
    sequence = ((block.sequence.astype(np.int64) + sequence_offset) % 2**32).tolist()
    for name, valve in nodes.valves.items():
        samples = block.valves[name]
        t = samples.t.tolist()
        for signal, variable in valve.signals:
            values = getattr(samples, signal).tolist()
            status = samples.status[signal].tolist()  # type: ignore[index]
            present = samples.present[signal].tolist()  # type: ignore[index]
            columns.append((variable, values, status, present, t))
        columns.append((valve.sequence, sequence, [GOOD] * len(t), [True] * len(t), t))
    return [
        (variable, values[i], status[i], t[i])
        for i in range(len(block))
        for variable, values, status, present, t in columns
        if present[i]
    ]


def part(block: RigBlock, start: int, stop: int) -> RigBlock:
    """Samples ``start`` to ``stop`` of a block, as views."""
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


def _cut(column: Any, chosen: slice) -> Any:  # noqa: ANN401 - an array, or arrays by signal
    if isinstance(column, Mapping):
        return {signal: array[chosen] for signal, array in column.items()}
    return column[chosen]


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


async def _add_valve(
    server: HardenedServer, rig: ua.NodeId, bench: ValveBench, actions: Actions
) -> ValveNodes:
    name, circuit = bench.name, bench.circuit
    valve = await add_object(server, rig, name, description="Proportional valve on its bench")

    async def signal(last: str, unit: Unit, high: float, description: str) -> Variable:
        low = -0.05 * high  # noise around zero is no error
        return await add_variable(
            server,
            valve,
            f"{name}.{last}",
            None,
            unit=unit,
            value_range=(low, 1.05 * high),
            description=description,
        )

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
            f"{name}.{last}",
            values,
            unit=unit,
            value_range=(0.0, high),
            dimensions=(len(values),),
            description=description,
        )
    await add_method(
        server,
        valve,
        f"{name}.InjectFault",
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
                "wear, damage: % of the flow; temperature_ramp: K; spikes, offset: the signal's "
                "unit; bad_quality, uncertain_quality, drop_out: share of samples 0 to 1; "
                "clock_step: s",
            ),
            Argument(
                "duration",
                "Simulated time; 0 = for good",
                unit=Unit.SECOND,
                value_range=(0.0, 1e9),
            ),
        ],
        required=Role.OPERATOR,
        description="Make something go wrong with this valve, its oil or its sensors",
    )
    return ValveNodes(
        U=await signal("U", Unit.PERCENT, 100.0, "Control signal"),
        p1=await signal("p1", Unit.BAR, circuit.p0_bar, "Pressure before the valve"),
        p2=await signal("p2", Unit.BAR, circuit.p0_bar, "Pressure behind the valve"),
        Q=await signal("Q", Unit.LITRE_PER_MINUTE, circuit.Q_pump_l_min, "Flow through the valve"),
        T=await signal("Temperature", Unit.DEGREE_CELSIUS, 100.0, "Oil temperature"),
        sequence=await add_variable(
            server,
            valve,
            f"{name}.Sequence",
            None,
            type=ua.VariantType.UInt32,
            description="Number of the sample, modulo 2^32; a jump is a loss",
        ),
        U_command=await add_variable(
            server,
            valve,
            f"{name}.UCommand",
            0.0,
            unit=Unit.PERCENT,
            value_range=(0.0, 100.0),
            writable_by=Role.OPERATOR,
            on_write=lambda U: actions.command_U(name, U),
            description="Control signal from outside; taken by the scenario 'external'",
        ),
    )
