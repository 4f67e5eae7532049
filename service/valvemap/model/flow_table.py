"""The inverse map as a table over flow and pressure drop, for a spreadsheet."""

from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model.estimator import Estimator, State
from valvemap.model.inverse_map import invert
from valvemap.model.lookup_table import MARGIN, SLACK_U, LookupTable, place
from valvemap.model.map_pieces import MapPieces
from valvemap.model.samples import Codes, Floats
from valvemap.model.table_error import ROUNDING, Cells, certified_errors
from valvemap.vocabulary.statuses import InverseStatus

S = TypeVar("S", bound=State)
TRIED: Final = np.array([1e-6, 0.15, 0.35, 0.5, 0.65, 0.85, 1.0 - 1e-6])


@dataclass(frozen=True)
class FlowTable:
    """U over Q and dp, bilinear; more than 100 % or less than 0 is beyond the valve's reach.

    There U continues the map, linearly, so that cells across the border of the reach interpolate
    well; the control voltage is U limited to 0 … 100 %.

    Attributes
    ----------
    Q : (n_Q,)
        Axis, l/min.
    dp : (n_dp,)
        Axis, bar.
    U : (n_Q, n_dp)
        U in %; NaN where no U is valid.
    guessed : (n_Q, n_dp)
        Mask of points where the map is extrapolated.
    T
        Oil temperature, °C.
    error_U, error_Q, certified
        As of :class:`~valvemap.model.lookup_table.LookupTable`, after the limits.
    """

    Q: Floats
    dp: Floats
    U: Floats
    guessed: NDArray[np.bool_]
    T: float
    error_U: float = np.nan
    error_Q: float = np.nan
    certified: bool = False

    def interpolate(self, Q: Floats, dp: Floats) -> Floats:
        """Return U (N,) within 0 … 100 %, for points on the axes."""
        i, u = place(self.Q, Q)
        j, v = place(self.dp, dp)
        U = (1.0 - u) * ((1.0 - v) * self.U[i, j] + v * self.U[i, j + 1])
        U = U + u * ((1.0 - v) * self.U[i + 1, j] + v * self.U[i + 1, j + 1])
        return np.asarray(np.clip(U, 0.0, 100.0))


def flow_table(estimator: Estimator[S], state: S, inverse: LookupTable) -> FlowTable:
    """Tabulate over the flows and pressure drops of an inverse table, with as many points."""
    size, T = inverse.U.shape[0], inverse.T
    low, high = float(inverse.lowest.min()), float(inverse.highest.max())
    Q = low + (high - low) * np.linspace(0.0, 1.0, size) ** 2  # the reach is small at low dp
    gain = high / (100.0 * np.sqrt(inverse.dp[-1]))
    grid_Q, grid_dp = np.meshgrid(Q, inverse.dp, indexing="ij")
    status, U = _answers(estimator, state, grid_Q, grid_dp, T)
    slope = gain * np.sqrt(grid_dp)
    ends = [
        estimator.predict(state, np.full(grid_dp.size, end), grid_dp.ravel(), 0 * U.ravel() + T)[0]
        for end in (0.0, 100.0)
    ]
    below, above = (grid_Q - end.reshape(U.shape) for end in ends)
    U = np.where((status == InverseStatus.ABOVE_REACH) & (above > 0), 100.0 + above / slope, U)
    U = np.where((status == InverseStatus.BELOW_REACH) & (below < 0), below / slope, U)
    r = (grid_Q - inverse.lowest) / (inverse.highest - inverse.lowest)
    i, _ = place(inverse.r, np.clip(r, 0.0, 1.0))
    columns = np.arange(len(inverse.dp))
    guessed = inverse.guessed[i, columns] | inverse.guessed[i + 1, columns]
    table = FlowTable(Q, inverse.dp, U, guessed, T)
    error_U, error_Q = _measured(estimator, state, table)
    pieces = MapPieces.of(estimator, state, (float(inverse.dp[0]), float(inverse.dp[-1])), T)
    if pieces is not None:
        limits = min(float(np.nanmin(U)), 0.0) - 1.0, max(float(np.nanmax(U)), 100.0) + 1.0
        whole = pieces.extended(*limits, gain)
        error_U, error_Q = certified_errors(_cells(table), whole, SLACK_U * error_U)
    return replace(table, error_U=error_U, error_Q=error_Q, certified=pieces is not None)


def _answers(
    estimator: Estimator[S], state: S, Q: Floats, dp: Floats, T: float
) -> tuple[Codes, Floats]:
    answer = invert(estimator, state, Q.ravel(), dp.ravel(), T)
    return answer.status.reshape(Q.shape), answer.U.reshape(Q.shape)


def _measured(estimator: Estimator[S], state: S, table: FlowTable) -> tuple[float, float]:
    Q, dp = (
        (axis[:-1, None] + np.diff(axis)[:, None] * TRIED).ravel() for axis in (table.Q, table.dp)
    )
    grid_Q, grid_dp = (x.ravel() for x in np.meshgrid(Q, dp, indexing="ij"))
    T = np.full_like(grid_Q, table.T)
    mine = table.interpolate(grid_Q, grid_dp)
    exact = invert(estimator, state, grid_Q, grid_dp, table.T).U
    both = np.isfinite(mine) & np.isfinite(exact)
    flows = [estimator.predict(state, U[both], grid_dp[both], T[both])[0] for U in (mine, exact)]
    apart_U = float(np.abs(mine - exact)[both].max(initial=0.0))
    apart_Q = float(np.abs(flows[0] - flows[1]).max(initial=0.0))
    return MARGIN * apart_U + ROUNDING, MARGIN * apart_Q + ROUNDING


def _cells(table: FlowTable) -> Cells:
    shape = table.U.shape[0] - 1, table.U.shape[1] - 1
    Q, dQ = (np.repeat(x, shape[1]) for x in (table.Q[:-1], np.diff(table.Q)))
    dp, ddp = (np.tile(x, shape[0]) for x in (table.dp[:-1], np.diff(table.dp)))
    whole = Cells(
        U00=table.U[:-1, :-1].ravel(),
        U01=table.U[:-1, 1:].ravel(),
        U10=table.U[1:, :-1].ravel(),
        U11=table.U[1:, 1:].ravel(),
        r=0.0 * Q,
        dr=0.0 * Q + 1.0,
        dp=dp,
        ddp=ddp,
        low=Q,
        dlow=0.0 * Q,
        span=dQ,
        dspan=0.0 * Q,
    )
    return whole[np.isfinite(whole.U00 + whole.U01 + whole.U10 + whole.U11)]
