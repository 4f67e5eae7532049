"""Recursive least squares over arrays of regressors, without samples or signals."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from valvemap.model.forgetting import (
    Adaptive,
    Exponential,
    Forgetting,
)
from valvemap.model.kernels.change_detection import FEWEST_BETWEEN
from valvemap.model.kernels.row_layout import CHANGES
from valvemap.model.least_squares_answers import (
    parameter_covariance,
)
from valvemap.model.least_squares_learning import learn
from valvemap.model.least_squares_state import initial_state
from valvemap.model.place_grid import grid_of_rows
from valvemap.model.samples import Codes, Floats


@dataclass(frozen=True)
class RlsResult:
    """Result of :func:`recursive_least_squares` over N samples with n regressors.

    Attributes
    ----------
    theta : (n,)
        Parameters after the last sample.
    theta_history : (N, n)
        Parameters after each sample; 0 in undetermined directions.
    innovations : (N,)
        y - Xᵀtheta before each sample; NaN where earlier samples do not determine Xᵀtheta.
    covariance : (n, n)
        Covariance of theta (σ² estimated from the innovations); NaN while not determined.
    status : (N,)
        :class:`~valvemap.vocabulary.statuses.Status`.
    changes : (C, 3)
        A row per detected change of the plant (`Adaptive` only): sample of the alarm, first sample
        after the change as estimated, mean innovation from there to the alarm.
    """

    theta: Floats
    theta_history: Floats
    innovations: Floats
    covariance: Floats
    status: Codes
    changes: Floats


def recursive_least_squares(
    X: ArrayLike, y: ArrayLike, forgetting: float | Forgetting = 1.0, p0: float = np.inf
) -> RlsResult:
    """Recursive least squares over arrays, sample by sample.

    Parameters
    ----------
    X : (N, n)
        Regressors.
    y : (N,)
        Output.
    forgetting
        λ of exponential forgetting, or a rule of :mod:`valvemap.model.forgetting`.
    p0
        P(0) = p0·I; infinite: exact least squares from the first samples on.

    Raises
    ------
    ValueError
        if shapes do not fit, or λ or p0 is out of range.

    Examples
    --------
    >>> recursive_least_squares([[1, 0], [1, 1], [1, 2], [1, 3]], [1, 3, 5, 7]).theta.round(9)
    array([1., 2.])
    """
    regressors = np.ascontiguousarray(X, dtype=np.float64)
    output = np.ascontiguousarray(y, dtype=np.float64)
    if regressors.ndim != 2 or output.shape != regressors.shape[:1]:
        raise ValueError(
            f"X {regressors.shape} and y {output.shape} do not fit: (N, n) and (N,) are wanted"
        )
    rule = forgetting if isinstance(forgetting, Forgetting) else Exponential(float(forgetting))
    if not p0 > 0.0:
        raise ValueError(f"p0 = {p0!r} is not positive")
    N, n = regressors.shape
    state = initial_state(n, rule, p0)
    thetas, changes = np.empty((N, n)), np.empty((N // FEWEST_BETWEEN + 1, 3))
    usable, grid = np.ones(N, np.uint8), None
    if isinstance(rule, Adaptive):
        grid = grid_of_rows(regressors)
    state, trace = learn(
        state, rule, regressors, output, np.arange(N), usable, thetas, changes, grid
    )
    return RlsResult(
        theta=state.theta,
        theta_history=thetas,
        innovations=trace.residual,
        covariance=parameter_covariance(state, rule),
        status=trace.status,
        changes=changes[: state.counters[CHANGES]],
    )
