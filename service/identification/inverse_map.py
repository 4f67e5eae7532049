"""The inverse map U = f(Q, dp[, T]): closed form for eq. (7), a safeguarded search otherwise.

The printed inverse of eq. (7), U = (Q - a1 - a3·s - a5·s²)/(a2 + a4·s), is singular at s = -a2/a4
and turns round behind it; here a status says so, and U never leaves [0, 100] %.
"""

from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.identification.estimator import Estimator, State
from service.identification.inversion import InverseStatus, Inversion
from service.identification.model_structures import FiveTerms
from service.identification.monotone_search import search
from service.identification.samples import Codes, Floats

U_MAX: Final = 100.0
TWO_SIDED_95: Final = 1.959963984540054
ROUNDING: Final = 1e-12

S = TypeVar("S", bound=State)


@runtime_checkable
class Chooser(Protocol):
    """An estimator that lets the best of several speak for it."""

    def chosen(self, state: Any) -> tuple[Estimator[Any], Any]:  # noqa: ANN401 - any estimator
        """Name the estimator that speaks now, and its state."""


def invert(
    estimator: Estimator[S], state: S, Q: ArrayLike, dp: ArrayLike, T: ArrayLike
) -> Inversion:
    """Control voltage that delivers the demanded flow, at N points at once.

    Parameters
    ----------
    estimator, state
        Whose map is inverted. Eq. (7) has a closed form; any other map is searched through
        ``estimator.predict``.
    Q, dp, T : (N,) or scalar
        Demanded flow in l/min, pressure drop in bar, oil temperature in °C (NaN where unknown:
        harmless to a map that does not depend on it).

    Returns
    -------
    Inversion
        U, its 95 % interval by the delta method (std of Q̂ over dQ/dU) and the status. On a
        plateau U is the smallest that delivers Q; where the map rises, falls and rises again it is
        the smallest on a rising branch.
    """
    if isinstance(estimator, Chooser):
        return invert(*estimator.chosen(state), Q, dp, T)
    given = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in (Q, dp, T)))
    finite = np.isfinite(given[0]) & np.isfinite(given[1])
    demand, drop = (np.where(finite, x, 0.0) for x in given[:2])
    temperature = np.ascontiguousarray(given[2])
    with np.errstate(all="ignore"):
        match getattr(estimator, "structure", None):
            case FiveTerms() as structure:
                theta = _theta_of(estimator, state, structure)
                found = _invert_five_terms(theta, demand, drop)
            case _:
                found = _search(estimator, state, demand, drop, temperature)
        predicted, std = estimator.predict(state, np.nan_to_num(found.U), drop, temperature)
        lacking = np.isnan(predicted) & ~np.isfinite(temperature)
        if lacking.any():  # is it the missing temperature, or is the map not identified?
            lacking[lacking] = np.isfinite(
                _predict_at_any_temperature(estimator, state, drop[lacking])
            )
        return _answer(found, std, finite & ~lacking)


def inverse_table(
    estimator: Estimator[S], state: S, Q_axis: ArrayLike, dp_axis: ArrayLike, T: float
) -> Floats:
    """U in % over two axes, shape (len(Q_axis), len(dp_axis)); NaN where Q is not deliverable."""
    Q, dp = np.meshgrid(
        np.asarray(Q_axis, np.float64), np.asarray(dp_axis, np.float64), indexing="ij"
    )
    answer = invert(estimator, state, Q.ravel(), dp.ravel(), T)
    return np.where(answer.status == InverseStatus.OK, answer.U, np.nan).reshape(Q.shape)


@dataclass(frozen=True)
class _Found:
    """U in [0, 100] or NaN, U unclipped, dQ/dU there, status; all (N,)."""

    U: Floats
    unclipped: Floats
    slope: Floats
    status: Codes


def _theta_of(estimator: Estimator[S], state: S, structure: FiveTerms) -> Floats:
    """Pick the structure's own parameters: an estimator may have more (a noise model)."""
    theta = np.asarray(estimator.parameters(state)[0], np.float64)
    names = estimator.parameter_names
    return theta[[names.index(name) for name in structure.parameter_names]]


def _invert_five_terms(theta: Floats, Q: Floats, dp: Floats) -> _Found:
    """Invert eq. (7) in closed form, which holds where dQ/dU = a2 + a4·s > 0 alone."""
    a1, a2, a3, a4, a5 = theta
    s = np.copysign(np.sqrt(np.abs(dp)), dp)
    closed = a1 + a3 * s + a5 * dp
    slope = a2 + a4 * s
    unclipped = (Q - closed) / slope
    # Sizes of the terms at the point or at 100 bar: what is smaller than their rounding is zero.
    reach = np.maximum(np.abs(s), 10.0)
    size = abs(a1) + U_MAX * abs(a2) + reach * (abs(a3) + U_MAX * abs(a4)) + abs(a5) * reach**2
    tolerance = ROUNDING * (size + np.abs(Q))
    plateau = U_MAX * (np.abs(a2) + np.abs(a4 * s)) <= ROUNDING * size
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
    return _Found(np.clip(unclipped, 0.0, U_MAX), unclipped, slope, status)


def _search(estimator: Estimator[S], state: S, Q: Floats, dp: Floats, T: Floats) -> _Found:
    def flow(U: Floats, points: NDArray[np.intp]) -> Floats:
        return estimator.predict(state, U, dp[points], T[points])[0]

    U, slope, status = search(flow, Q)
    # Out of reach, the tangent at the end tells how far the demand lies behind it.
    beyond = (Q - flow(np.nan_to_num(U), np.arange(len(Q)))) / slope
    outside = (status == InverseStatus.ABOVE_REACH) | (status == InverseStatus.BELOW_REACH)
    return _Found(U, np.where(outside, U + beyond, U), slope, status)


def _predict_at_any_temperature(estimator: Estimator[S], state: S, dp: Floats) -> Floats:
    return estimator.predict(state, np.zeros_like(dp), dp, np.full_like(dp, 40.0))[0]


def _select(*cases: tuple[NDArray[np.bool_], InverseStatus]) -> Codes:
    """Status of the first case that holds, OK where none does."""
    conditions, codes = zip(*cases, strict=True)
    return np.asarray(np.select(conditions, codes, InverseStatus.OK), np.uint8)


def _answer(found: _Found, std: Floats, finite: NDArray[np.bool_]) -> Inversion:
    unknown = (found.status == InverseStatus.UNIDENTIFIED) | np.isinf(std)
    status = np.where(unknown, InverseStatus.UNIDENTIFIED, found.status)
    status = np.where(~finite, InverseStatus.NOT_FINITE, status).astype(np.uint8)
    given = status <= InverseStatus.BELOW_REACH
    U = np.where(given, found.U + 0.0, np.nan)
    half = TWO_SIDED_95 * std / found.slope
    known = given & np.isfinite(std)
    flat = known & ~(np.isfinite(found.unclipped) & np.isfinite(half) & (found.slope > 0.0))
    lower = np.where(flat, 0.0, np.clip(found.unclipped - half, 0.0, U_MAX))
    upper = np.where(flat, U_MAX, np.clip(found.unclipped + half, 0.0, U_MAX))
    return Inversion(
        U=U,
        lower=np.where(known, lower, np.nan),
        upper=np.where(known, upper, np.nan),
        status=status,
    )
