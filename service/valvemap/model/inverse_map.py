"""The inverse map U = f(Q, dp[, T]): closed form for eq. (7), a safeguarded search otherwise.

The published inverse of eq. (7), U = (Q - a1 - a3·s - a5·s²)/(a2 + a4·s), is singular at
s = -a2/a4 and has the wrong sign beyond. Here a status reports that, and U stays within [0, 100] %.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valvemap.model.capabilities import Invertible, MeasuresNoise, PathDependent
from valvemap.model.estimator import Estimator, State
from valvemap.model.extrapolation import U_range_of, is_eq7, trusted
from valvemap.model.inverse_forms import (
    U_MAX,
    Found,
    invert_affine,
    invert_by_search,
    invert_spline,
    on_branch,
    theta_of,
)
from valvemap.model.inversion import Inversion
from valvemap.model.kernels import inverse as kernel
from valvemap.model.linear_map import LinearMap
from valvemap.model.model_structures import Polynomial
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats
from valvemap.model.sensor_accuracy import EXACT, SensorAccuracy, systematic_std
from valvemap.model.support import Support
from valvemap.model.tensor_spline import TensorSpline
from valvemap.vocabulary.statuses import DELIVERS, InverseStatus

T_REFERENCE: Final = 40.0  # °C; stands in for a temperature that is missing
TWO_SIDED_95: Final = 1.959963984540054
CERTAIN_NOISE: Final = 3.0  # standard deviations of the meter's noise
CERTAIN_SHARE: Final = 5e-3  # of the largest flow, for meters with hardly any noise
LEVELS, CHUNK = 41, 256  # levels of U for an uncertain answer; answers processed together

S = TypeVar("S", bound=State)

Flags = NDArray[np.bool_]
Widening = Callable[[Floats, Floats, Floats, Floats], Floats]  # std of Q̂ at U, dp, T


def invert(
    estimator: Estimator[S],
    state: S,
    Q: ArrayLike,
    dp: ArrayLike,
    T: ArrayLike,
    direction: ArrayLike = 0.0,
    support: Support | None = None,
    accuracy: SensorAccuracy = EXACT,
    widened: Widening | None = None,
) -> Inversion:
    """Return the control voltage that delivers the demanded flow, at N points.

    Parameters
    ----------
    estimator, state
        Estimator and state of the map. Eq. (7), and any polynomial of first order in U, has a
        closed form; a spline is solved cubic by cubic; any other map is searched with ``predict``.
    Q, dp, T : (N,) or scalar
        Demanded flow in l/min, pressure drop in bar, oil temperature in °C (NaN if unknown, which
        has no effect on a map without T).
    direction : (N,) or scalar
        Direction of U's approach, if the map has a hysteresis: 1 from below, -1 from above, 0 in
        the middle of the loop. Other maps ignore it.
    support
        Region of the samples. Outside it, the interval grows with the distance from the samples,
        and the status is EXTRAPOLATING. None: no extrapolation check.
    accuracy
        Systematic errors of the sensors, which are part of the interval.
    widened
        The standard deviation of Q̂ from the estimator's, if its errors are known to be larger.

    Returns
    -------
    Inversion
        U, its 95 % interval by the delta method (std of Q̂ over dQ/dU) and the status. On a
        plateau U is the smallest that delivers Q; where the map rises, falls and rises again it is
        the smallest on a rising branch. Its status is UNCERTAIN if half the 95 % interval of Q̂
        exceeds both `CERTAIN_NOISE` and `CERTAIN_SHARE`; systematic errors do not count.
    """
    given = np.broadcast_arrays(*(np.atleast_1d(np.asarray(x, np.float64)) for x in (Q, dp, T)))
    finite = np.isfinite(given[0]) & np.isfinite(given[1])
    demand, drop = (np.where(finite, x, 0.0) for x in given[:2])
    temperature = np.ascontiguousarray(given[2])
    with np.errstate(all="ignore"):
        structure = getattr(estimator, "structure", None)
        match structure:
            case Polynomial() if structure.is_affine_in_U:
                theta = theta_of(estimator, state, structure)
                found = invert_affine(structure, theta, demand, drop, temperature)
            case TensorSpline() if (structure.U[0], structure.U[-1]) == (0.0, U_MAX):
                theta = structure.coefficients(theta_of(estimator, state, structure))
                nodes = np.array(structure.T, np.float64)
                found = invert_spline(*structure.knots, nodes, theta, demand, drop, temperature)
            case _ if isinstance(estimator, Invertible):
                found = Found(*estimator.inverted(state, demand, drop, temperature))
            case _:
                found = invert_by_search(estimator, state, demand, drop, temperature)
        if isinstance(estimator, PathDependent):
            lag = estimator.half_play(state) * np.asarray(direction, np.float64)
            found = on_branch(found, np.broadcast_to(lag, demand.shape), U_range_of(estimator))
        points = np.nan_to_num(found.U), drop, temperature
        std, lacking = _spread(estimator, state, *points)
        std = std if widened is None else widened(std, *points)
        off = _systematic(estimator, state, accuracy, points)
        if support is None:
            badly_known = _unknown_flow(estimator, state, std, 0.0)
            answer = _answer(found, np.hypot(std, off), finite & ~lacking, U_range_of(estimator))
            return _uncertain(answer, badly_known)
        std, guessed = trusted(estimator, state, support, points, demand, std)
        unknown = guessed & np.isinf(std)
        if unknown.any() and np.isfinite(estimator.parameters(state)[0]).any():
            std = np.where(unknown, support.Q_max, std)  # unknown here, known elsewhere
        badly_known = _unknown_flow(estimator, state, std, support.Q_max)
        answer = _answer(found, np.hypot(std, off), finite & ~lacking, U_range_of(estimator))
        has_U = answer.status <= InverseStatus.BELOW_REACH
        status = np.where(guessed & has_U, np.uint8(InverseStatus.EXTRAPOLATING), answer.status)
        answer = _uncertain(replace(answer, status=status), badly_known)
        bent = is_eq7(estimator, state) and support.is_eq7_refuted
        doubtful = (has_U & (guessed | bent)).nonzero()[0]
        given = demand, drop, temperature
        return _widened(estimator, state, (support, accuracy, widened), given, answer, doubtful)


def inverse_table(
    estimator: Estimator[S], state: S, Q_axis: ArrayLike, dp_axis: ArrayLike, T: float
) -> Floats:
    """U in % over two axes, shape (len(Q_axis), len(dp_axis)); NaN where Q is not deliverable."""
    Q, dp = np.asarray(Q_axis, np.float64), np.asarray(dp_axis, np.float64)
    answer = invert(estimator, state, np.repeat(Q, len(dp)), np.tile(dp, len(Q)), T)
    return np.where(_DELIVERS[answer.status], answer.U, np.nan).reshape(len(Q), len(dp))


_DELIVERS = np.array([status in DELIVERS for status in range(max(InverseStatus) + 1)])


def _spread(
    estimator: Estimator[S], state: S, U: Floats, dp: Floats, T: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Standard deviation of Q̂, infinite where unknown, and whether T is missing there."""
    match estimator, getattr(estimator, "structure", None):
        case RecursiveLeastSquares() | LinearMap(), TensorSpline() as structure if (
            not structure.T or np.isfinite(T).all()
        ):
            covariance = np.ascontiguousarray(estimator.covariance(state))
            nodes, variance = np.array(structure.T, np.float64), np.empty_like(U)
            kernel.variances(
                *structure.knots, nodes, covariance, structure.held, U, dp, T, variance
            )
            return np.sqrt(variance), np.zeros(len(U), np.bool_)
        case _:
            predicted, std = estimator.predict(state, U, dp, T)
            unknown = np.isnan(predicted)
            lacking = unknown & ~np.isfinite(T)
            if lacking.any():  # is the temperature missing, or is the map not identified?
                at, warm = dp[lacking], np.full(int(lacking.sum()), T_REFERENCE)
                lacking[lacking] = np.isfinite(estimator.predict(state, 0.0 * at, at, warm)[0])
            return np.where(unknown, np.inf, std), lacking


def _systematic(
    estimator: Estimator[S],
    state: S,
    accuracy: SensorAccuracy,
    points: tuple[Floats, Floats, Floats],
) -> Floats:
    """Effect of the sensors' systematic errors on the flow (N,), l/min."""
    if not accuracy.is_stated:
        return np.zeros(len(points[0]))

    def flow(U: Floats, dp: Floats, T: Floats) -> Floats:
        return estimator.predict(state, U, dp, T)[0]

    return systematic_std(accuracy, flow, points, U_range_of(estimator))


def _unknown_flow(estimator: Estimator[S], state: S, std: Floats, Q_max: float) -> Flags:
    """Whether the flow is known too badly to call an answer OK, as far as the noise is known."""
    if not isinstance(estimator, MeasuresNoise):
        return np.zeros(len(std), np.bool_)
    limit = max(CERTAIN_NOISE * estimator.noise_std(state), CERTAIN_SHARE * Q_max)
    return np.asarray(TWO_SIDED_95 * std > limit)


def _uncertain(answer: Inversion, where: Flags) -> Inversion:
    """Return the answers with those that are OK marked as uncertain somewhere."""
    marked = where & (answer.status == InverseStatus.OK)
    status = np.where(marked, np.uint8(InverseStatus.UNCERTAIN), answer.status)
    return replace(answer, status=status)


def _widened(
    estimator: Estimator[S],
    state: S,
    grounds: tuple[Support, SensorAccuracy, Widening | None],
    points: tuple[Floats, Floats, Floats],
    answer: Inversion,
    doubtful: NDArray[np.intp],
) -> Inversion:
    """Widen the intervals of uncertain answers to all levels of U that may deliver the demand.

    Where a map extrapolates, or is smoother than the valve, its slope is not the valve's.
    """
    support, accuracy, widened = grounds
    lower, upper = answer.lower.copy(), answer.upper.copy()
    levels = np.linspace(*U_range_of(estimator), LEVELS)
    for start in range(0, len(doubtful), CHUNK):
        rows = doubtful[start : start + CHUNK]
        Q, dp, T = (np.repeat(x[rows], LEVELS) for x in points)
        where = np.tile(levels, len(rows)), dp, T
        flow, std = estimator.predict(state, *where)
        std = std if widened is None else widened(std, *where)
        std, _ = trusted(estimator, state, support, where, flow, std)
        std = np.hypot(std, _systematic(estimator, state, accuracy, where))
        possible = ~(np.abs(flow - Q) > TWO_SIDED_95 * std).reshape(-1, LEVELS)
        above = levels >= answer.U[rows, None]
        up = np.logical_and.accumulate(possible | ~above, axis=1) & above
        down = np.logical_and.accumulate((possible | above)[:, ::-1], axis=1)[:, ::-1] & ~above
        lowest = np.where(down, levels, np.inf).min(axis=1)
        highest = np.where(up, levels, -np.inf).max(axis=1)
        lower[rows], upper[rows] = np.fmin(lower[rows], lowest), np.fmax(upper[rows], highest)
    return replace(answer, lower=lower, upper=upper)


def _answer(
    found: Found, std: Floats, finite: NDArray[np.bool_], reach: tuple[float, float]
) -> Inversion:
    unknown = (found.status == InverseStatus.UNIDENTIFIED) | np.isinf(std)
    status = np.where(unknown, InverseStatus.UNIDENTIFIED, found.status)
    status = np.where(~finite, InverseStatus.NOT_FINITE, status).astype(np.uint8)
    given = status <= InverseStatus.BELOW_REACH
    U = np.where(given, found.U + 0.0, np.nan)
    half = TWO_SIDED_95 * std / found.slope
    known = given & np.isfinite(std)
    flat = known & ~(np.isfinite(found.unclipped) & np.isfinite(half) & (found.slope > 0.0))
    lower = np.where(flat, reach[0], np.clip(found.unclipped - half, *reach))
    upper = np.where(flat, reach[1], np.clip(found.unclipped + half, *reach))
    return Inversion(
        U=U,
        lower=np.where(known, lower, np.nan),
        upper=np.where(known, upper, np.nan),
        status=status,
    )
