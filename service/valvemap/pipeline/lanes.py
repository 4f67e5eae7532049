"""Lanes: one estimator on M valves, with its residuals' statistics and its maps' support.

Lanes that an operator froze or gave another ``lam`` are updated one valve at a time; all others in
one call.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.capabilities import Forgetful, PathDependent
from valvemap.model.estimator import State, key_of
from valvemap.model.extrapolation import ABOUT_DP, ABOUT_U, within_ranges
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.model.sensor_accuracy import SensorAccuracy
from valvemap.model.support import Support
from valvemap.pipeline.estimator_states import states_of
from valvemap.pipeline.kernels import lanes as kernel
from valvemap.pipeline.kernels import score as score_kernel
from valvemap.pipeline.kernels.lanes import NO_STATUS
from valvemap.pipeline.lane_failures import CopyBuffer, Restore, Rows, all_of, isolate_last, saved
from valvemap.pipeline.lane_results import results_of, unknown_results
from valvemap.pipeline.lane_traces import nothing_of, prediction_only
from valvemap.pipeline.map_errors import MapErrors
from valvemap.pipeline.results import EstimatorResults
from valvemap.pipeline.score import Score, recent_rmse
from valvemap.pipeline.shared_support import SharedRests
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_state import AnyEstimator, Lane, with_forgetting
from valvemap.vocabulary.statuses import Quality, Status


class Lanes:
    """One estimator on M valves.

    Parameters
    ----------
    estimator
        The plan's estimator.
    M
        Number of valves.
    rests
        Support of the maps: the cells in which their samples lie.
    accuracy
        Accuracy of the valves' sensors.
    """

    def __init__(
        self, estimator: AnyEstimator, M: int, rests: SharedRests, accuracy: SensorAccuracy
    ) -> None:
        self._estimator = estimator
        self.states = states_of(estimator, M)
        self._scores = np.tile(Score.none().sums, (M, 1))
        self._spread = ResidualSpread.none().of_many(M)
        self._rests = rests
        self._accuracy = accuracy
        self._key = key_of(_LaneKey(key_of(estimator), accuracy))
        self.beyond = np.zeros(M, np.int64)  # samples with U beyond the estimator's range
        self._frozen = np.zeros(M, bool)
        self._lam = np.full(M, np.nan)  # set by an operator; NaN: as configured
        self._notes = kernel.nothing(M)
        spread = self._spread
        arrays = (self._scores, spread.cells, spread.stamps, spread.ages, spread.overall)
        self._arrays = (*arrays, self.beyond, *self._notes)  # beside the states

    def take(
        self,
        samples: Samples,
        segments: Segments,
        restore: Restore,
        stop: Callable[[int, Exception], None],
    ) -> tuple[Trace, Segments]:
        """Update the lanes; return the trace, and the segments of samples in the present maps.

        Failed lanes are skipped. A lane whose update raises is undone by ``restore``, a result of
        `saved`, and ``stop`` is called with it.
        """
        running = ~self.failed[segments.members]
        learnt, starts = None, segments.starts.copy()

        def learn(_: Rows) -> None:
            nonlocal learnt
            learnt, rests = self._take(samples, segments.of(running))
            starts[running] = rests.starts

        isolate_last(segments.members[running], learn, restore, stop)
        trace: Trace = nothing_of(len(samples)) if learnt is None else learnt
        for _, start, end in zip(*segments.of(~running), strict=True):
            trace.put(slice(start, end), nothing_of(end - start))
        return trace, Segments(segments.members, starts, segments.stops)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Mask (M,) of the lanes that stopped at an error."""
        failed: NDArray[np.bool_] = self._notes.status == _FAILED
        return failed

    def fail(self, m: int) -> None:
        """Stop the lane of valve ``m``; its state remains."""
        self._notes.status[m] = Status.FAILED

    def start_again(self, m: int) -> None:
        """Resume a stopped lane from its last state."""
        if self.failed[m]:
            self._notes.status[m] = NO_STATUS

    def saved(self, members: Times, buffer: CopyBuffer) -> Restore:
        """Copy the state of the given valves' lanes; the result writes the copies back."""
        own = saved(self._arrays, members, buffer)
        return all_of([self.states.saved(members, buffer), own])

    def _take(self, samples: Samples, segments: Segments) -> tuple[Trace, Segments]:
        beyond, began = self._beyond_range(samples, segments), self.states.began()
        if beyond is None:
            trace = self._learn(samples, segments)
        else:
            quality = np.where(beyond, np.uint8(Quality.BAD), samples.quality)
            trace = self._learn(replace(samples, quality=quality), segments)
            trace.status[beyond] = Status.EXTRAPOLATING
        score_kernel.accumulate(trace.residual, samples.Q, self._scores, segments)
        self._spread.learn(samples, trace, segments)
        kernel.note(samples.t, trace.predicted, trace.residual, trace.status, self._notes, segments)
        return trace, self._of_this_map(began, trace.status, segments)

    def revise(self, status: Codes, segments: Segments) -> None:
        """Replace the published status of the newest samples of running lanes."""
        running = segments.of(~self.failed[segments.members])
        self._notes.status[running.members] = status[running.stops - 1]

    def predicted(self, m: int, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Return flow and standard deviation (N,) of one valve's map, as its estimator gives it."""
        lane = self.get(m)
        return lane.estimator.predict(lane.state, U, dp, T)

    def follows(self, m: int) -> bool:
        """Whether the estimator knows that the flow of one valve depends on earlier samples."""
        estimator = self._estimator
        return isinstance(estimator, PathDependent) and estimator.follows(self.states.view(m))

    def columns(
        self, name: str, valves: tuple[str, ...], beside: Mapping[str, NDArray[Any]]
    ) -> Columns:
        """Return the state of all lanes as named arrays over valves, with those ``beside``."""
        spread = self._spread
        return Columns(
            f"{name} {self._key}",
            valves,
            {
                **{f"state_{n}": array for n, array in self.states.columns().items()},
                **{f"note_{n}": array for n, array in self._notes._asdict().items()},
                "scores": self._scores,
                "cells": spread.cells,
                "stamps": spread.stamps,
                "ages": spread.ages,
                "overall": spread.overall,
                **self._rests.columns(),
                **beside,
                "beyond": self.beyond,
                "frozen": self._frozen,
                "lam": self._lam,
            },
        )

    def take_up(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore all lanes from the written arrays of `columns`."""
        self.states.take_up({n[6:]: a for n, a in arrays.items() if n.startswith("state_")})
        self._rests.take_up(arrays)
        for m in (np.isfinite(self._lam)).nonzero()[0].tolist():
            if not _allows(self._estimator, float(self._lam[m])):
                self._lam[m] = np.nan  # no longer permitted: use the configured value

    def recent_rmse(self, chosen: Times) -> Floats:
        """Return the root mean square of recent residuals of the given valves, l/min."""
        return recent_rmse(self._scores[chosen])

    def _beyond_range(self, samples: Samples, segments: Segments) -> NDArray[np.bool_] | None:
        """Mask the samples (N,) whose U or Δp is beyond the estimator's ranges; count them."""
        beyond = ~within_ranges(self._estimator, samples.U, samples.dp, ABOUT_U, ABOUT_DP)
        beyond &= samples.quality != Quality.BAD
        if not beyond.any():
            return None
        for m, start, stop in zip(*segments, strict=True):
            self.beyond[m] += beyond[start:stop].sum()
        return beyond

    def _of_this_map(self, before: Times, status: Codes, segments: Segments) -> Segments:
        """Return the segments of samples in the present maps; ``before``: `began` at the start.

        If a map has restarted since, its support is reset.
        """
        anew = ((self.states.began() != before)[segments.members]).nonzero()[0]
        if not len(anew):
            return segments
        starts, since = segments.starts.copy(), self.states.samples_since()
        for k in anew:
            m, stop = segments.members[k], segments.stops[k]
            learnt = starts[k] + (status[starts[k] : stop] <= Status.UNEXCITED).nonzero()[0]
            starts[k] = [*learnt, stop][len(learnt) - since[m]]
            self._rests.put(int(m), self._rests.one(int(m)).forgotten())
        return Segments(segments.members, starts, segments.stops)

    def _learn(self, samples: Samples, segments: Segments) -> Trace:
        own_way = self._frozen[segments.members] | np.isfinite(self._lam[segments.members])
        trace = self.states.update(samples, segments.of(~own_way))
        for m, start, stop in zip(*segments.of(own_way), strict=True):
            rows = slice(start, stop)
            trace.put(rows, self._take_own_way(int(m), samples[rows]))
        return trace

    def get(self, m: int, errors: MapErrors | None = None) -> Lane:
        """Return a copy of the lane of valve ``m``, with these errors of its map."""
        of_map = self._spread.one(m), self._rests.one(m)
        return self._lane(m, self.states.get(m), Score(self._scores[m].copy()), *of_map, errors)

    def view(self, m: int) -> Lane:
        """Return the lane of valve ``m``, not copied: the next samples change it."""
        of_map = self._spread.view(m), self._rests.view(m)
        return self._lane(m, self.states.view(m), Score(self._scores[m]), *of_map)

    def _lane(
        self,
        m: int,
        state: State,
        score: Score,
        spread: ResidualSpread,
        support: Support,
        errors: MapErrors | None = None,
    ) -> Lane:
        count, t, predicted, residual, status = (array[m] for array in self._notes)
        lane = Lane(
            estimator=self._estimator,
            state=state,
            score=score,
            spread=spread,
            support=support,
            accuracy=self._accuracy,
            frozen=bool(self._frozen[m]),
            count=int(count),
            t=int(t),
            predicted=float(predicted),
            residual=float(residual),
            status=None if status == NO_STATUS else Status(int(status)),
            errors=errors,
        )
        lam = float(self._lam[m])
        return lane if np.isnan(lam) else with_forgetting(lane, lam)

    def results(self, chosen: Times, adaptation: Codes) -> EstimatorResults:
        """Return the results of the given valves (K,), with these diagnoses of their residuals."""
        scores, overall = self._scores[chosen], self._spread.overall[chosen]
        return results_of(self.states, self._notes, scores, overall, chosen, adaptation)

    def unknown(self, m: int) -> EstimatorResults:
        """Return Bad results of valve ``m``, for use when `results` raises."""
        return unknown_results(self._notes, m, len(self._estimator.parameter_names))

    def put(self, m: int, lane: Lane) -> None:
        """Replace the lane of valve ``m``."""
        self.states.put(m, lane.state)
        self._scores[m] = lane.score.sums
        self._spread.put(m, lane.spread)
        self._rests.put(m, lane.support)
        self._frozen[m] = lane.frozen
        self._lam[m] = np.nan if lane.lam is None else lane.lam
        status = NO_STATUS if lane.status is None else int(lane.status)
        notes = self._notes
        notes.learnt[m], notes.t[m], notes.status[m] = lane.count, lane.t, status
        notes.predicted[m], notes.residual[m] = lane.predicted, lane.residual

    def _take_own_way(self, m: int, samples: Samples) -> Trace:
        lane = self.get(m)
        if lane.frozen:
            return prediction_only(lane, samples)
        state, trace = lane.estimator.update(lane.state, samples)
        self.states.put(m, state)
        return trace


@dataclass(frozen=True)
class _LaneKey:
    """The configuration that a lane's state is bound to."""

    estimator: str
    accuracy: SensorAccuracy


_FAILED = int(Status.FAILED)  # as a number: it is compared several times a batch


def _allows(estimator: AnyEstimator, lam: float) -> bool:
    """Whether the estimator accepts ``lam``."""
    if not isinstance(estimator, Forgetful):
        return False
    try:
        estimator.with_forgetting(lam)
    except ValueError:
        return False
    return True
