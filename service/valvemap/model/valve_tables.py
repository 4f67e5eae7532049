"""Tables of a map and its inverse with intervals, for a unit that can only interpolate."""

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import Estimator, State
from valvemap.model.extrapolation import trusted
from valvemap.model.inverse_map import invert
from valvemap.model.lookup_table import LookupTable
from valvemap.model.map_pieces import MapPieces
from valvemap.model.residual_spread import TWO_SIDED_95
from valvemap.model.samples import Floats
from valvemap.model.support import Support

S = TypeVar("S", bound=State)
MARGIN: Final = 1.25  # on an error that is measured
ROUNDING: Final = 1e-4  # l/min; literals have 12 digits


@dataclass(frozen=True)
class ForwardTable:
    """The flow over U and s = √dp, bilinear.

    Attributes
    ----------
    U : (n_U,)
        Axis, %, with every kink of the map.
    s : (n_s,)
        Axis, √bar, from 0.
    Q, half : (n_U, n_s)
        Flow, and half the 95 % interval of a new measurement, l/min.
    guessed : (n_U, n_s)
        Mask of points where the map is extrapolated.
    error
        Largest difference from the map, l/min.
    certified
        Whether the error is a bound: (ΔU²·max|∂²Q/∂U²| + Δs²·max|∂²Q/∂s²|)/8 in each cell.
    """

    U: Floats
    s: Floats
    Q: Floats
    half: Floats
    guessed: NDArray[np.bool_]
    error: float
    certified: bool


@dataclass(frozen=True)
class ValveTables:
    """Both directions; ``lower`` and ``upper`` (n_r, n_dp) are the 95 % interval of U, %."""

    inverse: LookupTable
    lower: Floats
    upper: Floats
    forward: ForwardTable


def valve_tables(
    estimator: Estimator[S],
    state: S,
    inverse: LookupTable,
    support: Support,
    noise_std: float,
) -> ValveTables:
    """Add the intervals of an inverse table, and the table of the flow over the same range.

    Raises
    ------
    ValueError
        if the flow is not known over the whole range.
    """
    spans = inverse.highest - inverse.lowest
    Q = inverse.lowest + inverse.r[:, None] * spans
    dp = np.broadcast_to(inverse.dp, Q.shape)
    answer = invert(estimator, state, Q.ravel(), dp.ravel(), inverse.T, support=support)
    lower, upper = (
        np.where(np.isfinite(x), x, end).reshape(Q.shape)
        for x, end in ((answer.lower, 0.0), (answer.upper, 100.0))
    )
    U = np.nan_to_num(inverse.U)
    return ValveTables(
        inverse=inverse,
        lower=np.minimum(lower, U),
        upper=np.maximum(upper, U),
        forward=_forward(estimator, state, inverse, support, noise_std),
    )


def _forward(
    estimator: Estimator[S], state: S, inverse: LookupTable, support: Support, noise_std: float
) -> ForwardTable:
    T, dp_max = inverse.T, float(inverse.dp[-1])
    pieces = MapPieces.of(estimator, state, (0.0, dp_max), T)
    sizes = inverse.U.shape
    U, s = np.linspace(0.0, 100.0, sizes[0]), np.linspace(0.0, np.sqrt(dp_max), sizes[1])
    if pieces is not None:
        U = np.union1d(U, pieces.U[pieces.kinks_U])
        s = np.union1d(s, pieces.s[pieces.kinks_s])

    def at(U: Floats, s: Floats) -> tuple[tuple[Floats, Floats, Floats], Floats, Floats]:
        grid_U, grid_s = (x.ravel() for x in np.meshgrid(U, s, indexing="ij"))
        points = grid_U, grid_s**2, np.full(grid_U.size, T)
        return points, *estimator.predict(state, *points)

    points, Q, std = at(U, s)
    if not np.isfinite(Q).all():
        raise ValueError(f"the flow is not known over 0 … 100 % and 0 … {dp_max:g} bar")
    std, guessed = trusted(estimator, state, support, points, Q, std)
    half = TWO_SIDED_95 * np.hypot(np.where(np.isfinite(std), std, support.Q_max), noise_std)
    shape = len(U), len(s)
    flows = Q.reshape(shape)
    if pieces is None:
        between = (flows[:-1, :-1] + flows[1:, :-1] + flows[:-1, 1:] + flows[1:, 1:]) / 4.0
        middles = at((U[:-1] + U[1:]) / 2.0, (s[:-1] + s[1:]) / 2.0)[1].reshape(between.shape)
        error = MARGIN * float(np.abs(middles - between).max())
    else:
        cells = [x.ravel() for x in np.meshgrid(np.arange(len(U) - 1), np.arange(len(s) - 1))]
        i, j = cells
        _, bends, _ = pieces.over(U[i], U[i + 1], s[j], s[j + 1])
        squares = np.diff(U)[i] ** 2 * bends[0] + np.diff(s)[j] ** 2 * bends[2]
        error = float(squares.max()) / 8.0
    return ForwardTable(
        U=U,
        s=s,
        Q=flows,
        half=np.nan_to_num(half, nan=float(support.Q_max)).reshape(shape),
        guessed=guessed.reshape(shape),
        error=error + ROUNDING,
        certified=pieces is not None,
    )
