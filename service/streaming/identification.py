"""The service's model of the world: every valve's state, and what people may do to it.

Both the live service and the replay of recordings go through this one object; it knows neither
time nor network.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from service.errors import CommandRejected
from service.identification.auto import Auto
from service.identification.estimator import StateMismatchError, key_of
from service.identification.inversion import InverseStatus, Inversion
from service.identification.maximum_likelihood import MaximumLikelihood
from service.identification.recursive_least_squares import RecursiveLeastSquares
from service.identification.samples import (
    Codes,
    Floats,
    Quality,
    Samples,
    Segments,
    Status,
    Times,
    Trace,
)
from service.identification.sensor_accuracy import SensorAccuracy
from service.identification.survey import Survey
from service.streaming import pipeline
from service.streaming.alarm_states import AlarmRule
from service.streaming.alarms import (
    ALARM_NAMES,
    SERVICE_ALARM_NAMES,
    SERVICE_RULES,
    Alarm,
    ServiceAlarm,
    ServiceAlarms,
)
from service.streaming.alignment import COUNTER_NAMES as OF_ALIGNMENT
from service.streaming.alignment import Alignment, AlignmentSettings, ByValve
from service.streaming.baseline import Baseline, Difference, difference
from service.streaming.data_changes import DataChanges
from service.streaming.feedforward import FeedForwardStatus
from service.streaming.fleet import COUNTER_NAMES as NOT_LEARNT
from service.streaming.fleet import Fleet
from service.streaming.kernels.waiting import NEVER
from service.streaming.pipeline import (
    AnyEstimator,
    Forgetful,
    Lane,
    Required,
    ValvePlan,
    ValveState,
)
from service.streaming.plausibility import Finding, Kind, Plausibility
from service.streaming.ports import (
    SIGNALS,
    AlarmReport,
    AlarmResults,
    Checkpoint,
    EstimatorDescription,
    EstimatorResults,
    InverseResults,
    Remark,
    Results,
    SignalResults,
    ValveDescription,
    ValveResult,
)
from service.streaming.quality_gate import SENSORS, QualityGate
from service.streaming.timing import Timing, TimingSettings, TimingState
from service.streaming.valve_columns import Columns, copy_rows
from service.streaming.valve_memory import ValveMemory
from service.streaming.valve_timing import IN_SCANS, LISTENING
from service.streaming.waiting import waited_for

R = TypeVar("R")

MAPS_AT_ONCE = 100  # 2 ms each
MEMORY = "Diagnostics"  # no estimator is called so: what a valve remembers beside them
TIMING = "Signals"  # nor so: how its signals come
BASELINE = "Baseline"  # nor so: the map that was approved as new
ALARMS = "Alarms"  # nor so: how its alarms stand
OF_SERVICE = "Service"  # no valve is called so
COUNTERS = (*OF_ALIGNMENT, *NOT_LEARNT)
SURVEYS_AT_ONCE = 40  # half a millisecond each: a fleet is surveyed in turns

_MISSING = OF_ALIGNMENT.index("missing")
_LOST = [OF_ALIGNMENT.index(name) for name in ("missing", "gaps", "lost_by_time")]
_ALIGNED = OF_ALIGNMENT.index("aligned")
_GUESSED = InverseStatus.EXTRAPOLATING, InverseStatus.OUTSIDE
_DISARMED = {False: FeedForwardStatus.NOT_CONFIGURED, True: FeedForwardStatus.DISARMED}


@dataclass(frozen=True)
class _Through:
    """What a valve's samples go through before they are learnt from."""

    gate: QualityGate
    alignment: AlignmentSettings
    has_T: bool
    has_sequence: bool


@dataclass(frozen=True)
class _Comes:
    """What it depends on how a valve's signals come."""

    settings: TimingSettings
    nodes: Mapping[str, str]
    has_T: bool
    has_sequence: bool


class Identification:
    """All valves of one service; fulfils :class:`service.streaming.ports.Operator`."""

    def __init__(
        self,
        plans: Sequence[ValvePlan],
        alignment: Alignment,
        timing: Timing | None = None,
        service_alarms: Mapping[ServiceAlarm, AlarmRule] = SERVICE_RULES,
    ) -> None:
        self.plans = tuple(plans)
        self._fleets, self._fleet_of, self._member_of = _fleets(self.plans)
        self._keys = [
            {name: key_of(estimator) for name, estimator in fleet.plan.estimators.items()}
            for fleet in self._fleets
        ]
        self._memory_keys: dict[tuple[int, bool, bool], str] = {}  # a valve's fleet, T, numbers
        self._timing_keys: dict[int, str] = {}  # both made when first asked for: 0.5 ms each
        self._alignment = alignment
        self._waiting = alignment.initial_state()
        self._finds_timing = timing is not None
        self._timing = timing or Timing(TimingSettings(), alignment.has_T, fixed=True)
        self._numbers = {plan.name: number for number, plan in enumerate(self.plans)}
        self._maps = self._first_maps()
        self._surveys: list[Mapping[str, Survey]] = [{} for _ in self.plans]
        self._baselines: dict[int, Baseline] = {}
        self._approved = np.zeros(len(self.plans), np.int64)  # how many of each valve
        self._armed = np.zeros(len(self.plans), np.bool_)
        self._feed_forward = np.array(
            [_DISARMED[plan.feed_forward is not None] for plan in self.plans], np.uint8
        )
        self._next_survey = self._next_map = 0
        self._newest = SignalResults(
            t=np.zeros(len(self.plans), np.int64),
            quality=np.zeros(len(self.plans), np.uint8),
            values=np.full((len(self.plans), len(SIGNALS)), np.nan),
        )
        self._plausibility = Plausibility(len(self.plans))
        self._insists = np.array([plan.insist for plan in self.plans], np.bool_)
        self._implausible = np.zeros(len(self.plans), np.bool_)
        self._service_alarms = ServiceAlarms(service_alarms)

    def take(self, changes: DataChanges) -> ByValve:
        """Take data changes in; return the samples they completed, by valve."""
        return self._align(self._timing.take(changes))

    def _align(self, changes: DataChanges) -> ByValve:
        self._waiting, arrived = self._alignment.take(self._waiting, changes)
        return self.learn(arrived)

    def waits(self) -> NDArray[np.bool_]:
        """Which valves have samples that wait for earlier ones."""
        return self._alignment.waits(self._waiting) | (self._timing.pending > 0)

    def pending(self) -> Times:
        """How many samples of each valve wait for signals or for earlier samples."""
        return self._alignment.pending(self._waiting) + self._timing.pending

    def wait_no_longer(self, valves: Times) -> ByValve:
        """Take what waits for earlier samples without them; return it as `take` does."""
        unfinished = self._timing.flush(valves)
        if len(unfinished):
            return self._align(unfinished)
        self._waiting, arrived = self._alignment.flush(self._waiting, valves)
        return self.learn(arrived)

    def begin_source_anew(self, valves: Times) -> ByValve:
        """The source of some valves was restarted: its running numbers begin anew."""
        self._waiting, arrived = self._alignment.begin_anew(self._waiting, valves)
        return self.learn(arrived)

    def learn(self, arrived: ByValve) -> ByValve:
        """Take aligned samples in; return them, those that cannot be what they are called BAD."""
        self._note_newest(arrived)
        arrived = self._without_implausible(arrived)
        valves, starts, stops = arrived.segments
        fleets = self._fleet_of[valves]
        for number in np.unique(fleets):
            own = np.flatnonzero(fleets == number)
            rows, first, last = _rows(starts[own], stops[own])
            segments = Segments(self._member_of[valves[own]], first, last)
            self._fleets[number].take(arrived.samples[rows], segments)
            self._note_losses(self._fleets[number], valves[own])
        return arrived

    def _note_losses(self, fleet: Fleet, valves: Times) -> None:
        counts, places = self._waiting.counters[valves], self._member_of[valves]
        lost = counts[:, _LOST].sum(axis=1) + self._timing.not_made(valves)
        fleet.alarms.note_losses(places, lost, counts[:, _ALIGNED])
        fleet.alarms.be_patient(places, self._timing.holds[valves])

    def _note_newest(self, arrived: ByValve) -> None:
        valves, _, stops = arrived.segments
        last, newest = arrived.samples[stops - 1], self._newest
        newest.t[valves], newest.quality[valves] = last.t, last.quality
        columns = (getattr(last, name) for name in SIGNALS)
        newest.values[valves] = np.stack(list(columns), axis=1)

    def _reasons(self, valve: int) -> tuple[str, ...]:
        if self._implausible[valve]:
            return tuple(finding.sentence for finding in self.findings(valve))
        return self.waited_for(valve)

    def _signals(self, valves: Times, at_best: Codes) -> SignalResults:
        newest = self._newest
        quality = np.maximum(newest.quality[valves], at_best)
        return SignalResults(newest.t[valves], quality, newest.values[valves])

    def _without_implausible(self, arrived: ByValve) -> ByValve:
        """The same samples; those of valves that cannot be what they are called are BAD."""
        self._plausibility.count(arrived.samples, arrived.segments)
        valves, starts, stops = arrived.segments
        self._implausible[valves] |= self._plausibility.suspicious(valves) & ~self._insists[valves]
        refused = np.flatnonzero(self._implausible[valves])
        if not len(refused):
            return arrived
        quality = arrived.samples.quality.copy()
        for k in refused:
            quality[starts[k] : stops[k]] = Quality.BAD
        return replace(arrived, samples=replace(arrived.samples, quality=quality))

    def waited_for(self, valve: int) -> tuple[str, ...]:
        """Which signals keep a valve's samples from being made, and what would help."""
        timing, nodes = self._timing.valves[valve], self.plans[valve].nodes
        newest = np.maximum(self._alignment.newest(self._waiting, valve), timing.newest[:-1])
        has_T, settings = self._alignment.has_T[valve], self._alignment.settings
        if timing.stands == IN_SCANS:
            return (*timing.words.losses(nodes), *timing.words.still(nodes))
        said = waited_for(newest, settings, has_T=has_T, nodes=nodes)
        if timing.stands == LISTENING and (newest[: 4 + has_T] != NEVER).all():
            return ("how the signals come is not found yet: it takes some seconds of changes",)
        return said

    def stand_still(self, valve: int) -> tuple[str, ...]:
        """Which of a valve's signals, written on change, have not moved for long."""
        return self._timing.valves[valve].words.still(self.plans[valve].nodes)

    def timing(self, valve: int) -> tuple[str, ...]:
        """How each of a valve's signals comes, in words."""
        return self._timing.valves[valve].words.sentences(self.plans[valve].nodes)

    def newly_timed(self) -> list[int]:
        """Valves of which it was found since the last call that their signals come in scans."""
        return self._timing.newly_found()

    def holds(self) -> NDArray[np.bool_]:
        """Which valves have signals that come on change: silence is no loss of theirs."""
        return self._timing.holds

    def implausible(self) -> NDArray[np.bool_]:
        """Which valves are not learnt from, because their signals cannot be what they are called.

        Once refused, a valve is learnt from again after a restart, with what is wrong mended.
        """
        return self._implausible

    def findings(self, valve: int) -> list[Finding]:
        """What speaks against a valve's signals being what they are called."""
        return self._plausibility.findings(valve)

    def take_samples(self, valve: int, samples: Samples) -> tuple[Samples, Mapping[str, Trace]]:
        """Take samples of one valve in; return them as judged, and what every estimator said."""
        if len(samples) == 0:
            return samples, {}
        fleet, m = self._at(valve)
        return fleet.take(samples, Segments.one(len(samples))._replace(members=np.array([m])))

    def one_of_each_kind(self) -> list[int]:
        """Return the first of the valves that are treated alike, for every kind there is."""
        found: list[int] = np.unique(self._fleet_of, return_index=True)[1].tolist()
        return found

    def lane(self, valve: str, estimator: str) -> Lane:
        """One estimator as it stands."""
        number = self._numbers[valve]
        fleet, m = self._at(number)
        return replace(fleet.lane(m, estimator), accuracy=self._accuracy(number))

    def state(self, valve: int) -> ValveState:
        """One valve as it stands."""
        fleet, m = self._at(valve)
        state, accuracy = fleet.state(m), self._accuracy(valve)
        if accuracy == fleet.plan.accuracy:
            return state
        lanes = {n: replace(lane, accuracy=accuracy) for n, lane in state.lanes.items()}
        return replace(state, lanes=lanes)

    def _accuracy(self, valve: int) -> SensorAccuracy:
        """What the sensors may be off by, and within what their signals may move unseen."""
        stated, found = self.plans[valve].accuracy, self._timing.valves[valve].found
        if found is None or not found.deadband.any():
            return stated
        return stated.beside(*found.deadband[: len(SENSORS)].tolist())

    def refresh_maps(self, share: float = 1.0) -> None:
        """Compute the next inverse tables and surveys anew; results show the newest of them.

        Or a ``share`` of those, for one whom others wait for.
        """
        for _ in range(math.ceil(share * min(MAPS_AT_ONCE, len(self.plans)))):
            self._refresh_map(self._next_map % len(self.plans))
            self._next_map += 1
        lanes = self._all_lanes()
        for _ in range(math.ceil(share * min(SURVEYS_AT_ONCE, len(lanes)))):
            self._refresh_survey(*lanes[self._next_survey % len(lanes)])
            self._next_survey += 1

    def refresh_all_maps(self) -> None:
        """Compute every inverse table and survey anew."""
        for number in range(len(self.plans)):
            self._refresh_map(number)
        for number, name in self._all_lanes():
            self._refresh_survey(number, name)

    def _all_lanes(self) -> list[tuple[int, str]]:
        return [(number, name) for number, p in enumerate(self.plans) for name in p.estimators]

    def _refresh_map(self, number: int) -> None:
        self._maps[number] = self._inverse_map(number)
        self._implausible[number] |= not self._insists[number] and any(
            finding.kind is Kind.REFUSED for finding in self.findings(number)
        )

    def _refresh_survey(self, number: int, name: str) -> None:
        found = pipeline.survey_of(self.plans[number], self._state_of(number, name), name)
        self._surveys[number] = {**self._surveys[number], name: found}

    def results(
        self,
        valves: Sequence[int],
        lost: NDArray[np.bool_] | None = None,
        old: NDArray[np.bool_] | None = None,
    ) -> Iterator[Results]:
        """What is published of some valves, those treated alike together.

        All of it is BAD where ``lost``, an array over all valves, says that the sensors are, and
        at best UNCERTAIN where ``old`` says that the newest sample is.
        """
        chosen = np.array(valves, np.int64)
        fleets = self._fleet_of[chosen]
        for number in np.unique(fleets):
            own = chosen[fleets == number]
            at_best = np.full(len(own), np.uint8(Quality.GOOD))
            if old is not None:
                at_best[old[own]] = Quality.UNCERTAIN
            if lost is not None:
                at_best[lost[own]] = Quality.BAD
            yield self._results(self._fleets[number], own, at_best)

    def result(self, valve: int) -> ValveResult:
        """The same of one valve."""
        (results,) = self.results([valve])
        return results.one(0)

    def _results(self, fleet: Fleet, valves: Times, at_best: Codes) -> Results:
        places, is_old = self._member_of[valves], at_best == Quality.UNCERTAIN
        estimators = {
            name: replace(
                found,
                quality=np.maximum(found.quality, at_best),
                old=is_old if is_old.any() else None,
                survey=[self._surveys[valve].get(name) for valve in valves],
                systematic_std=self._systematic_std(fleet, valves, name),
            )
            for name, found in fleet.results(places).items()
        }
        return Results(
            valves=valves,
            estimators=estimators,
            inverse=self._inverse_results(fleet, valves, estimators),
            counters=self._counts(fleet, valves),
            counter_names=COUNTERS,
            signals=self._signals(valves, at_best),
            baselines=[self._baselines.get(int(valve)) for valve in valves],
            alarms=AlarmResults(
                fleet.alarms.version[places],
                lambda m: fleet.alarms.reports(int(places[m])),
            ),
            timing=[self.timing(int(valve)) for valve in valves],
            waiting=[
                self._reasons(int(valve)) if of_use else self.stand_still(int(valve))
                for valve, of_use in zip(
                    valves, (at_best == Quality.BAD) | self._implausible[valves], strict=True
                )
            ],
        )

    def _systematic_std(self, fleet: Fleet, valves: Times, name: str) -> Floats:
        """What the sensors' errors make of the flow at the newest sample of each valve, l/min."""
        found = np.full(len(valves), np.nan)
        stated = fleet.plan.accuracy.is_stated
        for k, valve in enumerate(valves):
            if not stated and self._timing.valves[valve].found is None:
                continue
            accuracy = self._accuracy(int(valve))
            if not accuracy.is_stated:
                continue
            newest = dict(zip(SIGNALS, self._newest.values[valve], strict=True))
            point = (np.array([newest[signal]]) for signal in ("U", "dp", "T"))
            lane = replace(fleet.lane(int(self._member_of[valve]), name), accuracy=accuracy)
            (found[k],) = pipeline.systematic(lane, *point)
        return found

    def _inverse_results(
        self, fleet: Fleet, valves: Times, estimators: Mapping[str, EstimatorResults]
    ) -> InverseResults:
        M = len(valves)
        t, quality = np.zeros(M, np.int64), np.zeros(M, np.uint8)
        for name, found in estimators.items():
            own = np.array([self.plans[valve].inverse == name for valve in valves])
            t[own], quality[own] = found.t[own], found.quality[own]
        U, status = np.full(M, np.nan), np.full(M, np.uint8(InverseStatus.NOT_FINITE))
        demanded = np.isfinite(fleet.demands(self._member_of[valves])).all(axis=1)
        for k in np.flatnonzero(demanded):
            valve = int(valves[k])
            U[k], _, status[k] = pipeline.required(*self._inverted(valve))
        guessed = (np.isin(status, _GUESSED) & demanded).astype(np.float64)
        fleet.alarms.note_answers(self._member_of[valves], guessed)
        return InverseResults(
            t=t,
            quality=quality,
            required_U=U,
            status=status,
            map_U=[self._maps[valve] for valve in valves],
            armed=self._armed[valves],
            feed_forward=self._feed_forward[valves],
        )

    def _counts(self, fleet: Fleet, valves: Times) -> Times:
        rejected = fleet.rejections()[self._member_of[valves]]
        aligned = self._waiting.counters[valves]
        aligned[:, _MISSING] += self._timing.not_made(valves)
        return np.column_stack((aligned, rejected))

    def counters(self, valve: int) -> Mapping[str, int]:
        """What was aligned, lost and rejected of one valve since the start."""
        (counts,) = self._counts(self._at(valve)[0], np.array([valve])).tolist()
        return dict(zip(COUNTERS, counts, strict=True))

    def descriptions(self) -> tuple[ValveDescription, ...]:
        """What a results server must know."""
        described = _once_each(_description)
        return tuple(
            ValveDescription(
                name=plan.name,
                estimators=tuple(
                    replace(described(estimator), name=name)
                    for name, estimator in plan.estimators.items()
                ),
                Q_range=(min(plan.map_Q), max(plan.map_Q)),
                dp_range=(0.0, max(plan.map_dp)),
                map_Q=plan.map_Q,
                map_dp=plan.map_dp,
                counters=COUNTERS,
                nameplate=plan.nameplate,
            )
            for plan in self.plans
        )

    def reset(self, valve: str, estimator: str) -> None:
        """Forget all samples; what the operator set stays set."""
        lane = self.lane(valve, estimator)
        fresh = pipeline.fresh_lane(lane.estimator, lane.support.forgotten())
        self._put(valve, estimator, replace(fresh, frozen=lane.frozen, lam=lane.lam))
        number = self._numbers[valve]
        if estimator == self.plans[number].inverse:
            fleet, m = self._at(number)
            fleet.alarms.forget_map(m)

    def freeze(self, valve: str, estimator: str) -> None:
        """Stop adaptation."""
        self._put(valve, estimator, replace(self.lane(valve, estimator), frozen=True))

    def resume(self, valve: str, estimator: str) -> None:
        """Adapt again."""
        self._put(valve, estimator, replace(self.lane(valve, estimator), frozen=False))

    def set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> None:
        """Use another forgetting factor from the next sample on."""
        lane = self.lane(valve, estimator)
        if not 0.0 < lam <= 1.0:
            raise CommandRejected(f"forgetting factor {lam:g}: allowed is 0 < lam <= 1")
        if not isinstance(lane.estimator, Forgetful):
            raise CommandRejected(f"{valve}.{estimator} has no forgetting factor")
        try:
            other = pipeline.with_forgetting(lane, lam)
        except ValueError as error:
            raise CommandRejected(f"{valve}.{estimator}: {error}") from None
        self._put(valve, estimator, other)

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Q (l/min), its standard deviation and status at one point."""
        point = (np.array([x], np.float64) for x in (U, dp, self._T(valve, T)))
        (Q,), (std,), (status,) = pipeline.predicted(self.lane(valve, estimator), *point)
        return float(Q), float(std), Status(int(status))

    def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, float, Status]:
        """Q, the 95 % interval of a new measurement (l/min), and status."""
        lane = self.lane(valve, estimator)
        point = (np.array([x], np.float64) for x in (U, dp, self._T(valve, T)))
        (Q,), (half,), (status,) = pipeline.predicted_measurement(lane, *point)
        return float(Q), float(Q - half), float(Q + half), Status(int(status))

    def invert(self, valve: str, Q: float, dp: float, T: float) -> Inversion:
        """U for a demanded flow at a pressure drop."""
        return pipeline.demanded(*self._inverted(self._numbers[valve]), Q, dp, T)

    def demand(self, valve: str, Q: float, dp: float) -> None:
        """Set the standing demand; NaN takes it back."""
        fleet, m = self._at(self._numbers[valve])
        fleet.demand(m, Q, dp)

    def required(self, valve: int) -> tuple[Required, Status]:
        """The answer to a valve's standing demand, and how its estimator stands."""
        plan, state = self._inverted(valve)
        status = state.lanes[plan.inverse].status
        answer = pipeline.required(plan, state)
        return answer, Status.WARMING_UP if status is None else status

    def approve(self, valve: str) -> None:
        """Keep what the estimators know as the valve's map when new."""
        number = self._numbers[valve]
        plan, state = self.plans[number], self.state(number)
        inverse = state.lanes[plan.inverse]
        if inverse.status not in (Status.OK, Status.UNEXCITED):
            said = "nothing was learnt yet" if inverse.status is None else inverse.status.sentence
            raise CommandRejected(
                f"{valve}: the map of {plan.inverse} is not one to build on: {said}"
            )
        self._approved[number] += 1
        keys = self._keys[self._fleet_of[number]]
        count = int(self._approved[number])
        self._baselines[number] = Baseline.of(count, state.t, state.lanes, keys)

    def roll_back(self, valve: str) -> None:
        """Have every estimator know what it knew when the baseline was approved."""
        number, baseline = self._numbers[valve], self._baseline(valve)
        before = {}
        for name, configured in self.plans[number].estimators.items():
            try:
                before[name] = baseline.lane(name, configured)
            except StateMismatchError as error:
                raise CommandRejected(f"{valve}.{name}: {error}") from None
        for name, then in before.items():
            now = self.lane(valve, name)
            known = then if now.lam is None else pipeline.with_forgetting(then, now.lam)
            self._put(valve, name, replace(known, frozen=now.frozen))

    def replace_valve(self, valve: str) -> None:
        """Another valve is there: nothing that was learnt holds, there is no baseline any more."""
        number = self._numbers[valve]
        for name in self.plans[number].estimators:
            self.reset(valve, name)
        self._baselines.pop(number, None)

    def compare(self, valve: str, estimator: str) -> Difference:
        """By how much an estimator's map has moved away from the baseline's."""
        number, baseline = self._numbers[valve], self._baseline(valve)
        plan = self.plans[number]
        if estimator not in plan.estimators:
            raise CommandRejected(f"{valve} has no estimator {estimator!r}")
        try:
            then = baseline.lane(estimator, plan.estimators[estimator])
        except StateMismatchError as error:
            raise CommandRejected(f"{valve}.{estimator}: {error}") from None
        return difference(plan, self.lane(valve, estimator), then, self._T(valve, np.nan))

    def baseline(self, valve: int) -> Baseline | None:
        """The map that was approved as new, if one was."""
        return self._baselines.get(valve)

    def _baseline(self, valve: str) -> Baseline:
        found = self._baselines.get(self._numbers[valve])
        if found is None:
            raise CommandRejected(f"{valve} has no baseline: Baseline.Approve makes one")
        return found

    def acknowledge(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Note that somebody has seen an alarm, of a valve or (None) of the service."""
        if valve is None:
            taken = self._service_alarms.acknowledge(_of_service(alarm), remark)
        else:
            fleet, m = self._at(self._numbers[valve])
            taken = fleet.alarms.acknowledge(m, _of_valve(alarm), remark)
        if not taken:
            raise CommandRejected(f"{valve or OF_SERVICE}.{alarm}: there is nothing to acknowledge")

    def confirm(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Note that an alarm that was acknowledged was dealt with."""
        if valve is None:
            taken = self._service_alarms.confirm(_of_service(alarm), remark)
        else:
            fleet, m = self._at(self._numbers[valve])
            taken = fleet.alarms.confirm(m, _of_valve(alarm), remark)
        if not taken:
            raise CommandRejected(f"{valve or OF_SERVICE}.{alarm}: there is nothing to confirm")

    def remark(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Note what somebody said of an alarm."""
        if valve is None:
            self._service_alarms.remark(_of_service(alarm), remark)
        else:
            fleet, m = self._at(self._numbers[valve])
            fleet.alarms.remark(m, _of_valve(alarm), remark)

    def alarmed(self) -> list[str]:
        """The valves of which any alarm ever came."""
        versions = [fleet.alarms.version for fleet in self._fleets]
        return [
            plan.name
            for valve, plan in enumerate(self.plans)
            if versions[self._fleet_of[valve]][self._member_of[valve]]
        ]

    def alarms(self, valve: str | None) -> tuple[AlarmReport, ...]:
        """How all alarms of a valve, or (None) of the service, stand."""
        if valve is None:
            return self._service_alarms.reports()
        fleet, m = self._at(self._numbers[valve])
        return fleet.alarms.reports(m)

    def was_away(self) -> None:
        """Nobody has listened to the source: silence until now is no loss of the sensors."""
        for fleet in self._fleets:
            fleet.alarms.was_away()

    def say_overdue(self, valves: Times, now: Times) -> list[int]:
        """Some valves have sent nothing until ``now``, UTC ns by the clocks of their sources.

        Returns those of which that is an alarm only now.
        """
        new: list[int] = []
        for number in np.unique(self._fleet_of[valves]):
            chosen = self._fleet_of[valves] == number
            own = valves[chosen]
            places, alarms = self._member_of[own], self._fleets[number].alarms
            before = alarms.version[places]
            alarms.overdue(places, now[chosen])
            new += own[alarms.version[places] != before].tolist()
        return new

    def watch_service(
        self, now: int, checkpoint_age_s: float, days_left: float, load: float
    ) -> tuple[AlarmReport, ...]:
        """Judge how the service itself stands: age of what is kept, certificate, share of time."""
        self._service_alarms.note(now, checkpoint_age_s, days_left, load)
        return self._service_alarms.reports()

    def arm(self, valve: str) -> None:
        """Have the answer to the standing demand written to the valve, while it may be."""
        number = self._numbers[valve]
        if self.plans[number].feed_forward is None:
            raise CommandRejected(f"{valve}: nodes.required_U is not configured")
        self._armed[number] = True

    def disarm(self, valve: str) -> None:
        """Write nothing to the valve any more."""
        self._armed[self._numbers[valve]] = False

    def is_armed(self, valve: int) -> bool:
        """Whether somebody has armed the valve's feed-forward since the start."""
        return bool(self._armed[valve])

    def feed_forward(self, valve: int) -> FeedForwardStatus:
        """Whether the answer was written to the valve when last looked at."""
        return FeedForwardStatus(int(self._feed_forward[valve]))

    def note_feed_forward(self, valve: int, status: FeedForwardStatus) -> None:
        """Publish from now on that a valve's feed-forward stands so."""
        self._feed_forward[valve] = status

    def kept(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """All that is kept of some valves, or of all: `checkpoints` and `memories`."""
        estimators, beside = [], []
        for valve in self._chosen(valves):
            state = self._as_kept(valve)
            estimators += self._checkpoints_of(valve, state)
            beside += self._memories_of(valve, state)
        return [*estimators, *beside, *self._kept_of_service()]

    def checkpoints(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Every estimator's state as bytes, of some valves or of all."""
        chosen = self._chosen(valves)
        return [c for valve in chosen for c in self._checkpoints_of(valve, self._as_kept(valve))]

    def memories(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """All that some valves, or all, remember beside their estimators' states."""
        chosen = self._chosen(valves)
        found = [c for valve in chosen for c in self._memories_of(valve, self._as_kept(valve))]
        return found + self._kept_of_service()

    def _chosen(self, valves: Iterable[int] | None) -> Iterable[int]:
        return range(len(self.plans)) if valves is None else valves

    def _as_kept(self, valve: int) -> ValveState:
        fleet, m = self._at(valve)
        return fleet.state(m)  # what sensors may be off by is not kept

    def _checkpoints_of(self, valve: int, state: ValveState) -> list[Checkpoint]:
        keys = self._keys[self._fleet_of[valve]]
        return [
            Checkpoint(
                valve=self.plans[valve].name,
                estimator=name,
                key=keys[name],
                t=lane.t,
                state=pipeline.lane_to_bytes(lane, keys[name]),
                lam=lane.lam,
                frozen=lane.frozen,
            )
            for name, lane in state.lanes.items()
        ]

    def _memories_of(self, valve: int, state: ValveState) -> list[Checkpoint]:
        fleet, m = self._at(valve)
        waiting = self._alignment.of(self._waiting, valve)
        memory = ValveMemory.of(state, waiting, dict(fleet.beyond(m)))
        key, name = self._memory_key(valve), self.plans[valve].name
        packed = memory.to_bytes(key)
        found = [Checkpoint(name, MEMORY, key, state.t, packed, lam=None, frozen=False)]
        found.append(self._alarms_of(valve, state.t))
        if self._finds_timing:
            found.append(self._timing_of(valve, state.t))
        if self._approved[valve]:
            found.append(self._baseline_of(valve))
        return found

    def _kept_of_service(self) -> list[Checkpoint]:
        if not self._service_alarms.version:
            return []
        packed = self._service_alarms.to_bytes()
        return [Checkpoint(OF_SERVICE, ALARMS, "", 0, packed, lam=None, frozen=False)]

    def _alarms_of(self, valve: int, t: int) -> Checkpoint:
        fleet, m = self._at(valve)
        packed, name = fleet.alarms.to_bytes(m), self.plans[valve].name
        return Checkpoint(name, ALARMS, "", t, packed, lam=None, frozen=False)

    def _take_alarms(self, kept: Checkpoint) -> None:
        if kept.valve == OF_SERVICE:
            self._service_alarms.from_bytes(kept.state)
        else:
            fleet, m = self._at(self._number(kept))
            fleet.alarms.from_bytes(m, kept.state)

    def _baseline_of(self, valve: int) -> Checkpoint:
        """The baseline, or, as ``frozen``, that there is none any more."""
        found = self._baselines.get(valve)
        none = Baseline.none(int(self._approved[valve]))
        packed = (found or none).to_bytes()
        t = 0 if found is None else found.t
        name = self.plans[valve].name
        return Checkpoint(name, BASELINE, "", t, packed, lam=None, frozen=found is None)

    def _take_baseline(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        found = Baseline.from_bytes(kept.state)
        self._approved[number] = found.number
        if not kept.frozen:
            self._baselines[number] = found

    def _timing_of(self, valve: int, t: int) -> Checkpoint:
        key = self._timing_key(valve)
        packed = self._timing.valves[valve].state.to_bytes(key)
        return Checkpoint(self.plans[valve].name, TIMING, key, t, packed, lam=None, frozen=False)

    def _timing_key(self, valve: int) -> str:
        if valve not in self._timing_keys:
            settings, nodes = self._timing.settings, self.plans[valve].nodes
            self._timing_keys[valve] = key_of(_Comes(settings, nodes, *self._has(valve)))
        return self._timing_keys[valve]

    def _has(self, valve: int) -> tuple[bool, bool]:
        """Whether a valve has a temperature, and running numbers."""
        alignment = self._alignment
        numbered = bool(alignment.has_sequence) and alignment.has_sequence[valve]
        return alignment.has_T[valve], numbered

    def _time_as_before(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        if not self._finds_timing:
            raise StateMismatchError("how signals come is configured")
        self._timing.put(number, TimingState.from_bytes(kept.state, self._timing_key(number)))

    def _memory_key(self, valve: int) -> str:
        kind = int(self._fleet_of[valve]), *self._has(valve)
        if kind not in self._memory_keys:
            gate, settings = self.plans[valve].gate, self._alignment.settings
            self._memory_keys[kind] = key_of(_Through(gate, settings, *self._has(valve)))
        return self._memory_keys[kind]

    def _remember(self, kept: Checkpoint) -> None:
        number = self._number(kept)
        fleet, m = self._at(number)
        memory = ValveMemory.from_bytes(
            kept.state, self._memory_key(number), self.plans[number].gate, self._alignment
        )
        self._waiting = self._alignment.put(self._waiting, number, memory.waiting)
        fleet.remember(m, memory.gate, memory.t, memory.T)
        fleet.demand(m, *memory.demand)
        for name, notes in memory.notes.items():
            known = name in self.plans[number].estimators and notes.status in (-1, *Status)
            if not known or not (lane := fleet.lane(m, name)).t:
                continue  # it starts afresh
            status = None if notes.status < 0 else Status(notes.status)
            said = replace(lane, predicted=notes.predicted, residual=notes.residual, status=status)
            fleet.put(m, name, said)
            fleet.count_beyond(m, name, notes.beyond)

    def _number(self, kept: Checkpoint) -> int:
        number = self._numbers.get(kept.valve)
        if number is None:
            raise StateMismatchError("no such valve is configured")
        return number

    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Take up what was kept, where the configuration still fits.

        Returns
        -------
        restored, refused
            names ``<Valve>.<Estimator>``; what is refused starts afresh, and why.
        """
        restored: list[str] = []
        refused: dict[str, str] = {}
        takers = {
            MEMORY: self._remember,
            TIMING: self._time_as_before,
            BASELINE: self._take_baseline,
            ALARMS: self._take_alarms,
        }
        known: set[int] = set()
        for kept in sorted(checkpoints, key=lambda kept: kept.estimator == MEMORY):
            name = f"{kept.valve}.{kept.estimator}"
            try:
                takers.get(kept.estimator, self._restore)(kept)
            except StateMismatchError as error:
                refused[name] = str(error)
            else:
                restored.append(name)
                known.update({self._numbers[kept.valve]} if kept.valve in self._numbers else ())
        for number in known:
            self._maps[number] = self._inverse_map(number)
        if known:
            self.refresh_maps()
        return restored, refused

    def _restore(self, kept: Checkpoint) -> None:
        configured = self.plans[self._number(kept)].estimators.get(kept.estimator)
        if configured is None:
            raise StateMismatchError("no such estimator is configured")
        lane = pipeline.lane_from_bytes(
            kept.state, configured, kept.lam, frozen=kept.frozen, t=kept.t
        )
        self._put(kept.valve, kept.estimator, lane)

    def columns(self) -> list[Columns]:
        """All that the valves remember of their samples, as the arrays themselves; no baselines."""
        names = tuple(plan.name for plan in self.plans)
        newest = self._newest
        every: dict[str, NDArray[Any]] = {
            "newest_t": newest.t,
            "newest_quality": newest.quality,
            "newest_values": newest.values,
            "implausible": self._implausible,
            "approved": self._approved,
            **{f"plausibility_{n}": array for n, array in self._plausibility.columns().items()},
        }
        found = [Columns("signals", names, every)]
        for number, fleet in enumerate(self._fleets):
            own = np.flatnonzero(self._fleet_of == number)
            found += fleet.columns([names[valve] for valve in own])
        return found

    def remember(
        self, columns: Sequence[Columns], baselines: Mapping[str, bytes]
    ) -> set[tuple[str, str]]:
        """Take up columns and baselines; return (key, valve) of what starts afresh."""
        own = self.columns()
        afresh = copy_rows(columns, own)
        for fleet in self._fleets:
            fleet.columns_written()
        for valve, packed in baselines.items():
            if valve in self._numbers:
                self._baselines[self._numbers[valve]] = Baseline.from_bytes(packed)
        return afresh

    def baselines(self) -> dict[str, bytes]:
        """The approved maps, packed, by valve."""
        return {self.plans[n].name: found.to_bytes() for n, found in self._baselines.items()}

    def _first_maps(self) -> list[Floats]:
        """Tables before the first sample: the same for valves treated alike."""
        tables: dict[tuple[object, ...], Floats] = {}
        maps = []
        for number, plan in enumerate(self.plans):
            key = (int(self._fleet_of[number]), plan.inverse, plan.map_Q, plan.map_dp)
            if key not in tables:
                tables[key] = self._inverse_map(number)
            maps.append(tables[key])
        return maps

    def _inverse_map(self, valve: int) -> Floats:
        return pipeline.inverse_map(*self._inverted(valve))

    def _inverted(self, valve: int) -> tuple[ValvePlan, ValveState]:
        """What the inverse of a valve's map is made from."""
        plan = self.plans[valve]
        return plan, self._state_of(valve, plan.inverse)

    def _state_of(self, valve: int, estimator: str) -> ValveState:
        """One valve as it stands, with one of its estimators: whole states are large."""
        fleet, m = self._at(valve)
        return fleet.state(m, [estimator])

    def _at(self, valve: int) -> tuple[Fleet, int]:
        return self._fleets[self._fleet_of[valve]], int(self._member_of[valve])

    def _T(self, valve: str, T: float) -> float:
        fleet, m = self._at(self._numbers[valve])
        return fleet.last_T(m) if np.isnan(T) else T

    def _put(self, valve: str, estimator: str, lane: Lane) -> None:
        fleet, m = self._at(self._numbers[valve])
        fleet.put(m, estimator, lane)


def _of_valve(alarm: str) -> Alarm:
    return Alarm(ALARM_NAMES.index(alarm))


def _of_service(alarm: str) -> ServiceAlarm:
    return ServiceAlarm(SERVICE_ALARM_NAMES.index(alarm))


def _fleets(plans: Sequence[ValvePlan]) -> tuple[list[Fleet], Times, Times]:
    """Fleets of the valves that are treated alike; of each valve its fleet and its place there."""
    numbers: dict[str, int] = {}
    first: list[ValvePlan] = []
    sizes: list[int] = []
    places = np.zeros((2, len(plans)), np.int64)
    keys = _once_each(key_of)
    for valve, plan in enumerate(plans):
        estimators = [(name, keys(e)) for name, e in plan.estimators.items()]
        ranges = pipeline.nothing_seen(plan).ranges.tolist()
        watched = plan.inverse, sorted(plan.alarms.items())
        key = repr((plan.gate, estimators, ranges, plan.accuracy, watched))
        number = numbers.setdefault(key, len(numbers))
        if number == len(first):
            first.append(plan)
            sizes.append(0)
        places[:, valve] = number, sizes[number]
        sizes[number] += 1
    fleets = [Fleet(plan, M) for plan, M in zip(first, sizes, strict=True)]
    return fleets, places[0], places[1]


def _rows(starts: Times, stops: Times) -> tuple[slice | NDArray[np.int64], Times, Times]:
    """Which rows the segments have, and where the segments are among those alone."""
    if (starts[1:] == stops[:-1]).all():
        return slice(starts[0], stops[-1]), starts - starts[0], stops - starts[0]
    rows = np.concatenate([np.arange(*pair) for pair in zip(starts, stops, strict=True)])
    last = np.cumsum(stops - starts)
    return rows, last - (stops - starts), last


def _once_each(of: Callable[[AnyEstimator], R]) -> Callable[[AnyEstimator], R]:
    """The same function, called once for each estimator: valves of one kind share theirs."""
    known: dict[int, R] = {}

    def cached(estimator: AnyEstimator) -> R:
        if id(estimator) not in known:
            known[id(estimator)] = of(estimator)
        return known[id(estimator)]

    return cached


def _description(estimator: AnyEstimator) -> EstimatorDescription:
    return EstimatorDescription(
        name="",
        description=_first_line(estimator),
        parameter_names=estimator.parameter_names,
        has_forgetting_factor=isinstance(estimator, Forgetful),
        finds_changes=pipeline.finds_changes(estimator),
        chooses_structure=isinstance(estimator, Auto),
        finds_lags=isinstance(estimator, Auto),
        has_named_parameters=isinstance(estimator, RecursiveLeastSquares | MaximumLikelihood),
    )


def _first_line(thing: object) -> str:
    return (type(thing).__doc__ or type(thing).__name__).strip().splitlines()[0]
