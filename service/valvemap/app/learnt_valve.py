"""One valve of a replay: its pipeline, and what its estimators have learnt."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from valvemap.app.recording_batches import name_of
from valvemap.errors import RecordingError
from valvemap.model.forgetting import Exponential
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples, Segments, Trace
from valvemap.pipeline.edges import LEAK
from valvemap.pipeline.fleet import COUNTER_NAMES, Fleet
from valvemap.pipeline.lane_failures import LaneFailures
from valvemap.pipeline.plausibility import Kind, Plausibility, refuse
from valvemap.pipeline.recommendation import Recommendation, recommendation
from valvemap.pipeline.results import EstimatorResults
from valvemap.pipeline.valve_state import ValvePlan, ValveState
from valvemap.runtime.failure_log import log_failure

BEST_FIT = "eq. (7), batch LSM"


class LearntValve:
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
                    f"{name_of(recording)}: valve {self.plan.name}: {finding.sentence}; --insist "
                    "(insist=True in Python) learns from it all the same"
                )
        return samples if self.plan.insist else refuse(samples, refused)

    def hints(self) -> tuple[str, ...]:
        """Return the findings on plausibility, one sentence each."""
        return tuple(finding.sentence for finding in self._plausibility.findings(0))

    def rejected(self) -> Mapping[str, int]:
        """Return the number of rejected samples by reason."""
        counts = self._fleet.rejections(np.zeros(1, np.int64))[0].tolist()
        return {name: n for name, n in zip(COUNTER_NAMES, counts, strict=True) if n}

    def learn(self, samples: Samples) -> tuple[Samples, Mapping[str, Trace]]:
        """Update the estimators; return the samples as gated, and each estimator's trace."""
        if len(samples) == 0:
            return samples, {}
        self.last = samples
        found = self._fleet.take(samples, Segments.one(len(samples)))
        for failure in self._failures.take_new():
            log_failure(failure)
        return found

    def results(self) -> Mapping[str, EstimatorResults]:
        """Return the results of each estimator."""
        return self._fleet.results(np.zeros(1, np.int64))

    def state(self) -> ValveState:
        """Return the state of the valve."""
        return self._fleet.state(0)

    def rank(self) -> tuple[Mapping[str, float], Recommendation]:
        """Return each estimator's error at places visited again, and the recommended one."""
        ranking, names = self._fleet.maps.rank_now(0), list(self.plan.estimators)
        errors = np.where(np.isfinite(ranking.errors), ranking.errors, np.nan)
        found = recommendation(ranking, names, self._fleet.maps.inverse(0))
        return dict(zip(names, errors.tolist(), strict=True)), found

    def beyond_range(self) -> Mapping[str, int]:
        """Return the number of samples with U or Δp outside each estimator's range."""
        return self._fleet.lanes.beyond(0)
