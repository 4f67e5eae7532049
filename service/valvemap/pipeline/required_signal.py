"""The inverse of a valve: the signal U for a demanded flow. Pure."""

from typing import NamedTuple

import numpy as np

from valvemap.model.capabilities import PathDependent
from valvemap.model.inverse_map import inverse_table, invert
from valvemap.model.inversion import Inversion
from valvemap.model.lead import led
from valvemap.model.samples import Floats
from valvemap.pipeline.valve_state import ValvePlan, ValveState
from valvemap.vocabulary.statuses import DELIVERS, InverseStatus


def inverse_map(plan: ValvePlan, state: ValveState) -> Floats:
    """The inverse as a table (len(map_Q), len(map_dp)), %, at the last temperature."""
    lane = state.lanes[plan.inverse]
    axes = np.array(plan.map_Q), np.array(plan.map_dp)
    return inverse_table(lane.estimator, lane.state, *axes, state.T)


class Required(NamedTuple):
    """The answer to a standing demand: U and its 95 % interval, %, and the status."""

    U: float
    lower: float
    upper: float
    status: InverseStatus

    @property
    def width(self) -> float:
        """Width of the interval, %."""
        return self.upper - self.lower


NOTHING_REQUIRED = Required(np.nan, np.nan, np.nan, InverseStatus.NOT_FINITE)


def required(plan: ValvePlan, state: ValveState, advance: float = 0.0) -> Required:
    """Return U for the standing demand, approached so that hysteresis is passed through.

    ``advance`` (l/min) is added to the demanded flow, as far as the answers deliver up to there.
    """
    if np.isnan(state.demand_Q) or np.isnan(state.demand_dp):
        return NOTHING_REQUIRED
    answer = led(
        lambda Q: demanded(plan, state, Q, state.demand_dp, np.nan),
        state.demand_Q,
        advance,
        lambda found: found.status[0] in DELIVERS,
    )
    lane, U = state.lanes[plan.inverse], answer.U
    moving = answer.status[0] in DELIVERS and not lane.frozen
    if moving and isinstance(lane.estimator, PathDependent):
        U = lane.estimator.approached(lane.state, U)
    shift = float(U[0] - answer.U[0])
    lower, upper = float(answer.lower[0]) + shift, float(answer.upper[0]) + shift
    return Required(float(U[0]), lower, upper, InverseStatus(int(answer.status[0])))


def demanded(plan: ValvePlan, state: ValveState, Q: float, dp: float, T: float) -> Inversion:
    """Return U for one demand; if T is NaN, at the last measured temperature."""
    lane = state.lanes[plan.inverse]
    T = state.T if np.isnan(T) else T
    return invert(
        *(lane.estimator, lane.state, [Q], [dp], [T]),
        support=lane.support,
        accuracy=lane.accuracy,
        widened=None if lane.errors is None else lane.errors.widened,
    )
