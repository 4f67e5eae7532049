"""A cylinder as the flow meter: four edges, bulk modulus and leakage from position and pressures.

For line A of a 4/3 valve on a cylinder (B likewise), with V_A(x) = V_0A + A_A·x::

    A_A·ẋ + (V_A/β)·ṗ_A = Q_PA(U, p_S - p_A) - Q_AT(U, p_A - p_T) - c·(p_A - p_B)

It is linear in the edges' maps, in 1/β and in c at 40 °C; at another temperature c is in inverse
proportion to the viscosity of an oil of ISO VG 46. An edge's map is K(y)·√Δp with K a quadratic
spline of the spool's position y, and a departure from √Δp proportional to y. The spool's position
comes from U through play and a lag of 2nd order, which are found by the residual
(:mod:`~valvemap.model.axis_search`). Smoothness is a Gaussian prior on the slope of K; its size is
the one of highest evidence.

A wrong piston area cannot be seen in these signals: it scales all flows by one factor, and the
speeds that the maps predict stay right.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from valvemap.model.kernels import axis_rows as kernel
from valvemap.model.kernels.flow_basis import axis as spline_axis
from valvemap.model.samples import Codes, Flags, Floats, Times
from valvemap.vocabulary.edges import EDGES

BREAKS: Final = np.array([0.0, *range(2, 14, 2), *range(15, 31, 3), *range(35, 101, 5)])
"""Breaks of the spool's position, %: fine where the edges open."""
KNOTS: Final = len(BREAKS) + 2  # spline functions, and the departure from √Δp
SIZE: Final = len(EDGES) * KNOTS + kernel.COMMON
SPOOL_DAMPING: Final = 0.8  # of the assumed spool; its frequency is found
_SIGNALS: Final = ("U", "x", "pA", "pB", "pS", "pT")
_SETTLING_S: Final = 0.1  # s; after a gap, until the spool's course is known again
_BLOCK_S: Final = 1.0  # s; of the block sums that tell how far residuals hang together
_FADED: Final = 6.0  # times the filter's; an impulse then has 4 % of its largest effect
_ROW_S: Final = 0.04  # s; from row to row: a fraction of the filter's time
_LONGEST: Final = 2.5  # sampling periods; a longer interval is a gap
_CORNER: Final = 0.015  # share of the third difference; tuned on simulated axes
_ASSUMED: Final = 0.002  # share of 1/β and c; of the spool's assumed damping, 0.7 to 0.9 tried
_LEAST_VARIANCE: Final = 1e-10  # (l/min)²
_COMPLIANCE_SIZE, _LEAKAGE_SIZE, _AIR_SIZE = 10.0, 20.0, 1.0  # prior, in the coefficients' units
_COEFFICIENT_SIZE: Final = 100.0  # l/min/√bar; prior of K itself, wide
_DEPARTURE_SIZE: Final = 1.0  # l/min/√bar at y = 100 %
_SLOPES: Final = (0.002, 0.005, 0.012, 0.03, 0.08)  # l/min/√bar/%^1.5; tried sizes of the prior


@dataclass(frozen=True)
class AxisGeometry:
    """Piston and rod diameter, stroke (mm), and each line's volume at its shortest (l).

    Examples
    --------
    >>> geometry = AxisGeometry(63, 45, 800, 1.2, 1.2)
    >>> round(geometry.A_A, 2), round(geometry.A_B, 2)
    (31.17, 15.27)
    """

    piston_mm: float
    rod_mm: float
    stroke_mm: float
    dead_A_l: float
    dead_B_l: float

    @property
    def A_A(self) -> float:
        """Area of the piston, cm²."""
        return math.pi / 400.0 * self.piston_mm**2

    @property
    def A_B(self) -> float:
        """Annular area, cm²."""
        return math.pi / 400.0 * (self.piston_mm**2 - self.rod_mm**2)


@dataclass(frozen=True)
class AxisSamples:
    """N samples of an axis: t (UTC ns), U (%), x (mm), pA, pB, pS, pT (bar), T (°C); all (N,).

    x = 0 where line A is shortest; U > 0 moves towards larger x. NaN is a missing value.
    """

    t: Times
    U: Floats
    x: Floats
    pA: Floats
    pB: Floats
    pS: Floats
    pT: Floats
    T: Floats

    @classmethod
    def of(cls, t: ArrayLike, **signals: ArrayLike | None) -> "AxisSamples":
        """Convert anything array-like; a signal that is not given is NaN."""
        time = np.ascontiguousarray(t, dtype=np.int64)
        given = {
            name: np.full(time.shape, np.nan)
            if (values := signals.get(name)) is None
            else np.ascontiguousarray(values, dtype=np.float64)
            for name in (*_SIGNALS, "T")
        }
        return cls(time, **given)

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, rows: slice | Flags) -> "AxisSamples":
        return AxisSamples(self.t[rows], *(getattr(self, s)[rows] for s in (*_SIGNALS, "T")))


@dataclass(frozen=True)
class AxisState:
    """State of the regression; arrays as in :func:`.kernels.axis_rows.axis_rows`."""

    last: Times
    memory: Floats
    filtered: Floats
    M: Floats
    b: Floats
    squares: Floats
    counts: Times
    theta: Floats
    errors: Floats
    score: Floats
    scores: Floats

    @property
    def rows(self) -> int:
        """Number of intervals that were used."""
        return int(self.counts[0])

    def reasons(self) -> dict[str, int]:
        """Return the number of intervals that were left out, by reason."""
        names = ("used", "gap", "missing", "low pressure", "end stop")
        return dict(zip(names, self.counts[1:].tolist(), strict=True))


class AxisTrace(NamedTuple):
    """Per sample: why it was left out (``kernels.axis_rows``), residuals of both lines, l/min."""

    reason: Codes
    residual: Floats


@dataclass(frozen=True)
class AxisRegression:
    """Recursive regression of an axis, given play and spool; forgetting in s of use, inf = none.

    Attributes
    ----------
    geometry : AxisGeometry
    period_s
        Sampling period.
    play_percent, spool_hz
        Width of the loop of U, and the spool's natural frequency; inf = no lag.
    filter_hz
        Corner of the low-pass of 2nd order.
    memory_s
        Time constant of forgetting, s of used intervals.
    lowest_bar, margin_mm
        Below this pressure, and this near to an end stop, intervals are left out.
    """

    geometry: AxisGeometry
    period_s: float = 0.01
    play_percent: float = 0.0
    spool_hz: float = math.inf
    filter_hz: float = 3.0
    memory_s: float = math.inf
    lowest_bar: float = 3.0
    margin_mm: float = 2.0

    def initial_state(self) -> AxisState:
        """Return the state before the first sample."""
        return AxisState(
            last=np.zeros(1, np.int64),
            memory=np.zeros(len(kernel.MEMORY)),
            filtered=np.zeros((2, 2, SIZE + 1)),
            M=np.zeros((SIZE, SIZE)),
            b=np.zeros(SIZE),
            squares=np.zeros(3),
            counts=np.zeros(6, np.int64),
            theta=np.zeros(SIZE),
            errors=np.zeros((2, 5)),
            score=np.zeros(SIZE),
            scores=np.zeros((SIZE, SIZE)),
        )

    def update(self, state: AxisState, samples: AxisSamples) -> tuple[AxisState, AxisTrace]:
        """Return the state after the samples; any division of them gives the same bits."""
        after = AxisState(**{name: array.copy() for name, array in vars(state).items()})
        n = len(samples)
        status, residual = np.empty(n, np.uint8), np.empty((n, 2))
        kernel.axis_rows(
            samples.t,
            np.ascontiguousarray(np.stack([getattr(samples, s) for s in (*_SIGNALS, "T")], axis=1)),
            after.last,
            after.memory,
            after.filtered,
            after.M,
            after.b,
            after.squares,
            after.counts,
            after.theta,
            after.errors,
            after.score,
            after.scores,
            _SPLINE.table,
            _SPLINE.breaks,
            self._geometry_numbers,
            self._settings,
            _PLACES,
            status,
            residual,
        )
        return after, AxisTrace(status, residual)

    @property
    def row_s(self) -> float:
        """Time from row to row, s."""
        return max(1.0, round(_ROW_S / self.period_s)) * self.period_s

    @cached_property
    def _geometry_numbers(self) -> Floats:
        g = self.geometry
        return np.array([g.A_A, g.A_B, g.stroke_mm, g.dead_A_l, g.dead_B_l])

    @cached_property
    def _settings(self) -> Floats:
        share = -math.expm1(-2.0 * math.pi * self.filter_hz * self.period_s)
        forget = math.exp(-self.period_s / self.memory_s)
        stride = round(self.row_s / self.period_s)
        spool = spool_transition(self.spool_hz, self.period_s / kernel.PARTS)
        return np.array(
            [
                self.period_s,
                0.5 * self.play_percent,
                *spool,
                0.0,
                0.0,
                share,
                forget,
                self.lowest_bar,
                self.margin_mm,
                _LONGEST * self.period_s,
                max(1.0, round(_SETTLING_S / self.period_s)),
                max(1.0, round(_BLOCK_S / (stride * self.period_s))),
                stride,
                max(1.0, round(_FADED / (2.0 * math.pi * self.filter_hz * self.period_s))),
                *_WALTHER,
            ]
        )


def spool_transition(hz: float, step_s: float) -> tuple[float, float, float, float]:
    """Return the transition of a spool's deviation and speed over a step, row by row.

    >>> spool_transition(math.inf, 0.01)
    (0.0, 0.0, 0.0, 0.0)
    """
    if math.isinf(hz):
        return 0.0, 0.0, 0.0, 0.0
    omega = 2.0 * math.pi * hz
    decay, swing = SPOOL_DAMPING * omega, omega * math.sqrt(1.0 - SPOOL_DAMPING**2)
    e, c, s = math.exp(-decay * step_s), math.cos(swing * step_s), math.sin(swing * step_s)
    return (
        e * (c + decay / swing * s),
        e * s / swing,
        -e * omega * omega / swing * s,
        e * (c - decay / swing * s),
    )


@dataclass(frozen=True)
class AxisFit:
    """The coefficients (n,), their covariance (n, n), and what they were fitted with.

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
        return np.asarray(edge_regressors(U, dp) @ self.theta[_columns(edge)])

    def flow_std(self, edge: str, U: ArrayLike, dp: ArrayLike) -> Floats:
        """Return the standard deviation of :meth:`flow`, l/min.

        A spline cannot follow a corner within one of its intervals: the third differences of its
        coefficients tell how far it may be off.
        """
        X, own = edge_regressors(U, dp), _columns(edge)
        random = np.einsum("...i,ij,...j->...", X, self.covariance[own, own], X)
        corner = _CORNER * (np.abs(X[..., :-1]) @ self.bends(edge))
        return np.asarray(np.sqrt(random + corner**2))

    def bends(self, edge: str) -> Floats:
        """Return the largest third difference near each spline coefficient, (KNOTS - 1,).

        In l/min/√bar. Where K has a corner, it is the jump of its slope times the knots' distance.
        """
        third = np.abs(np.diff(self.theta[_columns(edge)][:-1], 3))
        worst = np.maximum.reduce([np.pad(third, (k, 3 - k)) for k in range(4)])
        return np.asarray(worst)

    @property
    def bulk_modulus(self) -> tuple[float, float]:
        """β and its standard deviation, GPa."""
        inverse, std = self._common(0)
        return 1.0 / inverse, math.hypot(std / inverse**2, _ASSUMED / inverse)

    @property
    def leakage(self) -> tuple[float, float]:
        """Leakage c at 40 °C (without T: as it is) and its standard deviation, l/min/bar."""
        value, std = self._common(1)
        return kernel.PER_LEAKAGE * value, kernel.PER_LEAKAGE * math.hypot(std, _ASSUMED * value)

    @property
    def air(self) -> tuple[float, float]:
        """Free air at atmospheric pressure and its standard deviation, %."""
        return self._common(2)

    def _common(self, number: int) -> tuple[float, float]:
        place = SIZE - kernel.COMMON + number
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
    return max(fits, key=lambda found: found.evidence)


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
        middle = 0.5 * (scores + M / sigma2)  # halfway: blocks of few visits tell little
        covariance = covariance @ (middle + P) @ covariance
    return AxisFit(
        regression, theta, covariance, math.sqrt(loss / rows), together, loss, float(evidence)
    )


def with_theta(state: AxisState, theta: Floats) -> AxisState:
    """Return the state with coefficients for the residuals of the next samples."""
    return replace(state, theta=np.ascontiguousarray(theta))


def _prior(slope: float) -> Floats:
    """Return the prior's precision (n, n)."""
    P = np.zeros((SIZE, SIZE))
    for edge in range(len(EDGES)):
        at = edge * KNOTS
        for j, bend in enumerate(_SPLINE.bends):
            row = np.zeros(SIZE)
            row[at + j : at + j + 3] = bend / slope
            P += np.outer(row, row)
        own = np.arange(at, at + KNOTS - 1)
        P[own, own] += _COEFFICIENT_SIZE**-2
        P[at + KNOTS - 1, at + KNOTS - 1] = _DEPARTURE_SIZE**-2
    sizes = np.array([_COMPLIANCE_SIZE, _LEAKAGE_SIZE, _AIR_SIZE])
    common = np.arange(SIZE - kernel.COMMON, SIZE)
    P[common, common] = sizes**-2.0
    return P


def leakage_share(T: float) -> float:
    """Return the leakage at T (°C) over that at 40 °C; 1 where T is not a number.

    >>> round(leakage_share(60.0), 2), leakage_share(math.nan)
    (2.23, 1.0)
    """
    share = float(kernel.thinness(T, *_WALTHER))
    return share if math.isfinite(share) else 1.0


def _columns(edge: str) -> slice:
    at = EDGES.index(edge) * KNOTS
    return slice(at, at + KNOTS)


def edge_regressors(U: ArrayLike, dp: ArrayLike) -> Floats:
    """Return an edge's regressors, (..., KNOTS)."""
    y, drop = np.broadcast_arrays(np.abs(np.asarray(U, np.float64)), np.asarray(dp, np.float64))
    y = np.minimum(y, BREAKS[-1])
    s = np.copysign(np.sqrt(np.abs(drop)), drop)
    low = np.clip(np.searchsorted(BREAKS, y, side="right") - 1, 0, len(BREAKS) - 2)
    off = y - BREAKS[low]
    X = np.zeros((*y.shape, KNOTS))
    powers = np.stack([np.ones_like(off), off, off * off], axis=-1)
    for b in range(3):
        values = np.sum(_SPLINE.table[low, b] * powers, axis=-1) * s
        np.put_along_axis(X, (low + b)[..., None], values[..., None], axis=-1)
    X[..., KNOTS - 1] = 0.01 * y * s * (np.abs(s) / kernel.ROOT - 1.0)
    return X


def _walther(nu_40: float, nu_100: float) -> tuple[float, float]:
    """Return a and b of lg lg(ν + 0.7) = a - b·lg(T in K) from two viscosities, mm²/s."""
    at_40, at_100 = (math.log10(math.log10(nu + kernel.WALTHER_SHIFT)) for nu in (nu_40, nu_100))
    lg_40, lg_100 = (math.log10(T + kernel.KELVIN) for T in (40.0, 100.0))
    b = (at_40 - at_100) / (lg_100 - lg_40)
    return at_40 + b * lg_40, b


_WALTHER: Final = _walther(46.0, 6.8)  # mm²/s; ISO VG 46 with a viscosity index near 100
_SPLINE: Final = spline_axis(BREAKS)
_PLACES: Final = np.array(
    [
        [*range(2 * KNOTS), *range(SIZE - kernel.COMMON, SIZE)],
        [*range(2 * KNOTS, 4 * KNOTS), *range(SIZE - kernel.COMMON, SIZE)],
    ],
    dtype=np.int64,
)
_COMPARED_VARIANCE: Final = 0.01  # (l/min)²; of residuals, for the prior's weight
_COMPARED_PRIOR: Final = _prior(_SLOPES[2])
