"""The ObjectTypes of the results server, built by the code that creates the instances."""

from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

from asyncua import ua

from guarded_opcua import Declarations, HardenedServer, add_enumeration, add_object, add_type
from valvemap.opcua_results.information_model import (
    ALARMS,
    BASELINE,
    DIAGNOSTICS,
    DYNAMICS,
    INVERSE,
    PARAMETERS,
    SIGNALS,
    TYPES,
)
from valvemap.opcua_results.valve_variables import COUNTERS
from valvemap.pipeline.results import EstimatorDescription, ValveDescription
from valvemap.vocabulary.commission import Phase
from valvemap.vocabulary.dynamics import DynamicsStatus
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import FindingCode
from valvemap.vocabulary.statuses import (
    Adaptation,
    AxisStatus,
    Described,
    InverseStatus,
    LineEdge,
    Status,
)

VALVE, ESTIMATOR, ALARM = "Valve", "Estimator", "Alarm"
_NAMES = {
    VALVE: ("ValveType", "A valve and its results."),
    ESTIMATOR: ("EstimatorType", "Results and commands of one estimator of a valve."),
    INVERSE: ("InverseMapType", "The control voltage that a flow demands."),
    SIGNALS: ("SignalsType", "The newest sample of a valve."),
    BASELINE: ("BaselineType", "The map that was approved as new."),
    DIAGNOSTICS: ("DiagnosticsType", "What became of a valve's data on their way."),
    DYNAMICS: ("DynamicsType", "How quickly the spool and the flow meter of a valve follow."),
    ALARM: ("AlarmType", "An alarm as plain tags."),
}
_NOT_OF_ALL = {
    *("ChangeCount", "ChangeTime", "ChangeSize", "Structure", PARAMETERS, "LagU", "LagQ", "Map"),
    *("Condition",),
}
# has every optional part of a valve and of an estimator
_TEMPLATE = ValveDescription(
    name=TYPES,
    estimators=(
        EstimatorDescription(
            ESTIMATOR,
            "",
            (),
            has_forgetting_factor=True,
            finds_changes=True,
            chooses_structure=True,
            finds_lags=True,
        ),
    ),
    map_Q=(0.0, 1.0),
    map_dp=(0.0, 1.0),
    counters=tuple(COUNTERS),
)
Place = HardenedServer | Declarations  # of instances, of types
AddPart = Callable[[Place, ua.NodeId, ValveDescription], Coroutine[Any, Any, None]]


ENUMERATIONS: tuple[type[Described], ...] = (
    *(Status, Adaptation, InverseStatus, FeedForwardStatus, LineEdge),
    *(FindingCode, AxisStatus, DynamicsStatus, Phase),
)


def add_enumerations(server: HardenedServer) -> None:
    """Add the DataTypes of all published enumerations."""
    for kind in ENUMERATIONS:
        members = [(member.name, member.sentence) for member in kind]
        words = (kind.__doc__ or "").partition("\n")[0]
        add_enumeration(
            server, f"{TYPES}.{kind.__name__}", kind.__name__, members, description=words
        )


def type_of(server: HardenedServer, part: str) -> ua.NodeId:
    """Return the NodeId of the type of a valve or of one of its parts."""
    return ua.NodeId(f"{TYPES}.{part}", server.namespace_index)


async def add_types(
    server: HardenedServer,
    add_valves_own: AddPart,
    add_estimator: Callable[..., Coroutine[Any, Any, None]],
    add_alarm: Callable[[Any, ua.NodeId], Coroutine[Any, Any, None]],
    parts: dict[str, tuple[str, AddPart]],
) -> None:
    """Add all types; their children are created on first access.

    Parameters
    ----------
    add_valves_own
        Adds the variables of the valve itself.
    add_estimator
        Adds the variables and methods of an estimator.
    add_alarm
        Adds the variables and methods of an alarm.
    parts
        For each part of every valve: its description, and the function that adds its contents.
    """

    async def declare_valve(place: Declarations, own: ua.NodeId) -> None:
        prefix = str(own.Identifier)
        named = ValveDescription(name=prefix, estimators=())
        await add_valves_own(place, own, named)
        for part, (words, _) in parts.items():
            kind = type_of(server, part) if part in _NAMES else None
            folder = await add_object(
                place, own, f"{prefix}.{part}", description=words, type_definition=kind
            )
            if part == ALARMS:
                await _add_placeholder(place, folder, "<Alarm>", type_of(server, ALARM))
        await _add_placeholder(place, own, "<Estimator>", type_of(server, ESTIMATOR))

    async def declare_estimator(place: Declarations, own: ua.NodeId) -> None:
        (estimator,) = _TEMPLATE.estimators
        await add_estimator(estimator, place, own, _TEMPLATE)
        words = "The parameters as single variables."
        await add_object(place, own, f"{own.Identifier}.{PARAMETERS}", description=words)

    async def declare(add: AddPart, place: Declarations, own: ua.NodeId) -> None:
        await add(place, own, _TEMPLATE)

    for part, (name, words) in _NAMES.items():
        make: Callable[[Declarations, ua.NodeId], Coroutine[Any, Any, None]]
        if part == VALVE:
            make = declare_valve
        elif part == ESTIMATOR:
            make = declare_estimator
        elif part == ALARM:
            make = add_alarm
        else:
            make = partial(declare, parts[part][1])
        add_type(
            server,
            f"{TYPES}.{part}",
            name,
            make,
            description=words,
            optional=_NOT_OF_ALL,
        )


async def _add_placeholder(
    place: Declarations, parent: ua.NodeId, name: str, kind: ua.NodeId
) -> None:
    await add_object(
        place,
        parent,
        f"{parent.Identifier}.{name}",
        description="As many as there are.",
        type_definition=kind,
    )
