"""The results server: publishes the results to OPC UA clients and accepts operator commands."""

from collections.abc import Awaitable, Callable, Mapping, Sequence

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
    many_nodes,
)
from valvemap.model.samples import Times
from valvemap.opcua_results.commission_nodes import CommissionNodes
from valvemap.opcua_results.information_model import INVERSE, NAMESPACE, NODE_VERSION, ROOT, SERVICE
from valvemap.opcua_results.model_announcements import ModelAnnouncements
from valvemap.opcua_results.model_changes import version_of_root
from valvemap.opcua_results.node_names import check_axis_names, check_names
from valvemap.opcua_results.result_blocks import Generations
from valvemap.opcua_results.result_slots import ValveSlots
from valvemap.opcua_results.result_types import add_enumerations, add_types
from valvemap.opcua_results.result_values import Shown
from valvemap.opcua_results.server_parts import ServerParts, server_parts
from valvemap.opcua_results.successive_operator import SuccessiveOperator
from valvemap.pipeline.alarm_results import AlarmChange
from valvemap.pipeline.axis_ports import AxisOperator, AxisResults
from valvemap.pipeline.commission_ports import CommissionResults
from valvemap.pipeline.operator_ports import Operator
from valvemap.pipeline.result_ports import Health
from valvemap.pipeline.results import Results, ValveDescription
from valvemap.pipeline.store_ports import PastStore

__all__ = ["NAMESPACE", "ResultsServer"]


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
        self._parts: ServerParts  # this and the following are set by start()
        self._announcements: ModelAnnouncements
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
        parts = self._parts = await server_parts(
            server,
            self._in_charge.as_operator(),
            self._clock,
            self._slots,
            self._blocks,
            self._scalars_interval_s,
            self._on_reload,
            self._past,
            self._on_alarm,
        )
        self.commissions = parts.commissions
        self._announcements = ModelAnnouncements(server, self._clock)
        shown = self._slots.shown
        await add_property(server, root, NODE_VERSION, version_of_root(shown))
        server.let_emit(root, ua.NodeId(ua.ObjectIds.Server))
        with many_nodes():
            add_enumerations(server)
            await add_types(
                server,
                parts.of_valves.add_frame,
                parts.of_valves.add_estimator,
                parts.of_valves.declare_alarm,
                parts.of_valves.of_every_valve(),
            )
            for valve in shown:
                await parts.nodes.add(valve)
            await parts.service.add(root)
        service = ua.NodeId(SERVICE, server.namespace_index)
        parts.keep_events(root, service, ua.NodeId(ua.ObjectIds.Server))
        await server.start()
        self._server = server
        if self._before is not None:
            self._announcements.announce_valves(self._before, shown)

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
        server, parts, names = self._server, self._parts, [valve.name for valve in valves]
        assert server is not None  # noqa: S101 - it was started
        change = self._slots.follow(valves)
        parts.nodes.remove(change.gone)
        parts.variables.forget(change.gone)
        self._in_charge.hand_over(operator)
        self._blocks.keep(change.kept)
        self._blocks.add(server, change.came, self._clock.now())
        parts.publishing.follow(scalars_interval_s)
        parts.alarms.follow(self._slots.names, names, on_alarm)
        parts.demands.follow(names, change.gone)
        with many_nodes():
            for valve in change.came:
                await parts.nodes.add(valve)
        await parts.demands.repeat()
        self._announcements.announce_valves(change.before, change.after)

    async def follow_axes(self, axes: Sequence[str], operator: AxisOperator | None) -> None:
        """Show these axes, in place of those before; ``operator`` is None if there are none.

        Raises
        ------
        ConfigurationError
            if a name is invalid.
        """
        check_axis_names(axes)
        before = self._announcements.note_axes(axes)
        with many_nodes():
            self._parts.alarm_owners.follow_axes(axes, operator)
            await self._parts.axes.follow(axes, operator)
        if self._server is not None:
            self._announcements.announce_axes(before, axes, self._slots.shown)

    def show_axis(self, axis: str, results: AxisResults) -> None:
        """Publish the results of one axis; fulfils `AxisSink`."""
        if self._server is not None:
            self._parts.axes.show(axis, results)

    def show_commission(self, valve: str, results: CommissionResults) -> None:
        """Show how the run of one valve stands; fulfils `CommissionSink`."""
        if self._server is not None:
            self.commissions.show(valve, results)

    def show_demands(self, demands: Mapping[str, tuple[float, float]]) -> None:
        """Show demands that stand from before a restart, by valve: l/min, bar."""
        now, good = self._clock.now(), int(ua.StatusCodes.Good)
        self._parts.demands.stand(demands)
        for valve, values in demands.items():
            for name, value in zip(("FlowDemand", "PressureDrop"), values, strict=True):
                if not np.isnan(value):
                    self._parts.variables.show(valve, Shown(f"{INVERSE}.{name}", value, good, now))

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
            self._parts.publishing.publish(results)

    async def doubt(self, valves: Times) -> None:
        """Mark Good values of the given valves as Uncertain: their sample is old."""
        if self._server is not None and len(valves):
            self._parts.publishing.doubt(valves)

    async def show_health(self, health: Health) -> None:
        """Publish the state of the service itself."""
        if self._server is not None:
            now = self._clock.now()
            self._parts.publishing.publish_waits(health, now)
            self._parts.service.show(health, now)
