"""The nodes of axes: parameters and edges of a cylinder's valve, and the inverse for speed."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final

from asyncua import ua

from guarded_opcua import (
    HardenedServer,
    Unit,
    Variable,
    add_object,
)
from valvemap.clock import Clock
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.axis_methods import SPEEDS, add_arming, add_invert, add_set_reference
from valvemap.opcua_results.companions import Companions
from valvemap.opcua_results.information_model import (
    ALARMS,
    ARMED,
    DIAGNOSTICS,
    FEED_FORWARD_STATUS,
    FINDING_CODES,
    FINDING_PROBABILITIES,
    FINDINGS,
    INVERSE,
    ROOT,
    WAITING,
    VariableNode,
    sentences_of,
)
from valvemap.opcua_results.past import ResultsPast, has_past
from valvemap.opcua_results.result_alarms import ResultAlarms
from valvemap.opcua_results.result_health import ResultHealth
from valvemap.opcua_results.result_variables import ResultVariables, add_described
from valvemap.opcua_results.valve_variables import (
    arming_variables,
    counter_name,
    counter_variable,
    finding_variables,
    waiting_variable,
)
from valvemap.pipeline.alignment import COUNTER_NAMES
from valvemap.pipeline.axis_ports import AxisOperator, AxisResults
from valvemap.pipeline.axis_tracking import SPAN_S, AxisTracking
from valvemap.pipeline.operator_ports import Answer
from valvemap.vocabulary.axis_quantities import AXIS_QUANTITIES
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.statuses import AxisStatus, InverseStatus

TRACKING: Final = "Tracking"
_PERCENT: Final = (-100.0, 100.0)
_DOUBLE, _TEXT = ua.VariantType.Double, ua.VariantType.String
_CODES: Final = ua.StatusCodes


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
            parent = await add_object(
                server, folder, f"{name}.{edge}", description=f"The edge {edge} of the valve."
            )
            for node in edge_variables(name, edge):
                await self._add_variable(parent, node)
        parent = await add_object(
            server, folder, f"{name}.{DIAGNOSTICS}", description="What has changed at the axis."
        )
        for node in (*finding_variables(name), *arrival_variables(name)):
            await self._add_variable(parent, node)
        await add_set_reference(server, parent, name, operator)
        parent = await add_object(
            server, folder, f"{name}.{INVERSE}", description="The control voltage for a speed."
        )
        demand = partial(_demand, operator, name)
        for node in inverse_variables(name):
            await self._add_variable(parent, node, demand if node.writable else None)
        await add_invert(server, parent, name, operator)
        await add_arming(server, parent, name, operator)
        parent = await add_object(
            server,
            folder,
            f"{name}.{TRACKING}",
            description="How the axis follows its set position.",
        )
        for node in tracking_variables(name):
            await self._add_variable(parent, node)
        parent = await add_object(
            server, folder, f"{name}.{ALARMS}", description="The alarms of the axis."
        )
        await self._alarms.add(parent, name, self._of_alarms.add_standing)

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
                (self._variables[f"{axis}.{TRACKING}.{name}"], value, int(_CODES.Good), t)
                for name, value in tracking_values(course)
                if f"{axis}.{TRACKING}.{name}" in self._variables
            )
        self._health.stands(axis, results.alarms)
        self._alarms.take(axis, results.alarms, self._clock.now())


def axis_variables(axis: str) -> tuple[VariableNode, ...]:
    """Return the variables of the axis itself."""

    def of(name: str, words: str, kind: ua.VariantType = _DOUBLE, **more: Any) -> VariableNode:  # noqa: ANN401
        return VariableNode(f"{axis}.{name}", words, kind, **more)

    sentences = sentences_of(AxisStatus)
    return (
        of(
            "Status", f"How the axis stands. {sentences}", ua.VariantType.Int32, statuses=AxisStatus
        ),
        of("Reason", "Status in words, with the figures behind it.", _TEXT),
        *(of(one.name, one.sentence) for one in AXIS_QUANTITIES),
        of("LeftOut", "Intervals that were left out, by reason, in words.", _TEXT, dimensions=(0,)),
        of("U", "Positions of the spool at which Flow of each edge is given, %.", dimensions=(0,)),
    )


def arrival_variables(axis: str) -> tuple[VariableNode, ...]:
    """Return the variables of the arrival of samples: what is waited for, and counters."""
    return waiting_variable(axis), *(counter_variable(axis, name) for name in COUNTER_NAMES)


def edge_variables(axis: str, edge: str) -> tuple[VariableNode, ...]:
    """Return the variables of one edge."""
    prefix = f"{axis}.{edge}"
    return (
        VariableNode(
            f"{prefix}.Flow",
            "Flow of the edge at a drop of 70 bar over it, l/min, at the positions U of the axis.",
            dimensions=(0,),
        ),
        VariableNode(f"{prefix}.FlowStd", "Standard deviation of Flow, l/min.", dimensions=(0,)),
        VariableNode(f"{prefix}.KnownTo", "Position of the spool up to which Flow is known, %."),
    )


def inverse_variables(axis: str) -> tuple[VariableNode, ...]:
    """Return the variables of the inverse for speed."""
    prefix = f"{axis}.{INVERSE}"
    sentences = sentences_of(InverseStatus)
    end = "end of the 95 % interval of RequiredU"
    return (
        VariableNode(
            f"{prefix}.SpeedDemand",
            "Speed of the piston that is demanded; above 0 extends, NaN withdraws the demand.",
            unit=Unit.MILLIMETRE_PER_SECOND,
            range=SPEEDS,
            writable=True,
        ),
        VariableNode(
            f"{prefix}.RequiredU",
            "Control voltage for SpeedDemand at the present pressures; NaN: there is none.",
            unit=Unit.PERCENT,
            range=_PERCENT,
        ),
        VariableNode(f"{prefix}.RequiredULower", f"Lower {end}, %."),
        VariableNode(f"{prefix}.RequiredUUpper", f"Upper {end}, %."),
        VariableNode(
            f"{prefix}.RequiredUStatus",
            f"How far RequiredU can be used; of an axis, flow means speed. {sentences}",
            ua.VariantType.Int32,
            statuses=InverseStatus,
        ),
        *arming_variables(prefix),
    )


def tracking_variables(axis: str) -> tuple[VariableNode, ...]:
    """Return the variables of the tracking error; without a set position they have no value."""
    prefix = f"{axis}.{TRACKING}"
    return (
        VariableNode(
            f"{prefix}.Rms",
            f"Root mean square of Position less SetPosition over {SPAN_S:g} s, mm.",
        ),
        VariableNode(f"{prefix}.Time", "Times of Position, s since 1970 (UTC).", dimensions=(0,)),
        VariableNode(
            f"{prefix}.Position", f"Position in the newest {SPAN_S:g} s, mm.", dimensions=(0,)
        ),
        VariableNode(f"{prefix}.SetPosition", "Set position at the same times.", dimensions=(0,)),
    )


def tracking_values(course: AxisTracking) -> Iterator[tuple[str, Any]]:
    """Yield name and value of each variable of the tracking error."""
    yield "Rms", course.rms
    yield "Time", (1e-9 * course.t).tolist()
    yield "Position", course.position.tolist()
    yield "SetPosition", course.set_position.tolist()


def values_of(results: AxisResults) -> Iterator[tuple[str, Any, int]]:
    """Yield name, value and StatusCode of every variable that results have a value for."""
    known, required = results.map, results.required
    code = int(_CODES.UncertainLastUsableValue if results.is_stale else _CODES.Good)
    yield "Status", int(results.status), int(_CODES.Good)
    yield "Reason", results.sentence, int(_CODES.Good)
    left_out = [f"{reason}: {n}" for reason, n in results.left_out.items() if n]
    yield "LeftOut", left_out, int(_CODES.Good)
    for name, value in results.numbers.items():
        yield name, value, int(_CODES.Good) if name == "Used" else code
    if known is not None:
        yield "U", known.U.tolist(), code
        for edge, flow, std, to in zip(EDGES, known.flow, known.flow_std, known.known, strict=True):
            yield f"{edge}.Flow", flow.tolist(), code
            yield f"{edge}.FlowStd", std.tolist(), code
            yield f"{edge}.KnownTo", float(to), code
    findings, known_code = results.findings or (), code
    if results.findings is None:
        known_code = int(_CODES.UncertainInitialValue)
    yield FINDINGS, [one.sentence for one in findings], known_code
    yield FINDING_CODES, [int(one.code) for one in findings], known_code
    yield FINDING_PROBABILITIES, [one.probability for one in findings], known_code
    yield WAITING, list(results.waiting), int(_CODES.Good)
    for counter, n in results.counters.items():
        yield counter_name(counter), n, int(_CODES.Good)
    code = int(_CODES.BadNoCommunication if results.is_stale else _CODES.Good)
    yield f"{INVERSE}.RequiredU", required.U, code
    yield f"{INVERSE}.RequiredULower", required.lower, code
    yield f"{INVERSE}.RequiredUUpper", required.upper, code
    yield f"{INVERSE}.RequiredUStatus", int(required.status), code
    yield f"{INVERSE}.{ARMED}", results.is_armed, int(_CODES.Good)
    yield f"{INVERSE}.{FEED_FORWARD_STATUS}", int(results.feed_forward), int(_CODES.Good)


def _demand(operator: AxisOperator, axis: str, v: float) -> Answer[None]:
    return answered(partial(operator.demand_speed, axis, v), lambda _: None)
