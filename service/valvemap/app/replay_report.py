"""What a replay reports of each estimator."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from valvemap.app.learnt_valve import BEST_FIT, LearntValve
from valvemap.app.map_checks import MapCheck
from valvemap.errors import RecordingError
from valvemap.model.change import Change
from valvemap.model.survey import Survey
from valvemap.pipeline import valve_state
from valvemap.pipeline.recommendation import NOT_YET, Recommendation
from valvemap.pipeline.score import Score
from valvemap.pipeline.valve_state import Lane
from valvemap.vocabulary.findings import Finding


@dataclass(frozen=True)
class EstimatorReport:
    """The result of a replay for one estimator: its final lane and figures of merit.

    Without a verification file, ``verify`` is None and the inverse is tested on the last batch. At
    most ``MOST_TRIED`` evenly spaced samples of a batch are tested.

    - ``round_trip_max``: the largest |Q(U(Q, dp), dp) - Q| in l/min over the feasible flows.
    - ``infeasible``: the number of tested flows that are not feasible.
    - ``noise_std``: standard deviation of recent measurements about the map, l/min.
    - ``covered``: the share of tested samples within their 95 % interval.
    - ``survey``: the coverage of the map.
    - ``beyond_range``: the number of samples with U or Δp outside the estimator's range.
    - ``T``: the last measured oil temperature, °C.
    - ``change``: the last detected change of the valve.
    - ``structure``: the structure chosen by `Auto`.
    - ``samples``: the number of all samples; ``rejected``: the number rejected, by reason.
    - ``hints``: implausible properties of the valve's signals.
    - ``again``: the error at places visited again, l/min, by which estimators are ranked; NaN for
      one that is not.
    - ``findings``: causes that the estimator found in the samples.
    - ``recommended``: the valve's recommended estimator, and why.
    """

    lane: Lane
    parameters: Mapping[str, float]
    std: Mapping[str, float]
    one_step: Score
    verify: Score | None
    round_trip_max: float
    infeasible: int
    noise_std: float
    covered: float
    survey: Survey
    beyond_range: int
    T: float
    change: Change | None
    structure: str | None
    rejected: Mapping[str, int] = field(default_factory=dict)
    samples: int = 0
    hints: tuple[str, ...] = ()
    again: float = np.nan
    recommended: Recommendation = NOT_YET
    findings: tuple[Finding, ...] = ()


Report = Mapping[str, Mapping[str, EstimatorReport]]


def report_of(
    valve: LearntValve, checks: Mapping[str, MapCheck], *, verified: bool
) -> Mapping[str, EstimatorReport]:
    """Return the report of one valve; ``checks`` are of its maps, by estimator."""
    report = {}
    again, recommended = valve.rank()
    state, results, beyond = valve.state(), valve.results(), valve.beyond_range()
    for name, lane in state.lanes.items():
        result, names = results[name], lane.estimator.parameter_names
        check = checks.get(name)
        report[name] = EstimatorReport(
            lane=lane,
            parameters=dict(zip(names, result.theta[0].tolist(), strict=True)),
            std=dict(zip(names, result.std[0].tolist(), strict=True)),
            one_step=lane.score,
            verify=check.score if check is not None and verified else None,
            round_trip_max=np.nan if check is None else check.round_trip_max,
            infeasible=0 if check is None else check.infeasible,
            noise_std=float(result.noise_std[0]),
            covered=check.covered / check.tried if check and check.tried else np.nan,
            survey=valve_state.survey_of(valve.plan, state, name),
            beyond_range=beyond[name],
            T=state.T,
            change=result.change[0],
            structure=result.structure[0],
            rejected=valve.rejected(),
            samples=valve.samples,
            hints=valve.hints(),
            again=again[name],
            recommended=recommended,
            findings=valve_state.findings_of(lane),
        )
    return report


def as_json(report: Report) -> dict[str, Any]:
    """Return the report in its JSON form; unknown values are null."""
    return {
        valve: {
            name: {
                "parameters": _numbers(r.parameters),
                "std": _numbers(r.std),
                "one_step": _numbers(
                    {k: getattr(r.one_step, k) for k in ("rmse", "nrmse", "r2", "n")}
                ),
                "verify": None
                if r.verify is None
                else _numbers({k: getattr(r.verify, k) for k in ("rmse", "max_abs", "r2", "n")}),
                "inverse": _numbers(
                    {"round_trip_max": r.round_trip_max, "infeasible": r.infeasible}
                ),
                "interval": _numbers({"noise_std": r.noise_std, "covered": r.covered}),
                "next_point": _numbers({"U": r.survey.suggested_U, "dp": r.survey.suggested_dp}),
                "coverage": _numbers({"share": r.survey.share, "condition": r.survey.condition}),
                "last_change": None if r.change is None else asdict(r.change),
                "structure": r.structure,
                "again": _numbers({"rmse": r.again}),
                "recommended": name == r.recommended.name,
                "findings": [
                    {"code": f.code.name, "probability": f.probability, "sentence": f.sentence}
                    for f in r.findings
                ],
            }
            for name, r in estimators.items()
            if name != BEST_FIT
        }
        for valve, estimators in report.items()
    }


def refuse_if_nothing_was_learnt(report: Report) -> None:
    """Raise RecordingError if no sample of a valve could be used; it names the reasons."""
    empty = []
    for valve, estimators in report.items():
        r = next(iter(estimators.values()))
        if all(r.lane.count == 0 for r in estimators.values()):
            why = ", ".join(f"{reason.replace('_', ' ')} {n}" for reason, n in r.rejected.items())
            why = why or "they are too few"
            said = f"{valve}: nothing was learnt from {r.samples} samples: {why}"
            if r.rejected.get("not_finite", 0) >= r.samples > 0:
                said += (
                    " (no row has all of U, p1, p2 and Q: as rows of time, tag and value, each tag "
                    "keeps its last value)"
                )
            empty.append(said)
    if empty:
        raise RecordingError("; ".join(empty))


def _numbers(values: Mapping[str, float]) -> dict[str, float | None]:
    return {key: value if np.isfinite(value) else None for key, value in values.items()}
