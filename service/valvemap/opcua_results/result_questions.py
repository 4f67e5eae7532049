"""Query methods of valves: read-only, allowed for every user."""

from collections.abc import Iterable
from functools import partial

from asyncua import ua

from guarded_opcua import Argument, Role, Unit, add_method
from valvemap.model.samples import Floats
from valvemap.opcua_results.answers import answered
from valvemap.opcua_results.information_model import BASELINE, INVERSE, U_RANGE
from valvemap.opcua_results.result_notes import ResultNotes
from valvemap.opcua_results.result_types import Place
from valvemap.pipeline.operator_ports import Answer, Operator
from valvemap.vocabulary.statuses import InverseStatus, Status

_STATUS = Argument("Status", "How far the answer can be trusted", ua.VariantType.Int32)
_U = Argument("U", "Control voltage", unit=Unit.PERCENT, value_range=U_RANGE)
_FLOW = (
    Argument("Q", "Flow; NaN if unknown", unit=Unit.LITRE_PER_MINUTE),
    Argument("Std", "Its standard deviation", unit=Unit.LITRE_PER_MINUTE),
    _STATUS,
)
_dp = Argument("dp", "Pressure drop p1 - p2", unit=Unit.BAR)
_T = Argument(
    "T",
    "Oil temperature; NaN takes the one measured last",
    unit=Unit.DEGREE_CELSIUS,
    or_nan=True,
)


class ResultQuestions:
    """Adds the query methods.

    Parameters
    ----------
    operator
        Answers the queries.
    notes
        Record refused comparisons with the baseline.
    """

    def __init__(self, operator: Operator, notes: ResultNotes) -> None:
        self._operator = operator
        self._notes = notes

    async def add_to_estimator(
        self, place: Place, parent: ua.NodeId, valve: str, estimator: str
    ) -> None:
        """Add the queries of an estimator: Predict and PredictMeasurement."""
        prefix, who, flow = f"{valve}.{estimator}", (valve, estimator), Unit.LITRE_PER_MINUTE
        await add_method(
            place,
            parent,
            f"{prefix}.Predict",
            partial(self._predict, *who),
            inputs=(_U, _dp, _T),
            outputs=_FLOW,
            required=Role.OBSERVER,
            description=f"Flow at a point of the map. Status: {_numbered(Status)}.",
        )
        await add_method(
            place,
            parent,
            f"{prefix}.PredictMeasurement",
            partial(self._predict_measurement, *who),
            inputs=(_U, _dp, _T),
            outputs=(
                Argument("Q", "Flow; NaN if unknown", unit=flow),
                Argument("Lower", "Lower end of the 95 % interval", unit=flow),
                Argument("Upper", "Upper end of the 95 % interval", unit=flow),
                _STATUS,
            ),
            required=Role.OBSERVER,
            description="Prediction of a measurement within the next 32 samples, noise and misfit "
            f"of the structure included. Status: {_numbered(Status)}.",
        )

    async def add_to_inverse(self, place: Place, parent: ua.NodeId, valve: str) -> None:
        """Add the query of an inverse map: Invert, the control voltage for a flow."""
        await add_method(
            place,
            parent,
            f"{valve}.{INVERSE}.Invert",
            partial(self._invert, valve),
            inputs=(Argument("Q", "Demanded flow", unit=Unit.LITRE_PER_MINUTE), _dp, _T),
            outputs=(
                Argument("U", "Control voltage; NaN if none can be trusted", unit=Unit.PERCENT),
                Argument("Lower", "Lower end of its 95 % interval", unit=Unit.PERCENT),
                Argument("Upper", "Upper end of its 95 % interval", unit=Unit.PERCENT),
                _STATUS,
            ),
            required=Role.OBSERVER,
            description="Control voltage U (%) for a flow Q (l/min) at a pressure drop dp (bar), "
            "from the same map as RequiredU; Lower and Upper (%) are the ends of its 95 % "
            "interval. T is the oil temperature (°C), NaN the one measured last. "
            f"Status: {_numbered(InverseStatus)}.",
        )

    async def add_to_baseline(self, place: Place, parent: ua.NodeId, valve: str) -> None:
        """Add the queries of the baseline: Compare, an estimator's deviation from it; Predict."""
        flow = Unit.LITRE_PER_MINUTE
        await add_method(
            place,
            parent,
            f"{valve}.{BASELINE}.Compare",
            partial(self._compare, valve),
            inputs=(Argument("Estimator", "Whose map", type=ua.VariantType.String),),
            outputs=(
                Argument(
                    "Mean",
                    "Present minus approved flow, mean over the points; NaN without any",
                    unit=flow,
                ),
                Argument("Largest", "The difference of the largest size, with its sign", unit=flow),
                Argument("U", "Control voltage of Largest", unit=Unit.PERCENT),
                Argument("dp", "Pressure drop of Largest", unit=Unit.BAR),
                Argument("Points", "Number of compared points", type=ua.VariantType.UInt32),
            ),
            required=Role.OBSERVER,
            description="Flow of the present map minus that of the approved one, at the points of "
            "a grid where both rest on measurements: Mean and Largest (l/min; negative: less flow "
            "than approved), U (%) and dp (bar) of Largest, and the number of points.",
        )
        await add_method(
            place,
            parent,
            f"{valve}.{BASELINE}.Predict",
            partial(self._predict_approved, valve),
            inputs=(Argument("Estimator", "Whose map", type=ua.VariantType.String), _U, _dp, _T),
            outputs=_FLOW,
            required=Role.OBSERVER,
            description=f"Flow at a point of the approved map. Status: {_numbered(Status)}.",
        )

    def _predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, int]]:
        return answered(
            partial(self._operator.predict, valve, estimator, U, dp, T),
            lambda found: (found[0], found[1], int(found[2])),
        )

    def _predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, float, int]]:
        return answered(
            partial(self._operator.predict_measurement, valve, estimator, U, dp, T),
            lambda found: (found[0], found[1], found[2], int(found[3])),
        )

    def _invert(
        self, valve: str, Q: float, dp: float, T: float
    ) -> Answer[tuple[float, float, float, int]]:
        return answered(
            partial(self._operator.invert, valve, Q, dp, T),
            lambda answer: (
                _first(answer.U),
                _first(answer.lower),
                _first(answer.upper),
                int(answer.status[0]),
            ),
        )

    def _predict_approved(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> Answer[tuple[float, float, int]]:
        return answered(
            partial(self._operator.predict_approved, valve, estimator, U, dp, T),
            lambda found: (found[0], found[1], int(found[2])),
            partial(self._notes.refused, valve),
        )

    def _compare(
        self, valve: str, estimator: str
    ) -> Answer[tuple[float, float, float, float, int]]:
        return answered(
            partial(self._operator.compare, valve, estimator),
            lambda found: (found.mean, found.largest, found.U, found.dp, found.points),
            partial(self._notes.refused, valve),
        )


def _first(values: Floats) -> float:
    return float(values[0])


def _numbered(statuses: Iterable[Status] | Iterable[InverseStatus]) -> str:
    return ", ".join(f"{member.value} {member.name}" for member in statuses)
