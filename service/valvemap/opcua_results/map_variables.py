"""The variables of maps: surveys of an estimator, the inverse of a valve, of an edge, of a line."""

from asyncua import ua

from guarded_opcua import Unit
from valvemap.opcua_results.information_model import (
    ARMED,
    DIAGNOSTICS,
    FEED_FORWARD_STATUS,
    INVERSE,
    LEAKAGE,
    LEAKAGE_STD,
    U_RANGE,
    YEAR_S,
    VariableNode,
    sentences_of,
)
from valvemap.opcua_results.valve_variables import arming_variables
from valvemap.pipeline.results import EstimatorDescription, ValveDescription
from valvemap.vocabulary.statuses import (
    InverseStatus,
    LineEdge,
)


def survey_variables(
    valve: ValveDescription, estimator: EstimatorDescription
) -> tuple[VariableNode, ...]:
    """The variables of an estimator's survey: coverage and certainty of its map."""
    prefix = f"{valve.name}.{estimator.name}"
    litres = Unit.LITRE_PER_MINUTE
    return (
        VariableNode(
            f"{prefix}.Coverage",
            "Standard deviation of the map over U (rows, Diagnostics.CoverageU) and pressure "
            "drop (columns, Diagnostics.CoverageDp); NaN where there are no samples.",
            unit=litres,
            range=valve.Q_range,
            dimensions=(0, 0),
        ),
        VariableNode(
            f"{prefix}.CoverageAge",
            "Time since the last sample in each region of Coverage, s; NaN where there was none.",
            unit=Unit.SECOND,
            range=(0.0, YEAR_S),
            dimensions=(0, 0),
        ),
        VariableNode(
            f"{prefix}.CoverageShare",
            "Share of the regions of Coverage that contain recent samples.",
            range=(0.0, 1.0),
        ),
        VariableNode(
            f"{prefix}.Conditioning",
            "Ratio of the largest to the smallest uncertainty among combinations of parameters. "
            "1 is best; the larger, the less the samples determine one of the combinations. "
            "Infinite while one is not excited, NaN where the map has no parameters.",
        ),
        VariableNode(
            f"{prefix}.SuggestedU",
            "Control voltage, in % of its range, of the test point that would reduce the map's "
            "uncertainty most. It is within the configured ranges; whether the plant can drive "
            "it safely is for the operator to judge.",
            unit=Unit.PERCENT,
            range=U_RANGE,
        ),
        VariableNode(
            f"{prefix}.SuggestedDp",
            "Pressure drop of the suggested test point.",
            unit=Unit.BAR,
            range=valve.dp_range,
        ),
    )


def survey_axes(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The axes of every estimator's Coverage on one valve."""
    prefix = f"{valve.name}.{DIAGNOSTICS}"
    return (
        VariableNode(
            f"{prefix}.CoverageU",
            "Centres of the rows of Coverage and CoverageAge.",
            unit=Unit.PERCENT,
            range=U_RANGE,
            dimensions=(0,),
        ),
        VariableNode(
            f"{prefix}.CoverageDp",
            "Centres of the columns of Coverage and CoverageAge.",
            unit=Unit.BAR,
            range=valve.dp_range,
            dimensions=(0,),
        ),
    )


def inverse_variables(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The variables of one valve's inverse map, except the map itself."""
    prefix = f"{valve.name}.{INVERSE}"
    return (
        VariableNode(
            f"{prefix}.FlowDemand",
            "Demanded flow; RequiredU is the answer.",
            unit=Unit.LITRE_PER_MINUTE,
            range=valve.Q_range,
            writable=True,
        ),
        VariableNode(
            f"{prefix}.PressureDrop",
            "Pressure drop p1 - p2 for FlowDemand.",
            unit=Unit.BAR,
            range=valve.dp_range,
            writable=True,
        ),
        VariableNode(
            f"{prefix}.RequiredU",
            "Control voltage U, in % of its range, that passes FlowDemand at PressureDrop at the "
            "oil temperature measured last. The map is that of the estimator named by the setting "
            "inverse; by default the one that Recommended names, until then Auto or the first. "
            "RequiredULower and RequiredUUpper are the ends of its 95 % interval.",
            unit=Unit.PERCENT,
            range=valve.U_range,
        ),
        *(
            VariableNode(
                f"{prefix}.RequiredU{end}",
                f"{end} end of the 95 % interval of RequiredU.",
                unit=Unit.PERCENT,
                range=valve.U_range,
            )
            for end in ("Lower", "Upper")
        ),
        VariableNode(
            f"{prefix}.RequiredUStatus",
            f"Whether RequiredU can be used. {sentences_of(InverseStatus)}",
            ua.VariantType.Int32,
            statuses=InverseStatus,
        ),
        *arming_variables(prefix),
        VariableNode(
            f"{prefix}.MapQ",
            "Flows of the map's rows, l/min.",
            dimensions=(len(valve.map_Q),),
        ),
        VariableNode(
            f"{prefix}.MapDp",
            "Pressure drops of the map's columns, bar.",
            dimensions=(len(valve.map_dp),),
        ),
    )


def line_variables(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The variables that a line of a valve with ports has beside others."""
    if not valve.is_line:
        return ()
    prefix = f"{valve.name}.{INVERSE}"
    return (
        VariableNode(
            f"{valve.name}.{LEAKAGE}",
            "Flow that the line loses per bar between p1 and p2 while all edges are closed, in "
            "(l/min)/bar; the flow of its edges is without it.",
        ),
        VariableNode(
            f"{valve.name}.{LEAKAGE_STD}", "Standard deviation of Leakage, in (l/min)/bar."
        ),
        VariableNode(
            f"{prefix}.Edge",
            f"The edge that passes FlowDemand. {sentences_of(LineEdge)}",
            ua.VariantType.Int32,
            statuses=LineEdge,
        ),
    )


def inverse_results(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The variables of a valve's inverse map that change with each result."""
    rare = f"{valve.name}.{INVERSE}.{ARMED}", f"{valve.name}.{INVERSE}.{FEED_FORWARD_STATUS}"
    return tuple(
        node
        for node in inverse_variables(valve)
        if node.dimensions is None and not node.writable and node.id not in rare
    )


def map_variable(valve: ValveDescription) -> VariableNode:
    """The inverse map as a matrix, an ImageItemType (Part 8, 5.3.4.4)."""
    return VariableNode(
        f"{valve.name}.{INVERSE}.Map",
        "Control voltage U over flow (rows, YAxisDefinition, MapQ) and pressure drop (columns, "
        "XAxisDefinition, MapDp); NaN where the valve cannot deliver.",
        unit=Unit.PERCENT,
        range=valve.U_range,
        dimensions=(len(valve.map_Q), len(valve.map_dp)),
    )
