"""The nodes of one valve or machine: its signals, and the variables and methods of operators."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from asyncua import ua

from guarded_opcua import (
    Argument,
    Declarations,
    HardenedServer,
    Role,
    Unit,
    Variable,
    add_method,
    add_type,
    add_variable,
)
from valvemap_rig.circuit import largest_drop
from valvemap_rig.command import STANDSTILL_S
from valvemap_rig.faults import described_sizes
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import Scenario, ValveBench, faultable
from valvemap_rig.simulation import MOST_LOAD_BAR

VALVE_TYPE = "Types.RigValve"
_NOT_OF_ALL = (  # of a fleet's
    *("ReachableU", "ReachableDp", "InjectFault"),
    *("UCommand", "LoadCommand", "Heartbeat"),
)
_REACHABLE_U = np.linspace(0.0, 100.0, 21)
_UNITS: Final = {
    "%": Unit.PERCENT,
    "bar": Unit.BAR,
    "l/min": Unit.LITRE_PER_MINUTE,
    "°C": Unit.DEGREE_CELSIUS,
    "mm": Unit.MILLIMETRE,
    "mm/s": Unit.MILLIMETRE_PER_SECOND,
}

StartScenario = Callable[[str], None]
StopScenario = Callable[[], None]
InjectFault = Callable[[str, str, float, float], str | None]
CommandU = Callable[[str, float], None]
CommandLoad = Callable[[str, float], None]
Heartbeat = Callable[[str, int], None]
_Place = HardenedServer | Declarations
Signals = tuple[list[Variable], Variable]  # U, p1, p2, Q, T; sequence


@dataclass(frozen=True)
class Actions:
    """Actions of operators: method calls, and writes of the two commands and ``Heartbeat``."""

    start_scenario: StartScenario
    stop_scenario: StopScenario
    inject_fault: InjectFault
    command_U: CommandU
    command_load: CommandLoad
    heartbeat: Heartbeat


def add_valve_type(server: HardenedServer, scenario: Scenario) -> ua.NodeId:
    """Add the ObjectType of the valves, using the code that adds the valves."""

    def nothing(*_: object) -> None:
        """Do nothing: methods of the type are never called."""

    async def declare(place: Declarations, own: ua.NodeId) -> None:
        nobody = Actions(*(nothing,) * 6)
        await add_valve_parts(place, own, scenario.valves[0], nobody)

    return add_type(
        server,
        VALVE_TYPE,
        "RigValveType",
        declare,
        description="A proportional valve on its bench, or of a recording.",
        optional=_NOT_OF_ALL,
    )


async def add_valve_parts(
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
    return await add_signals(server, valve, bench)


async def add_machine_parts(
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


async def add_signals(server: _Place, valve: ua.NodeId, bench: ValveBench) -> Signals:
    """Add the signals of a valve, without a value yet."""
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
