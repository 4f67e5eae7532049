"""The nodes of axes: parameters and edges of a cylinder's valve, and the inverse for speed."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Final

from asyncua import ua

from guarded_opcua import HardenedServer, Variable, add_object
from valvemap.clock import Clock
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.axis_methods import add_arming, add_invert, add_set_reference
from valvemap.opcua_results.axis_variables import (
    TRACKING,
    arrival_variables,
    axis_variables,
    edge_variables,
    inverse_variables,
    tracking_values,
    tracking_variables,
    values_of,
)
from valvemap.opcua_results.companions import Companions
from valvemap.opcua_results.information_model import (
    ALARMS,
    DIAGNOSTICS,
    INVERSE,
    ROOT,
    VariableNode,
)
from valvemap.opcua_results.past import ResultsPast, has_past
from valvemap.opcua_results.result_alarms import ResultAlarms
from valvemap.opcua_results.result_health import ResultHealth
from valvemap.opcua_results.result_variables import ResultVariables, add_described
from valvemap.opcua_results.valve_variables import finding_variables
from valvemap.pipeline.axis_ports import AxisOperator, AxisResults
from valvemap.pipeline.axis_tracking import AxisTracking
from valvemap.pipeline.operator_ports import Answer
from valvemap.vocabulary.edges import EDGES

_GOOD: Final = int(ua.StatusCodes.Good)


class AxisNodes:
    """Adds the nodes of axes, and writes them.

    Parameters
    ----------
    server
        The server that shows them.
    clock
        Time of values without a sample.
    variables, alarms
        Add and write the nodes of alarms, and report their changes.
    companions, health
        Add and publish the DeviceHealth.
    past
        The history of variables; None: no history.
    keep_events
        Gives an object a history of its events.
    """

    def __init__(
        self,
        server: HardenedServer,
        clock: Clock,
        variables: ResultVariables,
        alarms: ResultAlarms,
        companions: Companions,
        health: ResultHealth,
        past: ResultsPast | None,
        keep_events: Callable[[ua.NodeId], None],
    ) -> None:
        self._server, self._clock = server, clock
        self._of_alarms, self._alarms = variables, alarms
        self._companions, self._health = companions, health
        self._past, self._keep_events = past, keep_events
        self._variables: dict[str, Variable] = {}
        self._names: tuple[str, ...] = ()
        self._tracking: dict[str, AxisTracking] = {}  # as written last

    async def follow(self, axes: Sequence[str], operator: AxisOperator | None) -> None:
        """Show these axes, in place of those before; ``operator`` is None if there are none."""
        server = self._server
        root = ua.NodeId(ROOT, server.namespace_index)
        gone = [ua.NodeId(name, server.namespace_index) for name in self._names]
        if gone:
            server.remove(gone, (root,))
            self._of_alarms.forget(self._names)
            for name in self._names:
                self._health.forget(name)
        self._variables.clear()
        self._tracking.clear()
        self._names = tuple(axes)
        if operator is not None:
            for axis in axes:
                await self._add(root, axis, operator)

    async def _add(self, root: ua.NodeId, name: str, operator: AxisOperator) -> None:
        server = self._server
        words = f"The axis {name}: the edges of its valve, from position and pressures."
        folder = await add_object(server, root, name, description=words)
        server.let_emit(folder)
        self._keep_events(folder)
        server.refer_to_conditions(folder, self._alarms.keys(name))
        health = await self._companions.add_health(folder, "axis")
        self._health.add(name, health, None)
        for node in axis_variables(name):
            await self._add_variable(folder, node)
        for edge in EDGES:
            words = f"The edge {edge} of the valve."
            await self._add_part(folder, f"{name}.{edge}", words, edge_variables(name, edge))
        found = *finding_variables(name), *arrival_variables(name)
        words = "What has changed at the axis."
        part = await self._add_part(folder, f"{name}.{DIAGNOSTICS}", words, found)
        await add_set_reference(server, part, name, operator)
        words, demand = "The control voltage for a speed.", partial(_demand, operator, name)
        inverse = inverse_variables(name)
        part = await self._add_part(folder, f"{name}.{INVERSE}", words, inverse, demand)
        await add_invert(server, part, name, operator)
        await add_arming(server, part, name, operator)
        words = "How the axis follows its set position."
        await self._add_part(folder, f"{name}.{TRACKING}", words, tracking_variables(name))
        part = await self._add_part(folder, f"{name}.{ALARMS}", "The alarms of the axis.")
        await self._alarms.add(part, name, self._of_alarms.add_standing)

    async def _add_part(
        self,
        folder: ua.NodeId,
        id_: str,
        words: str,
        variables: Iterable[VariableNode] = (),
        on_write: Callable[[float], Answer[None]] | None = None,
    ) -> ua.NodeId:
        """Add an object with its variables; ``on_write`` is called for the writable ones."""
        part = await add_object(self._server, folder, id_, description=words)
        for node in variables:
            await self._add_variable(part, node, on_write if node.writable else None)
        return part

    async def _add_variable(
        self,
        parent: ua.NodeId,
        node: VariableNode,
        on_write: Callable[[float], Answer[None]] | None = None,
    ) -> None:
        variable = await add_described(self._server, parent, node, None, on_write)
        self._variables[node.id] = variable
        if self._past is not None and has_past(node.id):
            self._server.add_history([variable], self._past)

    def show(self, axis: str, results: AxisResults) -> None:
        """Write the newest results of one axis."""
        t = results.t or self._clock.now()
        self._server.write(
            (self._variables[f"{axis}.{name}"], value, code, t)
            for name, value, code in values_of(results)
            if f"{axis}.{name}" in self._variables
        )
        course = results.tracking
        if course is not None and course is not self._tracking.get(axis):
            self._tracking[axis] = course
            self._server.write(
                (self._variables[f"{axis}.{TRACKING}.{name}"], value, _GOOD, t)
                for name, value in tracking_values(course)
                if f"{axis}.{TRACKING}.{name}" in self._variables
            )
        self._health.stands(axis, results.alarms)
        self._alarms.take(axis, results.alarms, self._clock.now())


def _demand(operator: AxisOperator, axis: str, v: float) -> Answer[None]:
    return answered(partial(operator.demand_speed, axis, v), lambda _: None)
