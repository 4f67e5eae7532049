"""The results server: what was identified, for any OPC UA client, and what operators may do."""

from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from inspect import isawaitable
from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from service.errors import CommandRejected
from service.hardened import (
    Argument,
    Clock,
    Declarations,
    HardenedServer,
    OutOfRange,
    Role,
    ServerSettings,
    Startable,
    SystemClock,
    Unit,
    Variable,
    add_method,
    add_object,
    add_property,
    add_variable,
    caller,
    event_fields,
    many_nodes,
)
from service.hardened import CommandRejected as Refused
from service.identification.inversion import InverseStatus
from service.identification.samples import Floats, Quality, Status
from service.identification.survey import axes
from service.opcua.answers import answered, say_nothing
from service.opcua.changed_results import ChangedResults
from service.opcua.companions import Companions, add_companions
from service.opcua.information_model import (
    ALARMS,
    ARMED,
    BASELINE,
    DIAGNOSTICS,
    FEED_FORWARD_STATUS,
    INVERSE,
    LAST_ACTION,
    NAMESPACE,
    NODE_VERSION,
    PARAMETERS,
    PENDING,
    ROOT,
    SAMPLE_AGE,
    SERVICE,
    SIGNALS,
    U_RANGE,
    VariableNode,
    alarm_variables,
    axis,
    baseline_variables,
    builds_on_variable,
    check_names,
    counter_variable,
    discovery_variables,
    estimator_variables,
    health_variables,
    inverse_variables,
    lag_variables,
    last_action,
    map_variable,
    parameter_variables,
    service_variables,
    signal_variables,
    survey_axes,
    survey_variables,
    timing_variable,
    waiting_variable,
)
from service.opcua.model_changes import model_change, version_of_root, version_of_valve
from service.opcua.past import AlarmsPast, ResultsPast, has_past
from service.opcua.result_alarms import ResultAlarms
from service.opcua.result_blocks import Generations
from service.opcua.result_frames import frame_names, frame_variables, frames
from service.opcua.result_health import ResultHealth
from service.opcua.result_types import ESTIMATOR, VALVE, add_types, type_of
from service.opcua.result_values import (
    Column,
    Shown,
    baseline_values,
    columns_of,
    service_values,
)
from service.opcua.successive_operator import SuccessiveOperator
from service.streaming.feedforward import FeedForwardStatus
from service.streaming.ports import (
    AlarmChange,
    AlarmReport,
    Answer,
    EstimatorDescription,
    Health,
    Operator,
    PastStore,
    Results,
    ValveDescription,
)

__all__ = ["NAMESPACE", "ResultsServer"]

_PARTS = {
    f"{SERVICE}.Checkpoint": "Whether what was learnt survives a restart.",
    f"{SERVICE}.History": "What signals and results have been: whether it is kept.",
    f"{SERVICE}.Source": "What came from the source since the service started.",
}
_AddPart = Callable[["_Place", ua.NodeId, ValveDescription], Coroutine[Any, Any, None]]
_Place = HardenedServer | Declarations
_SAID_FOR_S = 600.0  # what another configuration changed, to clients that come back
_IMAGE_ITEM_TYPE = ua.NodeId(12047)
_STATUS = Argument("Status", "How far the answer can be trusted", ua.VariantType.Int32)
_U = Argument("U", "Control voltage", unit=Unit.PERCENT, value_range=U_RANGE)
_dp = Argument("dp", "Pressure drop p1 - p2", unit=Unit.BAR)
_T = Argument(
    "T",
    "Oil temperature; NaN takes the one measured last",
    unit=Unit.DEGREE_CELSIUS,
    or_nan=True,
)


class ResultsServer(Startable):
    """Shows results and takes commands; fulfils :class:`~service.streaming.ports.ResultSink`.

    Use it with ``async with``, or call :meth:`start` and :meth:`stop`.

    Parameters
    ----------
    settings
        Address, security, users; the namespace must be ``urn:valvemap:service``.
    valves
        What there is to show.
    operator
        Who carries out commands and answers questions.
    clock
        Stamps what no sample is behind.
    scalars_interval_s
        Shortest time between two results of a valve in its single variables; its Frame has them
        all. What is Bad never waits.
    on_reload
        Carries out the method Reload: raises CommandRejected where it cannot; None: there is none.
    past
        What signals, results and alarms have been; None: that cannot be asked.
    on_alarm
        Takes each change of an alarm, to be kept.
    before
        What was shown until now, where this server follows another: who comes back hears what has
        changed; None: nobody comes back.
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
        self._valves = list(valves)  # by slot, for good: also those that are gone
        self._in_charge = SuccessiveOperator(operator)
        self._operator = self._in_charge.as_operator()
        self._clock = clock or SystemClock()
        self._server: HardenedServer | None = None
        self._variables: dict[str, Variable] = {}
        self._not_shown: dict[str, Shown] = {}  # the newest of what has no node yet, by id
        self._slots = {valve.name: slot for slot, valve in enumerate(self._valves)}
        self._slot_of = np.arange(len(self._valves))  # of each of the operator's valves
        self._demands = {valve.name: (np.nan, np.nan) for valve in self._valves}
        self._sequences = np.zeros(len(self._valves), np.int64)
        self._scalars_interval_s = scalars_interval_s
        self._on_reload = on_reload
        self._store = past
        self._past = None if past is None else ResultsPast(past)
        self._on_alarm = on_alarm
        self._before = before
        self._scalars_due = np.full(len(self._valves), -np.inf)
        counters = max((len(valve.counters) for valve in self._valves), default=0)
        self._changed = ChangedResults(len(self._valves), counters)
        self._blocks = Generations()
        self._alarms: ResultAlarms
        self._health: ResultHealth
        self._companions: Companions
        self._service_alarms: tuple[AlarmReport, ...] = ()

    @property
    def url(self) -> str:
        """Where clients connect."""
        return self._settings.url if self._server is None else self._server.url

    async def start(self) -> None:
        """Make the nodes that lead to each valve, then listen.

        What is below a valve is made when somebody first looks at it.

        Raises
        ------
        ServerError
            if the address is in use or not ours.
        CertificateError
            if certificate or key cannot be had.
        """
        server = await HardenedServer.create(self._settings, self._clock)
        root = await add_object(
            server, None, ROOT, description="Flow maps of hydraulic valves, identified online."
        )
        self._companions = await add_companions(server)
        self._blocks.add(server, self._valves, self._clock.now())
        self._health = ResultHealth(server, self._clock)
        self._alarms = ResultAlarms(
            server,
            self._valves,
            self._operator,
            self._clock,
            partial(self._show, server),
            self._note,
            self._health.stands,
            self._on_alarm,
        )
        await add_property(server, root, NODE_VERSION, version_of_root(self._valves))
        server.let_emit(root, ua.NodeId(ua.ObjectIds.Server))
        if self._past is not None:
            server.add_history((), self._past)
        with many_nodes():
            await add_types(
                server,
                self._add_frame,
                self._add_estimator,
                self._declare_alarm,
                self._parts(),
            )
            for slot in range(len(self._valves)):
                await self._add_folder(server, root, slot)
            await self._add_service(server, root)
        service = ua.NodeId(SERVICE, server.namespace_index)
        self._remember_events(server, root, service, ua.NodeId(ua.ObjectIds.Server))
        await server.start()
        self._server = server
        if self._before is not None:
            self._say_what_changed(server, self._before, self._valves)

    async def follow(
        self,
        valves: Sequence[ValveDescription],
        operator: Operator,
        scalars_interval_s: float = 0.0,
        on_alarm: Callable[[AlarmChange], None] | None = None,
    ) -> None:
        """Go on with other valves, of another operator; sessions and subscriptions live on.

        Valves that are described as before keep their nodes, and who monitors these misses nothing.
        Nodes of the others come and go; who listens to the Server object hears it.

        Raises
        ------
        ConfigurationError
            if a name cannot be; nothing has changed then.
        """
        check_names(valves)
        server, now = self._server, self._clock.now()
        assert server is not None  # noqa: S101 - it was started
        before = [self._valves[slot] for slot in self._slots.values()]
        after = {valve.name: valve for valve in valves}
        gone = {valve.name for valve in before if after.get(valve.name) != valve}
        self._remove_valves(server, gone)
        came = [valve for valve in valves if valve.name not in self._slots]
        self._in_charge.hand_over(operator)
        self._scalars_interval_s = scalars_interval_s
        self._valves += came
        self._slots |= {v.name: len(self._valves) - len(came) + k for k, v in enumerate(came)}
        self._slot_of = np.array([self._slots[valve.name] for valve in valves], np.intp)
        self._sequences = np.append(self._sequences, np.zeros(len(came), np.int64))
        self._scalars_due = np.append(self._scalars_due, np.full(len(came), -np.inf))
        counters = max((len(valve.counters) for valve in self._valves), default=0)
        self._changed = ChangedResults(len(self._valves), counters)
        self._blocks.keep(self._slot_of[self._slot_of < len(self._valves) - len(came)])
        self._blocks.add(server, came, now)
        self._alarms.follow([valve.name for valve in self._valves], after, on_alarm)
        root = ua.NodeId(ROOT, server.namespace_index)
        with many_nodes():
            for valve in came:
                await self._add_folder(server, root, self._slots[valve.name])
        await self._demand_again(after)
        self._say_what_changed(server, before, valves)

    def take_no_commands(self) -> None:
        """Refuse what would change the operator, until another one follows."""
        self._in_charge.refuses = True

    async def _add_folder(self, server: HardenedServer, root: ua.NodeId, slot: int) -> None:
        """Add a valve; what is below it is added later."""
        valve = self._valves[slot]
        folder = await add_object(
            server,
            root,
            valve.name,
            description=f"The valve {valve.name} and what is known of it.",
            type_definition=type_of(server, VALVE),
        )
        server.let_emit(folder)
        # before it is put aside, or it would be made at once
        self._remember_events(server, folder)
        self._companions.list_device(folder)
        server.add_later(folder, partial(self._add_valve, server, folder, slot))

    def _remove_valves(self, server: HardenedServer, names: Collection[str]) -> None:
        index = server.namespace_index
        referrers = ua.NodeId(ROOT, index), self._companions.device_set
        server.remove([ua.NodeId(name, index) for name in names], referrers)
        for name in names:
            del self._slots[name]
            self._demands.pop(name, None)
            self._health.forget(name)
        for known in (self._variables, self._not_shown):
            for id_ in [id_ for id_ in known if id_.partition(".")[0] in names]:
                del known[id_]

    async def _demand_again(self, valves: Iterable[str]) -> None:
        """Have the new operator know what stands at the inverse maps."""
        demands, nothing = self._demands, (np.nan, np.nan)
        self._demands = {name: demands.get(name, nothing) for name in valves}
        for name, (Q, dp) in self._demands.items():
            if not np.isnan(Q):
                with suppress(CommandRejected):
                    outcome = self._operator.demand(name, Q, dp)
                    if isawaitable(outcome):
                        await outcome

    def _remember_events(self, server: HardenedServer, *emitters: ua.NodeId) -> None:
        if self._store is not None:
            past = AlarmsPast(self._store, self._alarms.event_of)
            server.add_event_history(emitters, past, event_fields())

    def _say_what_changed(
        self,
        server: HardenedServer,
        before: Sequence[ValveDescription],
        after: Sequence[ValveDescription],
    ) -> None:
        kind, now = type_of(server, VALVE), self._clock.now()
        event = model_change(before, after, server.namespace_index, kind, now)
        if event is not None:
            version = ua.NodeId(f"{ROOT}.{NODE_VERSION}", server.namespace_index)
            server.write_property(version, ua.Variant(version_of_root(after)))
            server.say(event, _SAID_FOR_S)

    async def stop(self) -> None:
        """Close every session and stop listening; safe to call twice."""
        server, self._server = self._server, None
        if server is not None:
            await server.stop()

    async def publish(self, results: Results) -> None:
        """Show results; a later call for the same valve replaces the earlier one."""
        if self._server is None or not len(results.valves):
            return
        results = replace(results, valves=self._slot_of[results.valves])
        now, valves = self._clock.now(), results.valves
        self._sequences[valves] += 1
        described = self._valves[int(valves[0])]
        whole = frames(described, results, self._sequences[valves], now)
        self._blocks.write(valves, [whole])
        due = self._due(results)
        by_name = [e.name for e in described.estimators if e.has_named_parameters]
        columns = columns_of(results, now, by_name)
        if not due.all():
            columns = (column[due] for column in columns)
        self._blocks.write(valves[due], (*columns, *self._changed.counts(results, due, now)))
        for valve, new in self._changed.values(results, now):
            self._show(self._server, self._valves[valve].name, new)
        self._alarms.publish(results, now)
        for number in valves[self._sequences[valves] == 1].tolist():
            name = self._valves[number].name
            if name in self._health:
                self._health.stands(name, self._operator.alarms(name))

    async def show_health(self, health: Health) -> None:
        """Show how the service itself stands."""
        if self._server is None:
            return
        now, every = self._clock.now(), self._slot_of
        t = np.full(len(every), now)
        good = np.full(len(every), ua.StatusCodes.Good, np.uint32)
        waits = np.uint32(ua.StatusCodes.BadWaitingForInitialData)
        known = np.where(np.isnan(health.age_s), waits, good)
        self._blocks.write(
            every,
            [Column(SAMPLE_AGE, health.age_s, known, t), Column(PENDING, health.waiting, good, t)],
        )
        self._server.write(
            (self._variables[name], value, code, now)
            for name, value, code in service_values(health)
        )
        self._health.stands(SERVICE, health.alarms)
        if health.alarms != self._service_alarms:
            self._service_alarms = tuple(health.alarms)
            self._alarms.take(SERVICE, health.alarms, now)

    def _show(self, server: _Place, valve: str, new: Shown) -> None:
        """Write a variable, or keep what is new of it until it has a node."""
        id_ = f"{valve}.{new.name}"
        variable = self._variables.get(id_)
        if variable is None:
            self._not_shown[id_] = new
        else:
            server.write([(variable, new.value, new.code, new.t)])

    def _due(self, results: Results) -> NDArray[np.bool_]:
        """Whose single variables are written now, (M,)."""
        now, valves = self._clock.monotonic(), results.valves
        due = now >= self._scalars_due[valves]
        for estimator in results.estimators.values():
            due |= estimator.quality == Quality.BAD
        self._scalars_due[valves[due]] = now + self._scalars_interval_s
        return due

    async def _add_valve(self, server: HardenedServer, folder: ua.NodeId, slot: int) -> None:
        """Add what is below a valve's folder; what is in folders there is added later still."""
        valve = self._valves[slot]
        server.refer_to_conditions(folder, self._alarms.keys(valve.name))
        await add_property(server, folder, NODE_VERSION, version_of_valve(valve))
        await self._companions.add_identification(folder, valve.nameplate)
        is_heard_of = self._sequences[slot] > 0
        self._health.add(
            valve.name,
            await self._companions.add_health(folder),
            self._operator.alarms(valve.name) if is_heard_of else None,
        )
        await self._add_frame(server, folder, valve)
        add_part = partial(self._add_part, server, folder, valve)
        for estimator in valve.estimators:
            add_estimator = partial(self._add_estimator, estimator)
            kind = type_of(server, ESTIMATOR)
            await add_part(estimator.name, estimator.description, add_estimator, kind)
        for name, (words, add) in self._parts().items():
            await add_part(name, words, add, type_of(server, name) if name != ALARMS else None)

    def _parts(self) -> dict[str, tuple[str, _AddPart]]:
        """What every valve has: what it is, and what adds what is in it."""
        words = "What became of the valve's data on their way into the model."
        return {
            SIGNALS: ("The newest sample.", self._add_signals),
            INVERSE: ("The control voltage that a flow demands.", self._add_inverse),
            BASELINE: ("The map that was approved as new.", self._add_baseline),
            DIAGNOSTICS: (words, self._add_diagnostics),
            ALARMS: ("What needs somebody's attention.", self._add_alarms_of),
        }

    async def _add_frame(self, server: _Place, folder: ua.NodeId, valve: ValveDescription) -> None:
        of_frame, of_names = frame_variables(valve)
        await self._add_variable(server, folder, of_names, frame_names(valve))
        await self._add_variable(server, folder, of_frame, None)

    async def _add_part(
        self,
        server: HardenedServer,
        folder: ua.NodeId,
        valve: ValveDescription,
        name: str,
        description: str,
        add: _AddPart,
        kind: ua.NodeId | None,
    ) -> None:
        part = await add_object(
            server,
            folder,
            f"{valve.name}.{name}",
            description=description,
            type_definition=kind,
        )
        server.add_later(part, partial(add, server, part, valve))

    async def _add_signals(
        self, server: _Place, parent: ua.NodeId, valve: ValveDescription
    ) -> None:
        for node in signal_variables(valve):
            await self._add_variable(server, parent, node, None)

    async def _add_diagnostics(
        self, server: _Place, parent: ua.NodeId, valve: ValveDescription
    ) -> None:
        for node, middles in zip(survey_axes(valve), axes(max(valve.dp_range)), strict=True):
            await self._add_variable(server, parent, node, middles.tolist())
        await self._add_variable(server, parent, waiting_variable(valve.name), [])
        await self._add_variable(server, parent, timing_variable(valve.name), [])
        for node in lag_variables(valve):
            await self._add_variable(server, parent, node, None)
        await self._add_variable(server, parent, last_action(valve), "")
        for counter in valve.counters:
            await self._add_variable(server, parent, counter_variable(valve.name, counter), 0)
        for node in health_variables(valve.name):
            await self._add_variable(server, parent, node, None)

    async def _add_alarms_of(
        self, server: _Place, parent: ua.NodeId, valve: ValveDescription | None
    ) -> None:
        async def add(parent: ua.NodeId, node: VariableNode, now: Shown) -> None:
            self._not_shown.setdefault(node.id, now)
            await self._add_variable(server, parent, node, None)

        await self._alarms.add(parent, None if valve is None else valve.name, add)

    async def _declare_alarm(self, server: _Place, own: ua.NodeId) -> None:
        for node in alarm_variables(str(own.Identifier)):
            await self._add_variable(server, own, node, None)
        await self._alarms.declare(server, own)

    async def _add_service(self, server: HardenedServer, root: ua.NodeId) -> None:
        folder = await add_object(
            server, root, SERVICE, description="How the service itself stands."
        )
        server.let_emit(folder)
        server.refer_to_conditions(folder, self._alarms.keys(None))
        self._health.add(SERVICE, await self._companions.add_health(folder), None)
        for part, variables in service_variables().items():
            parent = await add_object(server, folder, part, description=_PARTS[part])
            for node in variables:
                await self._add_variable(server, parent, node, None)
        parent = await add_object(
            server, folder, f"{SERVICE}.{ALARMS}", description="What the service itself needs."
        )
        server.add_later(parent, partial(self._add_alarms_of, server, parent, None))
        if self._on_reload is not None:
            await add_method(
                server,
                folder,
                f"{SERVICE}.Reload",
                partial(_refusing_later, self._on_reload),
                required=Role.ENGINEER,
                description="Read the configuration again. Valves that it leaves alone keep what "
                "they know and miss nothing; a faulty one is refused, and the old one goes on.",
            )

    async def _add_estimator(
        self,
        estimator: EstimatorDescription,
        server: _Place,
        parent: ua.NodeId,
        valve: ValveDescription,
    ) -> None:
        prefix = f"{valve.name}.{estimator.name}"
        names = list(estimator.parameter_names)
        for node in estimator_variables(valve, estimator):
            value = names if node.kind == ua.VariantType.String else None
            await self._add_variable(server, parent, node, value)
        for node in (
            *survey_variables(valve, estimator),
            *discovery_variables(valve, estimator),
        ):
            await self._add_variable(server, parent, node, None)
        await self._add_variable(server, parent, builds_on_variable(valve.name, estimator.name), "")
        parameters = parameter_variables(valve, estimator)
        if parameters:
            words = "The parameters, each by itself."
            each = await add_object(server, parent, f"{prefix}.{PARAMETERS}", description=words)
            for node in parameters:
                await self._add_variable(server, each, node, None)
        command = partial(self._add_command, server, parent, prefix)
        who = (valve.name, estimator.name)
        await command("Reset", partial(self._operator.reset, *who), "Forget all samples.")
        await command(
            "Freeze", partial(self._operator.freeze, *who), "Stop adaptation: predict only."
        )
        await command("Resume", partial(self._operator.resume, *who), "Adapt again.")
        await command(
            "SetForgettingFactor",
            partial(self._set_forgetting_factor, *who),
            "Use another forgetting factor from the next sample on; 1 forgets nothing.",
            Argument("ForgettingFactor", "0 < λ <= 1"),
        )
        await add_method(
            server,
            parent,
            f"{prefix}.Predict",
            partial(self._predict, *who),
            inputs=(_U, _dp, _T),
            outputs=(
                Argument("Q", "Flow; NaN if unknown", unit=Unit.LITRE_PER_MINUTE),
                Argument("Std", "Its standard deviation", unit=Unit.LITRE_PER_MINUTE),
                _STATUS,
            ),
            required=Role.OBSERVER,
            description=f"Flow at a point of the map. Status: {_numbered(Status)}.",
        )

        await add_method(
            server,
            parent,
            f"{prefix}.PredictMeasurement",
            partial(self._predict_measurement, *who),
            inputs=(_U, _dp, _T),
            outputs=(
                Argument("Q", "Flow; NaN if unknown", unit=Unit.LITRE_PER_MINUTE),
                Argument("Lower", "Lower end of the 95 % interval", unit=Unit.LITRE_PER_MINUTE),
                Argument("Upper", "Upper end of the 95 % interval", unit=Unit.LITRE_PER_MINUTE),
                _STATUS,
            ),
            required=Role.OBSERVER,
            description="Where a measurement within the next 32 samples will lie: noise and what "
            f"the structure cannot follow included. Status: {_numbered(Status)}.",
        )

    async def _add_inverse(
        self, server: _Place, parent: ua.NodeId, valve: ValveDescription
    ) -> None:
        prefix = f"{valve.name}.{INVERSE}"
        start: dict[str, Any] = {
            f"{prefix}.MapQ": list(valve.map_Q),
            f"{prefix}.MapDp": list(valve.map_dp),
            f"{prefix}.{ARMED}": False,
            f"{prefix}.{FEED_FORWARD_STATUS}": int(FeedForwardStatus.NOT_CONFIGURED),
        }
        on_write = {
            f"{prefix}.FlowDemand": partial(self._demand_flow, valve.name),
            f"{prefix}.PressureDrop": partial(self._demand_at, valve.name),
        }
        for node in inverse_variables(valve):
            await self._add_variable(
                server, parent, node, start.get(node.id), on_write.get(node.id)
            )
        if valve.map_Q and valve.map_dp:
            await self._add_map(server, parent, valve)
        command = partial(self._add_command, server, parent, prefix)
        await command(
            "Arm",
            partial(self._arm, valve.name),
            "Write RequiredU to the valve while FeedForwardStatus lets it; a restart disarms.",
        )
        await command(
            "Disarm",
            partial(self._disarm, valve.name),
            "Write nothing to the valve any more: it is the source's own.",
        )
        await add_method(
            server,
            parent,
            f"{prefix}.Invert",
            partial(self._invert, valve.name),
            inputs=(Argument("Q", "Demanded flow", unit=Unit.LITRE_PER_MINUTE), _dp, _T),
            outputs=(
                Argument("U", "Control voltage; NaN if none can be trusted", unit=Unit.PERCENT),
                Argument("Lower", "Lower end of its 95 % interval", unit=Unit.PERCENT),
                Argument("Upper", "Upper end of its 95 % interval", unit=Unit.PERCENT),
                _STATUS,
            ),
            required=Role.OBSERVER,
            description=f"Control voltage for a flow. Status: {_numbered(InverseStatus)}.",
        )

    async def _add_baseline(
        self, server: _Place, parent: ua.NodeId, valve: ValveDescription
    ) -> None:
        for node in baseline_variables(valve.name):
            empty = "" if node.kind == ua.VariantType.String else None
            await self._add_variable(server, parent, node, empty)
        prefix = f"{valve.name}.{BASELINE}"
        for name, action, description in (
            ("Approve", self._approve, "Keep what is known now as the valve's map when new."),
            ("RollBack", self._roll_back, "Have all estimators know what they knew when approved."),
            (
                "ValveReplaced",
                self._replace_valve,
                "Another valve is there: forget what was learnt, and the approved map.",
            ),
        ):
            function = partial(action, valve.name)
            await self._add_command(server, parent, prefix, name, function, description)
        flow = Unit.LITRE_PER_MINUTE
        await add_method(
            server,
            parent,
            f"{prefix}.Compare",
            partial(self._compare, valve.name),
            inputs=(Argument("Estimator", "Whose map", type=ua.VariantType.String),),
            outputs=(
                Argument("Mean", "Now less then, over all points; NaN: none", unit=flow),
                Argument("Largest", "The largest of them, with its sign", unit=flow),
                Argument("U", "Where that is", unit=Unit.PERCENT),
                Argument("dp", "Where that is", unit=Unit.BAR),
                Argument("Points", "How many could be compared", type=ua.VariantType.UInt32),
            ),
            required=Role.OBSERVER,
            description="By how much a map has moved away from the approved one, where both rest "
            "on measurements.",
        )

    async def _add_map(self, server: _Place, parent: ua.NodeId, valve: ValveDescription) -> None:
        """Add the map, and make it an ImageItemType: SCADA clients draw it without our help."""
        variable = await self._add_variable(
            server, parent, map_variable(valve), None, type_definition=_IMAGE_ITEM_TYPE
        )
        scale = ua.Variant(ua.AxisScaleEnumeration.Linear, ua.VariantType.Int32)
        for name, value, kind in (
            ("Title", ua.LocalizedText(f"Inverse flow map of {valve.name}"), "LocalizedText"),
            ("AxisScaleType", scale, "AxisScaleEnumeration"),
            ("XAxisDefinition", axis("Pressure drop", Unit.BAR, valve.map_dp), "AxisInformation"),
            (
                "YAxisDefinition",
                axis("Flow", Unit.LITRE_PER_MINUTE, valve.map_Q),
                "AxisInformation",
            ),
        ):
            data_type = ua.NodeId(getattr(ua.ObjectIds, kind))
            await add_property(server, variable.id, name, value, data_type)

    async def _add_variable(
        self,
        server: _Place,
        parent: ua.NodeId,
        node: VariableNode,
        value: Any,  # noqa: ANN401 - as the variable's type says
        on_write: Callable[[float], Answer[None]] | None = None,
        type_definition: ua.NodeId | None = None,
    ) -> Variable:
        variable = await add_variable(
            server,
            parent,
            node.id,
            value,
            description=node.description,
            type=node.kind,
            unit=node.unit,
            value_range=node.range,
            dimensions=node.dimensions,
            enum_strings=node.enum_strings,
            writable_by=Role.OPERATOR if node.writable else None,
            on_write=on_write,
            or_nan=node.writable,  # NaN takes a demand back
            type_definition=type_definition,
        )
        self._variables[node.id] = variable
        if self._past is not None and has_past(node.id):
            server.add_history([variable], self._past)
        valve, _, name = node.id.partition(".")
        if node.id in self._not_shown:
            self._show(server, valve, self._not_shown.pop(node.id))
        if valve in self._slots:
            self._blocks.show(self._slots[valve], name, variable)
        return variable

    def _demand_flow(self, valve: str, Q: float) -> Answer[None]:
        return self._demand(valve, Q, self._demands[valve][1])

    def _demand_at(self, valve: str, dp: float) -> Answer[None]:
        return self._demand(valve, self._demands[valve][0], dp)

    def _demand(self, valve: str, Q: float, dp: float) -> Answer[None]:
        def demanded(_: None) -> None:
            self._demands[valve] = (Q, dp)
            self._note(valve, f"{INVERSE} demand {Q:g} l/min at {dp:g} bar")

        return answered(partial(self._operator.demand, valve, Q, dp), demanded)

    def _approve(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.approve, valve)
        return answered(asked, lambda _: self._show_baseline(valve))

    def _roll_back(self, valve: str) -> Answer[None]:
        return self._operator.roll_back(valve)

    def _replace_valve(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.replace_valve, valve)
        return answered(asked, lambda _: self._show_baseline(valve))

    def _show_baseline(self, valve: str) -> None:
        """At once: who has called may read."""
        (number,) = np.flatnonzero(self._slot_of == self._slots[valve]).tolist()
        found = self._operator.baseline(number)
        if self._server is not None:
            for new in baseline_values(found, self._clock.now()):
                self._show(self._server, valve, new)

    def _compare(
        self, valve: str, estimator: str
    ) -> Answer[tuple[float, float, float, float, int]]:
        return answered(
            partial(self._operator.compare, valve, estimator),
            lambda found: (found.mean, found.largest, found.U, found.dp, found.points),
            partial(self._note_refusal, valve),
        )

    def _arm(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.arm, valve)
        return answered(asked, lambda _: self._show_armed(valve, armed=True))

    def _disarm(self, valve: str) -> Answer[None]:
        asked = partial(self._operator.disarm, valve)
        return answered(asked, lambda _: self._show_armed(valve, armed=False))

    def _show_armed(self, valve: str, *, armed: bool) -> None:
        """At once: who has called may read."""
        if self._server is not None:
            new = Shown(f"{INVERSE}.{ARMED}", armed, ua.StatusCodes.Good, self._clock.now())
            self._show(self._server, valve, new)

    async def _add_command(
        self,
        server: _Place,
        parent: ua.NodeId,
        prefix: str,
        name: str,
        function: Callable[..., Answer[None]],
        description: str,
        *inputs: Argument,
    ) -> None:
        valve, _, part = prefix.partition(".")

        def command(*arguments: Any) -> Answer[None]:  # noqa: ANN401 - the command's own
            given = "".join(f" {argument:g}" for argument in arguments)
            return answered(
                partial(function, *arguments),
                lambda _: self._note(valve, f"{part} {name}{given}"),
                partial(self._note_refusal, valve) if part == BASELINE else say_nothing,
            )

        await add_method(
            server,
            parent,
            f"{prefix}.{name}",
            command,
            inputs=inputs,
            required=Role.OPERATOR,
            description=description,
        )

    def _note(self, valve: str, action: str) -> None:
        """Show what was done to a valve, and by whom."""
        if self._server is not None:
            said = f"{caller()}: {action}"
            new = Shown(LAST_ACTION, said, ua.StatusCodes.Good, self._clock.now())
            self._show(self._server, valve, new)

    def _note_refusal(self, valve: str, why: str) -> None:
        """Show why an action on the baseline was refused: a StatusCode alone does not say it."""
        if self._server is not None:
            new = Shown(f"{BASELINE}.LastRefusal", why, ua.StatusCodes.Good, self._clock.now())
            self._show(self._server, valve, new)

    def _set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> Answer[None]:
        if not 0.0 < lam <= 1.0:
            raise OutOfRange(f"forgetting factor {lam:g}: allowed is 0 < λ <= 1")
        return self._operator.set_forgetting_factor(valve, estimator, lam)

    def _predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, int]]:
        return answered(
            partial(self._operator.predict, valve, estimator, U, dp, T),
            lambda found: (found[0], found[1], int(found[2])),
        )

    def _predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, float, int]]:
        return answered(
            partial(self._operator.predict_measurement, valve, estimator, U, dp, T),
            lambda found: (found[0], found[1], found[2], int(found[3])),
        )

    def _invert(
        self, valve: str, Q: float, dp: float, T: float
    ) -> Answer[tuple[float, float, float, int]]:
        return answered(
            partial(self._operator.invert, valve, Q, dp, T),
            lambda answer: (
                _first(answer.U),
                _first(answer.lower),
                _first(answer.upper),
                int(answer.status[0]),
            ),
        )


async def _refusing_later(function: Callable[[], Awaitable[None]]) -> None:
    """The same, for what takes its time."""
    try:
        await function()
    except CommandRejected as rejected:
        raise Refused(str(rejected)) from rejected


def _first(values: Floats) -> float:
    return float(values[0])


def _numbered(statuses: Iterable[Status] | Iterable[InverseStatus]) -> str:
    return ", ".join(f"{member.value} {member.name}" for member in statuses)
