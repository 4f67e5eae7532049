"""All valves with one plan: their states are one structure of arrays, updated in place.

Valves with the same plan differ only in their samples and their operators' settings. One kernel
call each gates, estimates and scores a batch for any number of valves; one valve is a fleet of one.
:class:`~valvemap.pipeline.valve_state.Lane` and
:class:`~valvemap.pipeline.valve_state.ValveState` are copies that later samples do not change.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.capabilities import FindsCauses, FindsLags, finds_changes
from valvemap.model.estimator import key_of
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.pipeline.alarms import Alarms
from valvemap.pipeline.kernels import lanes as kernel
from valvemap.pipeline.lane_failures import (
    CopyBuffer,
    LaneFailure,
    LaneFailures,
    Restore,
    Rows,
    Step,
    all_of,
    isolate,
    isolate_last,
    saved,
)
from valvemap.pipeline.lanes import Lanes, SharedRests, nothing_of
from valvemap.pipeline.places import Places, Ranking
from valvemap.pipeline.quality_gate import COUNTER_NAMES as OF_GATE
from valvemap.pipeline.quality_gate import GateState
from valvemap.pipeline.results import EstimatorResults
from valvemap.pipeline.shared_support import SharedSupport
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
from valvemap.vocabulary.statuses import Adaptation, Quality, Status

MISFIT_EVERY_NS = 10_000_000_000  # interval at which the adaptation status is polled: it is slow

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
    places : Places
        Errors at places that a valve visits again, and the ranking of its estimators by them.
    changes : int
        How often alarms were judged or a lane was stopped: publishing does so, too.
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
        self.waits = frozenset(waits) & plan.estimators.keys()
        self._names = [plan.name] * M if names is None else names
        self._failures = failures or LaneFailures()
        self._key = f"valve {key_of(plan.gate)}"
        self._keys = tuple((name, key_of(one)) for name, one in plan.estimators.items())
        self._gate = plan.gate.initial_state(M)
        self._support = SharedSupport(nothing_seen(plan), len(plan.estimators), M)
        self._lanes = {
            name: Lanes(estimator, M, SharedRests(self._support, number), plan.accuracy)
            for number, (name, estimator) in enumerate(plan.estimators.items())
        }
        references = [e for e, name in enumerate(plan.estimators) if name in plan.references]
        self.places = Places(len(plan.estimators), M, references)
        self._t = np.zeros(M, np.int64)
        self._T = np.full(M, np.nan)
        self._demand = np.full((M, 2), np.nan)  # Q, dp
        self.alarms = Alarms(M, plan.alarms, max(plan.map_Q) - min(plan.map_Q))
        names = [plan.inverse, *plan.estimators]
        self._finder = next((n for n in names if finds_changes(plan.estimators[n])), None)
        self._laggard = next((n for n in names if isinstance(plan.estimators[n], FindsLags)), None)
        self._finders = [n for n, one in plan.estimators.items() if isinstance(one, FindsCauses)]
        self._misfit_due = np.zeros(M, np.int64)
        self.changes = 0

    def take(self, samples: Samples, segments: Segments) -> tuple[Samples, Mapping[str, Trace]]:
        """Gate samples and update the estimators; return the gated samples and the traces.

        ``segments`` assigns the samples to valves by the fleet's numbers; none may be empty. If a
        step raises, all steps are repeated valve by valve. An error then stops the lane of the
        step, or, outside of any lane, the valve.
        """
        judged = samples
        traces: Mapping[str, Trace] = {name: nothing_of(len(samples)) for name in self._lanes}

        def take(rows: Rows) -> None:
            nonlocal judged, traces
            if len(rows) == len(segments.members):
                judged, traces = self._take(samples, segments)
                return
            if judged is samples:
                judged = replace(samples, quality=np.full_like(samples.quality, Quality.BAD))
            for k in rows:
                start, end = segments.starts[k], segments.stops[k]
                one = Segments.one(end - start)._replace(members=segments.members[k : k + 1])
                found, said = self._take(samples[start:end], one)
                judged.quality[start:end] = found.quality
                for name, trace in traces.items():
                    for f in fields(Trace):
                        getattr(trace, f.name)[start:end] = getattr(said[name], f.name)

        stop = partial(self.stop, None, Step.LEARNING)
        isolate(segments.members, take, self._saved, stop)
        return judged, traces

    def _take(self, samples: Samples, segments: Segments) -> tuple[Samples, Mapping[str, Trace]]:
        """Process samples in rounds: maps are compared at fixed numbers of samples of a valve."""
        stops = self._next_stops(segments)
        if (stops == segments.stops).all():
            return self._take_round(samples, segments)
        quality = samples.quality.copy()
        traces = {name: nothing_of(len(samples)) for name in self._lanes}
        left = segments
        while len(left.members):
            now = left._replace(stops=self._next_stops(left))
            rows = _rows_of(now, len(samples))
            found, said = self._take_round(samples[rows], now.among(rows))
            quality[rows] = found.quality
            for name, trace in traces.items():
                for f in fields(Trace):
                    getattr(trace, f.name)[rows] = getattr(said[name], f.name)
            left = left._replace(starts=now.stops).of(now.stops < left.stops)
        return replace(samples, quality=quality), traces

    def _next_stops(self, segments: Segments) -> Times:
        """Return the rows up to which the given valves' samples are processed at once."""
        ahead = self.places.due(segments.members)
        ahead[self.stopped()[segments.members]] = np.iinfo(np.int32).max
        return np.minimum(segments.stops, segments.starts + np.maximum(ahead, 1))

    def _take_round(
        self, samples: Samples, segments: Segments
    ) -> tuple[Samples, Mapping[str, Trace]]:
        judged = self._judged(samples, segments)
        traces, rests = {}, []
        for name, lanes in self._lanes.items():
            if name in self.waits:
                traces[name] = nothing_of(len(samples), Status.WARMING_UP)
                rests.append((traces[name].status, segments._replace(starts=segments.stops)))
                continue
            stop = partial(self.stop, name, Step.LEARNING)
            traces[name], own = lanes.take(judged, segments, self._restore[name], stop)
            rests.append((traces[name].status, own))
        self._support_from(judged, rests, segments)
        traces = self._compared(judged, traces, segments)
        running = segments.of(~self.stopped()[segments.members])
        self._t[running.members] = samples.t[running.stops - 1]
        kernel.last_T(judged.T, judged.quality, self._T, running)

        def watch(_: Rows) -> None:
            for name, own in self._by_inverse(running.members):
                self.alarms.watch(judged, traces[name], running.of(own))
            self._note(running.members)

        stop = partial(self.stop, None, Step.ALARMS)
        isolate_last(running.members, watch, self._restore[Step.ALARMS], stop)
        return judged, traces

    def _compared(
        self, judged: Samples, traces: Mapping[str, Trace], segments: Segments
    ) -> dict[str, Trace]:
        """Compare the estimators at the valves' places; return the traces with revised statuses."""
        running = segments.of(~self.stopped()[segments.members])
        residual = np.stack([trace.residual for trace in traces.values()])
        early = np.stack([trace.early for trace in traces.values()])
        status = np.stack([trace.status for trace in traces.values()])

        def compare(_: Rows) -> None:
            self.places.learn(judged, residual, early, status, running)

        stop = partial(self.stop, None, Step.COMPARISON)
        isolate_last(running.members, compare, self._restore[Step.COMPARISON], stop)
        for said, lanes in zip(status, self._lanes.values(), strict=True):
            lanes.revise(said, running)
        for m in running.members[self.places.due(running.members) <= 0]:
            look = partial(self._look_back, int(m))
            one = np.array([m])
            isolate_last(one, look, self.places.saved(one, self._buffer), stop)
        return {
            name: replace(trace, status=said)
            for (name, trace), said in zip(traces.items(), status, strict=True)
        }

    def _look_back(self, m: int, _: Rows) -> None:
        """Evaluate the maps of one valve at the places that it left, and rank them."""
        points, one = self.places.points(m), np.array([m])
        maps: list[tuple[Floats, Floats] | None] = []
        for name, lanes in self._lanes.items():
            maps.append(None)
            if lanes.failed[m] or name in self.waits:
                continue

            def evaluate(_: Rows, lanes: Lanes = lanes) -> None:
                maps[-1] = lanes.predicted(m, *points)

            stop = partial(self.stop, name, Step.COMPARISON)
            isolate(one, evaluate, _nothing_saved, stop)
        before = self.inverse(m)
        self.places.look_back(m, maps)
        if self.inverse(m) != before:
            self.alarms.forget_usual(m)

    def rank_now(self, m: int) -> Ranking:
        """Compare the newest maps of one valve before it is due; return the ranking."""
        if not self.stopped()[m]:
            stop = partial(self.stop, None, Step.COMPARISON)
            one = np.array([m])
            restore = self.places.saved(one, CopyBuffer())
            isolate_last(one, partial(self._look_back, m), restore, stop)
        return self.places.ranking(m)

    def inverse(self, m: int) -> str:
        """Name of the estimator whose map is inverted at one valve."""
        return self.inverses(np.array([m]))[0]

    def inverses(self, chosen: Times) -> list[str]:
        """As `inverse`, of the given valves (K,)."""
        names, plan = list(self._lanes), self.plan
        if not plan.follows:
            return [plan.inverse] * len(chosen)
        numbers = self.places.chosen(chosen).tolist()
        return [plan.inverse if number < 0 else names[number] for number in numbers]

    def _by_inverse(self, chosen: Times) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        """Yield each inverted estimator, and which of the given valves (K,) it is inverted at."""
        names = np.array(self.inverses(chosen))
        for name in dict.fromkeys(names.tolist()):
            yield name, names == name

    def stopped(self) -> NDArray[np.bool_]:
        """Mask (M,) of the valves whose lanes have all failed: their samples are not processed."""
        return np.asarray(np.all([lanes.failed for lanes in self._lanes.values()], axis=0))

    def has_failed(self, m: int, name: str) -> bool:
        """Whether a lane of one valve stopped at an error."""
        return bool(self._lanes[name].failed[m])

    def stop(self, name: str | None, step: Step, m: int, error: Exception) -> None:
        """Stop one lane of a valve, or (None) all of them, because of an error in a step.

        Lanes that stopped before are unchanged: an error is noted once.
        """
        lanes = self._lanes.values() if name is None else [self._lanes[name]]
        if all(one.failed[m] for one in lanes):
            return
        self.changes += 1
        for one in lanes:
            one.fail(m)
        failure = LaneFailure(self._names[m], name, step, error)
        self._failures.note(failure)
        self.alarms.note_failure(m, failure.reason, whole=name is None)
        self.show_stopped(m)

    def start_again(self, m: int) -> None:
        """Resume all lanes, if an error in a step of the whole valve has stopped them."""
        if self.alarms.stopped_whole(m):
            for lanes in self._lanes.values():
                lanes.start_again(m)
        self.show_stopped(m)

    def show_stopped(self, m: int) -> None:
        """Update the alarm with the number of stopped lanes."""
        count = sum(bool(lanes.failed[m]) for lanes in self._lanes.values())
        self.alarms.note_stopped(m, count, int(self._t[m]))

    def watch(self, chosen: Times, do: Callable[[Rows], None]) -> None:
        """Judge the alarms of the given valves (K,); ``do`` is called with rows of the K."""
        self.changes += 1
        running = np.flatnonzero(~self.stopped()[chosen])
        stop = partial(self.stop, None, Step.ALARMS)
        isolate(chosen[running], lambda rows: do(running[rows]), self._alarms_saved, stop)

    def _saved(self, members: Times) -> Restore:
        """Copy the state of the given valves; the result writes the copies back."""
        self._buffer.clear()
        buffer = self._buffer
        self._restore = {
            Step.GATE: saved(self._gate_arrays, members, buffer),
            Step.SUPPORT: self._support.saved(members, buffer),
            Step.COMPARISON: self.places.saved(members, buffer),
            Step.ALARMS: self._copy_alarms(members),
            **{name: lanes.saved(members, buffer) for name, lanes in self._lanes.items()},
        }
        times = saved((self._t, self._T), members, buffer)
        return all_of([times, *self._restore.values()])

    @property
    def _gate_arrays(self) -> tuple[NDArray[Any], ...]:
        return *self._gate.memory, self._gate.bad_status

    def _alarms_saved(self, members: Times) -> Restore:
        self._buffer.clear()
        return self._copy_alarms(members)

    def _copy_alarms(self, members: Times) -> Restore:
        due = saved([self._misfit_due], members, self._buffer)
        return all_of([self.alarms.saved(members, self._buffer), due])

    def _judged(self, samples: Samples, segments: Segments) -> Samples:
        """Return the gated samples; all samples of a stopped valve are BAD."""
        quality = np.full(len(samples), Quality.BAD, np.uint8)
        running = segments.of(~self.stopped()[segments.members])

        def judge(_: Rows) -> None:
            nonlocal quality
            found = self.plan.gate.judge(self._gate, samples, running).quality
            if len(running.members) == len(segments.members):
                quality = found
                return
            for _, start, stop in zip(*running, strict=True):
                quality[start:stop] = found[start:stop]

        stop_at = partial(self.stop, None, Step.GATE)
        isolate_last(running.members, judge, self._restore[Step.GATE], stop_at)
        return replace(samples, quality=quality)

    def _support_from(
        self, judged: Samples, rests: Sequence[tuple[Codes, Segments]], segments: Segments
    ) -> None:
        running = ~self.stopped()[segments.members]

        def learn(_: Rows) -> None:
            some = [(status, own.of(running)) for status, own in rests]
            self._support.learn(judged, some, segments.of(running))

        stop = partial(self.stop, None, Step.SUPPORT)
        isolate_last(segments.members[running], learn, self._restore[Step.SUPPORT], stop)

    def _note(self, chosen: Times) -> None:
        """Update the alarms with the estimators' latest changes, lags and adaptation status."""
        if self._finder is not None:
            found = self._lanes[self._finder].states.newest_changes(chosen)
            changes = found["count"], found["t"], found["size"]
            self.alarms.note_changes(chosen, *changes, weighed=self._finder in self._finders)
        if self._laggard is not None:
            self.alarms.note_lags(chosen, self._lanes[self._laggard].states.largest_lags(chosen))
        due = chosen[self._t[chosen] >= self._misfit_due[chosen]]
        if len(due):
            self._misfit_due[due] = self._t[due] + MISFIT_EVERY_NS
            for name, own in self._by_inverse(due):
                some, e = due[own], list(self._lanes).index(name)
                rmse = np.fmax(self._lanes[name].recent_rmse(some), self.places.errors(some, e))
                self.alarms.note_misfit(some, self._adaptations(some)[e], rmse)

    def lane(self, m: int, name: str) -> Lane:
        """Return one estimator of one valve."""
        errors = self.places.of(m, list(self._lanes).index(name))
        return replace(self._lanes[name].get(m), errors=errors)

    def places_to_bytes(self, m: int) -> bytes:
        """Pack the places of one valve."""
        return self.places.to_bytes(m, dict(self._keys))

    def places_from_bytes(self, m: int, data: bytes) -> None:
        """Unpack the places of one valve.

        Raises
        ------
        StateMismatchError
        """
        self.places.from_bytes(m, data, dict(self._keys))

    def findings(self, m: int) -> tuple[Finding, ...]:
        """Return the causes that the running estimators of one valve find, the likeliest first."""
        running = [name for name in self._finders if not self.has_failed(m, name)]
        return merged_findings(findings_of(self._lanes[name].get(m)) for name in running)

    def reset_errors(self, m: int, name: str) -> None:
        """Reset the errors of one estimator's map, after its reset."""
        self.places.reset(m, list(self._lanes).index(name))

    def accept(self, m: int, name: str) -> None:
        """Accept the restored map of one estimator: it is not warmed up again."""
        self.places.accept(m, list(self._lanes).index(name))

    def put(self, m: int, name: str, lane: Lane) -> None:
        """Replace a lane; its estimator must be the plan's, except for ``lam``."""
        self._lanes[name].put(m, lane)

    def state(self, m: int, names: Iterable[str] | None = None) -> ValveState:
        """Return the state of one valve, with the named estimators or with all."""
        one = slice(m, m + 1)
        return ValveState(
            gate=self._gate.of(one),
            lanes={name: self.lane(m, name) for name in names or self._lanes},
            t=int(self._t[m]),
            T=float(self._T[m]),
            demand_Q=float(self._demand[m, 0]),
            demand_dp=float(self._demand[m, 1]),
        )

    def remember(self, m: int, gate: GateState, t: int, T: float) -> None:
        """Restore one valve's gate, last sample time and last temperature."""
        self._gate.put(m, gate)
        self._t[m], self._T[m] = t, T

    def beyond(self, m: int) -> Mapping[str, int]:
        """Return, by estimator, the number of one valve's samples beyond its range."""
        return {name: int(lanes.beyond[m]) for name, lanes in self._lanes.items()}

    def count_beyond(self, m: int, name: str, count: int) -> None:
        """Restore that number for one estimator."""
        self._lanes[name].beyond[m] = count

    def results(self, chosen: Times) -> Mapping[str, EstimatorResults]:
        """Return the estimators' results of the given valves, without surveys."""
        found = zip(self._lanes.items(), self._adaptations(chosen), strict=True)
        return {
            name: replace(lanes.results(chosen), adaptation=codes) for (name, lanes), codes in found
        }

    def _adaptations(self, chosen: Times) -> list[Codes]:
        """Diagnoses of the estimators' residuals, each (K,), for the given valves.

        Where an estimator itself is undecided, its errors at places visited again decide.
        """
        fits = self.places.fits(chosen)
        own = [lanes.states.adaptations(chosen) for lanes in self._lanes.values()]
        return [
            np.where(said == Adaptation.UNDECIDED, fit, said).astype(np.uint8)
            for said, fit in zip(own, fits, strict=True)
        ]

    def unknown(self, m: int) -> Mapping[str, EstimatorResults]:
        """Return Bad results of one valve, for use when `results` raises."""
        return {name: lanes.unknown(m) for name, lanes in self._lanes.items()}

    def demands(self, chosen: Times) -> Floats:
        """Flow and pressure drop demanded of the given valves (K, 2); NaN without a demand."""
        return np.asarray(self._demand[chosen])

    def last_t(self, m: int) -> int:
        """Time of the newest sample of one valve, UTC ns."""
        return int(self._t[m])

    def last_T(self, m: int) -> float:
        """Last measured temperature of one valve, °C."""
        return float(self._T[m])

    def demand(self, m: int, Q: float, dp: float) -> None:
        """Set the standing demand of one valve."""
        self._demand[m] = Q, dp

    def columns(self, valves: Sequence[str]) -> list[Columns]:
        """Return the state of the valves as columns; call `take_up` after writing to them.

        Arrays with a row for each valve are returned themselves, the others are copies.
        """
        gate = {f"gate_{name}": array for name, array in self._gate.memory._asdict().items()}
        own = {"bad_status": self._gate.bad_status, "t": self._t, "T": self._T}
        names = tuple(valves)
        return [
            Columns(self._key, names, {**gate, **own, "demand": self._demand}),
            Columns("places", names, self.places.columns_of_valves()),
            Columns("alarms", names, {**self.alarms.columns(), "misfit_due": self._misfit_due}),
            *(
                lanes.columns(name, names, self.places.columns_of_lane(e))
                for e, (name, lanes) in enumerate(self._lanes.items())
            ),
        ]

    def take_up(self, written: Sequence[Columns]) -> None:
        """Update the fleet after the arrays of `columns` were written to."""
        of_lanes = written[len(written) - len(self._lanes) :]
        for lanes, columns in zip(self._lanes.values(), of_lanes, strict=True):
            lanes.take_up(columns.arrays)
        for m in range(len(self._t)):
            self.show_stopped(m)

    def rejections(self) -> Times:
        """Counts (M, reasons) since the start: rejections by gate and estimators, lane failures."""
        beyond = np.max([lanes.beyond for lanes in self._lanes.values()], axis=0)
        censored = np.max([lanes.censored() for lanes in self._lanes.values()], axis=0)
        failed = self.alarms.failures()
        return np.column_stack((self._gate.counts(), beyond, censored, failed))


def _nothing_saved(_: Times) -> Restore:
    """Return a restoration for a step that writes nothing."""
    return lambda: None


def _rows_of(segments: Segments, N: int) -> NDArray[np.bool_]:
    """Mask (N,) of the rows of all segments."""
    steps = np.zeros(N + 1, np.int64)
    np.add.at(steps, segments.starts, 1)
    np.add.at(steps, segments.stops, -1)
    return np.asarray(np.cumsum(steps[:-1]) > 0)
