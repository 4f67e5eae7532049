"""The nodes of axes: parameters and edges of a cylinder's valve, and the inverse for speed."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Final

from asyncua import ua

from guarded_opcua import (
    Argument,
    HardenedServer,
    Role,
    Unit,
    Variable,
    add_method,
    add_object,
)
from valvemap.clock import Clock
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.information_model import INVERSE, ROOT, VariableNode, sentences_of
from valvemap.opcua_results.result_variables import add_described
from valvemap.pipeline.axis_ports import AxisOperator, AxisResults, RequiredU
from valvemap.pipeline.ports import Answer
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.statuses import AxisStatus, InverseStatus

_SPEEDS: Final = (-5_000.0, 5_000.0)  # mm/s; faster than any cylinder
_PERCENT: Final = (-100.0, 100.0)
_PRESSURES: Final = (0.0, 1_000.0)
_TEMPERATURES: Final = (-50.0, 200.0)
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
    """

    def __init__(self, server: HardenedServer, clock: Clock) -> None:
        self._server = server
        self._clock = clock
        self._variables: dict[str, Variable] = {}
        self._names: tuple[str, ...] = ()

    async def follow(self, axes: Sequence[str], operator: AxisOperator | None) -> None:
        """Show these axes, in place of those before; ``operator`` is None if there are none."""
        server = self._server
        root = ua.NodeId(ROOT, server.namespace_index)
        gone = [ua.NodeId(name, server.namespace_index) for name in self._names]
        if gone:
            server.remove(gone, (root,))
        self._variables.clear()
        self._names = tuple(axes)
        if operator is not None:
            for axis in axes:
                await self._add(root, axis, operator)

    async def _add(self, root: ua.NodeId, name: str, operator: AxisOperator) -> None:
        server = self._server
        words = f"The axis {name}: the edges of its valve, from position and pressures."
        folder = await add_object(server, root, name, description=words)
        for node in axis_variables(name):
            await self._add_variable(folder, node)
        for edge in EDGES:
            parent = await add_object(
                server, folder, f"{name}.{edge}", description=f"The edge {edge} of the valve."
            )
            for node in edge_variables(name, edge):
                await self._add_variable(parent, node)
        parent = await add_object(
            server, folder, f"{name}.{INVERSE}", description="The control voltage for a speed."
        )
        demand = partial(_demand, operator, name)
        for node in inverse_variables(name):
            await self._add_variable(parent, node, demand if node.writable else None)
        await _add_invert(server, parent, name, operator)

    async def _add_variable(
        self,
        parent: ua.NodeId,
        node: VariableNode,
        on_write: Callable[[float], Answer[None]] | None = None,
    ) -> None:
        variable = await add_described(self._server, parent, node, None, on_write)
        self._variables[node.id] = variable

    def show(self, axis: str, results: AxisResults) -> None:
        """Write the newest results of one axis."""
        t = results.t or self._clock.now()
        self._server.write(
            (self._variables[f"{axis}.{name}"], value, code, t)
            for name, value, code in values_of(results)
            if f"{axis}.{name}" in self._variables
        )


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
        of("BulkModulus", "Bulk modulus of oil and hoses, GPa."),
        of("BulkModulusStd", "Standard deviation of BulkModulus, GPa."),
        of(
            "Leakage",
            "Leakage between the lines A and B, in (l/min)/bar; at 40 °C, if there is T.",
        ),
        of("LeakageStd", "Standard deviation of Leakage, in (l/min)/bar."),
        of("Air", "Free air in the lines at atmospheric pressure, % of their volume."),
        of("AirStd", "Standard deviation of Air, %."),
        of("Play", "Width of the loop of U: hysteresis of the spool, %."),
        of("SpoolFrequency", "Natural frequency of the spool, Hz."),
        of("Used", "Movement that the present map was learnt from, s."),
        of("LeftOut", "Intervals that were left out, by reason, in words.", _TEXT, dimensions=(0,)),
        of("U", "Positions of the spool at which Flow of each edge is given, %.", dimensions=(0,)),
    )


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
            range=_SPEEDS,
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
    )


def values_of(results: AxisResults) -> Iterator[tuple[str, Any, int]]:
    """Yield name, value and StatusCode of every variable that results have a value for."""
    known, required = results.map, results.required
    code = int(_CODES.UncertainLastUsableValue if results.is_stale else _CODES.Good)
    yield "Status", int(results.status), int(_CODES.Good)
    yield "Reason", results.sentence, int(_CODES.Good)
    left_out = [f"{reason}: {n}" for reason, n in results.left_out.items() if n]
    yield "LeftOut", left_out, int(_CODES.Good)
    yield "Used", results.used_s, int(_CODES.Good)
    if known is not None:
        pairs = {"BulkModulus": known.bulk_modulus, "Leakage": known.leakage, "Air": known.air}
        for name, (value, std) in pairs.items():
            yield name, value, code
            yield f"{name}Std", std, code
        yield "Play", known.play_percent, code
        yield "SpoolFrequency", known.spool_hz, code
        yield "U", known.U.tolist(), code
        for edge, flow, std, to in zip(EDGES, known.flow, known.flow_std, known.known, strict=True):
            yield f"{edge}.Flow", flow.tolist(), code
            yield f"{edge}.FlowStd", std.tolist(), code
            yield f"{edge}.KnownTo", float(to), code
    code = int(_CODES.BadNoCommunication if results.is_stale else _CODES.Good)
    yield f"{INVERSE}.RequiredU", required.U, code
    yield f"{INVERSE}.RequiredULower", required.lower, code
    yield f"{INVERSE}.RequiredUUpper", required.upper, code
    yield f"{INVERSE}.RequiredUStatus", int(required.status), code


async def _add_invert(
    server: HardenedServer, parent: ua.NodeId, axis: str, operator: AxisOperator
) -> None:
    pressures = tuple(
        Argument(
            name,
            "Pressure; NaN takes the one measured last",
            unit=Unit.BAR,
            value_range=_PRESSURES,
            or_nan=True,
        )
        for name in ("pA", "pB", "pS", "pT")
    )
    speed = Argument("v", "Speed", unit=Unit.MILLIMETRE_PER_SECOND, value_range=_SPEEDS)
    temperature = Argument(
        "T",
        "Oil temperature, which moves the leakage; NaN takes the newest",
        unit=Unit.DEGREE_CELSIUS,
        value_range=_TEMPERATURES,
        or_nan=True,
    )
    numbered = ", ".join(f"{member.value} {member.name}" for member in InverseStatus)
    await add_method(
        server,
        parent,
        f"{axis}.{INVERSE}.Invert",
        partial(_invert, operator, axis),
        inputs=(speed, *pressures, temperature),
        outputs=(
            Argument("U", "Control voltage; NaN if none can be trusted", unit=Unit.PERCENT),
            Argument("Lower", "Lower end of its 95 % interval", unit=Unit.PERCENT),
            Argument("Upper", "Upper end of its 95 % interval", unit=Unit.PERCENT),
            Argument("Status", "How far the answer can be trusted", ua.VariantType.Int32),
        ),
        required=Role.OBSERVER,
        description="Control voltage U (%) for a speed v (mm/s, above 0 extends) at these "
        "pressures (bar), in the middle of the loop of Play: add half of it while U rises, "
        "subtract half while U falls. Lower and Upper are the ends of its 95 % interval. "
        f"Status: {numbered}.",
    )


def _demand(operator: AxisOperator, axis: str, v: float) -> Answer[None]:
    return answered(partial(operator.demand_speed, axis, v), lambda _: None)


def _invert(
    operator: AxisOperator,
    axis: str,
    v: float,
    pA: float,
    pB: float,
    pS: float,
    pT: float,
    T: float,
) -> Answer[tuple[float, float, float, int]]:
    def numbers(found: RequiredU) -> tuple[float, float, float, int]:
        return found.U, found.lower, found.upper, int(found.status)

    return answered(partial(operator.invert_speed, axis, v, pA, pB, pS, pT, T), numbers)
