"""The parts of the results server that add nodes and write them."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial

from asyncua import ua

from guarded_opcua import Clock, HardenedServer, event_fields
from valvemap.opcua_results.alarm_owners import AlarmOwners
from valvemap.opcua_results.axis_nodes import AxisNodes
from valvemap.opcua_results.commission_nodes import CommissionNodes
from valvemap.opcua_results.companions import add_companions
from valvemap.opcua_results.past import AlarmsPast, ResultsPast
from valvemap.opcua_results.process_values import ProcessValues
from valvemap.opcua_results.result_alarms import ResultAlarms
from valvemap.opcua_results.result_blocks import Generations
from valvemap.opcua_results.result_commands import ResultCommands
from valvemap.opcua_results.result_demands import ResultDemands
from valvemap.opcua_results.result_health import ResultHealth
from valvemap.opcua_results.result_nodes import ResultNodes
from valvemap.opcua_results.result_notes import ResultNotes
from valvemap.opcua_results.result_parts import ResultParts
from valvemap.opcua_results.result_publishing import ResultPublishing
from valvemap.opcua_results.result_questions import ResultQuestions
from valvemap.opcua_results.result_service import ResultService
from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.pipeline.alarm_results import AlarmChange
from valvemap.pipeline.operator_ports import Operator
from valvemap.pipeline.store_ports import PastStore


@dataclass(frozen=True)
class ServerParts:
    """Parts of one running server; ``keep_events`` gives emitters of events their history."""

    variables: ResultVariables
    alarms: ResultAlarms
    alarm_owners: AlarmOwners
    demands: ResultDemands
    publishing: ResultPublishing
    nodes: ResultNodes
    service: ResultService
    axes: AxisNodes
    commissions: CommissionNodes
    of_valves: ResultParts
    keep_events: Callable[..., None]


async def server_parts(
    server: HardenedServer,
    operator: Operator,
    clock: Clock,
    slots: ValveSlots,
    blocks: Generations,
    scalars_interval_s: float,
    on_reload: Callable[[], Awaitable[None]] | None,
    past: PastStore | None,
    on_alarm: Callable[[AlarmChange], None] | None,
) -> ServerParts:
    """Create the parts in the order of their dependencies; parameters as of `ResultsServer`."""
    results_past = None if past is None else ResultsPast(past)
    if results_past is not None:
        server.add_history((), results_past)
    companions = await add_companions(server)
    blocks.add(server, slots.shown, clock.now())
    variables = ResultVariables(server, slots, blocks, results_past)
    notes, health = ResultNotes(variables, clock), ResultHealth(server, clock)
    alarm_owners = AlarmOwners(operator)
    alarms = ResultAlarms(
        server,
        slots.shown,
        alarm_owners,
        clock,
        variables.show,
        notes.acted,
        health.stands,
        on_alarm,
    )
    alarms_past = None if past is None else AlarmsPast(past, alarms.event_of)
    keep_events = partial(_keep_events, server, alarms_past)
    demands = ResultDemands(operator, notes, slots.names)
    publishing = ResultPublishing(
        slots,
        blocks,
        variables,
        alarms,
        health,
        operator,
        clock,
        scalars_interval_s,
    )
    parts = ResultParts(
        variables,
        ResultCommands(operator, slots, variables, notes, clock),
        ResultQuestions(operator, notes),
        demands,
        alarms,
    )
    nodes = ResultNodes(
        server,
        companions,
        parts,
        ProcessValues(server, companions, variables),
        alarms,
        health,
        operator,
        publishing.is_heard_of,
        keep_events,
    )
    service = ResultService(server, companions, variables, alarms, health, on_reload)
    axes = AxisNodes(
        server,
        clock,
        variables,
        alarms,
        companions,
        health,
        results_past,
        keep_events,
    )
    return ServerParts(
        variables,
        alarms,
        alarm_owners,
        demands,
        publishing,
        nodes,
        service,
        axes,
        CommissionNodes(server, clock),
        parts,
        keep_events,
    )


def _keep_events(server: HardenedServer, past: AlarmsPast | None, *emitters: ua.NodeId) -> None:
    if past is not None:
        server.add_event_history(emitters, past, event_fields())
