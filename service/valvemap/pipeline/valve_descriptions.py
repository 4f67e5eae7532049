"""What a results server has to know of the valves before their results. Pure."""

from collections.abc import Sequence
from dataclasses import replace

from valvemap.model.capabilities import (
    ChoosesStructure,
    FindsLags,
    Forgetful,
    LinearInParameters,
    finds_changes,
)
from valvemap.pipeline.all_valves import once_each
from valvemap.pipeline.result_tables import COUNTERS
from valvemap.pipeline.results import EstimatorDescription, ValveDescription
from valvemap.pipeline.valve_state import AnyEstimator, ValvePlan


def descriptions(plans: Sequence[ValvePlan]) -> tuple[ValveDescription, ...]:
    """Return the descriptions of valves for a results server."""
    described = once_each(_description)
    return tuple(
        ValveDescription(
            name=plan.name,
            estimators=tuple(
                replace(described(estimator), name=name)
                for name, estimator in plan.estimators.items()
            ),
            Q_range=(min(plan.map_Q), max(plan.map_Q)),
            dp_range=(min(0.0, *plan.map_dp), max(plan.map_dp)),
            map_Q=plan.map_Q,
            map_dp=plan.map_dp,
            counters=COUNTERS,
            nameplate=plan.nameplate,
            U_range=plan.U_range,
            is_line=plan.part is not None and plan.part.edge is None,
            is_driven=plan.is_driven,
        )
        for plan in plans
    )


def _description(estimator: AnyEstimator) -> EstimatorDescription:
    return EstimatorDescription(
        name="",
        description=_first_line(estimator),
        parameter_names=estimator.parameter_names,
        has_forgetting_factor=isinstance(estimator, Forgetful),
        finds_changes=finds_changes(estimator),
        chooses_structure=isinstance(estimator, ChoosesStructure),
        finds_lags=isinstance(estimator, FindsLags),
        has_named_parameters=isinstance(estimator, LinearInParameters),
    )


def _first_line(thing: object) -> str:
    return (type(thing).__doc__ or type(thing).__name__).strip().splitlines()[0]
