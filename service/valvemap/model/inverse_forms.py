"""The inverse of one map at given parameters, by its form: affine in U, spline, or any other."""

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import Estimator, State
from valvemap.model.extrapolation import U_range_of
from valvemap.model.kernels import inverse as kernel
from valvemap.model.model_structures import Polynomial, Structure
from valvemap.model.monotone_search import search
from valvemap.model.samples import Codes, Floats
from valvemap.vocabulary.statuses import InverseStatus

U_MAX: Final = 100.0
ROUNDING: Final = 1e-12

S = TypeVar("S", bound=State)


@dataclass(frozen=True)
class Found:
    """U in [0, 100] or NaN, U unclipped, dQ/dU there, status; all (N,)."""

    U: Floats
    unclipped: Floats
    slope: Floats
    status: Codes


def theta_of(estimator: Estimator[S], state: S, structure: Structure) -> Floats:
    """Return the structure's parameters: an estimator may have more (a noise model)."""
    theta = np.asarray(estimator.parameters(state)[0], np.float64)
    if estimator.parameter_names == structure.parameter_names:
        return theta
    names = {name: place for place, name in enumerate(estimator.parameter_names)}
    return theta[[names[name] for name in structure.parameter_names]]


def invert_affine(structure: Polynomial, theta: Floats, Q: Floats, dp: Floats, T: Floats) -> Found:
    """Invert Q = closed + slope·U, which is valid only if slope = dQ/dU > 0."""
    with_U = structure.powers_of_U == 1
    one = np.ones_like(dp)
    terms = theta * structure.regressors(one, dp, T)
    closed, slope = terms[:, ~with_U].sum(axis=1), terms[:, with_U].sum(axis=1)
    unclipped = (Q - closed) / slope
    # Sizes of the terms at the point or at 100 bar; values below their rounding error are zero.
    sizes = np.abs(theta * structure.regressors(one, np.maximum(np.abs(dp), 100.0), T))
    size = sizes[:, ~with_U].sum(axis=1) + U_MAX * sizes[:, with_U].sum(axis=1)
    tolerance = ROUNDING * (size + np.abs(Q))
    plateau = U_MAX * np.abs(terms[:, with_U]).sum(axis=1) <= ROUNDING * size
    unclipped = np.where(plateau, np.sign(Q - closed) * np.inf, unclipped)
    delivers = plateau & (np.abs(Q - closed) <= tolerance)
    unclipped[delivers] = 0.0
    status = _select(
        (~np.isfinite(closed) | ~np.isfinite(slope), InverseStatus.UNIDENTIFIED),
        (delivers, InverseStatus.OK),
        (~plateau & (slope * U_MAX <= ROUNDING * size), InverseStatus.NOT_MONOTONE),
        (Q - closed > slope * U_MAX + tolerance, InverseStatus.ABOVE_REACH),
        (Q - closed < -tolerance, InverseStatus.BELOW_REACH),
    )
    return Found(np.clip(unclipped, 0.0, U_MAX), unclipped, slope, status)


def invert_spline(
    knots_U: Floats, knots_s: Floats, nodes: Floats, theta: Floats, Q: Floats, dp: Floats, T: Floats
) -> Found:
    """Invert a tensor spline with nodes of temperature by its compiled search."""
    U, unclipped, slope = np.empty_like(Q), np.empty_like(Q), np.empty_like(Q)
    status = np.empty(len(Q), np.uint8)
    theta = np.ascontiguousarray(theta)
    kernel.invert(knots_U, knots_s, nodes, theta, Q, dp, T, U, unclipped, slope, status)
    return Found(U, unclipped, slope, status)


def on_branch(found: Found, lag: Floats, reach: tuple[float, float]) -> Found:
    """Add the hysteresis lag (%) of the map to U, within its range."""
    led = found.unclipped + lag
    moved = (lag != 0.0) & (found.status <= InverseStatus.BELOW_REACH) & np.isfinite(led)
    above, below = led > reach[1], led < reach[0]
    status = _select((above, InverseStatus.ABOVE_REACH), (below, InverseStatus.BELOW_REACH))
    return Found(
        U=np.where(moved, np.clip(led, *reach), found.U),
        unclipped=np.where(moved, led, found.unclipped),
        slope=found.slope,
        status=np.where(moved, status, found.status).astype(np.uint8),
    )


def invert_by_search(estimator: Estimator[S], state: S, Q: Floats, dp: Floats, T: Floats) -> Found:
    """Invert any map by a safeguarded search."""

    def flow(U: Floats, points: NDArray[np.intp]) -> Floats:
        return estimator.predict(state, U, dp[points], T[points])[0]

    U, slope, status = search(flow, Q, U_range_of(estimator))
    # Outside the range, the tangent at its end estimates the distance of the demand.
    beyond = (Q - flow(np.nan_to_num(U), np.arange(len(Q)))) / slope
    outside = (status == InverseStatus.ABOVE_REACH) | (status == InverseStatus.BELOW_REACH)
    return Found(U, np.where(outside, U + beyond, U), slope, status)


def _select(*cases: tuple[NDArray[np.bool_], InverseStatus]) -> Codes:
    """Return the status of the first case that holds, OK if none does."""
    status = np.zeros(len(cases[0][0]), np.uint8)
    for holds, code in reversed(cases):
        status[holds] = code
    return status
