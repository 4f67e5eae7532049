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
    Objects/Identification/<Valve>/ProcessValues/…   s=<Valve>.ProcessValues.<Name>.AnalogSignal
    Objects/Identification/Service/<Part>/…          s=Service.<Part>.<Variable>

    Objects/Identification/<Axis>/…                  s=<Axis>.<Variable>, s=<Axis>.<Edge>.Flow,
                                                     s=<Axis>.Inverse.<Variable>,
                                                     s=<Axis>.DeviceHealth

An edge of a valve with ports has the place of a valve under the name ``<Valve>.PA``, a line under
``<Valve>.LineA``: ``s=<Valve>.PA.<Estimator>.<Variable>``, ``s=<Valve>.LineA.Leakage``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from asyncua import ua

from guarded_opcua import Unit
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE
from valvemap.pipeline.results import EstimatorDescription, ValveDescription
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES, Bounds, Kind, Quantity
from valvemap.vocabulary.signals import PUBLISHED, SENSORS
from valvemap.vocabulary.statuses import (
    Described,
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
PROCESS_VALUES = "ProcessValues"

U_RANGE = (0.0, 100.0)
T_RANGE = (-20.0, 100.0)  # °C, of hydraulic oil
YEAR_S = 3.15e7

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
            "Change of the flow; negative: less. RLS: mean innovation between the change and its "
            "detection. Auto: root mean square difference from the former map over the next 10 s.",
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


def builds_on_variable(valve: str, estimator: str) -> VariableNode:
    """The variable with the version of the approved map that an estimator's results build on."""
    return VariableNode(
        f"{valve}.{estimator}.{BUILDS_ON}",
        "Version of the approved map on which the results build; empty if none was approved.",
        ua.VariantType.String,
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
