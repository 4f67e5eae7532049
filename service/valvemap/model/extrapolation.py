"""How far a map may be trusted at a point: the std of its flow there, and whether it is a guess."""

from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from valvemap.model.model_structures import Polynomial, Structure
from valvemap.model.residual_spread import TWO_SIDED_95
from valvemap.model.samples import Floats
from valvemap.model.support import Support

EQ_7: Final = frozenset({"1", "U", "s", "U*s", "dp"})

ONE_EDGE: Final = (0.0, 100.0)  # %: eq. (7) and the splines of `Auto` know no second edge

SURE: Final = 0.7  # share of the way to the border of *inside* where the interval begins to grow
TOGETHER: Final = 1.5  # widens eq. (7) beyond: there all points err together, and 99 % must hold
NARROW: Final = 0.02  # of the largest flow: half an interval below it is of use
HIDDEN: Final = 0.15  # of the largest flow: what a bend that cannot be seen may come to
PER_DISTANCE: Final = 0.04  # of the largest flow, per 5 % of U or 5 bar: as far as flows may bend
PER_WARMTH: Final = 0.015  # of the flow, per 5 °C: as much as oil and clearances make of it


@runtime_checkable
class ChoosesStructure(Protocol):
    """An estimator whose structure is chosen by the samples."""

    def structure_now(self, state: Any) -> Structure | None:  # noqa: ANN401 - its own state
        """The structure that speaks now; None for one that is only known where samples were."""


def trusted(
    estimator: Any,  # noqa: ANN401 - any estimator
    state: Any,  # noqa: ANN401 - its own
    support: Support,
    points: tuple[Floats, Floats, Floats],
    Q: Floats,
    std: Floats,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Standard deviation of the flow, and whether it is extrapolated, at N points.

    Inside, and some way towards its border, the map's own std holds. Beyond, a map of the structure
    of eq. (7) that sufficed for its samples keeps the std that its parameters give, half as much
    again, as long as the interval stays narrow: that is no extrapolation in our sense. Any other
    map is extrapolated, and its std grows with the distance from the samples. Of a map of eq. (7)
    that is refuted the misfit is in its std, too, wherever it is asked.

    Parameters
    ----------
    estimator, state
        Whose map.
    support
        What it rests on.
    points
        U (%), dp (bar) and T (°C, NaN where unknown), each (N,).
    Q, std
        What the map says there, l/min, each (N,).
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
        holds[holds] = support.may_hide(U[holds], dp[holds]) <= HIDDEN * support.Q_max
    return np.where(holds, widened, guessed), outside & ~holds


def U_range_of(estimator: Any) -> tuple[float, float]:  # noqa: ANN401 - any estimator
    """Which U (%) an estimator can describe: one metering edge, unless a network has another range.

    >>> from valvemap.model.rbf_network import RbfNetwork
    >>> U_range_of(RbfNetwork(U_range=(-100.0, 100.0)))
    (-100.0, 100.0)
    """
    low, high = getattr(estimator, "U_range", ONE_EDGE)
    return float(low), float(high)


def is_eq7(estimator: Any, state: Any) -> bool:  # noqa: ANN401 - any estimator and its state
    """Whether a map has the structure of eq. (7), which can be held against its samples."""
    if isinstance(estimator, ChoosesStructure):
        structure = estimator.structure_now(state)
    else:
        structure = getattr(estimator, "structure", None)
    return isinstance(structure, Polynomial) and set(structure.terms) == EQ_7
