"""The maps of a fleet's estimators, compared at places that the valves visit again. Pure.

The comparison revises the statuses of samples, diagnoses residuals, and chooses whose map is
inverted.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from valvemap.model.samples import Codes, Flags, Floats, Samples, Segments, Times, Trace
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.fleet_lanes import FleetLanes
from valvemap.pipeline.lane_failures import (
    CopyBuffer,
    Restore,
    Rows,
    Step,
    isolate,
    isolate_last,
)
from valvemap.pipeline.lanes import Lanes
from valvemap.pipeline.map_errors import MapErrors
from valvemap.pipeline.place_ranking import Ranking
from valvemap.pipeline.places import Places
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.statuses import Adaptation


class ComparedMaps:
    """The maps of M valves' estimators.

    Parameters
    ----------
    plan
        Names the estimator whose map is inverted, and those that are never recommended.
    M
        Number of valves.
    keys
        Hash of each estimator, by name.
    lanes, alarms
        Those of the valves.

    Attributes
    ----------
    places : Places
        Errors at places that a valve visits again, and the ranking of its estimators by them.
    """

    def __init__(
        self, plan: ValvePlan, M: int, keys: Mapping[str, str], lanes: FleetLanes, alarms: Alarms
    ) -> None:
        self._plan, self._keys = plan, keys
        self._lanes, self._alarms = lanes, alarms
        references = [e for name, e in lanes.numbers.items() if name in plan.references]
        self.places = Places(len(plan.estimators), M, references)

    def next_stops(self, segments: Segments) -> Times:
        """Return the rows up to which the given valves' samples are processed at once."""
        ahead = self.places.due(segments.members)
        ahead[self._lanes.stopped()[segments.members]] = np.iinfo(np.int32).max
        return np.minimum(segments.stops, segments.starts + np.maximum(ahead, 1))

    def compare(
        self,
        judged: Samples,
        traces: Mapping[str, Trace],
        segments: Segments,
        restore: Restore,
        buffer: CopyBuffer,
    ) -> dict[str, Trace]:
        """Compare the estimators at the valves' places; return the traces with revised statuses.

        ``restore`` undoes what is written to `places`; ``buffer`` is memory for further copies.
        """
        running = segments.of(~self._lanes.stopped()[segments.members])
        residual = np.array([trace.residual for trace in traces.values()])
        early = np.array([trace.early for trace in traces.values()])
        status = np.array([trace.status for trace in traces.values()])

        def compare(_: Rows) -> None:
            self.places.learn(judged, residual, early, status, running)

        stop = self._lanes.stop_at(Step.COMPARISON)
        isolate_last(running.members, compare, restore, stop)
        for said, lanes in zip(status, self._lanes.by_name.values(), strict=True):
            lanes.revise(said, running)
        for m in running.members[self.places.due(running.members) <= 0]:
            self._look_back_isolated(int(m), buffer)
        return {
            name: replace(trace, status=said)
            for (name, trace), said in zip(traces.items(), status, strict=True)
        }

    def rank_now(self, m: int) -> Ranking:
        """Compare the newest maps of one valve before it is due; return the ranking."""
        if not self._lanes.stopped()[m]:
            self._look_back_isolated(m, CopyBuffer())
        return self.places.ranking(m)

    def _look_back_isolated(self, m: int, buffer: CopyBuffer) -> None:
        one, stop = np.array([m]), self._lanes.stop_at(Step.COMPARISON)
        isolate_last(one, partial(self._look_back, m), self.places.saved(one, buffer), stop)

    def _look_back(self, m: int, _: Rows) -> None:
        """Evaluate the maps of one valve at the places that it left, and rank them."""
        points, one = self.places.points(m), np.array([m])
        maps: list[tuple[Floats, Floats] | None] = []
        follows: list[bool] = []
        for name, lanes in self._lanes.by_name.items():
            maps.append(None)
            follows.append(lanes.follows(m))
            if lanes.failed[m] or name in self._lanes.waits:
                continue

            def evaluate(_: Rows, lanes: Lanes = lanes) -> None:
                maps[-1] = lanes.predicted(m, *points)

            stop = self._lanes.stop_at(Step.COMPARISON, name)
            isolate(one, evaluate, _nothing_saved, stop)
        before = self.inverse(m)
        self.places.look_back(m, maps, follows)
        if self.inverse(m) != before:
            self._alarms.forget_usual(m)

    def inverse(self, m: int) -> str:
        """Name of the estimator whose map is inverted at one valve."""
        return self.inverses(np.array([m]))[0]

    def inverses(self, chosen: Times) -> list[str]:
        """As `inverse`, of the given valves (K,)."""
        names, plan = list(self._lanes.by_name), self._plan
        if not plan.follows:
            return [plan.inverse] * len(chosen)
        numbers = self.places.chosen(chosen).tolist()
        return [plan.inverse if number < 0 else names[number] for number in numbers]

    def by_inverse(self, chosen: Times) -> Iterator[tuple[str, Flags]]:
        """Yield each inverted estimator, and which of the given valves (K,) it is inverted at."""
        names = np.array(self.inverses(chosen))
        for name in dict.fromkeys(names.tolist()):
            yield name, names == name

    def adaptations(self, chosen: Times) -> dict[str, Codes]:
        """Diagnoses of each estimator's residuals (K,) for the given valves.

        Where an estimator itself is undecided, its errors at places visited again decide.
        """
        fits = self.places.fits(chosen)
        found: dict[str, Codes] = {}
        for (name, lanes), fit in zip(self._lanes.by_name.items(), fits, strict=True):
            said = lanes.states.adaptations(chosen)
            found[name] = np.where(said == Adaptation.UNDECIDED, fit, said).astype(np.uint8)
        return found

    def recent_rmse(self, chosen: Times, name: str) -> Floats:
        """The larger of an estimator's recent RMS residual and its error at places left, l/min."""
        rmse = self._lanes.by_name[name].recent_rmse(chosen)
        return np.asarray(np.fmax(rmse, self.places.errors(chosen, self._lanes.numbers[name])))

    def errors(self, m: int, name: str) -> MapErrors:
        """Return a copy of the errors of one estimator's map."""
        return self.places.of(m, self._lanes.numbers[name])

    def reset(self, m: int, name: str) -> None:
        """Reset the errors of one estimator's map, after its reset."""
        self.places.reset(m, self._lanes.numbers[name])

    def accept(self, m: int, name: str) -> None:
        """Accept the restored map of one estimator: it is not warmed up again."""
        self.places.accept(m, self._lanes.numbers[name])

    def to_bytes(self, m: int) -> bytes:
        """Pack the places of one valve."""
        return self.places.to_bytes(m, self._keys)

    def from_bytes(self, m: int, data: bytes) -> None:
        """Unpack the places of one valve.

        Raises
        ------
        StateMismatchError
        """
        self.places.from_bytes(m, data, self._keys)


def _nothing_saved(_: Times) -> Restore:
    """Return a restoration for a step that writes nothing."""
    return lambda: None
