"""The results server: what was identified, for any OPC UA client, and what operators may do."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from asyncua import ua
from asyncua.common.node import Node

from service.clock import Clock, SystemClock
from service.identification.inversion import InverseStatus
from service.identification.recursive_least_squares import Change
from service.identification.samples import Floats, Quality, Status
from service.identification.survey import Survey, axes
from service.opcua.hardened import (
    Argument,
    HardenedServer,
    OutOfRange,
    Role,
    ServerSettings,
    Startable,
    Unit,
    Variable,
    add_method,
    add_object,
    add_variable,
    many_nodes,
)
from service.opcua.information_model import (
    DIAGNOSTICS,
    INVERSE,
    NAMESPACE,
    ROOT,
    U_RANGE,
    VariableNode,
    axis,
    check_names,
    counter_variable,
    discovery_variables,
    estimator_variables,
    inverse_variables,
    map_variable,
    survey_axes,
    survey_variables,
)
from service.opcua.result_blocks import ResultBlocks
from service.opcua.result_frames import frame, frame_names, frame_variables
from service.opcua.result_values import (
    Shown,
    discovery_values,
    map_value,
    survey_values,
    values_of,
)
from service.streaming.ports import EstimatorDescription, Operator, ValveDescription, ValveResult

__all__ = ["NAMESPACE", "ResultsServer"]

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
    """

    def __init__(
        self,
        settings: ServerSettings,
        valves: Sequence[ValveDescription],
        operator: Operator,
        clock: Clock | None = None,
    ) -> None:
        check_names(valves)
        self._settings = settings
        self._valves = tuple(valves)
        self._operator = operator
        self._clock = clock or SystemClock()
        self._server: HardenedServer | None = None
        self._variables: dict[str, Variable] = {}
        self._maps: dict[str, tuple[Floats, int]] = {}
        self._surveys: dict[str, tuple[Survey | None, Quality]] = {}
        self._discoveries: dict[str, tuple[Change | None, str | None, Quality]] = {}
        self._counts: dict[str, int] = {}
        self._diagnostics: dict[str, ua.NodeId] = {}
        self._demands: dict[str, tuple[float, float]] = {}
        self._described = {valve.name: valve for valve in self._valves}
        self._sequences = dict.fromkeys(self._described, 0)
        self._scalars: list[Variable] = []
        self._frames: list[tuple[Variable, int]] = []
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
            for valve in self._valves:
                await self._add_valve(server, root, valve)
        self._blocks = ResultBlocks(server, self._scalars, self._frames)
        await server.start()
        self._server = server

    async def stop(self) -> None:
        """Close every session and stop listening; safe to call twice."""
        server, self._server = self._server, None
        if server is not None:
            await server.stop()

    async def publish(self, results: Sequence[ValveResult]) -> None:
        """Show results; a later call for the same valve replaces the earlier one."""
        if self._server is None:
            return
        now = self._clock.now()
        shown: list[Shown] = []
        for result in results:
            shown += values_of(result, now)
            shown += self._map_if_new(result, now)
            shown += self._surveys_if_new(result, now)
            shown += self._discoveries_if_new(result, now)
            shown += await self._new_counts(self._server, result, now)
            shown += self._next_frame(result, now)
        self._server.write(
            (self._variables[new.id], new.value, new.code, new.t)
            for new in self._blocks.write(shown)
            if new.id in self._variables
        )

    def _next_frame(self, result: ValveResult, now: int) -> list[Shown]:
        valve = self._described.get(result.valve)
        if valve is None:
            return []
        self._sequences[valve.name] += 1
        return [frame(valve, result, self._sequences[valve.name], now)]

    def _map_if_new(self, result: ValveResult, now: int) -> list[Shown]:
        """The map is large: it goes out only when it was computed anew or its code changed."""
        shown = map_value(result, now)
        table, code = self._maps.get(result.valve, (None, 0))
        if result.inverse.map_U is table and shown.code == code:
            return []
        self._maps[result.valve] = (result.inverse.map_U, shown.code)
        return [shown]

    def _surveys_if_new(self, result: ValveResult, now: int) -> list[Shown]:
        """Surveys are made now and then, and go out once each."""
        shown: list[Shown] = []
        for name, estimator in result.estimators.items():
            key = f"{result.valve}.{name}"
            old, quality = self._surveys.get(key, (None, None))
            if estimator.survey is not old or estimator.quality != quality:
                self._surveys[key] = estimator.survey, estimator.quality
                shown += survey_values(result.valve, name, estimator, now)
        return shown

    def _discoveries_if_new(self, result: ValveResult, now: int) -> list[Shown]:
        """Changes and structures are rare news: each goes out once."""
        shown: list[Shown] = []
        for name, estimator in result.estimators.items():
            key = f"{result.valve}.{name}"
            found = estimator.change, estimator.structure, estimator.quality
            if self._discoveries.get(key) != found:
                self._discoveries[key] = found
                shown += discovery_values(result.valve, name, estimator, now)
        return shown

    async def _new_counts(
        self, server: HardenedServer, result: ValveResult, now: int
    ) -> list[Shown]:
        shown: list[Shown] = []
        for name, count in result.counters.items():
            node = counter_variable(result.valve, name)
            if node.id not in self._variables and result.valve in self._diagnostics:
                await self._add_variable(server, self._diagnostics[result.valve], node, count)
            if self._counts.get(node.id) != count:
                self._counts[node.id] = count
                shown.append(Shown(node.id, count, ua.StatusCodes.Good, now))
        return shown

    async def _add_valve(
        self, server: HardenedServer, root: ua.NodeId, valve: ValveDescription
    ) -> None:
        folder = await add_object(
            server, root, valve.name, description=f"The valve {valve.name} and what is known of it."
        )
        of_frame, of_names = frame_variables(valve)
        names = frame_names(valve)
        await self._add_variable(server, folder, of_names, names)
        whole = await self._add_variable(server, folder, of_frame, None)
        self._frames.append((whole, len(names)))
        for estimator in valve.estimators:
            await self._add_estimator(server, folder, valve, estimator)
        await self._add_inverse(server, folder, valve)
        self._diagnostics[valve.name] = await add_object(
            server,
            folder,
            f"{valve.name}.{DIAGNOSTICS}",
            description="What became of the valve's data on their way into the model.",
        )
        for node, middles in zip(survey_axes(valve), axes(max(valve.dp_range)), strict=True):
            await self._add_variable(server, self._diagnostics[valve.name], node, middles.tolist())

    async def _add_estimator(
        self,
        server: HardenedServer,
        folder: ua.NodeId,
        valve: ValveDescription,
        estimator: EstimatorDescription,
    ) -> None:
        prefix = f"{valve.name}.{estimator.name}"
        parent = await add_object(server, folder, prefix, description=estimator.description)
        for node in estimator_variables(valve, estimator):
            names = list(estimator.parameter_names) if node.id.endswith(".ParameterNames") else None
            variable = await self._add_variable(server, parent, node, names)
            if node.dimensions is None:
                self._scalars.append(variable)
        for node in (
            *survey_variables(valve, estimator),
            *discovery_variables(valve, estimator),
        ):
            await self._add_variable(server, parent, node, None)
        command = partial(_add_command, server, parent, prefix)
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
            description="Where a new measurement of the flow will lie: noise and what the "
            f"structure cannot follow included. Status: {_numbered(Status)}.",
        )

    async def _add_inverse(
        self, server: HardenedServer, folder: ua.NodeId, valve: ValveDescription
    ) -> None:
        prefix = f"{valve.name}.{INVERSE}"
        parent = await add_object(
            server, folder, prefix, description="The control voltage that a flow demands."
        )
        self._demands[valve.name] = (np.nan, np.nan)
        start: dict[str, Any] = {
            f"{prefix}.MapQ": list(valve.map_Q),
            f"{prefix}.MapDp": list(valve.map_dp),
        }
        on_write = {
            f"{prefix}.FlowDemand": partial(self._demand_flow, valve.name),
            f"{prefix}.PressureDrop": partial(self._demand_at, valve.name),
        }
        for node in inverse_variables(valve):
            variable = await self._add_variable(
                server, parent, node, start.get(node.id), on_write.get(node.id)
            )
            if node.dimensions is None and not node.writable:
                self._scalars.append(variable)
        if valve.map_Q and valve.map_dp:
            await self._add_map(server, parent, valve)
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


async def _add_command(
    server: HardenedServer,
    parent: ua.NodeId,
    prefix: str,
    name: str,
    function: Callable[..., None],
    description: str,
    *inputs: Argument,
) -> None:
    await add_method(
        server,
        parent,
        f"{prefix}.{name}",
        function,
        inputs=inputs,
        required=Role.OPERATOR,
        description=description,
    )


def _first(values: Floats) -> float:
    return float(values[0])


def _numbered(statuses: Iterable[Status] | Iterable[InverseStatus]) -> str:
    return ", ".join(f"{member.value} {member.name}" for member in statuses)
