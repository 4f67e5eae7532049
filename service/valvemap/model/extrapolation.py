"""Validity of a map at a point: the standard deviation of its flow, and whether it extrapolates."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.capabilities import ChoosesStructure
from valvemap.model.model_structures import Polynomial
from valvemap.model.residual_spread import TWO_SIDED_95
from valvemap.model.samples import Floats
from valvemap.model.support import Support

ABOUT_U: Final = 5.0  # %; samples so far beyond the range, by a sensor's offset, are learnt
ABOUT_DP: Final = 0.1  # of the range of Δp; the same, 5 % of its root
ONE_EDGE: Final = (0.0, 100.0)  # %: eq. (7) and the splines of `Auto` describe one metering edge

SURE: Final = 0.7  # distance at which the interval starts to grow; 1 at the border of *inside*
TOGETHER: Final = 1.5  # factor on eq. (7)'s std outside, where all points share their error
NARROW: Final = 0.02  # of the largest flow: upper limit of a useful half interval
HIDDEN: Final = 0.15  # of the largest flow: upper limit of undetectable curvature
PER_DISTANCE: Final = 0.04  # of the largest flow, per 5 % of U or 5 bar: assumed curvature
PER_WARMTH: Final = 0.015  # of the flow, per 5 °C: effect of viscosity and clearances


def trusted(
    estimator: Any,  # noqa: ANN401 - any estimator
    state: Any,  # noqa: ANN401 - its own
    support: Support,
    points: tuple[Floats, Floats, Floats],
    Q: Floats,
    std: Floats,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the standard deviation of the flow, and whether it is extrapolated, at N points.

    Inside, up to a margin at the border, the map's std is returned. Outside, a map of eq. (7) that
    has passed the lack-of-fit test keeps the std of its parameters, increased by half, while the
    interval is narrow, within the estimator's ranges; this does not count as extrapolation. Any
    other map is extrapolated, and its std grows with the distance from the samples. If eq. (7) is
    rejected, its std includes the misfit everywhere.

    Parameters
    ----------
    estimator, state
        Estimator and state of the map.
    support
        Region of the samples, and the lack-of-fit test.
    points
        U (%), dp (bar) and T (°C, NaN if unknown), each (N,).
    Q, std
        Flow of the map and its std, l/min, each (N,).
    """
    U, dp, T = points
    far, level, warmth = support.distances(U, dp, T)
    outside, suffices = far > 1.0, False
    if is_eq7(estimator, state):
        suffices = support.is_eq7_enough
        if support.is_eq7_refuted:
            std = np.hypot(std, support.misfit(U, dp, Q))
    level = np.maximum(level, support.below(dp))
    if not (np.maximum(far, level) > SURE).any():
        return std, outside
    with np.errstate(all="ignore"):
        widened = std * (1.0 + (TOGETHER - 1.0) * np.clip((far - SURE) / (1.0 - SURE), 0.0, 1.0))
        bent = np.minimum(PER_DISTANCE * np.maximum(level - SURE, 0.0), 1.0) * support.Q_max
        warmed = PER_WARMTH * np.abs(Q) * np.where(warmth > SURE, warmth, 0.0)
        guessed = np.sqrt(widened**2 + bent**2 + warmed**2)
    holds = np.zeros(len(U), np.bool_)
    if suffices:
        holds = (warmth <= 1.0) & (TWO_SIDED_95 * widened <= NARROW * support.Q_max)
        holds &= within_ranges(estimator, U, dp)
        holds[holds] = support.may_hide(U[holds], dp[holds]) <= HIDDEN * support.Q_max
    return np.where(holds, widened, guessed), outside & ~holds


def U_range_of(estimator: Any) -> tuple[float, float]:  # noqa: ANN401 - any estimator
    """Range of U (%) of an estimator: one metering edge, unless a network has another range.

    >>> from valvemap.model.rbf_network import RbfNetwork
    >>> U_range_of(RbfNetwork(U_range=(-100.0, 100.0)))
    (-100.0, 100.0)
    """
    low, high = getattr(estimator, "U_range", ONE_EDGE)
    return float(low), float(high)


def dp_range_of(estimator: Any) -> tuple[float, float]:  # noqa: ANN401 - any estimator
    """Range of Δp (bar) that an estimator's map covers; infinite where the map is a formula.

    >>> from valvemap.model.rbf_network import RbfNetwork
    >>> dp_range_of(RbfNetwork()), dp_range_of(object())
    ((0.0, 200.0), (-inf, inf))
    """
    low, high = getattr(estimator, "dp_range", (-np.inf, np.inf))
    return float(low), float(high)


def ranges_of(estimator: Any) -> str:  # noqa: ANN401 - any estimator
    """Ranges of an estimator's map in words.

    >>> from valvemap.model.rbf_network import RbfNetwork
    >>> ranges_of(RbfNetwork()), ranges_of(object())
    ('U 0 … 100 %, Δp 0 … 200 bar', 'U 0 … 100 %')
    """
    (low_U, high_U), (low, high) = U_range_of(estimator), dp_range_of(estimator)
    of_dp = f", Δp {low:g} … {high:g} bar" if np.isfinite(high - low) else ""
    return f"U {low_U:g} … {high_U:g} %{of_dp}"


def within_ranges(
    estimator: Any,  # noqa: ANN401 - any estimator
    U: Floats,
    dp: Floats,
    about_U: float = 0.0,
    about_dp: float = 0.0,
) -> NDArray[np.bool_]:
    """Whether N points lie in the ranges of an estimator's map; beyond, it gives its border.

    ``about_U`` (%) and ``about_dp`` (of the range) are allowed beyond; NaN lies within.
    """
    (low_U, high_U), (low, high) = U_range_of(estimator), dp_range_of(estimator)
    slack = about_dp * (high - low) if np.isfinite(high - low) else 0.0
    beyond = (low_U - about_U > U) | (high_U + about_U < U)
    return np.asarray(~(beyond | (low - slack > dp) | (high + slack < dp)))


def is_eq7(estimator: Any, state: Any) -> bool:  # noqa: ANN401 - any estimator and its state
    """Whether a map has the structure of eq. (7), so that its lack of fit can be tested."""
    if isinstance(estimator, ChoosesStructure):
        structure = estimator.structure_now(state)
    else:
        structure = getattr(estimator, "structure", None)
    return isinstance(structure, Polynomial) and structure.is_eq7
