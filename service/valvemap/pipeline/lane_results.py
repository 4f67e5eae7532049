"""Results to publish of one estimator's lanes, as arrays over the given valves."""

import numpy as np

from valvemap.model.residual_spread import noise_std
from valvemap.model.samples import Codes, Floats, Times
from valvemap.pipeline.estimator_states import Listed, Stacked
from valvemap.pipeline.kernels.lanes import NO_STATUS, Notes
from valvemap.pipeline.results import EstimatorResults
from valvemap.pipeline.score import recent_rmse
from valvemap.vocabulary.statuses import Quality, Status

_QUALITY = np.zeros(max(Status) + 1, np.uint8)
for _status, _quality in {
    Status.OK: Quality.GOOD,
    Status.FROZEN: Quality.GOOD,
    Status.WARMING_UP: Quality.UNCERTAIN,
    Status.UNEXCITED: Quality.UNCERTAIN,
    Status.HELD: Quality.UNCERTAIN,
    Status.EXTRAPOLATING: Quality.UNCERTAIN,
    Status.UNRELIABLE: Quality.UNCERTAIN,
    Status.REJECTED: Quality.BAD,
    Status.FAILED: Quality.BAD,
}.items():
    _QUALITY[_status] = _quality


def results_of(
    states: Stacked | Listed,
    notes: Notes,
    scores: Floats,
    overall: Floats,
    chosen: Times,
    adaptation: Codes,
) -> EstimatorResults:
    """Return the results of the given valves.

    Parameters
    ----------
    states, notes
        States and last results of all lanes.
    scores, overall
        Sums of the scores (K, …) and overall spread of the residuals (K, …) of the given valves.
    chosen
        Numbers of the given valves (K,).
    adaptation
        The diagnoses of their residuals (K,).
    """
    said = notes.status[chosen]
    theta, std = states.parameters(chosen)
    status = np.where(said == NO_STATUS, Status.WARMING_UP, said).astype(np.uint8)
    return EstimatorResults(
        t=notes.t[chosen],
        quality=_QUALITY[status],
        theta=theta,
        std=std,
        predicted=notes.predicted[chosen],
        residual=notes.residual[chosen],
        residual_rmse=recent_rmse(scores),
        sample_count=notes.learnt[chosen],
        status=status,
        noise_std=noise_std(overall),
        survey=[None] * len(chosen),
        change=states.changes(chosen),
        structure=states.structures(chosen),
        lags=states.lags(chosen),
        adaptation=adaptation,
        systematic_std=np.full(len(chosen), np.nan),
    )


def unknown_results(notes: Notes, m: int, parameters: int) -> EstimatorResults:
    """Return Bad results of valve ``m``, whose estimator has this number of parameters."""
    nothing, t = np.full(1, np.nan), np.maximum(notes.t[m : m + 1], 1)
    return EstimatorResults(
        t=t,
        quality=np.full(1, Quality.BAD, np.uint8),
        theta=np.full((1, parameters), np.nan),
        std=np.full((1, parameters), np.nan),
        predicted=nothing,
        residual=nothing,
        residual_rmse=nothing,
        sample_count=notes.learnt[m : m + 1],
        status=np.full(1, Status.FAILED, np.uint8),
        noise_std=nothing,
        survey=[None],
        change=[None],
        structure=[None],
        lags=[None],
        adaptation=np.zeros(1, np.uint8),
        systematic_std=nothing,
    )
