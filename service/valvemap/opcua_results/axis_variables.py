"""The variables of an axis, and their values from its results."""

from collections.abc import Iterator
from typing import Any, Final

from asyncua import ua

from guarded_opcua import Unit
from valvemap.opcua_results.axis_methods import SPEEDS
from valvemap.opcua_results.information_model import (
    ARMED,
    FEED_FORWARD_STATUS,
    FINDING_CODES,
    FINDING_PROBABILITIES,
    FINDINGS,
    INVERSE,
    WAITING,
    VariableNode,
    sentences_of,
)
from valvemap.opcua_results.valve_variables import (
    arming_variables,
    counter_name,
    counter_variable,
    waiting_variable,
)
from valvemap.pipeline.alignment import COUNTER_NAMES
from valvemap.pipeline.axis_ports import AxisResults
from valvemap.pipeline.axis_tracking import SPAN_S, AxisTracking
from valvemap.vocabulary.axis_quantities import AXIS_QUANTITIES
from valvemap.vocabulary.edges import EDGES
from valvemap.vocabulary.statuses import AxisStatus, InverseStatus

TRACKING: Final = "Tracking"
_PERCENT: Final = (-100.0, 100.0)
_DOUBLE, _TEXT = ua.VariantType.Double, ua.VariantType.String
_CODES: Final = ua.StatusCodes


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
    """Return the variables of the arrival of samples: missing signals, and counters."""
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
