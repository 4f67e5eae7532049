"""The information model of the results server: name, type, unit, range, meaning of every node.

The identifiers and paths are a contract with every client and never change::

    Objects/Identification/<Valve>/<Estimator>/…     s=<Valve>.<Estimator>.<Variable>
    Objects/Identification/<Valve>/<Estimator>/Parameters/…
                                                     s=<Valve>.<Estimator>.Parameters.<Name>
    Objects/Identification/<Valve>/Signals/…         s=<Valve>.Signals.<Signal>
    Objects/Identification/<Valve>/Inverse/…         s=<Valve>.Inverse.<Variable>
    Objects/Identification/<Valve>/Diagnostics/…     s=<Valve>.Diagnostics.<Counter>
    Objects/Identification/<Valve>/Commission/…      s=<Valve>.Commission.Start, Abort, State, …
    Objects/Identification/<Valve>/Dynamics/…        s=<Valve>.Dynamics.<Quantity>, with Std, Status
    Objects/Identification/<Valve>/…                 s=<Valve>.Frame, s=<Valve>.FrameNames,
                                                     s=<Valve>.Recommended, .RecommendedReason
    Objects/Identification/<Valve>/Alarms/<Alarm>/…  s=<Valve>.Alarms.<Alarm>.<Variable>
    Objects/Identification/<Valve>/…                 s=<Valve>.Identification.<Property>,
                                                     s=<Valve>.DeviceHealth: names of Devices (DI)
    Objects/Identification/Service/<Part>/…          s=Service.<Part>.<Variable>

    Objects/Identification/<Axis>/…                  s=<Axis>.<Variable>, s=<Axis>.<Edge>.Flow,
                                                     s=<Axis>.Inverse.<Variable>

An edge of a valve with ports has the place of a valve under the name ``<Valve>.PA``, a line under
``<Valve>.LineA``: ``s=<Valve>.PA.<Estimator>.<Variable>``, ``s=<Valve>.LineA.Leakage``.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from asyncua import ua

from guarded_opcua import Unit
from valvemap.errors import ConfigurationError
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE
from valvemap.pipeline.ports import EstimatorDescription, ValveDescription
from valvemap.vocabulary.edges import PARTS, split_id
from valvemap.vocabulary.findings import FindingCode
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, Bounds, Kind, Quantity
from valvemap.vocabulary.signals import PUBLISHED, SENSORS
from valvemap.vocabulary.statuses import (
    Described,
    FeedForwardStatus,
    InverseStatus,
    LineEdge,
)

NAMESPACE = SERVICE_NAMESPACE
ROOT = "Identification"
INVERSE = "Inverse"
COMMISSION, DYNAMICS = "Commission", "Dynamics"
DIAGNOSTICS = "Diagnostics"
LAG_U, LAG_Q = "LagU", "LagQ"
PARAMETERS = "Parameters"
FRAME, FRAME_NAMES = "Frame", "FrameNames"
SERVICE, SIGNALS, ALARMS, TYPES = "Service", "Signals", "Alarms", "Types"
SAMPLE_AGE, PENDING = f"{DIAGNOSTICS}.SampleAge", f"{DIAGNOSTICS}.Pending"
WAITING, TIMING = f"{DIAGNOSTICS}.Waiting", f"{DIAGNOSTICS}.Timing"
BASELINE, BUILDS_ON = "Baseline", "BuildsOn"
ARMED, FEED_FORWARD_STATUS = "Armed", "FeedForwardStatus"
LAST_ACTION = f"{DIAGNOSTICS}.LastAction"
RECOMMENDED, RECOMMENDED_REASON = "Recommended", "RecommendedReason"
LEAKAGE, LEAKAGE_STD = "Leakage", "LeakageStd"
FINDINGS, FINDING_CODES = f"{DIAGNOSTICS}.Findings", f"{DIAGNOSTICS}.FindingCodes"
FINDING_PROBABILITIES = f"{DIAGNOSTICS}.FindingProbabilities"
IDENTIFICATION, DEVICE_HEALTH = "Identification", "DeviceHealth"  # browse names of DI
NODE_VERSION = "NodeVersion"

U_RANGE = (0.0, 100.0)
T_RANGE = (-20.0, 100.0)  # °C, of hydraulic oil
YEAR_S = 3.15e7

_TAKEN = {
    *(DYNAMICS, COMMISSION, INVERSE, DIAGNOSTICS, FRAME, FRAME_NAMES, SIGNALS, ALARMS, BASELINE),
    *(IDENTIFICATION, DEVICE_HEALTH, NODE_VERSION, RECOMMENDED, RECOMMENDED_REASON),
    *PARTS,
}
_NAME = re.compile(r"[A-Za-z0-9_-]+")
_Range = tuple[float, float]


@dataclass(frozen=True)
class VariableNode:
    """One variable.

    ``id`` is the string identifier; ``dimensions`` is None for a scalar, else the length of each
    dimension (0 = any); ``statuses`` is the enumeration of an Int32's values.
    """

    id: str
    description: str
    kind: ua.VariantType = ua.VariantType.Double
    unit: Unit | None = None
    range: _Range | None = None
    dimensions: tuple[int, ...] | None = None
    statuses: type[Described] | None = None
    writable: bool = False

    @property
    def enum_strings(self) -> tuple[str, ...] | None:
        """Names of the values 0, 1, …."""
        return None if self.statuses is None else tuple(member.name for member in self.statuses)


def check_names(valves: Sequence[ValveDescription]) -> None:
    """Check that names are valid and unique, so that NodeIds and paths keep to the contract.

    Raises
    ------
    ConfigurationError
        if a name is invalid or taken; names the valve or estimator.
    """
    _check_unique("valve", [valve.name for valve in valves], {ROOT, SERVICE, TYPES})
    for valve in valves:
        names = [estimator.name for estimator in valve.estimators]
        _check_unique(f"valve {valve.name}: estimator", names, _TAKEN)


def check_axis_names(axes: Sequence[str]) -> None:
    """Check the names of axes, as `check_names` does those of valves."""
    _check_unique("axis", list(axes), {ROOT, SERVICE, TYPES})


def estimator_variables(
    valve: ValveDescription, estimator: EstimatorDescription
) -> tuple[VariableNode, ...]:
    """The variables of one estimator on one valve."""
    prefix, doubles = f"{valve.name}.{estimator.name}", ua.VariantType.Double
    return (
        VariableNode(
            f"{prefix}.ParameterVector",
            "The parameters θ of the flow map after the newest sample, in physical units "
            "(U in %, pressures in bar, Q in l/min); ParameterNames names them.",
            doubles,
            dimensions=(0,),
        ),
        VariableNode(
            f"{prefix}.ParameterStd",
            "Standard deviation of each parameter; NaN while it is not determined.",
            doubles,
            dimensions=(0,),
        ),
        VariableNode(
            f"{prefix}.ParameterNames",
            "Names of the elements of ParameterVector and ParameterStd.",
            ua.VariantType.String,
            dimensions=(0,),
        ),
        *(_quantity_variable(prefix, quantity, valve) for quantity in ESTIMATOR_QUANTITIES),
    )


def signal_variables(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The newest sample of one valve, in the order of ``vocabulary.signals.PUBLISHED``."""
    ranges = {
        "%": valve.U_range,
        "bar": (0.0, max(valve.dp_range)),
        "l/min": valve.Q_range,
        "°C": T_RANGE,
    }
    meant = {
        signal.label: (signal.sentence, signal.unit, ranges[signal.unit]) for signal in SENSORS
    }
    meant["dp"] = "pressure drop p1 - p2", "bar", valve.dp_range
    return tuple(
        VariableNode(
            f"{valve.name}.{SIGNALS}.{name}",
            f"{words[0].upper()}{words[1:]} of the newest sample, as measured.",
            unit=_UNITS[unit],
            range=bounds,
        )
        for name in PUBLISHED
        for words, unit, bounds in [meant[name]]
    )


def parameter_variables(
    valve: ValveDescription, estimator: EstimatorDescription
) -> tuple[VariableNode, ...]:
    """Each parameter as a separate variable, for clients that cannot show arrays."""
    if not estimator.has_named_parameters:
        return ()
    prefix = f"{valve.name}.{estimator.name}.{PARAMETERS}"
    return tuple(
        VariableNode(f"{prefix}.{name}", f"The parameter {name} of ParameterVector.")
        for name in estimator.parameter_names
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


def discovery_variables(
    valve: ValveDescription, estimator: EstimatorDescription
) -> tuple[VariableNode, ...]:
    """The variables of what an estimator detects: changes of the valve and the map's structure."""
    prefix = f"{valve.name}.{estimator.name}"
    _, Q_max = valve.Q_range
    changes = (
        VariableNode(
            f"{prefix}.ChangeCount",
            "Abrupt changes of the valve found since the start or the last Reset.",
            ua.VariantType.UInt32,
        ),
        VariableNode(
            f"{prefix}.ChangeTime",
            "Source time of the last sample before the newest change, as estimated.",
            ua.VariantType.DateTime,
        ),
        VariableNode(
            f"{prefix}.ChangeSize",
            "Mean innovation between the change and its detection; negative: less flow.",
            unit=Unit.LITRE_PER_MINUTE,
            range=(-Q_max, Q_max),
        ),
    )
    structure = VariableNode(
        f"{prefix}.Structure",
        "Description of the structure that the estimator has chosen.",
        ua.VariantType.String,
    )
    found = changes if estimator.finds_changes else ()
    return (*found, structure) if estimator.chooses_structure else found


def recommended_variables(valve: str) -> tuple[VariableNode, VariableNode]:
    """The variables that name the estimator to use, and say why."""
    return (
        VariableNode(
            f"{valve}.{RECOMMENDED}",
            "Name of the estimator whose map has the least error at places that the valve visited "
            "again; empty while there is none.",
            ua.VariantType.String,
        ),
        VariableNode(
            f"{valve}.{RECOMMENDED_REASON}",
            "Why it is recommended, how sure that is, and what would improve the map.",
            ua.VariantType.String,
        ),
    )


def arming_variables(prefix: str) -> tuple[VariableNode, VariableNode]:
    """The variables of feed-forward, of a valve's or an axis's inverse."""
    return (
        VariableNode(
            f"{prefix}.{ARMED}",
            "Whether writing RequiredU to the valve is armed; see Arm and Disarm.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.{FEED_FORWARD_STATUS}",
            "Whether RequiredU is written to the valve, and the first reason if not. With reasons "
            "1 to 3 nothing is written. With 4 to 12 feed_forward.fallback applies: hold the "
            "last U, ramp to fallback_percent, or hand the valve back to the source. "
            f"{sentences_of(FeedForwardStatus)}",
            ua.VariantType.Int32,
            statuses=FeedForwardStatus,
        ),
    )


def finding_variables(valve: str) -> tuple[VariableNode, VariableNode, VariableNode]:
    """The variables with the causes that explain a valve's samples, the likeliest first."""
    return (
        VariableNode(
            f"{valve}.{FINDINGS}",
            "Causes that explain the valve's samples, a sentence each, the likeliest first.",
            ua.VariantType.String,
            dimensions=(0,),
        ),
        VariableNode(
            f"{valve}.{FINDING_CODES}",
            f"The cause of each of Findings. {sentences_of(FindingCode)}",
            ua.VariantType.Int32,
            dimensions=(0,),
            statuses=FindingCode,
        ),
        VariableNode(
            f"{valve}.{FINDING_PROBABILITIES}",
            "The probability of each of Findings.",
            range=(0.0, 1.0),
            dimensions=(0,),
        ),
    )


def waiting_variable(valve: str) -> VariableNode:
    """The variable that explains why no samples are made of a valve's signals, or none are used."""
    return VariableNode(
        f"{valve}.{WAITING}",
        "Reason why no samples are made of the valve's signals or none are learnt: a sentence "
        'for each signal at fault, with the setting that would help, e.g. that p2 "has sent no '
        'value: is nodes.p2 the right node?". Empty if samples are learnt.',
        ua.VariantType.String,
        dimensions=(0,),
    )


def timing_variable(valve: str) -> VariableNode:
    """The variable that describes the timing of a valve's signals."""
    return VariableNode(
        f"{valve}.{TIMING}",
        "Timing of each signal, found at the start and fixed since: a common time, one after "
        "the other in a scan, or on change.",
        ua.VariantType.String,
        dimensions=(0,),
    )


def builds_on_variable(valve: str, estimator: str) -> VariableNode:
    """The variable with the version of the approved map that an estimator's results build on."""
    return VariableNode(
        f"{valve}.{estimator}.{BUILDS_ON}",
        "Version of the approved map on which the results build; empty if none was approved.",
        ua.VariantType.String,
    )


def alarm_variables(prefix: str) -> tuple[VariableNode, ...]:
    """The variables of one alarm; ``prefix`` is the identifier of its object."""
    return (
        VariableNode(
            f"{prefix}.Active",
            "Whether the alarm is active; its SourceTimestamp is the time of the last change.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.Severity",
            "Severity of the alarm while it is active, 1 to 1,000, as configured.",
            ua.VariantType.UInt16,
        ),
        VariableNode(
            f"{prefix}.Since",
            "Source time since which the measured value was beyond its limit when the alarm was "
            "last raised.",
            ua.VariantType.DateTime,
        ),
        VariableNode(
            f"{prefix}.Text",
            "Measured value, time of onset and possible cause; empty before the first occurrence.",
            ua.VariantType.String,
        ),
        VariableNode(
            f"{prefix}.Acked",
            "Whether the alarm was acknowledged since it last became active; true before the "
            "first occurrence.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.Confirmed",
            "False while an acknowledged alarm waits for Confirm; else true, also for an alarm "
            "that was never active or is not yet acknowledged.",
            ua.VariantType.Boolean,
        ),
    )


def baseline_variables(valve: str) -> tuple[VariableNode, ...]:
    """The variables of the baseline, the map that was approved as new."""
    prefix = f"{valve}.{BASELINE}"
    return (
        VariableNode(
            f"{prefix}.Version",
            "The approved map: its number and the first digits of its hash; empty if there is "
            "none.",
            ua.VariantType.String,
        ),
        VariableNode(f"{prefix}.Time", "Time of the newest sample in it.", ua.VariantType.DateTime),
        VariableNode(
            f"{prefix}.DataHash", "SHA-256 of the approved map's content.", ua.VariantType.String
        ),
        VariableNode(
            f"{prefix}.LastRefusal",
            "Reason for the last refused action; empty if none was refused.",
            ua.VariantType.String,
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


def lag_variables(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The lags of the signals; empty if no estimator of the valve estimates lags."""
    if not any(estimator.finds_lags for estimator in valve.estimators):
        return ()
    prefix = f"{valve.name}.{DIAGNOSTICS}"
    return (
        VariableNode(
            f"{prefix}.{LAG_U}",
            "First-order lag between U and its effect on the flow, as estimated or configured.",
            unit=Unit.SECOND,
            range=(0.0, 1.0),
        ),
        VariableNode(
            f"{prefix}.{LAG_Q}",
            "First-order lag of the flow meter, as estimated or configured.",
            unit=Unit.SECOND,
            range=(0.0, 1.0),
        ),
    )


def last_action(valve: ValveDescription) -> VariableNode:
    """The variable with the last action on a valve."""
    return VariableNode(
        f"{valve.name}.{LAST_ACTION}",
        "Last action of a user on this valve: user, colon, method or demand. Its "
        "SourceTimestamp is the time of the action.",
        ua.VariantType.String,
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


def counter_name(counter: str) -> str:
    """Name of a counter's variable within its valve, from its name in snake case.

    >>> counter_name("bad_status")
    'Diagnostics.BadStatus'
    """
    return f"{DIAGNOSTICS}.{_camel_case(counter)}"


def counter_variable(valve: str, counter: str) -> VariableNode:
    """The variable of one counter of a valve."""
    meaning = COUNTERS.get(counter, f"{counter.replace('_', ' ').capitalize()}.")
    since = "A restart keeps it." if counter in _KEPT else "Counted since the service started."
    return VariableNode(
        f"{valve}.{counter_name(counter)}",
        f"{meaning} {since}",
        ua.VariantType.UInt64,
    )


def health_variables(valve: str) -> tuple[VariableNode, VariableNode]:
    """Freshness of a valve's data: the age of the newest sample and the pending samples."""
    return (
        VariableNode(
            f"{valve}.{SAMPLE_AGE}",
            "Age of the newest sample by the source's clock; it grows while no sample arrives. "
            "Beyond alignment.stale_after_s results are no longer Good.",
            unit=Unit.SECOND,
            range=(0.0, YEAR_S),
        ),
        VariableNode(
            f"{valve}.{PENDING}",
            "Samples waiting for a missing signal or for earlier samples.",
            ua.VariantType.UInt64,
        ),
    )


def service_variables() -> dict[str, tuple[VariableNode, ...]]:
    """The variables of the service itself, by part."""
    counts = ua.VariantType.UInt64
    return {
        f"{SERVICE}.Checkpoint": (
            VariableNode(
                f"{SERVICE}.Checkpoint.Age",
                "Time since the last save of the states.",
                unit=Unit.SECOND,
                range=(0.0, YEAR_S),
            ),
            VariableNode(
                f"{SERVICE}.Checkpoint.Failures",
                "Failed saves of states since the service started.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Checkpoint.Refused",
                "States rejected at the start: damaged, or of another configuration.",
                counts,
            ),
            VariableNode(f"{SERVICE}.Checkpoint.Size", "Size on disk, bytes.", counts),
        ),
        f"{SERVICE}.History": (
            VariableNode(
                f"{SERVICE}.History.Lost",
                "Rows of the history that were lost: the buffer was full or the disk refused them.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.History.Failures",
                "Failed writes of the history since the service started.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.History.Size", "Size on disk, bytes; 0 if there is no file.", counts
            ),
        ),
        f"{SERVICE}.Start": (
            VariableNode(
                f"{SERVICE}.Start.Text",
                "State of the start: compiling, with the parts done, or complete.",
                ua.VariantType.String,
            ),
            VariableNode(
                f"{SERVICE}.Start.Compiled",
                "Share of the numerical kernels that are compiled. Until 100 %, estimators that "
                "are too slow without them (Auto) wait; no sample is lost.",
                unit=Unit.PERCENT,
                range=(0.0, 100.0),
            ),
        ),
        f"{SERVICE}.Source": (
            VariableNode(
                f"{SERVICE}.Source.Notifications", "Value changes received from the source.", counts
            ),
            VariableNode(
                f"{SERVICE}.Source.Overflows",
                "Value changes marked Overflow: the source's queue was full and lost others.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.MissingMessages",
                "Messages lost: not received and not republished.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.Undecodable",
                "Value changes that are not numbers, and messages that cannot be decoded.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.FromHistory",
                "Value changes missed live and read from the source's history.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.States",
                "One line per source: connection and losses.",
                ua.VariantType.String,
                dimensions=(0,),
            ),
        ),
    }


def axis(title: str, unit: Unit, steps: Sequence[float]) -> ua.AxisInformation:
    """Describe one axis of the map (Part 8, 5.6.6)."""
    return ua.AxisInformation(
        EngineeringUnits=unit.information,
        EURange=ua.Range(Low=min(steps, default=0.0), High=max(steps, default=0.0)),
        Title=ua.LocalizedText(title),
        AxisScaleType=ua.AxisScaleEnumeration.Linear,
        AxisSteps=list(steps),
    )


def _quantity_variable(prefix: str, quantity: Quantity, valve: ValveDescription) -> VariableNode:
    statuses = quantity.statuses
    described = "" if statuses is None else f" {sentences_of(statuses)}"
    _, Q_max = valve.Q_range
    ranges = {
        Bounds.NONE: None,
        Bounds.FLOW: valve.Q_range,
        Bounds.DIFFERENCE: (-Q_max, Q_max),
        Bounds.SPREAD: (0.0, Q_max),
    }
    return VariableNode(
        f"{prefix}.{quantity.name}",
        quantity.sentence + described,
        _KINDS[quantity.kind],
        unit=None if quantity.unit is None else _UNITS[quantity.unit],
        range=ranges[quantity.bounds],
        statuses=statuses,
    )


_KINDS = {
    Kind.NUMBER: ua.VariantType.Double,
    Kind.COUNT: ua.VariantType.UInt64,
    Kind.CODE: ua.VariantType.Int32,
}
_UNITS = {
    "%": Unit.PERCENT,
    "bar": Unit.BAR,
    "l/min": Unit.LITRE_PER_MINUTE,
    "°C": Unit.DEGREE_CELSIUS,
}


@cache
def sentences_of(statuses: type[Described]) -> str:
    """Return every member of an enumeration with its sentence, for a description."""
    return " ".join(f"{member.value} {member.name}: {member.sentence}" for member in statuses)


def _camel_case(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


def _own_name(name: str) -> str:
    """Return a name; of an edge or a line, that of its valve."""
    owner, rest = split_id(name)
    return name if rest else owner.partition(".")[0]


def _check_unique(what: str, names: Sequence[str], taken: set[str]) -> None:
    for number, name in enumerate(names):
        if not _NAME.fullmatch(_own_name(name)):
            raise ConfigurationError(
                f"{what} '{name}': a name of letters, digits, '_' and '-' is needed"
            )
        if name in taken or name in names[:number]:
            raise ConfigurationError(f"{what} '{name}': the name is taken")


_KEPT = {"lane_failures"}  # part of the checkpoint
COUNTERS = {
    "aligned": "Samples whose signals were aligned.",
    "late": "Signals received after their sample had been dropped.",
    "missing": "Samples dropped because a signal was missing.",
    "duplicates": "Signals received twice for one sample.",
    "clock_steps": "Jumps of the source's clock backwards.",
    "lost_by_time": "Samples lost according to the usual sampling interval, where the source "
    "has no Sequence.",
    "restarts": "Restarts of the source's Sequence, its running number of samples.",
    "gaps": "Samples lost according to the source's Sequence, its running number of samples.",
    "bad_status": "Samples rejected for their OPC UA status.",
    "not_finite": "Samples rejected for a value that is not finite.",
    "out_of_range": "Samples rejected for a value outside the sensor's range.",
    "frozen": "Samples rejected because a signal was constant for too long.",
    "too_fast": "Samples rejected because a signal changed faster than its limit.",
    "spike": "Samples rejected because a signal had a spike.",
    "beyond_range": "Samples not learnt by an estimator: U is outside the range of its structure.",
    "censored": "Samples not learnt by Auto: the meter does not show a flow as large or as small.",
    "lane_failures": "Stops of an estimator at an unexpected error (alarm LaneFailed).",
}
