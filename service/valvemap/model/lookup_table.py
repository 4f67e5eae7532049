"""The inverse map as a table with a stated error, for a controller that can only interpolate."""

from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import Estimator, State
from valvemap.model.extrapolation import U_range_of, trusted
from valvemap.model.inverse_map import invert
from valvemap.model.map_pieces import MapPieces
from valvemap.model.samples import Codes, Floats
from valvemap.model.support import Support
from valvemap.model.table_error import END, ROUNDING, Cells, certified_errors
from valvemap.vocabulary.statuses import InverseStatus

S = TypeVar("S", bound=State)
LEVELS: Final = np.linspace(0.0, 100.0, 401)
WITHIN: Final = np.array([1e-6, 0.15, 0.35, 0.5, 0.65, 0.85, 1.0 - 1e-6])
EDGES: Final = np.array([1e-6, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3])
MARGIN: Final = 1.25
SLACK_U: Final = 1.1  # of the measured error in U: a bound below is not refined


@dataclass(frozen=True)
class LookupTable:
    """U over pressure drop and flow, the flow as a share of the valve's range at that dp.

    The range is therefore exact, and no cell crosses its border::

        low, high = lowest(dp), highest(dp)      linear between the points of dp
        r = (Q - low)/(high - low)
        U = U(r, dp)                             bilinear

    Attributes
    ----------
    dp : (n_dp,)
        Axis, ascending, bar.
    lowest, highest : (n_dp,)
        Flow at U = 0 and the largest flow at each dp, l/min.
    r : (n_r,)
        Axis, 0 … 1.
    U : (n_r, n_dp)
        U in %; NaN where no U is valid.
    guessed : (n_r, n_dp)
        Mask of points where the map is extrapolated.
    T
        Oil temperature, °C.
    error_U, error_Q
        Largest difference from the map's inverse, %, and of the flow that U gives from the demanded
        one (limited to lowest … highest), l/min.
    certified
        Whether the errors are bounds over the whole domain (:mod:`~valvemap.model.table_error`).
        Else, for a map of unknown form, they are the largest at 49 points of each cell, plus 25 %.
    """

    dp: Floats
    lowest: Floats
    highest: Floats
    r: Floats
    U: Floats
    guessed: NDArray[np.bool_]
    T: float
    error_U: float = np.nan
    error_Q: float = np.nan
    certified: bool = False

    def interpolate(self, Q: Floats, dp: Floats) -> tuple[Floats, Codes]:
        """Return U (N,) within 0 … 100 %, and status: :class:`InverseStatus`.

        Outside the axis of dp, its nearest end is used. The status is EXTRAPOLATING if one of the
        surrounding points is.
        """
        inside = np.clip(dp, self.dp[0], self.dp[-1])
        j, v = _place(self.dp, inside)
        low, high = ((1.0 - v) * x[j] + v * x[j + 1] for x in (self.lowest, self.highest))
        r = (Q - low) / (high - low)
        i, u = _place(self.r, np.clip(r, 0.0, 1.0))
        U = (1.0 - u) * ((1.0 - v) * self.U[i, j] + v * self.U[i, j + 1])
        U = U + u * ((1.0 - v) * self.U[i + 1, j] + v * self.U[i + 1, j + 1])
        U = np.select([r > 1.0, r < 0.0], [100.0, 0.0], U)
        g = self.guessed
        guess = g[i, j] | g[i, j + 1] | g[i + 1, j] | g[i + 1, j + 1]
        status = np.select(
            [
                ~np.isfinite(Q + dp),
                inside != dp,
                guess & ~np.isnan(U),
                r > 1.0,
                r < 0.0,
                np.isnan(U),
            ],
            [
                InverseStatus.NOT_FINITE,
                InverseStatus.OUTSIDE,
                InverseStatus.EXTRAPOLATING,
                InverseStatus.ABOVE_REACH,
                InverseStatus.BELOW_REACH,
                InverseStatus.UNIDENTIFIED,
            ],
            InverseStatus.OK,
        )
        return np.where(np.isfinite(Q + dp), U, np.nan), status.astype(np.uint8)


def lookup_table(
    estimator: Estimator[S],
    state: S,
    dp_max: float = 200.0,
    T: float = 40.0,
    *,
    points: tuple[int, int] = (41, 31),
    dp_min: float = 5.0,
    support: Support | None = None,
) -> LookupTable:
    """Tabulate the inverse of a map at temperature ``T``.

    Parameters
    ----------
    dp_min, dp_max
        The axis of dp: towards dp = 0 every valve's inverse is singular.
    points
        Along r, closer near both ends where dead band and saturation are, and along dp.
    support
        Region of the samples; None: no extrapolation check.

    Raises
    ------
    ValueError
        if the axis is empty, or if the map covers other U than 0 … 100 %, is not determined, or
        does not rise with U.

    Examples
    --------
    >>> from valvemap.model.linear_map import LinearMap, LinearMapState
    >>> from valvemap.model.model_structures import FiveTerms
    >>> state = LinearMapState(np.array([0.0, 0.0, 0.0, 0.1, 0.0]), np.zeros((5, 5)))
    >>> table = lookup_table(LinearMap(FiveTerms()), state)
    >>> table.interpolate(np.array([50.0]), np.array([100.0]))[0].round(2)
    array([50.01])
    >>> table.error_U < 0.6
    True
    """
    low, high = U_range_of(estimator)
    if low < 0.0 or high > END:
        raise ValueError(
            f"the map covers U from {low:g} to {high:g} %, a table 0 to 100 %: learn one direction "
            "alone, from the samples with U >= 0, or with -U and -Q in place of U and Q"
        )
    if not 0.0 < dp_min < dp_max or min(points) < 2:
        raise ValueError(f"a table of {points} points over {dp_min:g} … {dp_max:g} bar")
    dp = np.linspace(np.sqrt(dp_min), np.sqrt(dp_max), points[1]) ** 2
    U_at, dp_at = (x.ravel() for x in np.meshgrid(LEVELS, dp, indexing="ij"))
    flows, _ = estimator.predict(state, U_at, dp_at, np.full_like(U_at, T))
    flows = flows.reshape(len(LEVELS), -1)
    lowest, highest = flows[0], flows.max(axis=0)
    if not (highest > lowest).all():
        raise ValueError("the map is not determined, or does not rise with U")
    r = (1.0 - np.cos(np.linspace(0.0, np.pi, points[0]))) / 2.0
    Q = lowest + r[:, None] * (highest - lowest)
    across = np.tile(dp, len(r))
    U = _inverse(estimator, state, Q.ravel(), across, T).reshape(points)
    guessed = np.zeros(points, np.bool_)
    if support is not None:
        where = U.ravel(), across, np.full(U.size, T)
        _, beyond = trusted(estimator, state, support, where, *estimator.predict(state, *where))
        guessed = beyond.reshape(points) & ~np.isnan(U)
    table = LookupTable(dp, lowest, highest, r, U, guessed, T)
    error_U, error_Q = _errors(estimator, state, table)
    pieces = MapPieces.of(estimator, state, (dp[0], dp[-1]), T)
    if pieces is not None:
        tolerance = SLACK_U * error_U
        error_U, error_Q = certified_errors(_cells(table), pieces, tolerance)
    return replace(table, error_U=error_U, error_Q=error_Q, certified=pieces is not None)


def _inverse(estimator: Estimator[Any], state: Any, Q: Floats, dp: Floats, T: float) -> Floats:  # noqa: ANN401 - its own state
    return invert(estimator, state, Q, dp, T).U


def _errors(estimator: Estimator[Any], state: Any, table: LookupTable) -> tuple[float, float]:  # noqa: ANN401
    """Largest differences in U from the inverse, and of its flow from the demanded one."""
    r, dp = (
        (axis[:-1, None] + np.diff(axis)[:, None] * WITHIN).ravel() for axis in (table.r, table.dp)
    )
    r = np.concatenate([-EDGES, r, 1.0 + EDGES])  # the limits of the range are interpolated, too
    low, high = (np.interp(dp, table.dp, x) for x in (table.lowest, table.highest))
    Q = (low + r[:, None] * (high - low)).ravel()
    dp = np.tile(dp, len(r))
    T, demand = np.full_like(Q, table.T), np.clip(Q, np.tile(low, len(r)), np.tile(high, len(r)))
    mine, _ = table.interpolate(Q, dp)
    exact = _inverse(estimator, state, Q, dp, table.T)
    both = np.isfinite(mine) & np.isfinite(exact)
    flow, _ = estimator.predict(state, mine[both], dp[both], T[both])
    apart_U = float(np.abs(mine - exact)[both].max(initial=0.0))
    apart_Q = float(np.abs(flow - demand[both]).max(initial=0.0))
    return MARGIN * apart_U + ROUNDING, MARGIN * apart_Q + ROUNDING


def _cells(table: LookupTable) -> Cells:
    """Return the cells with a U at all corners, and the edges of the reach, where U is 0 or 100."""
    rows = table.U, table.r[:, None] + 0.0 * table.U
    below, above = (
        (np.full((2, len(table.dp)), x), np.full((2, len(table.dp)), y))
        for x, y in ((0.0, 0.0), (100.0, 1.0))
    )
    parts = [_cells_of(table, *x) for x in (rows, below, above)]
    names = Cells.__dataclass_fields__
    whole = Cells(**{k: np.concatenate([getattr(part, k) for part in parts]) for k in names})
    return whole[np.isfinite(whole.U00 + whole.U01 + whole.U10 + whole.U11)]


def _cells_of(table: LookupTable, U: Floats, r: Floats) -> Cells:
    shape = U.shape[0] - 1, U.shape[1] - 1

    def along_dp(values: Floats) -> Floats:
        return np.broadcast_to(values, shape).ravel()

    spans = table.highest - table.lowest
    return Cells(
        U00=U[:-1, :-1].ravel(),
        U01=U[:-1, 1:].ravel(),
        U10=U[1:, :-1].ravel(),
        U11=U[1:, 1:].ravel(),
        r=r[:-1, :-1].ravel(),
        dr=np.diff(r, axis=0)[:, :-1].ravel(),
        dp=along_dp(table.dp[:-1]),
        ddp=along_dp(np.diff(table.dp)),
        low=along_dp(table.lowest[:-1]),
        dlow=along_dp(np.diff(table.lowest)),
        span=along_dp(spans[:-1]),
        dspan=along_dp(np.diff(spans)),
    )


def place(axis: Floats, x: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Return the cells of N points of an axis, and their places from 0 to 1 within these."""
    i = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
    return i, (x - axis[i]) / (axis[i + 1] - axis[i])


def _place(axis: Floats, x: Floats) -> tuple[NDArray[np.intp], Floats]:
    return place(axis, np.where(np.isfinite(x), x, axis[0]))
