"""Flows that the map of a lane predicts, with intervals and statuses. Pure."""

import numpy as np

from valvemap.model.capabilities import PathDependent, ResidualStd
from valvemap.model.extrapolation import U_range_of, trusted
from valvemap.model.residual_spread import TWO_SIDED_95
from valvemap.model.samples import Codes, Floats, Samples
from valvemap.model.sensor_accuracy import systematic_std
from valvemap.pipeline.valve_state import Lane
from valvemap.vocabulary.statuses import Status


def predicted(lane: Lane, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats, Codes]:
    """Q, its standard deviation and the status at N points, all (N,).

    The standard deviation includes the sensors' systematic errors. The status is that of the
    estimator, or EXTRAPOLATING if no sample lies near.
    """
    Q, std, status = _as_measured(lane, U, dp, T)
    return Q, np.hypot(std, systematic(lane, U, dp, T)), status


def systematic(lane: Lane, U: Floats, dp: Floats, T: Floats) -> Floats:
    """Standard deviation of the flow due to sensor errors at N points, l/min (N,)."""
    if not lane.accuracy.is_stated:
        return np.zeros(len(U))

    def flow(*points: Floats) -> Floats:
        return lane.estimator.predict(lane.state, *points)[0]

    return systematic_std(lane.accuracy, flow, (U, dp, T), U_range_of(lane.estimator))


def _as_measured(lane: Lane, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats, Codes]:
    """As `predicted`, without the sensors' systematic errors."""
    Q, std = lane.estimator.predict(lane.state, U, dp, T)
    if lane.errors is not None:
        std = lane.errors.widened(std, U, dp, T)
    std, guessed = trusted(lane.estimator, lane.state, lane.support, (U, dp, T), Q, std)
    own = Status.WARMING_UP if lane.status is None else lane.status
    if own in (Status.WARMING_UP, Status.FAILED):  # these statuses take precedence
        guessed = np.zeros_like(guessed)
    return Q, std, np.where(guessed, np.uint8(Status.EXTRAPOLATING), np.uint8(own))


def predicted_measurement(
    lane: Lane, U: Floats, dp: Floats, T: Floats
) -> tuple[Floats, Floats, Codes]:
    """Q̂, half the 95 % interval of a new measurement, l/min, and status (N,); NaN if unknown.

    Assumes that the new measurement has the same systematic errors as the samples.
    """
    _, own = lane.estimator.predict(lane.state, U, dp, T)
    Q, std, status = _as_measured(lane, U, dp, T)
    with np.errstate(invalid="ignore"):
        beyond = np.where(status == Status.EXTRAPOLATING, np.maximum(std**2 - own**2, 0.0), 0.0)
        # the spread of the residuals includes the misfit, and a std that is taken from them
        known = 0.0 * own if isinstance(lane.estimator, ResidualStd) else own
        half = lane.spread.half_width(U, dp, np.sqrt(known**2 + beyond))
    if isinstance(lane.estimator, PathDependent):  # U may come from either side
        up, down = (
            lane.estimator.predict_along(lane.state, U, dp, T, np.full_like(U, side))[0]
            for side in (1.0, -1.0)
        )
        half = np.hypot(half, TWO_SIDED_95 * (up - down) / 2.0)
    return Q, half, status


def predicted_along(lane: Lane, samples: Samples) -> Floats:
    """Q̂ (N,) along a path of samples, without an update; hysteresis follows the path."""
    U, dp, T = samples.U, samples.dp, samples.T
    if isinstance(lane.estimator, PathDependent):
        directions = lane.estimator.directions(lane.state, U)
        Q, _ = lane.estimator.predict_along(lane.state, U, dp, T, directions)
    else:
        Q, _ = lane.estimator.predict(lane.state, U, dp, T)
    return Q
