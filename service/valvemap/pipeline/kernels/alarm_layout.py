"""The state of alarms, and the statistics that they are judged by, as the kernels' arrays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Flags, Floats, Times

# Alarms of a valve, numbered as `pipeline.alarm_rules.Alarm`; those that are judged here.
RESIDUAL, SENSOR_LOST, SENSOR_FROZEN, UNEXCITED = 1, 3, 4, 5

CELLS_U, CELLS_S = 10, 12  # in which residuals are compared
DIRECTIONS, CAUSES = 5, 6  # regressors of causes in the residual; possible causes, with none

# Indices into `Senses.memory` and `Senses.times`.
CELL, KNOWN, BLOCK_SUM, BLOCK_N, RECENT, RECENT_N, USUAL, USUAL_N, T_USUAL, Q_BEFORE = range(10)
SQUARES, RATIO, LOST, TAKEN, LOST_BEFORE, TAKEN_BEFORE, CHANGES_SEEN = range(10, 17)
USUAL_SQUARE, USUAL_SQUARE_N, LAG_BEFORE, MEMORY = range(17, 21)
NEWEST, USABLE, EXCITED, LOSS_TIME, LARGE_SINCE, LARGE_UNTIL, TIMES = range(7)
NEVER = np.iinfo(np.int64).min


class Conditions(NamedTuple):
    """State of A alarms of each of M valves, (M, A) unless stated otherwise.

    ``over`` is the time from which the limit is exceeded, 0 if it is not; ``since`` the start of
    the last activation, ``at`` its last activation, deactivation or acknowledgement, both UTC ns;
    ``value`` the largest value during it; ``detail`` (M, A, 2) and ``causes`` (M, A, 3) describe
    it; ``came`` counts activations; ``version`` (M,) counts changes of any alarm. ``at`` never
    decreases: clocks of service and source differ, and samples arrive late.
    """

    over: Times
    since: Times
    at: Times
    active: Flags
    acked: Flags
    value: Floats
    detail: Floats
    causes: NDArray[np.uint8]
    came: Times
    version: Times


class Senses(NamedTuple):
    """Statistics of M valves by which their alarms are judged.

    ``last``, ``still``, ``longest``, ``moves``, ``others`` (M, 5): each signal's value, time of its
    last change, longest standstill (ns), number of changes, and number of changes of the others
    since its last. ``weight``, ``bias``, ``square`` (M, 120): number of samples in each cell, mean
    and mean square of the residuals there, l/min. ``sums`` (M, 6, 6): sums of products of the
    regressors and, last, the residual.
    """

    last: Floats
    still: Times
    longest: Times
    moves: Times
    others: Times
    weight: NDArray[np.float32]
    bias: NDArray[np.float32]
    square: NDArray[np.float32]
    sums: Floats
    memory: Floats
    times: Times


class Watched(NamedTuple):
    """N gated samples, and the estimator's trace of them, all (N,) but ``values`` (N, COUNT)."""

    t: Times
    values: Floats
    quality: NDArray[np.uint8]
    predicted: Floats
    residual: Floats
    status: NDArray[np.uint8]
