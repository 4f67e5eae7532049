"""Results to publish, as arrays over valves with the same plan."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Floats, Times
from valvemap.pipeline import lane_predictions
from valvemap.pipeline.alarm_results import AlarmResults
from valvemap.pipeline.alignment import COUNTER_NAMES as OF_ALIGNMENT
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.approved_maps import ApprovedMaps
from valvemap.pipeline.armed_valves import ArmedValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.dynamics_results import NOTHING_YET, DynamicsResults
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.fleet import COUNTER_NAMES as NOT_LEARNT
from valvemap.pipeline.fleet import Fleet
from valvemap.pipeline.inverse_tables import InverseTables
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.line_inverse import LineInverse
from valvemap.pipeline.maps_and_surveys import MapsAndSurveys
from valvemap.pipeline.recommendation import NOT_YET, Recommendation, recommendation
from valvemap.pipeline.results import Results, SignalResults, ValveResult
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.pipeline.waiting_reasons import WaitingReasons
from valvemap.vocabulary.signals import PUBLISHED
from valvemap.vocabulary.statuses import Quality

COUNTERS = (*OF_ALIGNMENT, *NOT_LEARNT)

_MISSING = OF_ALIGNMENT.index("missing")


class ResultTables:
    """Collects the results of all parts.

    Parameters
    ----------
    valves
        The valves.
    arrivals, intake
        Alignment and newest samples.
    maps
        Inverse tables and surveys, as computed last.
    approved
        The valves' baselines.
    armed
        State of their feed-forward.
    commands, lines
        Compute the answers to their standing demands.

    Attributes
    ----------
    reasons : WaitingReasons
        Why samples of valves are not used.
    """

    def __init__(
        self,
        valves: AllValves,
        arrivals: Arrivals,
        intake: SampleIntake,
        maps: MapsAndSurveys,
        approved: ApprovedMaps,
        armed: ArmedValves,
        commands: EstimatorCommands,
        lines: LineInverse,
    ) -> None:
        self._valves = valves
        self._arrivals = arrivals
        self._intake = intake
        self._maps = maps
        self._approved = approved
        self._inverse = InverseTables(valves, maps, armed, commands, lines)
        self.reasons = WaitingReasons(valves, arrivals, intake)
        self._dynamics: dict[int, DynamicsResults] = {}
        self._alarms_base = 0  # added to the versions of alarms

    def show_all_alarms_again(self) -> None:
        """Let every version of the alarms differ from those of results published before."""
        self._alarms_base += 1 << 32

    def of(
        self,
        valves: Sequence[int],
        lost: NDArray[np.bool_] | None = None,
        old: NDArray[np.bool_] | None = None,
    ) -> Iterator[Results]:
        """Yield the results of the given valves, one for each group with the same plan.

        ``lost`` and ``old`` are masks over all valves. Results of valves with lost sensors are BAD;
        those with an old newest sample are UNCERTAIN or worse.
        """
        chosen = np.array(valves, np.int64)
        for fleet, rows in self._valves.by_fleet(chosen):
            own = chosen[rows]
            at_best = np.full(len(own), np.uint8(Quality.GOOD))
            if old is not None:
                at_best[old[own]] = Quality.UNCERTAIN
            if lost is not None:
                at_best[lost[own]] = Quality.BAD
            yield from self._isolated(fleet, own, at_best)

    def one(self, valve: int) -> ValveResult:
        """Return the results of one valve."""
        (results,) = self.of([valve])
        return results.one(0)

    def counters(self, valve: int) -> Mapping[str, int]:
        """Return the counts of one valve's aligned, lost and rejected samples since the start."""
        fleet, _ = self._valves.at(valve)
        (counts,) = self._counts(fleet, np.array([valve])).tolist()
        return dict(zip(COUNTERS, counts, strict=True))

    def recommendation(self, valve: int) -> Recommendation:
        """Return which estimator of one valve is recommended, and why."""
        fleet, m = self._valves.at(valve)
        names = list(fleet.plan.estimators)
        return recommendation(fleet.maps.places.ranking(m), names, fleet.maps.inverse(m))

    def waited_for(self, valve: int) -> tuple[str, ...]:
        """Return what the source says of a valve's nodes, else its missing signals."""
        return self.reasons.waited_for(valve)

    def note_dynamics(self, valve: int, found: DynamicsResults) -> None:
        """Note the dynamics of one valve; its results show them from now on."""
        self._dynamics[valve] = found

    def _dynamics_of(self, valve: int) -> DynamicsResults:
        return self._dynamics.get(valve, NOTHING_YET)

    def _isolated(self, fleet: Fleet, valves: Times, at_best: Codes) -> list[Results]:
        """Results of the given valves; stopped valves are separate, and all if one raises."""
        stopped = fleet.lanes.stopped()[self._valves.places[valves]]
        running, found = (~stopped).nonzero()[0], []
        alone = stopped.nonzero()[0]
        try:
            if len(running):
                found.append(self._of_fleet(fleet, valves[running], at_best[running]))
        except Exception:  # noqa: BLE001 - a bulkhead: the failing valve is found below
            alone = np.arange(len(valves))
        for k in alone:
            valve, one = int(valves[k]), slice(k, k + 1)
            try:
                found.append(self._of_fleet(fleet, valves[one], at_best[one]))
            except Exception as error:  # noqa: BLE001 - a bulkhead: the others are published
                self._valves.stop(valve, Step.RESULTS, None, error)
                found.append(self.unknown(valve))
        return found

    def unknown(self, valve: int) -> Results:
        """Return Bad results of one valve, for use when `results` raises."""
        fleet, m = self._valves.at(valve)
        one, plan = np.array([valve]), self._valves.plans[valve]
        bad = np.full(1, Quality.BAD, np.uint8)
        estimators = fleet.unknown(m)
        return Results(
            valves=one,
            estimators=estimators,
            inverse=self._inverse.unknown(valve, estimators[plan.inverse].t),
            counters=np.zeros((1, len(COUNTERS)), np.int64),
            counter_names=COUNTERS,
            signals=SignalResults(
                estimators[plan.inverse].t, bad, np.full((1, len(PUBLISHED)), np.nan)
            ),
            baselines=[None],
            recommended=[NOT_YET],
            findings=[()],
            alarms=AlarmResults(
                self._alarms_base + fleet.alarms.version[[m]], lambda _: fleet.alarms.reports(m)
            ),
            timing=[()],
            waiting=[()],
        )

    def _of_fleet(self, fleet: Fleet, valves: Times, at_best: Codes) -> Results:
        found = self._of_valves(fleet, valves, at_best)
        return self._inverse.of_lines(found, valves)

    def _of_valves(self, fleet: Fleet, valves: Times, at_best: Codes) -> Results:
        places, is_old = self._valves.places[valves], at_best == Quality.UNCERTAIN
        estimators = {
            name: replace(
                found,
                quality=np.maximum(found.quality, at_best),
                old=is_old if is_old.any() else None,
                survey=[self._maps.surveys[valve].get(name) for valve in valves],
                systematic_std=self._systematic_std(fleet, valves, name),
            )
            for name, found in fleet.results(places).items()
        }
        return Results(
            valves=valves,
            estimators=estimators,
            inverse=self._inverse.of(fleet, valves, estimators),
            counters=self._counts(fleet, valves),
            counter_names=COUNTERS,
            signals=self._intake.signals(valves, at_best),
            baselines=[self._approved.baselines.get(int(valve)) for valve in valves],
            recommended=[self.recommendation(int(valve)) for valve in valves],
            findings=[
                self._dynamics_of(valve).findings + fleet.findings(m)
                for valve, m in zip(valves.tolist(), places.tolist(), strict=True)
            ],
            dynamics=[self._dynamics_of(valve) for valve in valves.tolist()]
            if self._dynamics
            else (),
            alarms=AlarmResults(
                self._alarms_base + fleet.alarms.version[places],
                lambda m: fleet.alarms.reports(int(places[m])),
            ),
            timing=[
                self._arrivals.how_signals_come(valve, self._valves.plans[valve].nodes)
                for valve in valves.tolist()
            ],
            waiting=self.reasons.of(valves, at_best),
        )

    def _systematic_std(self, fleet: Fleet, valves: Times, name: str) -> Floats:
        """Flow's standard deviation due to sensor errors at each valve's newest sample, l/min."""
        found = np.full(len(valves), np.nan)
        stated, timing = fleet.plan.accuracy.is_stated, self._arrivals.timing
        for k, valve in enumerate(valves):
            if not stated and timing.valves[valve].found is None:
                continue
            accuracy = self._valves.accuracy(int(valve))
            if not accuracy.is_stated:
                continue
            newest = dict(zip(PUBLISHED, self._intake.newest.values[valve], strict=True))
            point = (np.array([newest[signal]]) for signal in ("U", "dp", "T"))
            lane = replace(fleet.lane(int(self._valves.places[valve]), name), accuracy=accuracy)
            (found[k],) = lane_predictions.systematic(lane, *point)
        return found

    def _counts(self, fleet: Fleet, valves: Times) -> Times:
        rejected = fleet.rejections(self._valves.places[valves])
        aligned = self._arrivals.counts(valves)
        aligned[:, _MISSING] += self._intake.splitter.dropped[valves]
        aligned[:, _MISSING] += self._intake.meters.dropped[valves]
        return np.column_stack((aligned, rejected))
