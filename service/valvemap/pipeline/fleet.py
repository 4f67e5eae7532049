"""All valves with one plan: their states are one structure of arrays, updated in place.

Valves with the same plan differ only in their samples and their operators' settings. One kernel
call each gates, estimates and scores a batch for any number of valves; one valve is a fleet of one.
:class:`~valvemap.pipeline.valve_state.Lane` and
:class:`~valvemap.pipeline.valve_state.ValveState` are copies that later samples do not change.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from valvemap.model.estimator import key_of
from valvemap.model.samples import Codes, Samples, Segments, Times
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.batch_parts import BatchParts, Taken, in_rounds
from valvemap.pipeline.compared_maps import ComparedMaps
from valvemap.pipeline.fleet_inputs import FleetInputs
from valvemap.pipeline.fleet_lanes import FleetLanes
from valvemap.pipeline.lane_alarms import LaneAlarms
from valvemap.pipeline.lane_failures import (
    CopyBuffer,
    LaneFailures,
    Restore,
    Rows,
    Step,
    all_of,
    isolate,
    isolate_last,
    saved,
)
from valvemap.pipeline.lane_traces import nothing_of
from valvemap.pipeline.lanes import Lanes
from valvemap.pipeline.quality_gate import COUNTER_NAMES as OF_GATE
from valvemap.pipeline.results import EstimatorResults
from valvemap.pipeline.shared_support import SharedRests, SharedSupport
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_state import (
    Lane,
    ValvePlan,
    ValveState,
    findings_of,
    merged_findings,
    nothing_seen,
)
from valvemap.vocabulary.findings import Finding
from valvemap.vocabulary.statuses import Quality, Status

COUNTER_NAMES = (*OF_GATE, "beyond_range", "censored", "lane_failures")


class Fleet:
    """M valves that share a plan.

    Parameters
    ----------
    plan
        Gate and estimators of each valve.
    M
        Number of valves.
    names, failures
        Names of the valves, and the list that collects their lanes' failures.
    waits
        Names of the estimators that do not run: their lanes keep their initial states.
    buffer
        Memory for copies of states; fleets that are not updated at once share it.

    Attributes
    ----------
    inputs : FleetInputs
        The gate's state, the newest time and temperature, and the standing demands.
    alarms : Alarms
    lanes : FleetLanes
        The lanes, and which of them have stopped.
    maps : ComparedMaps
        The estimators' maps, compared at places that a valve visits again.
    """

    def __init__(
        self,
        plan: ValvePlan,
        M: int,
        names: Sequence[str] | None = None,
        failures: LaneFailures | None = None,
        waits: Collection[str] = (),
        buffer: CopyBuffer | None = None,
    ) -> None:
        self.plan = plan
        self._buffer = buffer or CopyBuffer()
        self._restore: Mapping[str | Step, Restore] = {}  # of each part, by the newest `_saved`
        self.inputs = FleetInputs(plan.gate, M)
        self._support = SharedSupport(nothing_seen(plan), len(plan.estimators), M)
        self._lanes = {
            name: Lanes(estimator, M, SharedRests(self._support, number), plan.accuracy)
            for number, (name, estimator) in enumerate(plan.estimators.items())
        }
        self.alarms = Alarms(M, plan.alarms, max(plan.map_Q) - min(plan.map_Q))
        names, failures = names or [plan.name] * M, failures or LaneFailures()
        self.lanes = FleetLanes(self._lanes, waits, names, self.inputs.t, failures, self.alarms)
        keys = {name: key_of(one) for name, one in plan.estimators.items()}
        self.maps = ComparedMaps(plan, M, keys, self.lanes, self.alarms)
        self._lane_alarms = LaneAlarms(plan, self.alarms, self.lanes, self.maps, self.inputs.t)

    def take(self, samples: Samples, segments: Segments) -> Taken:
        """Gate samples and update the estimators; return the gated samples and the traces.

        ``segments`` assigns the samples to valves by the fleet's numbers; none may be empty. If a
        step raises, all steps are repeated valve by valve. An error then stops the lane of the
        step, or, outside of any lane, the valve.
        """
        parts: BatchParts | None = None
        taken: Taken | None = None

        def take(rows: Rows) -> None:
            nonlocal parts, taken
            if len(rows) == len(segments.members):
                taken = self._take(samples, segments)
                return
            parts = parts or self._nothing_of(samples)
            taken = parts.whole
            for k in rows:
                own = slice(segments.starts[k], segments.stops[k])
                one = Segments.one(own.stop - own.start)
                one = one._replace(members=segments.members[k : k + 1])
                parts.put(own, self._take(samples[own], one))

        isolate(segments.members, take, self._saved, self.lanes.stop_at(Step.LEARNING))
        return (samples, self._nothing_of(samples).whole[1]) if taken is None else taken

    def _nothing_of(self, samples: Samples) -> BatchParts:
        return BatchParts(samples, self._lanes, np.full_like(samples.quality, Quality.BAD))

    def _take(self, samples: Samples, segments: Segments) -> Taken:
        """Process samples in rounds: maps are compared at fixed numbers of samples of a valve."""
        return in_rounds(samples, segments, self._lanes, self.maps.next_stops, self._take_round)

    def _take_round(self, samples: Samples, segments: Segments) -> Taken:
        judged = self._judged(samples, segments)
        traces, rests = {}, []
        for name, lanes in self._lanes.items():
            if name in self.lanes.waits:
                traces[name] = nothing_of(len(samples), Status.WARMING_UP)
                rests.append((traces[name].status, segments._replace(starts=segments.stops)))
                continue
            stop = self.lanes.stop_at(Step.LEARNING, name)
            traces[name], own = lanes.take(judged, segments, self._restore[name], stop)
            rests.append((traces[name].status, own))
        self._support_from(judged, rests, segments)
        comparison = self._restore[Step.COMPARISON]
        traces = self.maps.compare(judged, traces, segments, comparison, self._buffer)
        running = segments.of(~self.lanes.stopped()[segments.members])
        self.inputs.note_newest(judged, running)
        self._lane_alarms.watch(judged, traces, running, self._restore[Step.ALARMS])
        return judged, traces

    def watch(self, chosen: Times, do: Callable[[Rows], None]) -> None:
        """Judge the alarms of the given valves (K,); ``do`` is called with rows of the K."""
        self._lane_alarms.judge(chosen, do, self._buffer)

    @property
    def changes(self) -> int:
        """How often an alarm, or its delay, began or ended, or a lane was stopped."""
        return self._lane_alarms.changes + self.lanes.changes

    def _saved(self, members: Times) -> Restore:
        """Copy the state of the given valves; the result writes the copies back."""
        self._buffer.clear()
        buffer, inputs = self._buffer, self.inputs
        self._restore = {
            Step.GATE: saved((*inputs.gate.memory, inputs.gate.bad_status), members, buffer),
            Step.SUPPORT: self._support.saved(members, buffer),
            Step.COMPARISON: self.maps.places.saved(members, buffer),
            Step.ALARMS: self._lane_alarms.saved(members, buffer),
            **{name: lanes.saved(members, buffer) for name, lanes in self._lanes.items()},
        }
        times = saved((inputs.t, inputs.T), members, buffer)
        return all_of([times, *self._restore.values()])

    def _judged(self, samples: Samples, segments: Segments) -> Samples:
        """Return the gated samples; all samples of a stopped valve are BAD."""
        quality = np.full(len(samples), Quality.BAD, np.uint8)
        running = segments.of(~self.lanes.stopped()[segments.members])

        def judge(_: Rows) -> None:
            nonlocal quality
            found = self.plan.gate.judge(self.inputs.gate, samples, running).quality
            if len(running.members) == len(segments.members):
                quality = found
                return
            for _, start, stop in zip(*running, strict=True):
                quality[start:stop] = found[start:stop]

        isolate_last(
            running.members, judge, self._restore[Step.GATE], self.lanes.stop_at(Step.GATE)
        )
        return replace(samples, quality=quality)

    def _support_from(
        self, judged: Samples, rests: Sequence[tuple[Codes, Segments]], segments: Segments
    ) -> None:
        running = ~self.lanes.stopped()[segments.members]

        def learn(_: Rows) -> None:
            some = [(status, own.of(running)) for status, own in rests]
            self._support.learn(judged, some, segments.of(running))

        stop = self.lanes.stop_at(Step.SUPPORT)
        isolate_last(segments.members[running], learn, self._restore[Step.SUPPORT], stop)

    def lane(self, m: int, name: str) -> Lane:
        """Return one estimator of one valve."""
        return self._lanes[name].get(m, self.maps.errors(m, name))

    def findings(self, m: int) -> tuple[Finding, ...]:
        """Return the causes that the running estimators of one valve find, the likeliest first."""
        running = [name for name in self._lane_alarms.finders if not self.lanes.has_failed(m, name)]
        return merged_findings(findings_of(self._lanes[name].get(m)) for name in running)

    def put(self, m: int, name: str, lane: Lane) -> None:
        """Replace a lane; its estimator must be the plan's, except for ``lam``."""
        self._lanes[name].put(m, lane)

    def state(self, m: int, names: Iterable[str] | None = None) -> ValveState:
        """Return the state of one valve, with the named estimators or with all."""
        return self.inputs.state(m, {name: self.lane(m, name) for name in names or self._lanes})

    def view(self, m: int) -> ValveState:
        """As `state`, not copied and without errors of maps: the next samples change it."""
        return self.inputs.view(m, {name: lanes.view(m) for name, lanes in self._lanes.items()})

    def results(self, chosen: Times) -> Mapping[str, EstimatorResults]:
        """Return the estimators' results of the given valves, without surveys."""
        adaptations = self.maps.adaptations(chosen)
        return {
            name: lanes.results(chosen, adaptations[name]) for name, lanes in self._lanes.items()
        }

    def unknown(self, m: int) -> Mapping[str, EstimatorResults]:
        """Return Bad results of one valve, for use when `results` raises."""
        return {name: lanes.unknown(m) for name, lanes in self._lanes.items()}

    def columns(self, valves: Sequence[str]) -> list[Columns]:
        """Return the state of the valves as columns; call `take_up` after writing to them.

        Arrays with a row for each valve are returned themselves, the others are copies.
        """
        names = tuple(valves)
        return [
            self.inputs.columns(names),
            Columns("places", names, self.maps.places.columns_of_valves()),
            Columns("alarms", names, self._lane_alarms.columns()),
            *(
                lanes.columns(name, names, self.maps.places.columns_of_lane(e))
                for e, (name, lanes) in enumerate(self._lanes.items())
            ),
        ]

    def take_up(self, written: Sequence[Columns]) -> None:
        """Update the fleet after the arrays of `columns` were written to."""
        of_lanes = written[len(written) - len(self._lanes) :]
        for lanes, columns in zip(self._lanes.values(), of_lanes, strict=True):
            lanes.take_up(columns.arrays)
        for m in range(len(self.inputs.t)):
            self.lanes.show_stopped(m)

    def rejections(self, chosen: Times) -> Times:
        """Counts (K, reasons) since the start: rejections by gate, estimators, lane failures."""
        lanes = [*self._lanes.values()]
        beyond = np.max([one.beyond[chosen] for one in lanes], axis=0)
        censored = np.max([one.states.censored(chosen) for one in lanes], axis=0)
        failed = self.alarms.failures(chosen)
        return np.column_stack((self.inputs.gate.counts(chosen), beyond, censored, failed))
