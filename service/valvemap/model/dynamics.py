"""Dynamics of spool and flow meter, fitted together with the static map. Pure.

    x'' = ω²·(U(t - d) - x) - 2ζω·x',  |x'| ≤ slew,  τ·y' + y = g(x, Δp),  g = Σ θ_j·φ_j(x)·ψ_j(Δp)

Nonlinear in ω = 2πf, ζ, slew, d and τ; the map is linear inside and eliminated by variable
projection (Golub and Pereyra 1973, doi 10.1137/0710036). Between samples U is either constant, as a
controller's output is, or a line, as a slow signal is. The wrong one biases f, and both fit nearly
as well: a line is taken only if it is significantly better. Δp is a line.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

import numpy as np

from valvemap.model.kernels import dynamics as kernels
from valvemap.model.samples import Floats, Samples
from valvemap.vocabulary.statuses import Quality, Status

NAMES: Final = ("NaturalFrequency", "Damping", "Slew", "DeadTime", "MeterLag")
UNITS: Final = {"NaturalFrequency": "Hz", "Damping": "1", "Slew": "%/s"}  # the others: s
STEP_S: Final = 2.5e-4  # s; of the integration
PARTS: Final = 20  # intervals of the map's B-splines along U
COLUMNS: Final = 3 * (PARTS + 2)  # of the map: B-splines times s, s·|s| and s³
BEYOND: Final = 0.2  # share of the range of U by which the spool may overshoot it
RIDGE: Final = 1e-9  # of the largest diagonal: columns without samples
LEAST_HZ: Final = 90.0  # Hz; slower samples do not show a spool
SLOWEST, FASTEST = 0.5, 200.0  # Hz; bounds of f
STARTS_HZ: Final = (4.0, 7.0, 12.0, 20.0, 35.0, 60.0, 100.0)
STARTS_LAG_S: Final = (0.003, 0.012, 0.035)
STARTS_SLEW: Final = (math.inf, 0.5, 0.25, 0.12)  # of the fastest that a full step reaches
FASTEST_STEP: Final = 240.0  # %/s per Hz of f: a full step of a spool without a limit
START_S: Final = 8.0  # s of samples on which starts are compared
KEPT: Final = 4  # starts that are continued
FLAT: Final = 8.0  # 2·log likelihood, below which a parameter is not excited
UNSURE: Final = 0.3  # relative standard deviation above which f or ζ is not determined
UNSURE_S: Final = 0.02  # s; the same for times
NO_SLEW: Final = 1e6  # %/s; no limit
COLOUR_S: Final = 0.1  # s; over which residuals of a misfit hang together
ITERATIONS: Final = 15
DONE: Final = 1e-5  # relative decrease of the sum of squares


class Hold(Enum):
    """U between two samples."""

    CONSTANT = "constant"
    LINE = "a line"


@dataclass(frozen=True)
class Quantity:
    """An estimate with its standard deviation; NaN and UNEXCITED if the samples do not tell it."""

    value: float
    std: float
    status: Status

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return self.value - 1.96 * self.std, self.value + 1.96 * self.std


@dataclass(frozen=True)
class Dynamics:
    """Result of `fit_dynamics`.

    Attributes
    ----------
    natural_frequency, damping, slew, dead_time, meter_lag, T90
        Hz, 1, %/s, s, s; T90 (s) is the time from a step of ``step_percent``, the largest that
        was seen, to 90 % of the spool's travel, dead time included, without the meter.
    noise
        Standard deviation of the residual, l/min.
    hold
        U between the samples.
    """

    natural_frequency: Quantity
    damping: Quantity
    slew: Quantity
    dead_time: Quantity
    meter_lag: Quantity
    T90: Quantity
    step_percent: float
    noise: float
    hold: Hold
    theta: Floats
    axis: tuple[float, float, float]  # first knot and distance of knots, %; largest √Δp

    def flow(self, U: Floats, dp: Floats) -> Floats:
        """Static flow at (U, Δp), both (N,), l/min."""
        low, width, top = self.axis
        s = np.sign(dp) * np.sqrt(np.abs(dp)) / top
        X = np.zeros((len(U), COLUMNS))
        for n in range(len(U)):  # a row at rest each
            row = X[n : n + 1]
            at = np.array([U[n]], np.float64)
            kernels.regressors(at, s[n : n + 1], np.zeros(4), 0.0, 0.0, low, width, PARTS, 1, row)
        return X @ self.theta

    def step_response(self, seconds: float = 0.3) -> tuple[Floats, Floats]:
        """Return times (s) and the spool's travel, %, after a step of ``step_percent``."""
        p = _Point(
            self.natural_frequency.value, self.damping.value, _known(self.slew.value, NO_SLEW),
            _known(self.dead_time.value, 0.0), 0.0,
        )  # fmt: skip
        return _response(p, self.step_percent, seconds)


@dataclass(frozen=True)
class _Point:
    """Nonlinear parameters: Hz, 1, %/s, s, s."""

    f: float
    zeta: float
    slew: float
    dead: float
    lag: float

    @property
    def free(self) -> Floats:
        """As free numbers (5,): logarithms of the first three, times in ms."""
        logs = np.log([self.f, self.zeta, self.slew])
        return np.array([*logs, 1e3 * self.dead, 1e3 * self.lag])

    @classmethod
    def of(cls, x: Floats) -> "_Point":
        """Return the point of free numbers."""
        f, zeta, slew = np.exp(x[:3])
        return cls(
            float(np.clip(f, SLOWEST, FASTEST)), float(np.clip(zeta, 0.05, 5.0)),
            float(np.clip(slew, 1.0, NO_SLEW)), 1e-3 * float(x[3]), 1e-3 * max(float(x[4]), 0.0),
        )  # fmt: skip


@dataclass(frozen=True)
class _Data:
    """Samples on a regular grid."""

    t: Floats
    U: Floats
    s: Floats
    Q: Floats
    period: float
    steps: int
    hold: Hold
    axis: tuple[float, float, float]

    @property
    def h(self) -> float:
        return self.period / self.steps


def fit_dynamics(samples: Samples) -> Dynamics | str:
    """Fit the dynamics of a valve; a sentence says why it is not possible.

    Parameters
    ----------
    samples
        N samples at 100 Hz or more: steps, PRBS or machine work, 10 s at least.
    """
    good = samples[samples.quality != Quality.BAD]
    good = good[np.isfinite(good.U) & np.isfinite(good.dp) & np.isfinite(good.Q)]
    if len(good) < 10 * LEAST_HZ:
        return f"{len(good)} usable samples are too few: 10 s at {LEAST_HZ:g} Hz are needed"
    t = (good.t - good.t[0]) * 1e-9
    period = float(np.median(np.diff(t)))
    if not 0.0 < period <= 1.0 / LEAST_HZ:
        return f"samples every {1e3 * period:.3g} ms are too seldom: 100 Hz are needed"
    if np.ptp(good.U) < 1.0:
        return "U does not move: steps, PRBS or machine work are needed"
    return _fitted(good, period)


def _data(samples: Samples, period: float, hold: Hold) -> _Data:
    n = round((samples.t[-1] - samples.t[0]) * 1e-9 / period) + 1
    own = (samples.t - samples.t[0]) * 1e-9
    t = np.arange(n) * period
    nearest = np.clip(np.searchsorted(own, t - 0.5 * period), 0, len(own) - 1)
    U, dp, Q = samples.U[nearest], samples.dp[nearest], samples.Q[nearest]
    s = np.sign(dp) * np.sqrt(np.abs(dp))
    top = max(float(np.abs(s).max()), 1e-9)
    span = float(np.ptp(U))
    low, width = float(U.min()) - BEYOND * span, (1.0 + 2.0 * BEYOND) * span / PARTS
    steps = max(math.ceil(period / STEP_S), 4)
    return _Data(t, U, s / top, Q, period, steps, hold, (low, width, top))


def _fitted(samples: Samples, period: float) -> Dynamics:
    data = _data(samples, period, Hold.CONSTANT)
    short = _first(data, START_S)
    starts = [
        _Point(f, 0.7, min(slew * FASTEST_STEP * f, NO_SLEW), 0.0, lag)
        for f in STARTS_HZ if f < 0.45 / period
        for lag in STARTS_LAG_S
        for slew in STARTS_SLEW
    ]  # fmt: skip
    best = sorted(starts, key=lambda p: _residual(short, p)[1])[:KEPT]
    point, _ = min((_descend(short, p) for p in best), key=lambda end: end[1])
    point, S = _descend(data, point)
    as_lines = replace(data, hold=Hold.LINE)
    line, S_line = _descend(as_lines, replace(point, dead=point.dead + 0.5 * period))
    if len(data.t) * math.log(S / S_line) > FLAT:
        point, data = line, as_lines
    return _judged(data, point)


def _first(data: _Data, seconds: float) -> _Data:
    n = min(round(seconds / data.period), len(data.t))
    return replace(data, t=data.t[:n], U=data.U[:n], s=data.s[:n], Q=data.Q[:n])


def _columns(data: _Data, p: _Point) -> Floats:
    """Return the map's columns behind spool and meter, (N, COLUMNS)."""
    h = data.h
    X = np.zeros((len(data.t), COLUMNS))
    left = math.exp(-h / p.lag) if p.lag > 1e-5 else 0.0
    low, width, _ = data.axis
    kernels.regressors(
        _commands(data, p.dead), data.s, _transition(p, h), p.slew * h, left, low, width, PARTS,
        data.steps, X,
    )  # fmt: skip
    return X


def _commands(data: _Data, dead: float) -> Floats:
    """Return the mean command of every step, after the dead time, %."""
    n = (len(data.t) - 1) * data.steps
    begin = np.arange(n) * data.h - dead
    if data.hold is Hold.LINE:
        return np.asarray(np.interp(begin + 0.5 * data.h, data.t, data.U))
    total = np.concatenate([[0.0], np.cumsum(data.U[:-1]) * data.period])  # ∫U, piecewise linear
    ends = np.concatenate([begin, begin[-1:] + data.h])
    before = np.minimum(ends - data.t[0], 0.0) * data.U[0]  # U was constant before the first sample
    after = np.maximum(ends - data.t[-1], 0.0) * data.U[-1]
    return np.asarray(np.diff(np.interp(ends, data.t, total) + before + after) / data.h)


def _transition(p: _Point, h: float) -> Floats:
    """Return the spool's transition of (x - U, h·x') over a step, (4,)."""
    w = 2.0 * math.pi * p.f
    A = np.array([[0.0, 1.0], [-((w * h) ** 2), -2.0 * p.zeta * w * h]])
    scaled, E = A / 64.0, np.eye(2)
    term = np.eye(2)
    for k in range(1, 9):
        term = term @ scaled / k
        E = E + term
    for _ in range(6):
        E = E @ E
    return np.ascontiguousarray(E.ravel())


def _residual(data: _Data, p: _Point) -> tuple[Floats, float, Floats]:
    """Return what the best map leaves (N,), its sum of squares, and the map."""
    X = _columns(data, p)
    G = X.T @ X
    G[np.diag_indices_from(G)] += RIDGE * G.diagonal().max() + 1e-30
    theta: Floats = np.asarray(np.linalg.solve(G, X.T @ data.Q), np.float64)
    r = data.Q - X @ theta
    return r, float(r @ r), theta


def _jacobian(data: _Data, x: Floats, r: Floats) -> Floats:
    """Return the derivatives of the projected residual by finite differences, (N, 5)."""
    J = np.empty((len(r), len(x)))
    for j, size in enumerate((1e-3, 1e-3, 1e-3, 0.02, 0.02)):
        moved = x.copy()
        moved[j] += size
        J[:, j] = (_residual(data, _Point.of(moved))[0] - r) / size
    return J


def _descend(data: _Data, p: _Point, fixed: tuple[int, ...] = ()) -> tuple[_Point, float]:
    """Levenberg-Marquardt on the free numbers; return the point and its sum of squares."""
    x, damping = p.free, 1e-2
    r, S, _ = _residual(data, p)
    free = [j for j in range(len(x)) if j not in fixed]
    for _ in range(ITERATIONS):
        J = _jacobian(data, x, r)[:, free]
        H, g = J.T @ J, J.T @ r
        scale = np.diag(H).copy() + 1e-12 * max(float(np.diag(H).max()), 1e-30)
        gained = 0.0
        for _ in range(6):
            new = x.copy()
            new[free] -= np.clip(np.linalg.solve(H + damping * np.diag(scale), g), -3.0, 3.0)
            new[4] = max(new[4], 0.0)
            new = _Point.of(new).free
            r_new, S_new, _ = _residual(data, _Point.of(new))
            if S_new < S:
                gained = (S - S_new) / S
                x, r, S, damping = new, r_new, S_new, 0.3 * damping
                break
            damping *= 5.0
        if gained < DONE:
            break
    return _Point.of(x), S


def _judged(data: _Data, p: _Point) -> Dynamics:
    """Judge by profile likelihood what the samples tell, and give standard deviations."""
    unlimited, S_unlimited = _descend(data, replace(p, slew=NO_SLEW), fixed=(2,))
    r, S, _ = _residual(data, p)
    noise2 = S / max(len(r) - COLUMNS - len(NAMES), 1)
    P = _covariance(_jacobian(data, p.free, r), r, noise2, data.period)
    slew_told = math.sqrt(P[2, 2]) < UNSURE and S_unlimited - S > FLAT * noise2 * _colour(r, data)
    if not slew_told:
        p = unlimited
    r, S, theta = _residual(data, p)
    free = [0, 1, 2, 3, 4] if slew_told else [0, 1, 3, 4]
    J = _jacobian(data, p.free, r)[:, free]
    P = np.zeros((5, 5))
    P[np.ix_(free, free)] = _covariance(J, r, noise2, data.period)
    std = np.sqrt(np.maximum(P.diagonal(), 0.0))
    step = float(np.abs(np.diff(data.U)).max()) if data.hold is Hold.CONSTANT else 0.0
    step = max(step, 0.1 * float(np.ptp(data.U)))
    f = _quantity(p.f, p.f * std[0], told=std[0] < UNSURE and p.f < 0.9 * FASTEST)
    zeta = _quantity(p.zeta, p.zeta * std[1], told=f.status is Status.OK and std[1] < UNSURE)
    return Dynamics(
        natural_frequency=f,
        damping=zeta,
        slew=_quantity(p.slew, p.slew * std[2], told=slew_told),
        dead_time=_quantity(p.dead, 1e-3 * std[3], told=1e-3 * std[3] < UNSURE_S),
        meter_lag=_quantity(p.lag, 1e-3 * std[4], told=1e-3 * std[4] < UNSURE_S),
        T90=_rise(p, P, step, told=f.status is Status.OK),
        step_percent=step,
        noise=math.sqrt(noise2),
        hold=data.hold,
        theta=theta,
        axis=data.axis,
    )


def _covariance(J: Floats, r: Floats, noise2: float, period: float) -> Floats:
    """Return the free numbers' covariance (n, n); coloured residuals widen it.

    A misfit of the map leaves residuals of one sign for a while. The sum over their neighbours
    (Newey and West 1987, doi 10.2307/1913610) replaces their variance where it is larger.
    """
    H = J.T @ J
    H[np.diag_indices_from(H)] += 1e-12 * H.diagonal().max() + 1e-30
    inverse = np.linalg.inv(H)
    many = max(round(COLOUR_S / period), 1)
    g = J * r[:, None]
    middle = g.T @ g
    for k in range(1, many):
        across = g[k:].T @ g[:-k]
        middle += (1.0 - k / many) * (across + across.T)
    white, coloured = noise2 * inverse, inverse @ middle @ inverse
    wider = np.sqrt(np.maximum(coloured.diagonal() / white.diagonal(), 1.0))
    return np.asarray(white * np.outer(wider, wider), np.float64)


def _colour(r: Floats, data: _Data) -> float:
    """Return by how much neighbours add to the variance of a mean of residuals, 1 at least."""
    many = max(round(COLOUR_S / data.period), 1)
    means = np.add.reduceat(r, np.arange(0, len(r), many))
    return max(float(means @ means / (r @ r)), 1.0)


def _quantity(value: float, std: float, *, told: bool) -> Quantity:
    if not told:
        return Quantity(math.nan, math.nan, Status.UNEXCITED)
    return Quantity(value, float(std), Status.OK)


def _rise(p: _Point, P: Floats, step: float, *, told: bool) -> Quantity:
    """Time to 90 % of a step, with its standard deviation by the delta method."""
    if not told:
        return Quantity(math.nan, math.nan, Status.UNEXCITED)
    x, at = p.free, _time_to_90(p, step)
    gradient = np.empty(5)
    for j, size in enumerate((1e-3, 1e-3, 1e-3, 0.02, 0.02)):
        moved = x.copy()
        moved[j] += size
        gradient[j] = (_time_to_90(_Point.of(moved), step) - at) / size
    return Quantity(at, math.sqrt(max(float(gradient @ P @ gradient), 0.0)), Status.OK)


def _time_to_90(p: _Point, step: float) -> float:
    seconds = 2.0 * step / p.slew + 3.0 * max(p.zeta, 1.0) / p.f + max(p.dead, 0.0)
    t, x = _response(p, step, seconds)
    reached = np.flatnonzero(x >= 0.9 * step)
    if not len(reached):
        return seconds
    k = max(int(reached[0]), 1)
    return float(np.interp(0.9 * step, x[k - 1 : k + 1], t[k - 1 : k + 1]))


def _response(p: _Point, step: float, seconds: float) -> tuple[Floats, Floats]:
    h = 0.5 * STEP_S
    n = max(math.ceil(seconds / h), 2)
    x = np.empty(n)
    kernels.spool(np.full(n, step), _transition(p, h), p.slew * h, x)
    return np.asarray(np.arange(1, n + 1) * h + p.dead, np.float64), x


def _known(x: float, otherwise: float) -> float:
    return x if math.isfinite(x) else otherwise
