"""The variables and methods of each part of a valve, for instances and types alike."""

from functools import partial
from typing import Any

from asyncua import ua

from guarded_opcua import Unit, add_object, add_property
from valvemap.model.survey import axes
from valvemap.opcua_results.dynamics_nodes import dynamics_variables
from valvemap.opcua_results.information_model import (
    ALARMS,
    ARMED,
    BASELINE,
    DIAGNOSTICS,
    DYNAMICS,
    FEED_FORWARD_STATUS,
    INVERSE,
    PARAMETERS,
    SIGNALS,
    axis,
    builds_on_variable,
    discovery_variables,
    estimator_variables,
    lag_variables,
    parameter_variables,
    signal_variables,
)
from valvemap.opcua_results.map_variables import (
    inverse_variables,
    line_variables,
    map_variable,
    survey_axes,
    survey_variables,
)
from valvemap.opcua_results.result_alarms import ResultAlarms
from valvemap.opcua_results.result_commands import ResultCommands
from valvemap.opcua_results.result_demands import ResultDemands
from valvemap.opcua_results.result_frames import frame_names, frame_variables
from valvemap.opcua_results.result_questions import ResultQuestions
from valvemap.opcua_results.result_types import AddPart, Place
from valvemap.opcua_results.result_variables import ResultVariables
from valvemap.opcua_results.valve_variables import (
    alarm_variables,
    baseline_variables,
    counter_variable,
    finding_variables,
    health_variables,
    last_action,
    recommended_variables,
    timing_variable,
    waiting_variable,
)
from valvemap.pipeline.results import EstimatorDescription, ValveDescription
from valvemap.vocabulary.commands import Subject
from valvemap.vocabulary.feed_forward import FeedForwardStatus

_IMAGE_ITEM_TYPE = ua.NodeId(12047)


class ResultParts:
    """Adds the contents of each part of a valve on first access.

    Parameters
    ----------
    variables
        Adds and writes variables.
    commands, questions
        Add the methods.
    demands
        Accepts the demands on inverse maps.
    alarms
        Adds the nodes of alarms.
    """

    def __init__(
        self,
        variables: ResultVariables,
        commands: ResultCommands,
        questions: ResultQuestions,
        demands: ResultDemands,
        alarms: ResultAlarms,
    ) -> None:
        self._variables = variables
        self._commands = commands
        self._questions = questions
        self._demands = demands
        self._alarms = alarms

    def of_every_valve(self) -> dict[str, tuple[str, AddPart]]:
        """The parts of every valve: description, and the function that adds the contents."""
        words = "What became of the valve's data on their way into the model."
        return {
            SIGNALS: ("The newest sample.", self._add_signals),
            INVERSE: ("The control voltage that a flow demands.", self._add_inverse),
            BASELINE: ("The map that was approved as new.", self._add_baseline),
            DIAGNOSTICS: (words, self._add_diagnostics),
            DYNAMICS: ("How quickly spool and meter follow.", self._add_dynamics),
            ALARMS: ("Conditions that need attention.", self._add_alarms),
        }

    async def add_frame(self, place: Place, folder: ua.NodeId, valve: ValveDescription) -> None:
        """Add the valve's own variables: frame and recommendation."""
        of_frame, of_names = frame_variables(valve)
        await self._variables.add(place, folder, of_names, frame_names(valve))
        await self._variables.add(place, folder, of_frame, None)
        for node in recommended_variables(valve.name):
            await self._variables.add(place, folder, node, None)
        for node in line_variables(valve):
            if f".{INVERSE}." not in node.id:
                await self._variables.add(place, folder, node, None)

    async def add_estimator(
        self,
        estimator: EstimatorDescription,
        place: Place,
        parent: ua.NodeId,
        valve: ValveDescription,
    ) -> None:
        """Add the variables and methods of one estimator of a valve."""
        add = partial(self._variables.add, place)
        names = list(estimator.parameter_names)
        for node in estimator_variables(valve, estimator):
            await add(parent, node, names if node.kind == ua.VariantType.String else None)
        for node in (
            *survey_variables(valve, estimator),
            *discovery_variables(valve, estimator),
        ):
            await add(parent, node, None)
        await add(parent, builds_on_variable(valve.name, estimator.name), "")
        parameters = parameter_variables(valve, estimator)
        if parameters:
            words, id_ = "The parameters as single variables.", f"{parent.Identifier}.{PARAMETERS}"
            each = await add_object(place, parent, id_, description=words)
            for node in parameters:
                await add(each, node, None)
        await self._commands.add(place, parent, Subject.ESTIMATOR, valve.name, estimator.name)
        await self._questions.add_to_estimator(place, parent, valve.name, estimator.name)

    async def declare_alarm(self, place: Place, own: ua.NodeId) -> None:
        """Declare the variables, methods and condition of an alarm, for its type."""
        for node in alarm_variables(str(own.Identifier)):
            await self._variables.add(place, own, node, None)
        await self._alarms.declare(place, own)

    async def _add_signals(self, place: Place, parent: ua.NodeId, valve: ValveDescription) -> None:
        for node in signal_variables(valve):
            await self._variables.add(place, parent, node, None)

    async def _add_inverse(self, place: Place, parent: ua.NodeId, valve: ValveDescription) -> None:
        prefix = f"{valve.name}.{INVERSE}"
        start: dict[str, Any] = {
            f"{prefix}.MapQ": list(valve.map_Q),
            f"{prefix}.MapDp": list(valve.map_dp),
            f"{prefix}.{ARMED}": False,
            f"{prefix}.{FEED_FORWARD_STATUS}": int(FeedForwardStatus.NOT_CONFIGURED),
        }
        on_write = {
            f"{prefix}.FlowDemand": partial(self._demands.flow, valve.name),
            f"{prefix}.PressureDrop": partial(self._demands.pressure_drop, valve.name),
        }
        for node in inverse_variables(valve):
            value, take = start.get(node.id), on_write.get(node.id)
            await self._variables.add(place, parent, node, value, take)
        for node in line_variables(valve):
            if f".{INVERSE}." in node.id:
                await self._variables.add(place, parent, node, None)
        if valve.map_Q and valve.map_dp:
            await self._add_map(place, parent, valve)
        await self._commands.add(place, parent, Subject.INVERSE, valve.name, INVERSE)
        await self._questions.add_to_inverse(place, parent, valve.name)

    async def _add_map(self, place: Place, parent: ua.NodeId, valve: ValveDescription) -> None:
        """Add the map as an ImageItemType, which SCADA clients can plot directly."""
        variable = await self._variables.add(
            place, parent, map_variable(valve), None, type_definition=_IMAGE_ITEM_TYPE
        )
        scale = ua.Variant(ua.AxisScaleEnumeration.Linear, ua.VariantType.Int32)
        flow, pressure = Unit.LITRE_PER_MINUTE, Unit.BAR
        for name, value, kind in (
            ("Title", ua.LocalizedText(f"Inverse flow map of {valve.name}"), "LocalizedText"),
            ("AxisScaleType", scale, "AxisScaleEnumeration"),
            ("XAxisDefinition", axis("Pressure drop", pressure, valve.map_dp), "AxisInformation"),
            ("YAxisDefinition", axis("Flow", flow, valve.map_Q), "AxisInformation"),
        ):
            data_type = ua.NodeId(getattr(ua.ObjectIds, kind))
            await add_property(place, variable.id, name, value, data_type)

    async def _add_baseline(self, place: Place, parent: ua.NodeId, valve: ValveDescription) -> None:
        for node in baseline_variables(valve.name):
            empty = "" if node.kind == ua.VariantType.String else None
            await self._variables.add(place, parent, node, empty)
        await self._commands.add(place, parent, Subject.BASELINE, valve.name, BASELINE)
        await self._questions.add_to_baseline(place, parent, valve.name)

    async def _add_diagnostics(
        self, place: Place, parent: ua.NodeId, valve: ValveDescription
    ) -> None:
        add = partial(self._variables.add, place, parent)
        for node, middles in zip(survey_axes(valve), axes(max(valve.dp_range)), strict=True):
            await add(node, middles.tolist())
        await add(waiting_variable(valve.name), [])
        await add(timing_variable(valve.name), [])
        for node in finding_variables(valve.name):
            await add(node, [])
        for node in lag_variables(valve):
            await add(node, None)
        await add(last_action(valve), "")
        for counter in valve.counters:
            await add(counter_variable(valve.name, counter), 0)
        for node in health_variables(valve.name):
            await add(node, None)

    async def _add_dynamics(self, place: Place, parent: ua.NodeId, valve: ValveDescription) -> None:
        for node in dynamics_variables(valve.name):
            await self._variables.add(place, parent, node, None)

    async def _add_alarms(self, _: Place, parent: ua.NodeId, valve: ValveDescription) -> None:
        await self._alarms.add(parent, valve.name, self._variables.add_standing)
