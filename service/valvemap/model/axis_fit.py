"""The fit of an axis' sums: edges, bulk modulus, leakage and air, with their covariance."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from valvemap.model.axis import AxisRegression, AxisState
from valvemap.model.axis_basis import (
    COMMON,
    KNOTS,
    SIZE,
    SPLINE,
    columns,
    edge_regressors,
    moved_edge,
)
from valvemap.model.kernels import axis_rows as kernel
from valvemap.model.kernels import flow_drift
from valvemap.model.samples import Floats
from valvemap.vocabulary.edges import EDGES

FORCE_SIZE: Final = 20.0  # 1/t; prior of both parts of the force, of the lightest piston: 50 kg
_CORNER: Final = 0.015  # share of the third difference; tuned on simulated axes
_ASSUMED: Final = 0.002  # share of 1/β and c; of the spool's assumed damping, 0.7 to 0.9 tried
_PLACE: Final = 0.05  # share of 1/β, where the place is a range; 0.02 to 0.05 seen with long moves
_ZERO_SIZE: Final = 0.2  # mm/s; prior of a measured speed's zero
_PLACE_SIZE: Final = 100.0  # mm/GPa; prior of what the place is off, where it is a range
DELAY_SIZE: Final = 1.0  # 10 ms; prior of a signal's delay: a cycle of a controller or a bus
_SCALE: Final = 0.001  # share; of a measured speed's scale, which scales all flows
_SHIFT: Final = 0.05  # %; step of derivatives by an edge's shift
_LEAST_VARIANCE: Final = 1e-10  # (l/min)²
_COMPLIANCE_SIZE, _LEAKAGE_SIZE, _AIR_SIZE = 10.0, 20.0, 1.0  # prior, in the coefficients' units
_COEFFICIENT_SIZE: Final = 100.0  # l/min/√bar; prior of K itself, wide
_DEPARTURE_SIZE: Final = 1.0  # l/min/√bar at y = 100 %
_NO_FLOWS: Final = (kernel.ZERO, kernel.FORCE, kernel.CREEP, kernel.PISTON, kernel.COMMAND)
_SLOPES: Final = (0.002, 0.005, 0.012, 0.03, 0.08)  # l/min/√bar/%^1.5; tried sizes of the prior


@dataclass(frozen=True)
class AxisFit:
    """The coefficients (n,), their covariance (n, n), and the data of the fit.

    ``residual_std`` (l/min) is that of the filtered rows, ``together`` of which count as one;
    ``loss`` compares plays and spools, ``evidence`` priors.
    """

    regression: AxisRegression
    theta: Floats
    covariance: Floats
    residual_std: float
    together: float
    loss: float
    evidence: float

    def flow(self, edge: str, U: ArrayLike, dp: ArrayLike) -> Floats:
        """Return an edge's flow (l/min) at the spool position |U| (%) and its own drop (bar)."""
        return np.asarray(edge_regressors(U, dp) @ self.theta[columns(edge)])

    def flow_std(self, edge: str, U: ArrayLike, dp: ArrayLike) -> Floats:
        """Return the standard deviation of :meth:`flow`, l/min.

        A spline cannot follow a corner within one of its intervals: the third differences of its
        coefficients tell how far it may be off.
        """
        X, own = edge_regressors(U, dp), columns(edge)
        random = np.einsum("...i,ij,...j->...", X, self.covariance[own, own], X)
        corner = _CORNER * (np.abs(X[..., :-1]) @ self.bends(edge))
        return np.asarray(np.sqrt(random + corner**2))

    def bends(self, edge: str) -> Floats:
        """Return the largest third difference near each spline coefficient, (KNOTS - 1,).

        In l/min/√bar. Where K has a corner, it is the jump of its slope times the knots' distance.
        """
        third = np.abs(np.diff(self.theta[columns(edge)][:-1], 3))
        worst = np.maximum.reduce([np.pad(third, (k, 3 - k)) for k in range(4)])
        return np.asarray(worst)

    @property
    def bulk_modulus(self) -> tuple[float, float]:
        """β and its standard deviation, GPa."""
        inverse, std = self._common(kernel.COMPLIANCE)
        assumed = _ASSUMED if self.regression.has_place else _PLACE
        return 1.0 / inverse, math.hypot(std / inverse**2, assumed / inverse)

    @property
    def leakage(self) -> tuple[float, float]:
        """Leakage c at 40 °C (without T: as it is) and its standard deviation, l/min/bar."""
        value, std = self._common(kernel.LEAKAGE)
        return kernel.PER_LEAKAGE * value, kernel.PER_LEAKAGE * math.hypot(std, _ASSUMED * value)

    @property
    def air(self) -> tuple[float, float]:
        """Free air at atmospheric pressure and its standard deviation, %."""
        return self._common(kernel.AIR)

    def _common(self, number: int) -> tuple[float, float]:
        place = COMMON + number
        return float(self.theta[place]), math.sqrt(self.covariance[place, place])


def fit(regression: AxisRegression, state: AxisState) -> AxisFit:
    """Return the fit of a state under the prior of highest evidence.

    Where the state was advanced with the coefficients of an earlier fit (:func:`with_theta`), rows
    that hang together count as fewer, and the covariance is that of the scores' blocks (sandwich):
    where the model fits worse, the interval is wider.
    """
    whole = state.M + np.tril(state.M, -1).T
    together = _hanging_together(state)
    fits = [_fit(regression, state, whole, slope, together) for slope in _SLOPES]
    best = max(fits, key=lambda found: found.evidence)
    if regression.has_place:
        return best
    flows = _SCALE * best.theta
    flows[[COMMON + k for k in _NO_FLOWS]] = 0.0
    return replace(best, covariance=best.covariance + np.outer(flows, flows))


def compared(state: AxisState) -> tuple[Floats, float]:
    """Return coefficients and residuals' root mean square (l/min), one prior for all spools."""
    M = state.M + np.tril(state.M, -1).T
    A = M + _COMPARED_VARIANCE * _COMPARED_PRIOR
    theta = np.asarray(np.linalg.solve(A, state.b), np.float64)
    loss = float(state.squares[:2].sum() - 2.0 * state.b @ theta + theta @ M @ theta)
    return theta, math.sqrt(max(loss, 0.0) / max(2.0 * state.squares[2], 1.0))


def _hanging_together(state: AxisState) -> float:
    """Return how many rows count as one: the variance of block sums over that of single rows."""
    squares, blocks, length = state.errors[:, 0], state.errors[:, 1], state.errors[:, 4]
    rows = state.squares[2]
    if rows <= 0.0 or (length <= 0.0).any() or not state.theta.any():
        return 1.0
    return float(np.clip(np.sum(blocks / length) / np.sum(squares / rows), 1.0, 1e3))


def _fit(
    regression: AxisRegression, state: AxisState, M: Floats, slope: float, together: float
) -> AxisFit:
    P = _prior(slope)
    rows = max(2.0 * state.squares[2] / together, 1.0)
    yy = float(state.squares[0] + state.squares[1]) / together
    M, b = M / together, state.b / together
    sigma2, loss = max(yy / rows, _LEAST_VARIANCE), yy
    theta, A, covariance = b, P, P
    for _ in range(4):
        A = M / sigma2 + P
        covariance = np.linalg.inv(A)
        theta = covariance @ b / sigma2
        loss = max(yy - 2.0 * float(b @ theta) + float(theta @ M @ theta), 0.0)
        free = SIZE - float(np.sum(covariance * P))
        sigma2 = max(loss / max(rows - free, 1.0), _LEAST_VARIANCE)
    evidence = 0.5 * (
        np.linalg.slogdet(P)[1]
        - np.linalg.slogdet(A)[1]
        - loss / sigma2
        - float(theta @ P @ theta)
        - rows * math.log(sigma2)
    )
    if state.theta.any():
        scores = (state.scores + np.tril(state.scores, -1).T) / (together * sigma2) ** 2
        middle = scores  # the noise of a measured speed is in both lines at once
        if regression.has_place:
            middle = 0.5 * (scores + M / sigma2)  # halfway: blocks of few visits tell little
        covariance = covariance @ (middle + P) @ covariance
    return AxisFit(
        regression, theta, covariance, math.sqrt(loss / rows), together, loss, float(evidence)
    )


def with_theta(state: AxisState, theta: Floats) -> AxisState:
    """Return the state with coefficients for the residuals of the next samples."""
    return replace(state, theta=np.ascontiguousarray(theta))


def with_map(state: AxisState, found: AxisFit) -> AxisState:
    """Return the state with a fit of its sums, from which gains and shifts are then learnt."""
    own = [columns(edge) for edge in EDGES]
    known = np.stack([found.covariance[part, part] for part in own])
    return replace(with_theta(state, found.theta), known=known)


def moved(found: AxisFit, state: AxisState) -> AxisFit:
    """Return the fit of a state's sums as the edges are now: with their gains and shifts.

    The covariance holds the doubt about both.
    """
    M, doubt = _moved_by(state), np.zeros((SIZE, SIZE))
    for k, edge in enumerate(EDGES):
        own, now = columns(edge), state.drift_now[k]
        gain, shift = now[0, flow_drift.GAIN], now[0, flow_drift.EDGE]
        unmoved = found.theta[own]
        risen = (moved_edge(gain, shift + _SHIFT) - M[own, own]) @ unmoved / _SHIFT
        by = np.stack([unmoved, risen], axis=1)
        levels = now[1 : 1 + flow_drift.OF_VALVE, : flow_drift.OF_VALVE]
        doubt[own, own] = by @ levels @ by.T
    return replace(found, theta=M @ found.theta, covariance=M @ found.covariance @ M.T + doubt)


def with_moved_sums(state: AxisState) -> AxisState:
    """Return the state with sums whose fit is the edges as they are now."""
    back = np.linalg.inv(_moved_by(state))
    whole = state.M + np.tril(state.M, -1).T
    scores = state.scores + np.tril(state.scores, -1).T
    return replace(
        state,
        M=np.tril(back.T @ whole @ back),
        b=back.T @ state.b,
        scores=np.tril(back.T @ scores @ back),
    )


def _moved_by(state: AxisState) -> Floats:
    """Return M (n, n): the edges are now M·θ, with θ the fit of the sums."""
    M = np.eye(SIZE)
    for k, edge in enumerate(EDGES):
        own, now = columns(edge), state.drift_now[k, 0]
        M[own, own] = moved_edge(now[flow_drift.GAIN], now[flow_drift.EDGE])
    return M


def _prior(slope: float) -> Floats:
    """Return the prior's precision (n, n)."""
    P = np.zeros((SIZE, SIZE))
    for edge in range(len(EDGES)):
        at = edge * KNOTS
        for j, bend in enumerate(SPLINE.bends):
            row = np.zeros(SIZE)
            row[at + j : at + j + 3] = bend / slope
            P += np.outer(row, row)
        own = np.arange(at, at + KNOTS - 1)
        P[own, own] += _COEFFICIENT_SIZE**-2
        P[at + KNOTS - 1, at + KNOTS - 1] = _DEPARTURE_SIZE**-2
    sizes = np.array(
        [
            *(_COMPLIANCE_SIZE, _LEAKAGE_SIZE, _AIR_SIZE),
            *(_ZERO_SIZE, _PLACE_SIZE, FORCE_SIZE, FORCE_SIZE, DELAY_SIZE, DELAY_SIZE),
        ]
    )
    common = np.arange(COMMON, SIZE)
    P[common, common] = sizes**-2.0
    return P


_COMPARED_VARIANCE: Final = 0.01  # (l/min)²; of residuals, for the prior's weight
_COMPARED_PRIOR: Final = _prior(_SLOPES[2])
