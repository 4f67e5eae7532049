"""The quantities that each estimator publishes of each valve, one row a quantity.

Nodes, the frame, the history, the fleet's messages, Prometheus' series and the page's table of
estimators are made from these rows. A new quantity is a row here, a field of `EstimatorResult` and
`EstimatorResults` (``pipeline/results.py``), and the place where it is computed
(``pipeline/lane_results.py``).
"""

from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

from valvemap.vocabulary.statuses import Adaptation, Described, Status


class Kind(Enum):
    """Type of a quantity's value."""

    NUMBER = "float64"
    COUNT = "int64"
    CODE = "uint8"  # of an enumeration


class Bounds(Enum):
    """The range of a quantity, from the valve's flow range."""

    NONE = "none"
    FLOW = "the valve's flow range"
    DIFFERENCE = "minus to plus the largest flow"
    SPREAD = "zero to the largest flow"


class Undetermined(Enum):
    """The severity of a value that is NaN."""

    UNCERTAIN = "not determined yet"
    BAD = "no data"
    NEVER = "the service's own: valid whatever the sensors' state"


@dataclass(frozen=True)
class Quantity:
    """One scalar of an estimator.

    Attributes
    ----------
    name
        Last segment of the NodeId ``s=<Valve>.<Estimator>.<name>``.
    field
        The field of `EstimatorResults` that holds it.
    sentence
        For nodes and the documentation; an enumeration's members are appended.
    kind, unit, bounds
        Type, unit (None: a plain number) and range.
    statuses
        The enumeration of a code.
    undetermined
        The severity of NaN.
    in_frame, in_history
        Whether the frame, and the history of results, have a column of it.
    series
        Name of its series in Prometheus, labelled by valve and estimator; None: there is none.
    heading
        Of its column in the page's table of estimators; None: there is none.
    decimals
        That the page shows.
    """

    name: str
    field: str
    sentence: str
    kind: Kind = Kind.NUMBER
    unit: str | None = None
    bounds: Bounds = Bounds.NONE
    statuses: type[Described] | None = None
    undetermined: Undetermined = Undetermined.UNCERTAIN
    in_frame: bool = False
    in_history: bool = False
    series: str | None = None
    heading: str | None = None
    decimals: int = 2

    def one(self, value: Any) -> Any:  # noqa: ANN401 - the field's type
        """An array's element as a plain value: a float, an int, or the enumeration's member."""
        if self.statuses is not None:
            return self.statuses(int(value))
        return int(value) if self.kind is Kind.COUNT else float(value)


ESTIMATOR_QUANTITIES: Final = (
    Quantity(
        "PredictedFlow",
        "predicted",
        "Flow predicted for the newest sample by the parameters before it.",
        unit="l/min",
        bounds=Bounds.FLOW,
        in_frame=True,
        in_history=True,
        series="valvemap_estimator_predicted_flow_litres_per_minute",
        heading="Q̂",
        decimals=1,
    ),
    Quantity(
        "Residual",
        "residual",
        "Measured minus predicted flow of the newest sample, predicted before the sample was "
        "learnt (the innovation).",
        unit="l/min",
        bounds=Bounds.DIFFERENCE,
        in_frame=True,
        in_history=True,
        series="valvemap_estimator_residual_litres_per_minute",
        heading="Q − Q̂",
    ),
    Quantity(
        "ResidualRmse",
        "residual_rmse",
        "Root mean square of the newest residuals.",
        unit="l/min",
        bounds=Bounds.SPREAD,
        in_frame=True,
        in_history=True,
        series="valvemap_estimator_residual_rmse_litres_per_minute",
        heading="RMSE",
    ),
    Quantity(
        "NoiseStd",
        "noise_std",
        "Standard deviation of recent measurements about the map: noise and misfit of the "
        "structure.",
        unit="l/min",
        bounds=Bounds.SPREAD,
        in_frame=True,
        in_history=True,
        series="valvemap_estimator_noise_litres_per_minute",
        heading="Noise",
    ),
    Quantity(
        "SystematicStd",
        "systematic_std",
        "Standard deviation of the flow at the newest sample that follows from the sensors' "
        "stated accuracy: more samples do not reduce it.",
        unit="l/min",
        bounds=Bounds.SPREAD,
        undetermined=Undetermined.BAD,
    ),
    Quantity(
        "SampleCount",
        "sample_count",
        "Samples learnt since the start or the last Reset; rejected ones are not counted.",
        Kind.COUNT,
        undetermined=Undetermined.NEVER,
        in_frame=True,
        series="valvemap_estimator_samples",
    ),
    Quantity(
        "Status",
        "status",
        "Effect of the newest sample on the estimator.",
        Kind.CODE,
        statuses=Status,
        undetermined=Undetermined.NEVER,
        in_frame=True,
        in_history=True,
        series="valvemap_estimator_status",
    ),
    Quantity(
        "Adaptation",
        "adaptation",
        "Cause to which the estimator attributes its residuals.",
        Kind.CODE,
        statuses=Adaptation,
        undetermined=Undetermined.NEVER,
    ),
)
"""In the order of the nodes, and of the frame's columns."""

FRAME_QUANTITIES: Final = tuple(q for q in ESTIMATOR_QUANTITIES if q.in_frame)
HISTORY_QUANTITIES: Final = tuple(q for q in ESTIMATOR_QUANTITIES if q.in_history)
