"""Replays recordings through the pipeline of the live service and reports the fit."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from pydantic import ValidationError

from valvemap.app.build import build_layout, build_plans
from valvemap.app.given import layout_of, recordings_in
from valvemap.config.loading import check_has_valves
from valvemap.config.models import Config, ValveConfig
from valvemap.errors import ConfigurationError, RecordingError
from valvemap.model.forgetting import Exponential
from valvemap.model.inverse_map import invert
from valvemap.model.recursive_least_squares import Change, RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples, Segments, Trace
from valvemap.model.survey import Survey
from valvemap.pipeline import valve_state
from valvemap.pipeline.edges import LEAK, Splitter, gathered
from valvemap.pipeline.fleet import COUNTER_NAMES, Fleet
from valvemap.pipeline.lane_failures import LaneFailures
from valvemap.pipeline.plausibility import Kind, Plausibility, refuse
from valvemap.pipeline.ports import EstimatorResults
from valvemap.pipeline.recommendation import NOT_YET, Recommendation, recommendation
from valvemap.pipeline.score import Score
from valvemap.pipeline.valve_state import Lane, ValvePlan, ValveState
from valvemap.plant.reading import Given
from valvemap.runtime.failure_log import log_failure
from valvemap.storage.layout import Layout
from valvemap.storage.recordings import read_recording
from valvemap.vocabulary.edges import edges_of
from valvemap.vocabulary.findings import Finding
from valvemap.vocabulary.statuses import InverseStatus, Quality

BEST_FIT = "eq. (7), batch LSM"
MOST_SPLIT: Final = 1 << 20  # samples of an edge that wait for the same rows of its line
MOST_TRIED: Final = 1_000  # samples of a batch; inverting a network costs 100 times an update

T = TypeVar("T")
S = TypeVar("S", Samples, Floats)

Progress = Callable[[Path, float], None]
Tap = Callable[[str, Samples, Mapping[str, Trace]], None]


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
    - ``beyond_range``: the number of samples with a U outside an estimator's range.
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


def replay(
    recordings: object,
    config: Config | None = None,
    verify: object = None,
    progress: Progress = lambda _file, _fraction: None,
    tap: Tap = lambda _valve, _samples, _traces: None,
    *,
    insist: bool = False,
    only: Collection[str] | None = None,
    estimators: Collection[str] | None = None,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    read_ahead: bool = True,
    header: tuple[str, ...] | None = None,
    given: Mapping[str, Given] | None = None,
) -> Report:
    """Run recordings through the pipeline, one after the other; files in constant memory.

    Parameters
    ----------
    recordings, verify
        Recordings to identify from, and one to predict with the final parameters. Each is a path
        (CSV, Parquet), a data frame (pandas, polars, pyarrow; extra ``dataframes``) or a dict of
        arrays by column; ``recordings`` may be a list of them.
    config
        Valves and estimators; without it the default estimators run on every valve found.
    progress
        Called with the file (of a table, the name of its type) and the fraction done (0 to 1).
    tap
        Called with every batch and the estimators' traces of it.
    insist
        Process implausible signals, too.
    only
        Names of the valves to identify; None: all.
    estimators
        Names of the estimators to run; None: all.
    units, columns
        Unit and column of each signal that differ from the standard, such as ``{"p1": "psi"}`` and
        ``{"U": "Control signal"}``; with ``config``, they are part of it.
    read_ahead
        Read the next batch in a thread while one is processed; useless if all processors are
        busy.
    header, given
        Headings of files that have none, and answers about foreign headings.

    Returns
    -------
    Report
        By valve and estimator. ``BEST_FIT`` is the batch LSM of eq. (7) on the same samples, the
        best fit possible with the paper's structure.

    Raises
    ------
    RecordingError, ConfigurationError
    """
    plans = None if config is None else {plan.name: plan for plan in build_plans(config)}
    layout = replace(_layout(config, units, columns), header=header, given=given or {})
    turn = _one_ahead if read_ahead else iter
    valves: dict[str, _Learnt] = {}
    found = dict[str, None]()
    splitter = _Splitting(plans or {})
    for recording in recordings_in(recordings):
        for name, samples in _read(recording, layout, progress, turn):
            found[name] = None
            if plans and name not in plans:
                continue
            plan = _default_plan(name) if plans is None else plans[name]
            if not _is_chosen(plan, only):
                continue
            if name not in valves:
                plan = replace(plan, insist=plan.insist or insist)
                valves[name] = _Learnt(_chosen(plan, estimators))

            def learn(name: str, some: Samples, recording: object = recording) -> Floats:
                judged, traces = valves[name].learn(valves[name].look_at(some, recording))
                tap(name, judged, traces)
                return traces[LEAK].predicted if LEAK in traces else np.empty(0)

            splitter.take(name, samples, learn)
    if not valves:
        raise _none_of(only, plans, found)
    if verify is None:
        checks = {name: [_check(v, v.last, scored=False)] for name, v in valves.items()}
    else:
        coming = (_read(one, layout, progress, turn) for one in recordings_in(verify))
        checks = _verified(valves, chain.from_iterable(coming), _Splitting(plans or {}))
    return {
        name: _report(valve, _summed(checks[name]), verified=verify is not None)
        for name, valve in valves.items()
    }


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


class _Splitting:
    """Splits the samples of valves with ports on their way to edges, batch by batch."""

    def __init__(self, plans: Mapping[str, ValvePlan]) -> None:
        self._names = list(plans)
        self._splitter = Splitter(
            [plan.part for plan in plans.values()], self._names, most=MOST_SPLIT
        )
        self._lines = {plan.name for plan in plans.values() if plan.part and plan.part.edge is None}

    def take(self, name: str, samples: Samples, use: Callable[[str, Samples], Floats]) -> None:
        """Call ``use`` with samples; of a line it returns the leakage, for those of its edges."""
        if not self._splitter:
            use(name, samples)
            return
        number, coming = self._names.index(name), {}
        if name in self._lines:
            self._splitter.note_leakage(number, samples.t, use(name, samples))
        else:
            coming[number] = samples
        arrived, used = self._splitter.split(gathered(coming), _raise)
        for m, start, stop in zip(*arrived.segments, strict=True):
            rows = np.arange(start, stop)[used[start:stop]]
            if len(rows):
                use(self._names[m], arrived.samples[rows])


def _raise(_: int, error: Exception) -> None:
    raise error


def _is_chosen(plan: ValvePlan, only: Collection[str] | None) -> bool:
    """Whether a valve is chosen, a valve of which it is a part, or an edge of it as a line."""
    if only is None or plan.name in only:
        return True
    if plan.part is None:
        return False
    edges = edges_of(plan.part.line) if plan.part.edge is None else ()
    return any(
        name in only for name in (plan.part.valve, *(f"{plan.part.valve}.{e}" for e in edges))
    )


class _Learnt:
    """One valve's pipeline and the last batch it processed."""

    def __init__(self, plan: ValvePlan) -> None:
        if LEAK not in plan.estimators:
            best = RecursiveLeastSquares(forgetting=Exponential(1.0))
            every, references = {**plan.estimators, BEST_FIT: best}, frozenset({BEST_FIT})
            plan = replace(plan, estimators=every, references=references)
        self.plan = plan
        self.last = Samples.empty()
        self._failures = LaneFailures()
        self._fleet = Fleet(self.plan, 1, failures=self._failures)
        self._plausibility = Plausibility(1)
        self.samples = 0

    def look_at(self, samples: Samples, recording: object) -> Samples:
        """Check the plausibility of a batch; return it with implausible samples rejected.

        Raises
        ------
        RecordingError
            if a signal is implausible throughout, unless the plan insists.
        """
        if len(samples) == 0:
            return samples
        self.samples += len(samples)
        refused = self._plausibility.count(samples, Segments.one(len(samples)))
        for finding in self._plausibility.findings(0):
            if finding.kind is Kind.REFUSED and not self.plan.insist:
                raise RecordingError(
                    f"{_name(recording)}: valve {self.plan.name}: {finding.sentence}; --insist "
                    "(insist=True in Python) learns from it all the same"
                )
        return samples if self.plan.insist else refuse(samples, refused)

    def hints(self) -> tuple[str, ...]:
        """Return the findings on plausibility, one sentence each."""
        return tuple(finding.sentence for finding in self._plausibility.findings(0))

    def rejected(self) -> Mapping[str, int]:
        """Return the number of rejected samples by reason."""
        counts = self._fleet.rejections()[0].tolist()
        return {name: n for name, n in zip(COUNTER_NAMES, counts, strict=True) if n}

    def learn(self, samples: Samples) -> tuple[Samples, Mapping[str, Trace]]:
        if len(samples) == 0:
            return samples, {}
        self.last = samples
        found = self._fleet.take(samples, Segments.one(len(samples)))
        for failure in self._failures.take_new():
            log_failure(failure)
        return found

    def results(self) -> Mapping[str, EstimatorResults]:
        return self._fleet.results(np.zeros(1, np.int64))

    def state(self) -> ValveState:
        return self._fleet.state(0)

    def rank(self) -> tuple[Mapping[str, float], Recommendation]:
        """Return each estimator's error at places visited again, and the recommended one."""
        ranking, names = self._fleet.rank_now(0), list(self.plan.estimators)
        errors = np.where(np.isfinite(ranking.errors), ranking.errors, np.nan)
        found = recommendation(ranking, names, self._fleet.inverse(0))
        return dict(zip(names, errors.tolist(), strict=True)), found

    @property
    def beyond_range(self) -> int:
        return int(self._fleet.rejections()[0, COUNTER_NAMES.index("beyond_range")])


def _none_of(
    only: Collection[str] | None, plans: Collection[str] | None, found: Collection[str]
) -> ConfigurationError:
    there = ", ".join(found)
    if only is not None:
        return ConfigurationError(f"valve {', '.join(only)} is not there; allowed is {there}")
    named = ", ".join(plans or ())
    return ConfigurationError(f"the recordings hold none of the configured valves: {named}")


def _verified(
    valves: Mapping[str, "_Learnt"],
    batches: Iterable[tuple[str, Samples]],
    splitting: "_Splitting",
) -> dict[str, list[Mapping[str, "_Check"]]]:
    checks: dict[str, list[Mapping[str, _Check]]] = {name: [] for name in valves}

    def check(name: str, samples: Samples) -> Floats:
        checks[name].append(_check(valves[name], samples, scored=True))
        lane = valves[name].state().lanes.get(LEAK)
        return np.empty(0) if lane is None else valve_state.predicted_along(lane, samples)

    for name, samples in batches:
        if name in valves:
            splitting.take(name, samples, check)
    return checks


@dataclass(frozen=True)
class _Check:
    """The test of one estimator's map and its inverse, without updating the estimator.

    ``score`` is over all samples, the other fields over the tested ones.
    """

    score: Score
    tried: int
    round_trip_max: float
    infeasible: int
    covered: int


def _check(valve: _Learnt, samples: Samples, *, scored: bool) -> Mapping[str, _Check]:
    """Test all estimators of a valve; without ``scored``, only on the thinned samples."""
    gate = valve.plan.gate
    _, judged = gate.update(gate.initial_state(), samples)
    good = judged[judged.quality != Quality.BAD]
    good = good if scored else _some(good)
    return {name: _check_lane(lane, good) for name, lane in valve.state().lanes.items()}


def _check_lane(lane: Lane, samples: Samples) -> _Check:
    estimator, state = lane.estimator, lane.state
    Q_hat = valve_state.predicted_along(lane, samples)
    residual = samples.Q - Q_hat
    trace = Trace(Q_hat, residual, residual, np.zeros(len(samples), np.uint8))
    tried = _some(samples)
    inverse = invert(estimator, state, tried.Q, tried.dp, tried.T)
    feasible = inverse.status == InverseStatus.OK
    U, dp, T = (x[feasible] for x in (inverse.U, tried.dp, tried.T))
    Q_back, _ = estimator.predict(state, U, dp, T)
    _, half, _ = valve_state.predicted_measurement(lane, tried.U, tried.dp, tried.T)
    return _Check(
        tried=len(tried),
        covered=int((np.abs(_some(residual)) <= half).sum()),
        score=Score.none().add(samples, trace),
        round_trip_max=float(np.abs(Q_back - tried.Q[feasible]).max(initial=0.0)),
        infeasible=int((~feasible).sum()),
    )


def _some(rows: S) -> S:
    """Return at most ``MOST_TRIED`` rows, evenly spaced."""
    return rows[:: max(1, math.ceil(len(rows) / MOST_TRIED))]


def _summed(checks: Sequence[Mapping[str, _Check]]) -> Mapping[str, _Check]:
    names = checks[0] if checks else ()
    return {
        name: _Check(
            score=Score.merged([check[name].score for check in checks]),
            round_trip_max=max(check[name].round_trip_max for check in checks),
            tried=sum(check[name].tried for check in checks),
            infeasible=sum(check[name].infeasible for check in checks),
            covered=sum(check[name].covered for check in checks),
        )
        for name in names
    }


def _report(
    valve: _Learnt, checks: Mapping[str, _Check], *, verified: bool
) -> Mapping[str, EstimatorReport]:
    report = {}
    again, recommended = valve.rank()
    state, results = valve.state(), valve.results()
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
            beyond_range=valve.beyond_range,
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


def refuse_if_nothing_was_learnt(report: Report) -> None:
    """Raise RecordingError if no sample of a valve could be used; it names the reasons."""
    empty = []
    for valve, estimators in report.items():
        r = next(iter(estimators.values()))
        if all(r.lane.count == 0 for r in estimators.values()):
            why = ", ".join(f"{reason.replace('_', ' ')} {n}" for reason, n in r.rejected.items())
            why = why or "they are too few"
            empty.append(f"{valve}: nothing was learnt from {r.samples} samples: {why}")
    if empty:
        raise RecordingError("; ".join(empty))


def _chosen(plan: ValvePlan, names: Collection[str] | None) -> ValvePlan:
    """Return the plan with the chosen estimators only."""
    if names is None or LEAK in plan.estimators:
        return plan
    for name in names:
        if name not in plan.estimators:
            known = ", ".join(plan.estimators)
            raise ConfigurationError(f"estimator {name!r} is not there; allowed is {known}")
    kept = {name: plan.estimators[name] for name in plan.estimators if name in names}
    inverse = plan.inverse if plan.inverse in kept else next(iter(kept))
    return replace(plan, estimators=kept, inverse=inverse)


def _layout(
    config: Config | None, units: Mapping[str, str] | None, columns: Mapping[str, str] | None
) -> Layout:
    if config is None:
        return layout_of(units, columns)
    if units or columns:
        raise ConfigurationError("with a config, units and columns are its valves.signals")
    check_has_valves(config, "a replay")
    return build_layout(config)


def _name(recording: object) -> Path:
    """Return a file, or the name of a table's type."""
    return recording if isinstance(recording, Path) else Path(type(recording).__name__)


def _read(
    recording: object,
    layout: Layout,
    progress: Progress,
    turn: Callable[[Iterator[tuple[str, Samples]]], Iterator[tuple[str, Samples]]],
) -> Iterator[tuple[str, Samples]]:
    file = _name(recording)
    with read_recording(recording, layout=layout) as batches:
        progress(file, 0.0)
        for name, samples in turn(batches):
            yield name, samples
            progress(file, batches.fraction)


def _one_ahead(items: Iterator[T]) -> Iterator[T]:
    """Yield the items; a thread reads the next one while the current one is processed."""
    with ThreadPoolExecutor(1) as thread:
        coming = thread.submit(next, items, None)
        while (item := coming.result()) is not None:
            coming = thread.submit(next, items, None)
            yield item


def _default_plan(name: str) -> ValvePlan:
    try:
        valve = ValveConfig(name=name)
    except ValidationError:
        raise ConfigurationError(
            f"valve {name!r}: a name is a letter, then letters, digits, _ or -, 64 at most"
        ) from None
    (plan,) = build_plans(Config(valves=(valve,)))
    return plan


def _numbers(values: Mapping[str, float]) -> dict[str, float | None]:
    return {key: value if np.isfinite(value) else None for key, value in values.items()}
