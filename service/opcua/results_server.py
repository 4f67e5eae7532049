"""The results server: what was identified, for any OPC UA client, and what operators may do."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from asyncua import ua
from asyncua.common.node import Node
from numpy.typing import NDArray

from service.errors import CommandRejected
from service.hardened import (
    Argument,
    Clock,
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
    add_variable,
    caller,
    many_nodes,
)
from service.hardened import CommandRejected as Refused
from service.identification.inversion import InverseStatus
from service.identification.samples import Floats, Quality, Status
from service.identification.survey import axes
from service.opcua.changed_results import ChangedResults
from service.opcua.information_model import (
    ARMED,
    DIAGNOSTICS,
    FEED_FORWARD_STATUS,
    FRAME,
    INVERSE,
    LAST_ACTION,
    NAMESPACE,
    PARAMETERS,
    PENDING,
    ROOT,
    SAMPLE_AGE,
    SERVICE,
    SIGNALS,
    U_RANGE,
    VariableNode,
    axis,
    check_names,
    counter_name,
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
    waiting_variable,
)
from service.opcua.result_blocks import Place, ResultBlocks
from service.opcua.result_frames import frame_names, frame_variables, frames
from service.opcua.result_values import Column, columns_of, service_values
from service.streaming.feedforward import FeedForwardStatus
from service.streaming.ports import (
    EstimatorDescription,
    Health,
    Operator,
    Results,
    ValveDescription,
)

__all__ = ["NAMESPACE", "ResultsServer"]

_PARTS = {
    f"{SERVICE}.Checkpoint": "Whether what was learnt survives a restart.",
    f"{SERVICE}.Source": "What came from the source since the service started.",
}
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
    """

    def __init__(
        self,
        settings: ServerSettings,
        valves: Sequence[ValveDescription],
        operator: Operator,
        clock: Clock | None = None,
        scalars_interval_s: float = 0.0,
    ) -> None:
        check_names(valves)
        self._settings = settings
        self._valves = tuple(valves)
        self._operator = operator
        self._clock = clock or SystemClock()
        self._server: HardenedServer | None = None
        self._variables: dict[str, Variable] = {}
        self._places: list[Place] = []
        self._demands: dict[str, tuple[float, float]] = {}
        self._sequences = np.zeros(len(self._valves), np.int64)
        self._scalars_interval_s = scalars_interval_s
        self._scalars_due = np.full(len(self._valves), -np.inf)
        counters = max((len(valve.counters) for valve in self._valves), default=0)
        self._changed = ChangedResults(len(self._valves), counters)
        self._blocks: ResultBlocks

    @property
    def url(self) -> str:
        """Where clients connect."""
        return self._settings.url if self._server is None else self._server.url

    async def start(self) -> None:
        """Make all nodes, then listen.

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
        with many_nodes():
            for number, valve in enumerate(self._valves):
                await self._add_valve(server, root, number, valve)
            await self._add_service(server, root)
        self._blocks = ResultBlocks(server, len(self._valves), self._places)
        await server.start()
        self._server = server

    async def stop(self) -> None:
        """Close every session and stop listening; safe to call twice."""
        server, self._server = self._server, None
        if server is not None:
            await server.stop()

    async def publish(self, results: Results) -> None:
        """Show results; a later call for the same valve replaces the earlier one."""
        if self._server is None or not len(results.valves):
            return
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
            variable = self._variables.get(f"{self._valves[valve].name}.{new.name}")
            if variable is not None:
                self._server.write([(variable, new.value, new.code, new.t)])

    async def show_health(self, health: Health) -> None:
        """Show how the service itself stands."""
        if self._server is None:
            return
        now, every = self._clock.now(), np.arange(len(self._valves))
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

    def _due(self, results: Results) -> NDArray[np.bool_]:
        """Whose single variables are written now, (M,)."""
        now, valves = self._clock.monotonic(), results.valves
        due = now >= self._scalars_due[valves]
        for estimator in results.estimators.values():
            due |= estimator.quality == Quality.BAD
        self._scalars_due[valves[due]] = now + self._scalars_interval_s
        return due

    async def _add_valve(
        self, server: HardenedServer, root: ua.NodeId, number: int, valve: ValveDescription
    ) -> None:
        folder = await add_object(
            server, root, valve.name, description=f"The valve {valve.name} and what is known of it."
        )
        of_frame, of_names = frame_variables(valve)
        names = frame_names(valve)
        await self._add_variable(server, folder, of_names, names)
        whole = await self._add_variable(server, folder, of_frame, None)
        self._places.append(Place(number, FRAME, whole, len(names)))
        for estimator in valve.estimators:
            await self._add_estimator(server, folder, number, estimator)
        await self._add_side_by_side(
            server, folder, number, SIGNALS, signal_variables(valve), "The newest sample."
        )
        await self._add_inverse(server, folder, number)
        diagnostics = await add_object(
            server,
            folder,
            f"{valve.name}.{DIAGNOSTICS}",
            description="What became of the valve's data on their way into the model.",
        )
        for node, middles in zip(survey_axes(valve), axes(max(valve.dp_range)), strict=True):
            await self._add_variable(server, diagnostics, node, middles.tolist())
        await self._add_variable(server, diagnostics, waiting_variable(valve.name), [])
        for node in lag_variables(valve):
            await self._add_variable(server, diagnostics, node, None)
        await self._add_variable(server, diagnostics, last_action(valve), "")
        for counter in valve.counters:
            node = counter_variable(valve.name, counter)
            variable = await self._add_variable(server, diagnostics, node, 0)
            self._places.append(Place(number, counter_name(counter), variable, None))

        for shown in health_variables(valve.name):
            variable = await self._add_variable(server, diagnostics, shown, None)
            self._places.append(
                Place(number, shown.id.removeprefix(f"{valve.name}."), variable, None)
            )

    async def _add_service(self, server: HardenedServer, root: ua.NodeId) -> None:
        folder = await add_object(
            server, root, SERVICE, description="How the service itself stands."
        )
        for part, variables in service_variables().items():
            parent = await add_object(server, folder, part, description=_PARTS[part])
            for node in variables:
                await self._add_variable(server, parent, node, None)

    async def _add_estimator(
        self,
        server: HardenedServer,
        folder: ua.NodeId,
        number: int,
        estimator: EstimatorDescription,
    ) -> None:
        valve = self._valves[number]
        prefix = f"{valve.name}.{estimator.name}"
        parent = await add_object(server, folder, prefix, description=estimator.description)
        for node in estimator_variables(valve, estimator):
            name = node.id.removeprefix(f"{valve.name}.")
            if node.kind == ua.VariantType.String:
                names = list(estimator.parameter_names)
                await self._add_variable(server, parent, node, names)
                continue
            variable = await self._add_variable(server, parent, node, None)
            length = None if node.dimensions is None else len(estimator.parameter_names)
            if length != 0:
                self._places.append(Place(number, name, variable, length))
        for node in (
            *survey_variables(valve, estimator),
            *discovery_variables(valve, estimator),
        ):
            await self._add_variable(server, parent, node, None)
        parameters = parameter_variables(valve, estimator)
        if parameters:
            name, what = f"{estimator.name}.{PARAMETERS}", "The parameters, each by itself."
            await self._add_side_by_side(server, parent, number, name, parameters, what)
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

    async def _add_side_by_side(
        self,
        server: HardenedServer,
        parent: ua.NodeId,
        number: int,
        name: str,
        nodes: Sequence[VariableNode],
        description: str,
    ) -> None:
        """Add an object whose variables are published together under ``name``."""
        valve = self._valves[number].name
        folder = await add_object(server, parent, f"{valve}.{name}", description=description)
        for k, node in enumerate(nodes):
            variable = await self._add_variable(server, folder, node, None)
            self._places.append(Place(number, None if k else name, variable, None))

    async def _add_inverse(self, server: HardenedServer, folder: ua.NodeId, number: int) -> None:
        valve = self._valves[number]
        prefix = f"{valve.name}.{INVERSE}"
        parent = await add_object(
            server, folder, prefix, description="The control voltage that a flow demands."
        )
        self._demands[valve.name] = (np.nan, np.nan)
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
            variable = await self._add_variable(
                server, parent, node, start.get(node.id), on_write.get(node.id)
            )
            if node.dimensions is None and not node.writable and node.id not in start:
                name = node.id.removeprefix(f"{valve.name}.")
                self._places.append(Place(number, name, variable, None))
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

    async def _add_map(
        self, server: HardenedServer, parent: ua.NodeId, valve: ValveDescription
    ) -> None:
        """Add the map, and make it an ImageItemType: SCADA clients draw it without our help."""
        variable = await self._add_variable(server, parent, map_variable(valve), None)
        node = Node(server.session, variable.id)
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
            id_ = ua.NodeId(f"{variable.id.Identifier}.{name}", server.namespace_index)
            data_type = ua.NodeId(getattr(ua.ObjectIds, kind))
            await node.add_property(id_, ua.QualifiedName(name, 0), value, datatype=data_type)
        has_type = ua.NodeId(ua.ObjectIds.HasTypeDefinition)
        old = await node.read_type_definition()
        await node.delete_reference(old, has_type, forward=True, bidirectional=True)
        await node.add_reference(_IMAGE_ITEM_TYPE, has_type, forward=True, bidirectional=False)

    async def _add_variable(
        self,
        server: HardenedServer,
        parent: ua.NodeId,
        node: VariableNode,
        value: Any,  # noqa: ANN401 - as the variable's type says
        on_write: Callable[[float], None] | None = None,
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
        )
        self._variables[node.id] = variable
        return variable

    def _demand_flow(self, valve: str, Q: float) -> None:
        self._demand(valve, Q, self._demands[valve][1])

    def _demand_at(self, valve: str, dp: float) -> None:
        self._demand(valve, self._demands[valve][0], dp)

    def _demand(self, valve: str, Q: float, dp: float) -> None:
        self._operator.demand(valve, Q, dp)
        self._demands[valve] = (Q, dp)
        self._note(valve, f"{INVERSE} demand {Q:g} l/min at {dp:g} bar")

    def _arm(self, valve: str) -> None:
        self._operator.arm(valve)
        self._show_armed(valve, armed=True)

    def _disarm(self, valve: str) -> None:
        self._operator.disarm(valve)
        self._show_armed(valve, armed=False)

    def _show_armed(self, valve: str, *, armed: bool) -> None:
        """At once: who has called may read."""
        if self._server is not None:
            variable = self._variables[f"{valve}.{INVERSE}.{ARMED}"]
            self._server.write([(variable, armed, ua.StatusCodes.Good, self._clock.now())])

    async def _add_command(
        self,
        server: HardenedServer,
        parent: ua.NodeId,
        prefix: str,
        name: str,
        function: Callable[..., None],
        description: str,
        *inputs: Argument,
    ) -> None:
        valve, _, part = prefix.partition(".")

        def command(*arguments: Any) -> None:  # noqa: ANN401 - the command's own
            _refusing(function)(*arguments)
            given = "".join(f" {argument:g}" for argument in arguments)
            self._note(valve, f"{part} {name}{given}")

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
            variable = self._variables[f"{valve}.{LAST_ACTION}"]
            said = f"{caller()}: {action}"
            self._server.write([(variable, said, ua.StatusCodes.Good, self._clock.now())])

    def _set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> None:
        if not 0.0 < lam <= 1.0:
            raise OutOfRange(f"forgetting factor {lam:g}: allowed is 0 < λ <= 1")
        self._operator.set_forgetting_factor(valve, estimator, lam)

    def _predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, int]:
        Q, std, status = self._operator.predict(valve, estimator, U, dp, T)
        return Q, std, int(status)

    def _predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, float, int]:
        *answer, status = self._operator.predict_measurement(valve, estimator, U, dp, T)
        return answer[0], answer[1], answer[2], int(status)

    def _invert(self, valve: str, Q: float, dp: float, T: float) -> tuple[float, float, float, int]:
        answer = self._operator.invert(valve, Q, dp, T)
        return _first(answer.U), _first(answer.lower), _first(answer.upper), int(answer.status[0])


def _refusing(function: Callable[..., None]) -> Callable[..., None]:
    """Let the server know a command that the service rejects as one that it refuses."""

    def command(*arguments: Any) -> None:  # noqa: ANN401 - the command's own
        try:
            function(*arguments)
        except CommandRejected as rejected:
            raise Refused(str(rejected)) from rejected

    return command


def _first(values: Floats) -> float:
    return float(values[0])


def _numbered(statuses: Iterable[Status] | Iterable[InverseStatus]) -> str:
    return ", ".join(f"{member.value} {member.name}" for member in statuses)
