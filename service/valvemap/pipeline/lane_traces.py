"""Traces of samples that a lane does not learn from. Pure."""

import numpy as np

from valvemap.model.samples import Floats, Samples, Trace
from valvemap.pipeline.valve_state import Lane
from valvemap.vocabulary.statuses import Quality, Status


def nothing_of(N: int, status: Status = Status.FAILED) -> Trace:
    """Return the trace of N samples in lanes that do not run."""
    predicted, residual, early = np.full((3, N), np.nan)
    return Trace(predicted, residual, early, np.full(N, status, np.uint8))


def prediction_only(lane: Lane, samples: Samples) -> Trace:
    """Return the trace of samples in a frozen lane."""
    Q_hat: Floats
    Q_hat, _ = lane.estimator.predict(lane.state, samples.U, samples.dp, samples.T)
    usable = samples.quality != Quality.BAD
    Q_hat = np.where(usable, Q_hat, np.nan)
    residual = samples.Q - Q_hat
    return Trace(
        predicted=Q_hat,
        residual=residual,
        early=residual,
        status=np.where(usable, Status.FROZEN, Status.REJECTED).astype(np.uint8),
    )
