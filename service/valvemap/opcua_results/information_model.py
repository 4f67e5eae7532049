"""The information model of the results server: name, type, unit, range, meaning of every node.

The identifiers and paths are a contract with every client and never change::

    Objects/Identification/<Valve>/<Estimator>/…     s=<Valve>.<Estimator>.<Variable>
    Objects/Identification/<Valve>/<Estimator>/Parameters/…
                                                     s=<Valve>.<Estimator>.Parameters.<Name>
    Objects/Identification/<Valve>/Signals/…         s=<Valve>.Signals.<Signal>
    Objects/Identification/<Valve>/Inverse/…         s=<Valve>.Inverse.<Variable>
    Objects/Identification/<Valve>/Diagnostics/…     s=<Valve>.Diagnostics.<Counter>
    Objects/Identification/<Valve>/…                 s=<Valve>.Frame, s=<Valve>.FrameNames
    Objects/Identification/<Valve>/Alarms/<Alarm>/…  s=<Valve>.Alarms.<Alarm>.<Variable>
    Objects/Identification/<Valve>/…                 s=<Valve>.Identification.<Property>,
                                                     s=<Valve>.DeviceHealth: names of Devices (DI)
    Objects/Identification/Service/<Part>/…          s=Service.<Part>.<Variable>
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
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, Bounds, Kind, Quantity
from valvemap.vocabulary.statuses import Described, FeedForwardStatus, InverseStatus

NAMESPACE = SERVICE_NAMESPACE
ROOT = "Identification"
INVERSE = "Inverse"
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
IDENTIFICATION, DEVICE_HEALTH = "Identification", "DeviceHealth"  # browse names of DI
NODE_VERSION = "NodeVersion"

U_RANGE = (0.0, 100.0)
T_RANGE = (-20.0, 100.0)  # °C, of hydraulic oil
YEAR_S = 3.15e7

_TAKEN = {
    *(INVERSE, DIAGNOSTICS, FRAME, FRAME_NAMES, SIGNALS, ALARMS, BASELINE),
    *(IDENTIFICATION, DEVICE_HEALTH, NODE_VERSION),
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
    """The newest sample of one valve, in the order of ``pipeline.ports.SIGNALS``."""
    p_range = 0.0, max(valve.dp_range)
    meant = (
        ("U", "Control voltage", Unit.PERCENT, U_RANGE),
        ("p1", "Pressure before the valve", Unit.BAR, p_range),
        ("p2", "Pressure behind the valve", Unit.BAR, p_range),
        ("Q", "Flow", Unit.LITRE_PER_MINUTE, valve.Q_range),
        ("dp", "Pressure drop p1 - p2", Unit.BAR, valve.dp_range),
        ("T", "Oil temperature", Unit.DEGREE_CELSIUS, T_RANGE),
    )
    return tuple(
        VariableNode(
            f"{valve.name}.{SIGNALS}.{name}",
            f"{words} of the newest sample, as measured.",
            unit=unit,
            range=bounds,
        )
        for name, words, unit, bounds in meant
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
            "Standard deviation of the map over U (rows, Diagnostics.CoverageU) and pressure drop "
            "(columns, Diagnostics.CoverageDp); NaN where nothing is known.",
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
            "Part of the regions of Coverage that recent samples lie in.",
            range=(0.0, 1.0),
        ),
        VariableNode(
            f"{prefix}.Conditioning",
            "How much better the best known combination of parameters is known than the worst; "
            "infinite while one is not excited at all, NaN where the map has no such parameters.",
        ),
        VariableNode(
            f"{prefix}.SuggestedU",
            "Control voltage of the test point that would make the map surer than any other.",
            unit=Unit.PERCENT,
            range=U_RANGE,
        ),
        VariableNode(
            f"{prefix}.SuggestedDp",
            "Pressure drop of that test point.",
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
            "Abrupt changes of the valve that were found since the start or the last Reset.",
            ua.VariantType.UInt32,
        ),
        VariableNode(
            f"{prefix}.ChangeTime",
            "Source time of the last sample before the newest of them, as estimated.",
            ua.VariantType.DateTime,
        ),
        VariableNode(
            f"{prefix}.ChangeSize",
            "Mean innovation from then on to its detection: less flow is negative.",
            unit=Unit.LITRE_PER_MINUTE,
            range=(-Q_max, Q_max),
        ),
    )
    structure = VariableNode(
        f"{prefix}.Structure",
        "The structure of the map that the estimator has chosen, in words.",
        ua.VariantType.String,
    )
    found = changes if estimator.finds_changes else ()
    return (*found, structure) if estimator.chooses_structure else found


def waiting_variable(valve: str) -> VariableNode:
    """The variable that explains why no samples are made of a valve's signals, or none are used."""
    return VariableNode(
        f"{valve}.{WAITING}",
        "Why no samples are made of the valve's signals, or none are learnt from: a sentence for "
        "each signal that is to blame, with the setting that would help; empty while all is well.",
        ua.VariantType.String,
        dimensions=(0,),
    )


def timing_variable(valve: str) -> VariableNode:
    """The variable that describes the timing of a valve's signals."""
    return VariableNode(
        f"{valve}.{TIMING}",
        "How each of the valve's signals comes, as found at the start and fixed since: with one "
        "time, one after the other in a scan, or on change.",
        ua.VariantType.String,
        dimensions=(0,),
    )


def builds_on_variable(valve: str, estimator: str) -> VariableNode:
    """The variable with the version of the approved map that an estimator's results build on."""
    return VariableNode(
        f"{valve}.{estimator}.{BUILDS_ON}",
        "Version of the approved map that the results build on; empty where none was approved.",
        ua.VariantType.String,
    )


def alarm_variables(prefix: str) -> tuple[VariableNode, ...]:
    """The variables of one alarm; ``prefix`` is the identifier of its object."""
    return (
        VariableNode(
            f"{prefix}.Active",
            "Whether it is there; when that began or ended is its SourceTimestamp.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.Severity",
            "How urgent it is when it is there, 1 to 1,000, as configured.",
            ua.VariantType.UInt16,
        ),
        VariableNode(
            f"{prefix}.Since",
            "Source time since when what was measured was beyond the limit, the last time.",
            ua.VariantType.DateTime,
        ),
        VariableNode(
            f"{prefix}.Text",
            "What was measured, since when, and what it may be; empty before the first time.",
            ua.VariantType.String,
        ),
        VariableNode(
            f"{prefix}.Acked",
            "Whether somebody has acknowledged it since it came last; true before the first time.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.Confirmed",
            "Whether it needs no confirming: false from when it was acknowledged until somebody "
            "says that it was dealt with.",
            ua.VariantType.Boolean,
        ),
    )


def baseline_variables(valve: str) -> tuple[VariableNode, ...]:
    """The variables of the baseline, the map that was approved as new."""
    prefix = f"{valve}.{BASELINE}"
    return (
        VariableNode(
            f"{prefix}.Version",
            "The approved map: its running number, and how its hash begins; empty: there is none.",
            ua.VariantType.String,
        ),
        VariableNode(
            f"{prefix}.Time", "Time of the newest sample behind it.", ua.VariantType.DateTime
        ),
        VariableNode(f"{prefix}.DataHash", "SHA-256 of all that it holds.", ua.VariantType.String),
        VariableNode(
            f"{prefix}.LastRefusal",
            "Why the last action on it that was refused was; empty: none was.",
            ua.VariantType.String,
        ),
    )


def survey_axes(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The axes of every estimator's Coverage on one valve."""
    prefix = f"{valve.name}.{DIAGNOSTICS}"
    return (
        VariableNode(
            f"{prefix}.CoverageU",
            "Middles of the rows of each Coverage and CoverageAge.",
            unit=Unit.PERCENT,
            range=U_RANGE,
            dimensions=(0,),
        ),
        VariableNode(
            f"{prefix}.CoverageDp",
            "Middles of the columns of each Coverage and CoverageAge.",
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
            "First-order lag from U to its effect on the flow, as taken into account.",
            unit=Unit.SECOND,
            range=(0.0, 1.0),
        ),
        VariableNode(
            f"{prefix}.{LAG_Q}",
            "First-order lag of the flow meter, as taken into account.",
            unit=Unit.SECOND,
            range=(0.0, 1.0),
        ),
    )


def last_action(valve: ValveDescription) -> VariableNode:
    """The variable with the last action on a valve."""
    return VariableNode(
        f"{valve.name}.{LAST_ACTION}",
        "What a user did to this valve last, and who: the name, a colon, the method or the demand. "
        "Its SourceTimestamp says when.",
        ua.VariantType.String,
    )


def inverse_variables(valve: ValveDescription) -> tuple[VariableNode, ...]:
    """The variables of one valve's inverse map, except the map itself."""
    prefix = f"{valve.name}.{INVERSE}"
    return (
        VariableNode(
            f"{prefix}.FlowDemand",
            "Flow that the valve shall pass; answered by RequiredU.",
            unit=Unit.LITRE_PER_MINUTE,
            range=valve.Q_range,
            writable=True,
        ),
        VariableNode(
            f"{prefix}.PressureDrop",
            "Pressure drop p1 - p2 at which it shall pass it.",
            unit=Unit.BAR,
            range=valve.dp_range,
            writable=True,
        ),
        VariableNode(
            f"{prefix}.RequiredU",
            "Control voltage that passes FlowDemand at PressureDrop, in % of its range.",
            unit=Unit.PERCENT,
            range=U_RANGE,
        ),
        VariableNode(
            f"{prefix}.RequiredUStatus",
            f"How far RequiredU can be used. {_sentences(InverseStatus)}",
            ua.VariantType.Int32,
            statuses=InverseStatus,
        ),
        VariableNode(
            f"{prefix}.{ARMED}",
            "Whether RequiredU is written to the valve while it may be; see Arm and Disarm.",
            ua.VariantType.Boolean,
        ),
        VariableNode(
            f"{prefix}.{FEED_FORWARD_STATUS}",
            "Whether RequiredU is written to the valve, and if not, why; the configured fallback "
            f"acts meanwhile. {_sentences(FeedForwardStatus)}",
            ua.VariantType.Int32,
            statuses=FeedForwardStatus,
        ),
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
        range=U_RANGE,
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
    return VariableNode(
        f"{valve}.{counter_name(counter)}",
        f"{meaning} Counted since the service started.",
        ua.VariantType.UInt64,
    )


def health_variables(valve: str) -> tuple[VariableNode, VariableNode]:
    """Freshness of a valve's data: the age of the newest sample and the pending samples."""
    return (
        VariableNode(
            f"{valve}.{SAMPLE_AGE}",
            "By how much the newest sample that was learnt is behind the source's clock.",
            unit=Unit.SECOND,
            range=(0.0, YEAR_S),
        ),
        VariableNode(
            f"{valve}.{PENDING}",
            "Samples that wait for signals of theirs, or for earlier samples.",
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
                "Time since states were last kept.",
                unit=Unit.SECOND,
                range=(0.0, YEAR_S),
            ),
            VariableNode(
                f"{SERVICE}.Checkpoint.Failures",
                "How often states could not be kept since the service started.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Checkpoint.Refused",
                "States found at the start that were damaged, or of another configuration.",
                counts,
            ),
            VariableNode(f"{SERVICE}.Checkpoint.Size", "Bytes that they take on disk.", counts),
        ),
        f"{SERVICE}.History": (
            VariableNode(
                f"{SERVICE}.History.Lost",
                "Rows of the history that found no room, or that the disk did not take.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.History.Failures",
                "How often the history could not be kept since the service started.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.History.Size", "Bytes that it takes on disk; 0: there is none.", counts
            ),
        ),
        f"{SERVICE}.Source": (
            VariableNode(
                f"{SERVICE}.Source.Notifications", "Changes that the source sent.", counts
            ),
            VariableNode(
                f"{SERVICE}.Source.Overflows",
                "Changes marked Overflow: the source's queue was full, and dropped some.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.MissingMessages",
                "Messages that never came and could not be had again.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.Undecodable",
                "Changes whose value is no number, and messages that cannot be understood.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.FromHistory",
                "Changes that were not heard and were read from the source's history.",
                counts,
            ),
            VariableNode(
                f"{SERVICE}.Source.States",
                "A line for each source: whether it is connected, and what was lost of it.",
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
    described = "" if statuses is None else f" {_sentences(statuses)}"
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
_UNITS = {"l/min": Unit.LITRE_PER_MINUTE}


@cache
def _sentences(statuses: type[Described]) -> str:
    return " ".join(f"{member.value} {member.name}: {member.sentence}" for member in statuses)


def _camel_case(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


def _check_unique(what: str, names: Sequence[str], taken: set[str]) -> None:
    for number, name in enumerate(names):
        if not _NAME.fullmatch(name):
            raise ConfigurationError(
                f"{what} '{name}': a name of letters, digits, '_' and '-' is needed"
            )
        if name in taken or name in names[:number]:
            raise ConfigurationError(f"{what} '{name}': the name is taken")


COUNTERS = {
    "aligned": "Samples whose signals found together.",
    "late": "Signals that came after their sample had been given up.",
    "missing": "Samples given up because a signal did not come.",
    "duplicates": "Signals that came twice for one sample.",
    "clock_steps": "Jumps of the source's clock backwards.",
    "lost_by_time": "Samples that the usual pace shows as lost where no Sequence tells.",
    "restarts": "How often the source's Sequence began anew.",
    "gaps": "Samples that the source's Sequence shows as lost.",
    "bad_status": "Samples rejected for their OPC UA status.",
    "not_finite": "Samples rejected for a value that is no finite number.",
    "out_of_range": "Samples rejected for a value that no such sensor can give.",
    "frozen": "Samples rejected because a signal stood still for too long.",
    "too_fast": "Samples rejected because a signal changed faster than it can.",
    "spike": "Samples rejected because a signal had a spike.",
    "beyond_range": "Samples that an estimator did not learn from: it cannot describe such a U.",
    "too_fast_for_lag": "Samples that Auto did not learn from: too fast for the signals' lags.",
    "lane_failures": "How often an estimator stopped at an unexpected error (alarm LaneFailed).",
}
