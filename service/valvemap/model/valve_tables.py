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
from valvemap.model.table_error import ROUNDING, CellsOfFlow, certified_errors

S = TypeVar("S", bound=State)
MARGIN: Final = 1.25  # on an error that is measured


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
        Whether the error is a bound over the whole table (:mod:`~valvemap.model.table_error`).
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
        error = MARGIN * float(np.abs(middles - between).max()) + ROUNDING
    else:
        _, error = certified_errors(_cells(U, s, flows, pieces), pieces, np.inf)
    return ForwardTable(
        U=U,
        s=s,
        Q=flows,
        half=np.nan_to_num(half, nan=float(support.Q_max)).reshape(shape),
        guessed=guessed.reshape(shape),
        error=error,
        certified=pieces is not None,
    )


def _cells(U: Floats, s: Floats, Q: Floats, pieces: MapPieces) -> CellsOfFlow:
    shape = len(U) - 1, len(s) - 1
    low_U, high_U = (np.repeat(x, shape[1]) for x in (U[:-1], U[1:]))
    across, steps = (np.tile(x, shape[0]) for x in (s[:-1], np.diff(s)))
    Q00, Q01, Q10, Q11 = (
        Q[a, b].ravel()
        for a in (slice(None, -1), slice(1, None))
        for b in (slice(None, -1), slice(1, None))
    )
    _, bends, kinked = pieces.over(low_U, high_U, across, across + steps)
    curved = ((high_U - low_U) ** 2 * bends[0] + steps**2 * bends[2]) / 8.0
    return CellsOfFlow(
        U00=low_U,
        U01=low_U,
        U10=high_U,
        U11=high_U,
        r=0.0 * Q00,
        dr=0.0 * Q00 + 1.0,
        dp=across,
        ddp=steps,
        low=Q00,
        dlow=Q01 - Q00,
        span=Q10 - Q00,
        dspan=Q11 - Q10 - Q01 + Q00,
        curved=np.where(kinked, np.inf, curved),
    )
