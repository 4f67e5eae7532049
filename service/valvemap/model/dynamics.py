"""Dynamics of spool and flow meter, fitted together with the static map. Pure.

The model is in :mod:`~valvemap.model.spool_model`, its search in
:mod:`~valvemap.model.spool_fit`; here the samples are chosen, and the result is judged.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.model import spool_fit as fit
from valvemap.model import spool_model as spool
from valvemap.model.samples import Floats, Samples
from valvemap.model.spool_model import Grid, Hold, Point
from valvemap.vocabulary.dynamics import DynamicsStatus
from valvemap.vocabulary.statuses import Quality, Status

LEAST_HZ: Final = 90.0  # Hz; slower samples do not show a spool
LEAST_S: Final = 10.0  # s of samples
GAP: Final = 5.0  # periods without a sample; a longer one separates two stretches
STILL_PERCENT: Final = 1.0  # of U: what moves less does not move
TRAVERSES: Final = (
    10.0  # times its own range, that U must travel: few moves do not separate dynamics from misfit
)
EARLY: Final = 1.5  # periods by which flow may seem to precede U: one is that of the sampling
UNSURE: Final = 0.3  # relative standard deviation above which f or ζ is not determined
UNSURE_S: Final = 0.02  # s; the same for times
COLOUR_S: Final = 0.1  # s; over which residuals of a misfit hang together


@dataclass(frozen=True)
class Quantity:
    """An estimate with its standard deviation; NaN and UNEXCITED if the samples do not tell it."""

    value: float = math.nan
    std: float = math.nan
    status: Status = Status.UNEXCITED

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval."""
        return self.value - 1.96 * self.std, self.value + 1.96 * self.std


@dataclass(frozen=True)
class NotFitted:
    """Why there are no dynamics, in a sentence."""

    status: DynamicsStatus
    sentence: str


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
    play_percent
        Play of the spool, where the flow tells one; else 0.
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
    play_percent: float = 0.0

    def flow(self, U: Floats, dp: Floats) -> Floats:
        """Static flow at (U, Δp), both (N,), l/min."""
        s = np.sign(dp) * np.sqrt(np.abs(dp)) / self.axis[2]
        return np.asarray(spool.static_columns(U, s, self.axis) @ self.theta)

    def step_response(self, seconds: float = 0.3) -> tuple[Floats, Floats]:
        """Return times (s) and the spool's travel, %, after a step of ``step_percent``."""
        return spool.response(self._point, self.step_percent, seconds)

    def frequency_response(self, f: Floats) -> tuple[Floats, Floats]:
        """Return magnitude (dB) and phase (degrees) from U to the spool at f (N,), Hz.

        Of movements too small to reach the slew limit.
        """
        p = self._point
        ratio = f / p.f
        real, imaginary = 1.0 - ratio**2, 2.0 * p.zeta * ratio
        phase = -np.arctan2(imaginary, real) - 2.0 * np.pi * f * p.dead
        return -10.0 * np.log10(real**2 + imaginary**2), np.degrees(phase)

    @property
    def _point(self) -> Point:
        slew, dead = self.slew.value, self.dead_time.value
        return Point(
            self.natural_frequency.value,
            self.damping.value,
            slew if math.isfinite(slew) else spool.NO_SLEW,
            dead if math.isfinite(dead) else 0.0,
            0.0,
        )


def fit_dynamics(samples: Samples) -> Dynamics | NotFitted:
    """Fit the dynamics of a valve, or say why that is not possible.

    Parameters
    ----------
    samples
        N samples at 100 Hz or more: steps, PRBS or machine work. The longest stretch without a gap
        is used; 10 s at least.

    Examples
    --------
    >>> fit_dynamics(Samples.empty()).sentence
    '0 usable samples are too few: 10 s at 90 Hz are needed'
    """
    good = samples[samples.quality != Quality.BAD]
    good = good[np.isfinite(good.U) & np.isfinite(good.dp) & np.isfinite(good.Q)]
    if len(good) < 2:
        return _too_few(len(good))
    period = float(np.median(np.diff(good.t))) * 1e-9
    if not 0.0 < period <= 1.0 / LEAST_HZ:
        why = f"one sample every {1e3 * period:.3g} ms is too slow: 100 Hz are needed"
        return NotFitted(DynamicsStatus.TOO_SLOW, why)
    good = _longest_stretch(good, period)
    if len(good) * period < LEAST_S or len(good) < LEAST_S * LEAST_HZ:
        return _too_few(len(good))
    span = float(np.ptp(good.U))
    if span < STILL_PERCENT or float(np.abs(np.diff(good.U)).sum()) < TRAVERSES * span:
        return NotFitted(DynamicsStatus.UNEXCITED, DynamicsStatus.UNEXCITED.sentence)
    return _judged(*fit.best_point(good, period))


def _too_few(n: int) -> NotFitted:
    why = f"{n} usable samples are too few: {LEAST_S:g} s at {LEAST_HZ:g} Hz are needed"
    return NotFitted(DynamicsStatus.WAITING, why)


def _longest_stretch(samples: Samples, period: float) -> Samples:
    gaps = np.flatnonzero(np.diff(samples.t) > GAP * period * 1e9) + 1
    ends = np.concatenate([[0], gaps, [len(samples)]])
    k = int(np.argmax(np.diff(ends)))
    return samples[int(ends[k]) : int(ends[k + 1])]


def _judged(grid: Grid, p: Point) -> Dynamics:
    """Decide by profile likelihood which parameters are determined; give standard deviations."""
    unlimited, S_unlimited = fit.descend(grid, replace(p, slew=spool.NO_SLEW), fixed=(spool.SLEW,))
    r, S, theta = spool.residual(grid, p)
    noise2 = S / max(len(r) - spool.COLUMNS - spool.FREE, 1)
    free = [j for j in range(spool.FREE) if j not in p.fixed]
    P = _spread(grid, p, r, noise2, free)
    flat = fit.FLAT * noise2 * fit.colour(r, grid.period)
    has_slew = math.sqrt(P[2, 2]) < UNSURE and S_unlimited - S > flat
    if not has_slew:
        p = unlimited
        r, S, theta = spool.residual(grid, p)
        P = _spread(grid, p, r, noise2, [j for j in free if j != spool.SLEW])
    std = np.sqrt(np.maximum(P.diagonal(), 0.0))
    step = float(np.abs(np.diff(grid.U)).max()) if grid.hold is Hold.CONSTANT else 0.0
    step = max(step, 0.1 * float(np.ptp(grid.U)))
    gain = spool.static_residual(grid) - S
    follows = p.dead + 1.96e-3 * std[3] > -EARLY * grid.period
    lags = (
        follows
        and gain > fit.FLAT * noise2 * fit.colour(r, grid.period)
        and p.f < fit.SEEN / grid.period
    )
    f = _quantity(p.f, p.f * std[0], known=lags and std[0] < UNSURE and p.f < 0.9 * spool.FASTEST)
    zeta = _quantity(p.zeta, p.zeta * std[1], known=f.status is Status.OK and std[1] < UNSURE)
    return Dynamics(
        natural_frequency=f,
        damping=zeta,
        slew=_quantity(p.slew, p.slew * std[2], known=lags and has_slew),
        dead_time=_quantity(p.dead, 1e-3 * std[3], known=lags and 1e-3 * std[3] < UNSURE_S),
        meter_lag=_quantity(p.lag, 1e-3 * std[4], known=lags and 1e-3 * std[4] < UNSURE_S),
        T90=_rise(p, P, step, known=zeta.status is Status.OK),
        step_percent=step,
        noise=math.sqrt(noise2),
        hold=grid.hold,
        theta=theta,
        axis=grid.axis,
        play_percent=p.play,
    )


def _spread(grid: Grid, p: Point, r: Floats, noise2: float, free: list[int]) -> Floats:
    """Return the covariance of all numbers; those that are not free have none."""
    P = np.zeros((spool.FREE, spool.FREE))
    J = fit.jacobian(grid, p.free, r, free)
    P[np.ix_(free, free)] = _covariance(J, r, noise2, grid.period)
    return P


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
    wider = np.sqrt(np.maximum(coloured.diagonal() / np.maximum(white.diagonal(), spool.TINY), 1.0))
    return np.asarray(white * np.outer(wider, wider), np.float64)


def _quantity(value: float, std: float, *, known: bool) -> Quantity:
    if not known:
        return Quantity()
    return Quantity(value, float(std), Status.OK)


def _rise(p: Point, P: Floats, step: float, *, known: bool) -> Quantity:
    """Time to 90 % of a step, with its standard deviation by the delta method."""
    if not known:
        return Quantity()
    x, at = p.free, _time_to_90(p, step)
    gradient = np.empty(spool.FREE)
    for j, size in enumerate(fit.MOVES):
        moved = x.copy()
        moved[j] += size
        gradient[j] = (_time_to_90(Point.of(moved), step) - at) / size
    return Quantity(at, math.sqrt(max(float(gradient @ P @ gradient), 0.0)), Status.OK)


def _time_to_90(p: Point, step: float) -> float:
    seconds = 2.0 * step / p.slew + 3.0 * max(p.zeta, 1.0) / p.f + max(p.dead, 0.0)
    t, x = spool.response(p, step, seconds)
    reached = np.flatnonzero(x >= 0.9 * step)
    if not len(reached):
        return seconds
    k = max(int(reached[0]), 1)
    return float(np.interp(0.9 * step, x[k - 1 : k + 1], t[k - 1 : k + 1]))
