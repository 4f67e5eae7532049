"""The results server: publishes the results to OPC UA clients and accepts operator commands."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial

import numpy as np
from asyncua import ua

from guarded_opcua import (
    Clock,
    HardenedServer,
    ServerSettings,
    Startable,
    SystemClock,
    add_object,
    add_property,
    event_fields,
    many_nodes,
)
from valvemap.model.samples import Times
from valvemap.opcua_results.alarm_owners import AlarmOwners
from valvemap.opcua_results.axis_nodes import AxisNodes
from valvemap.opcua_results.commission_nodes import CommissionNodes
from valvemap.opcua_results.companions import add_companions
from valvemap.opcua_results.information_model import INVERSE, NAMESPACE, NODE_VERSION, ROOT, SERVICE
from valvemap.opcua_results.model_changes import axes_change, model_change, version_of_root
from valvemap.opcua_results.node_names import check_axis_names, check_names
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
from valvemap.opcua_results.result_types import VALVE, add_enumerations, add_types, type_of
from valvemap.opcua_results.result_values import Shown
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.opcua_results.successive_operator import SuccessiveOperator
from valvemap.pipeline.alarm_results import AlarmChange
from valvemap.pipeline.axis_ports import AxisOperator, AxisResults
from valvemap.pipeline.commission_ports import CommissionResults
from valvemap.pipeline.operator_ports import Operator
from valvemap.pipeline.result_ports import Health
from valvemap.pipeline.results import Results, ValveDescription
from valvemap.pipeline.store_ports import PastStore

__all__ = ["NAMESPACE", "ResultsServer"]

_SAID_FOR_S = 600.0  # a model change event is kept for clients that reconnect


class ResultsServer(Startable):
    """Publishes results, accepts commands; a :class:`~valvemap.pipeline.result_ports.ResultSink`.

    Use it with ``async with``, or call :meth:`start` and :meth:`stop`.

    Parameters
    ----------
    settings
        Address, security, users; the namespace must be ``urn:valvemap:service``.
    valves
        The valves to show.
    operator
        Carries out commands and answers queries.
    clock
        Source time of values without a sample.
    scalars_interval_s
        Minimum time between two updates of a valve's scalar variables; its Frame has every result.
        Bad values are always published immediately.
    on_reload
        Carries out the method Reload; raises CommandRejected on failure. None: no such method.
    past
        The history of signals, results and alarms; None: no history.
    on_alarm
        Called with each change of an alarm, to store it.
    before
        The valves shown by the previous server, if this one replaces it: clients that reconnect
        receive a model change event. None: there was no previous server.
    """

    def __init__(
        self,
        settings: ServerSettings,
        valves: Sequence[ValveDescription],
        operator: Operator,
        clock: Clock | None = None,
        scalars_interval_s: float = 0.0,
        on_reload: Callable[[], Awaitable[None]] | None = None,
        past: PastStore | None = None,
        on_alarm: Callable[[AlarmChange], None] | None = None,
        before: Sequence[ValveDescription] | None = None,
    ) -> None:
        check_names(valves)
        self._settings = settings
        self._in_charge = SuccessiveOperator(operator)
        self._clock = clock or SystemClock()
        self._scalars_interval_s = scalars_interval_s
        self._on_reload = on_reload
        self._past = past
        self._on_alarm = on_alarm
        self._before = before
        self._slots = ValveSlots(valves)
        self._blocks = Generations()
        self._server: HardenedServer | None = None
        self._variables: ResultVariables  # this and the following are set by start()
        self._alarms: ResultAlarms
        self._alarm_owners: AlarmOwners
        self._alarms_past: AlarmsPast | None
        self._demands: ResultDemands
        self._publishing: ResultPublishing
        self._nodes: ResultNodes
        self._service: ResultService
        self._axes: AxisNodes
        self._axis_names: tuple[str, ...] | None = None  # none were asked for yet
        self.commissions: CommissionNodes

    @property
    def url(self) -> str:
        """The endpoint URL that clients connect to."""
        return self._settings.url if self._server is None else self._server.url

    async def start(self) -> None:
        """Create the folders of all valves, then listen.

        The children of a valve's folder are created on first access.

        Raises
        ------
        ServerError
            if the address is in use or not an address of this host.
        CertificateError
            if the certificate or key cannot be loaded or created.
        """
        server = await HardenedServer.create(self._settings, self._clock)
        root = await add_object(
            server, None, ROOT, description="Flow maps of hydraulic valves, identified online."
        )
        parts = await self._furnish(server)
        shown = self._slots.shown
        await add_property(server, root, NODE_VERSION, version_of_root(shown))
        server.let_emit(root, ua.NodeId(ua.ObjectIds.Server))
        with many_nodes():
            add_enumerations(server)
            await add_types(
                server,
                parts.add_frame,
                parts.add_estimator,
                parts.declare_alarm,
                parts.of_every_valve(),
            )
            for valve in shown:
                await self._nodes.add(valve)
            await self._service.add(root)
        service = ua.NodeId(SERVICE, server.namespace_index)
        self._keep_events(server, root, service, ua.NodeId(ua.ObjectIds.Server))
        await server.start()
        self._server = server
        if self._before is not None:
            self._say_what_changed(server, self._before, shown)

    async def follow(
        self,
        valves: Sequence[ValveDescription],
        operator: Operator,
        scalars_interval_s: float = 0.0,
        on_alarm: Callable[[AlarmChange], None] | None = None,
    ) -> None:
        """Switch to the valves of another operator; sessions and subscriptions continue.

        Valves with an unchanged description keep their nodes, so clients that monitor them lose no
        data. Nodes of other valves are added and removed; the Server object emits a model change
        event.

        Raises
        ------
        ConfigurationError
            if a name is invalid; nothing has changed then.
        """
        check_names(valves)
        server, names = self._server, [valve.name for valve in valves]
        assert server is not None  # noqa: S101 - it was started
        change = self._slots.follow(valves)
        self._nodes.remove(change.gone)
        self._variables.forget(change.gone)
        self._in_charge.hand_over(operator)
        self._blocks.keep(change.kept)
        self._blocks.add(server, change.came, self._clock.now())
        self._publishing.follow(scalars_interval_s)
        self._alarms.follow(self._slots.names, names, on_alarm)
        self._demands.follow(names, change.gone)
        with many_nodes():
            for valve in change.came:
                await self._nodes.add(valve)
        await self._demands.repeat()
        self._say_what_changed(server, change.before, change.after)

    async def follow_axes(self, axes: Sequence[str], operator: AxisOperator | None) -> None:
        """Show these axes, in place of those before; ``operator`` is None if there are none.

        Raises
        ------
        ConfigurationError
            if a name is invalid.
        """
        check_axis_names(axes)
        before = tuple(axes) if self._axis_names is None else self._axis_names
        self._axis_names = tuple(axes)
        with many_nodes():
            self._alarm_owners.follow_axes(axes, operator)
            await self._axes.follow(axes, operator)
        server = self._server
        if server is not None:
            self._renew_version(server, self._slots.shown)
            event = axes_change(before, axes, server.namespace_index, self._clock.now())
            if event is not None:
                server.events.stand(event, _SAID_FOR_S)

    def show_axis(self, axis: str, results: AxisResults) -> None:
        """Publish the results of one axis; fulfils `AxisSink`."""
        if self._server is not None:
            self._axes.show(axis, results)

    def show_commission(self, valve: str, results: CommissionResults) -> None:
        """Show how the run of one valve stands; fulfils `CommissionSink`."""
        if self._server is not None:
            self.commissions.show(valve, results)

    def show_demands(self, demands: Mapping[str, tuple[float, float]]) -> None:
        """Show demands that stand from before a restart, by valve: l/min, bar."""
        now, good = self._clock.now(), int(ua.StatusCodes.Good)
        self._demands.stand(demands)
        for valve, values in demands.items():
            for name, value in zip(("FlowDemand", "PressureDrop"), values, strict=True):
                if not np.isnan(value):
                    self._variables.show(valve, Shown(f"{INVERSE}.{name}", value, good, now))

    def take_no_commands(self) -> None:
        """Reject commands until another operator follows; queries are still answered."""
        self._in_charge.refuses = True

    async def stop(self) -> None:
        """Close every session and stop listening; safe to call twice."""
        server, self._server = self._server, None
        if server is not None:
            await server.stop()

    async def publish(self, results: Results) -> None:
        """Publish results; a later call for the same valve replaces the earlier one."""
        if self._server is not None and len(results.valves):
            self._publishing.publish(results)

    async def doubt(self, valves: Times) -> None:
        """Mark Good values of the given valves as Uncertain: their sample is old."""
        if self._server is not None and len(valves):
            self._publishing.doubt(valves)

    async def show_health(self, health: Health) -> None:
        """Publish the state of the service itself."""
        if self._server is not None:
            now = self._clock.now()
            self._publishing.publish_waits(health, now)
            self._service.show(health, now)

    async def _furnish(self, server: HardenedServer) -> ResultParts:
        """Create the objects that add nodes and write them, in the order of their dependencies."""
        operator, clock, slots = self._in_charge.as_operator(), self._clock, self._slots
        past = None if self._past is None else ResultsPast(self._past)
        if past is not None:
            server.add_history((), past)
        companions = await add_companions(server)
        self._blocks.add(server, slots.shown, clock.now())
        variables = ResultVariables(server, slots, self._blocks, past)
        notes, health = ResultNotes(variables, clock), ResultHealth(server, clock)
        self._alarm_owners = AlarmOwners(operator)
        alarms = ResultAlarms(
            server,
            slots.shown,
            self._alarm_owners,
            clock,
            variables.show,
            notes.acted,
            health.stands,
            self._on_alarm,
        )
        self._alarms_past = None if self._past is None else AlarmsPast(self._past, alarms.event_of)
        demands = ResultDemands(operator, notes, slots.names)
        self._publishing = ResultPublishing(
            slots,
            self._blocks,
            variables,
            alarms,
            health,
            operator,
            clock,
            self._scalars_interval_s,
        )
        parts = ResultParts(
            variables,
            ResultCommands(operator, slots, variables, notes, clock),
            ResultQuestions(operator, notes),
            demands,
            alarms,
        )
        self._nodes = ResultNodes(
            server,
            companions,
            parts,
            ProcessValues(server, companions, variables),
            alarms,
            health,
            operator,
            self._publishing.is_heard_of,
            partial(self._keep_events, server),
        )
        self._service = ResultService(
            server, companions, variables, alarms, health, self._on_reload
        )
        self._variables, self._alarms, self._demands = variables, alarms, demands
        self._axes = AxisNodes(
            server,
            clock,
            variables,
            alarms,
            companions,
            health,
            past,
            partial(self._keep_events, server),
        )
        self.commissions = CommissionNodes(server, clock)
        return parts

    def _keep_events(self, server: HardenedServer, *emitters: ua.NodeId) -> None:
        if self._alarms_past is not None:
            server.add_event_history(emitters, self._alarms_past, event_fields())

    def _say_what_changed(
        self,
        server: HardenedServer,
        before: Sequence[ValveDescription],
        after: Sequence[ValveDescription],
    ) -> None:
        kind, now = type_of(server, VALVE), self._clock.now()
        event = model_change(before, after, server.namespace_index, kind, now)
        if event is not None:
            self._renew_version(server, after)
            server.events.stand(event, _SAID_FOR_S)

    def _renew_version(self, server: HardenedServer, valves: Sequence[ValveDescription]) -> None:
        node = ua.NodeId(f"{ROOT}.{NODE_VERSION}", server.namespace_index)
        version = version_of_root(valves, self._axis_names or ())
        server.write_property(node, ua.Variant(version, ua.VariantType.String))
