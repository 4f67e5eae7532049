"""Evidence for operators: the coarse map of the last samples for any parameters; joint refinement.

The residual r(θ) of the coarse map, fitted for each θ, is nearly linear in the parameters nearby.
Steps of Gauss and Newton refine all of them at once; JᵀJ of the last is their precision.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import flow_evidence
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.flow_basis import Axis, axis
from valvemap.model.samples import Floats, Singles

LIMITS: Final = {paths.CHOKE: (0.2, 0.98)}
SLOWEST: Final = dict.fromkeys(
    (paths.DEAD_U, paths.LAG_U, paths.DEAD_Q, paths.AVERAGE, paths.LAG_Q),
    (0.0, 2.0 * rules.LONGEST_LAG),
)
ABRUPT: Final = (paths.STICK, paths.TOP)  # the residual is no smooth function of these
OF_SIGNALS: Final = (paths.HELD_U, paths.HELD_P, paths.HELD_Q, paths.NOISE_U)
FIXED: Final = (paths.NEWS, paths.LEAST, *OF_SIGNALS)
DAMPED: Final = (0.0, 0.1, 10.0)  # of JᵀJ's diagonal; tried in turn until a step helps


class Left(NamedTuple):
    """What a coarse map leaves.

    Mean square of the residual, how many rows count, at which phase friction began (slips); of the
    noise of U and Δp that is averaged out the variance and the covariance of neighbours; the
    residual (N,).
    """

    square: float
    rows: float
    phase: float
    averaged: float
    beside: float
    residual: Floats


class Noise(NamedTuple):
    """Mean square of a residual's innovations; φ and κ, see `kernels.flow_evidence`."""

    innovation: float
    phi: float
    kappa: float


class Evidence:
    """Log likelihoods of the rows, each computed once, for a valve of these axes."""

    def __init__(self, axis_U: Axis, axis_s: Axis, rows: Floats) -> None:
        self.rows, self.Q, self._top = rows, rows[:, paths.LEFT_Q], float(axis_s.breaks[-1])
        rows[:, paths.MEASURED_U] = rows[:, paths.LEFT_U]
        self._axis = coarse(axis_U.breaks[0], axis_U.breaks[-1])
        self._used = np.zeros(len(rows), np.bool_)
        flow_evidence.counted(rows, self._used)
        square = float(np.einsum("i,i->", self.Q, self.Q)) / max(len(rows), 1)
        self._floor = rules.MISFIT**2 * square  # no coarse map is nearer to a valve
        self.of_signals = {
            paths.HELD_U: period(rows[:, paths.STEP], rows[:, paths.LEFT_U]),
            paths.HELD_P: period(rows[:, paths.STEP], rows[:, paths.LEFT_DP]),
            paths.HELD_Q: period(rows[:, paths.STEP], rows[:, paths.LEFT_Q]),
            paths.NOISE_U: noise_where_calm(rows[:, paths.LEFT_U]),
        }
        self._as_they_were = {(0.0,) * len(OF_SIGNALS): (rows, self.of_signals[paths.NOISE_U])}
        self._known: dict[tuple[float, ...], Left] = {}
        self._noises: dict[tuple[float, ...], Noise] = {}
        self._in_phase = True  # where no operator is needed, none has a phase to be searched for
        self._in_phase = self.explains(np.zeros(paths.PARAMETERS))

    def of(self, given: Floats) -> Left:
        """What the best coarse map leaves with these parameters."""
        key = tuple(given.tolist())
        if key not in self._known:
            self._known[key] = self._fit(given)[1]
        return self._known[key]

    def noise(self, given: Floats) -> Noise:
        """White noise and slow part that are left."""
        key = tuple(given.tolist())
        if key not in self._noises:
            left, out = self.of(given), np.empty(3)
            flow_evidence.colour(left.residual, self._used, out)
            self._noises[key] = without_averaging(Noise(*map(float, out)), left)
        return self._noises[key]

    @property
    def spent(self) -> int:
        """How many fits there were."""
        return len(self._known)

    def _fit(self, given: Floats, near: Floats | None = None) -> tuple[Floats, Left]:
        b = np.zeros(flow_evidence.terms_of(self._axis)) if near is None else near.copy()
        ridge = rules.RIDGE if near is None else 1.0
        residual, out = np.empty(len(self.rows)), np.empty(5)
        flow_evidence.leftover(
            self._axis, self._top, *self._rows(given), self._used, given, ridge, self._in_phase, b,
            residual, out,
        )  # fmt: skip
        square, many, phase, averaged, beside = map(float, out)
        return b, Left(square, many, phase, averaged, beside, residual)

    def _rows(self, given: Floats) -> tuple[Floats, float]:
        """Rows with the signals as they were, where some are held or noisy; noise left of U, %."""
        key = tuple(float(given[k]) for k in OF_SIGNALS)
        if key not in self._as_they_were:
            rows = self.rows.copy()
            left = flow_evidence.as_they_were(self.rows, given, rows)
            if not given[paths.NOISE_U]:
                left = self.of_signals[paths.NOISE_U]
            self._as_they_were[key] = rows, left
        return self._as_they_were[key]

    def fill(self, given: Floats, axis_U: Axis, axis_s: Axis, theta: Singles) -> None:
        """Fill the map's coefficients with those of the coarse map."""
        flow_evidence.refine(self._axis, self._top, self._fit(given)[0], axis_U, axis_s, theta)

    def moved(self, at: Floats, k: int, axis_U: Axis, axis_s: Axis) -> Floats:
        """Derivative of the map's coefficients by parameter k, 0 where the rows do not reach."""
        above, below = around(at, k)
        near, slope = self._fit(at)[0], np.zeros(len(axis_U.sites) * len(axis_s.sites))
        b = (self._fit(above, near)[0] - self._fit(below, near)[0]) / (above[k] - below[k])
        flow_evidence.refine(self._axis, self._top, b, axis_U, axis_s, slope)
        return slope

    def gain(self, better: Floats, than: Floats) -> float:
        """Log likelihood ratio: what is left is white noise and a slow part."""
        one, other = self.noise(better), self.noise(than)
        return self._ratio(one.innovation, other.innovation, self.of(better).rows)

    def whitened(self, x: Floats, noise: Noise) -> Floats:
        """Innovations of what adds to a residual of that noise (N,)."""
        out = np.empty(len(x))
        flow_evidence.innovations(x, self._used, noise.phi, noise.kappa, out)
        return out

    def gain_if_white(self, better: Floats, than: Floats) -> float:
        """Log likelihood ratio of white noise."""
        one, other = self.of(better), self.of(than)
        return self._ratio(one.square, other.square, one.rows)

    def explains(self, at: Floats) -> bool:
        """Whether hardly more than white noise is left."""
        noise = rules.EXPLAINED * noise_of(self.Q) ** 2
        return bool(self.of(at).square < max(noise, self._floor))

    def _ratio(self, one: float, other: float, rows: float) -> float:
        one, other = one + self._floor, other + self._floor
        return 0.5 * rows * math.log(other / one) if one > 0.0 and other > 0.0 else 0.0


def without_averaging(noise: Noise, left: Left) -> Noise:
    """The noise, had none of U and Δp been averaged out.

    The mean square of a residual has that already, as if all of it were white. Its innovations
    Σ w_k·r_(i-k) have more of it: Σ w_k² of its variance, Σ w_k·w_(k+1) of what neighbours share.
    """
    phi, kappa = noise.phi, noise.kappa
    first, rest = -phi * kappa, phi * (1.0 - kappa)  # w_1, and w_(k+1)/w_k from there on
    later = first**2 / max(1.0 - rest**2, 1e-9)
    alone, shared = 1.0 + later, first + later * rest
    innovation = noise.innovation * (1.0 - left.averaged / max(left.square, 1e-300))
    return Noise(innovation + alone * left.averaged - 2.0 * shared * left.beside, phi, kappa)


def period(steps: Floats, x: Floats) -> float:
    """How long each value is held of a signal that comes more rarely than others, s; 0: it is not.

    A value may rest for several periods, but hardly for less than one.
    """
    moments = np.cumsum(steps)[1:][np.diff(x) != 0.0]
    spans = np.diff(moments)
    if len(spans) < rules.FEWEST_HELD:
        return 0.0
    short = spans[spans <= rules.LATEST_VALUE * np.quantile(spans, rules.SHORT_SPANS)]
    held = float(np.mean(short))
    is_longer = held > rules.HELD_STEPS * float(np.median(steps))
    return held if is_longer and held <= rules.LONGEST_HELD else 0.0


def noise_where_calm(x: Floats) -> float:
    """Standard deviation of a signal's noise about straight lines, where it is calmest.

    The steps of a signal whose values last several rows are no noise.
    """
    once = x[np.diff(x, prepend=math.nan) != 0.0]
    noise = min(_where_calm(x), _where_calm(once) if 2 * len(once) <= len(x) else math.inf)
    return noise if math.isfinite(noise) else 0.0


def _where_calm(x: Floats) -> float:
    size = rules.CALM_STRETCH
    parts = x[: len(x) // size * size].reshape(-1, size)
    if not len(parts):
        return math.inf
    line = np.vander(np.linspace(-1.0, 1.0, size), 2)
    off = parts - parts @ np.linalg.pinv(line).T @ line.T
    calmest = np.quantile(np.sum(off**2, axis=1), rules.CALMEST) / rules.OF_CALMEST
    return math.sqrt(calmest) if calmest > rules.NO_NOISE**2 else 0.0


def new_readings(rows: Floats) -> NDArray[np.bool_]:
    """Rows (N,) in which the meter shows a new reading: all, unless it is held."""
    new = np.ones(len(rows), np.bool_)
    if period(rows[:, paths.STEP], rows[:, paths.LEFT_Q]) > 0.0:
        new[1:] = np.diff(rows[:, paths.LEFT_Q]) != 0.0
    return new


def noise_of(Q: Floats) -> float:
    """Standard deviation of white noise in readings, from their second differences."""
    new = np.flatnonzero(np.diff(Q)) + 1
    Q = Q[new] if 2 * len(new) < len(Q) else Q  # a meter that repeats its readings
    bends = np.abs(Q[2:] - 2.0 * Q[1:-1] + Q[:-2])
    return float(rules.MEDIAN_TO_STD * np.median(bends) / math.sqrt(6.0)) if len(bends) else 0.0


def coarse(low: float, high: float) -> Axis:
    """Axis of the coarse map."""
    size = max(abs(low), abs(high))
    shares = size * np.array(rules.SHARES_COARSE)
    breaks = np.concatenate([-shares[:0:-1], shares]) if low < 0.0 else shares
    return axis(breaks)


def with_value(at: Floats, k: int, value: float) -> Floats:
    """Parameters with another value of parameter k."""
    other = at.copy()
    other[k] = value
    return other


def smooth(at: Floats) -> list[int]:
    """Parameters that are there, on which the residual depends smoothly."""
    return [int(k) for k in np.flatnonzero(at) if k not in ABRUPT + FIXED]


def slopes(evidence: Evidence, at: Floats) -> Floats:
    """Derivatives of the residual by the `smooth` parameters (N, p)."""
    J = np.empty((len(evidence.rows), len(smooth(at))))
    for n, k in enumerate(smooth(at)):
        above, below = around(at, k)
        J[:, n] = evidence.of(above).residual - evidence.of(below).residual
        J[:, n] /= above[k] - below[k]
    return J


def around(at: Floats, k: int) -> tuple[Floats, Floats]:
    """Parameters with somewhat more and with somewhat less of parameter k."""
    step = rules.DIFFERENCE * at[k]
    return limited(at, k, at[k] + step), limited(at, k, at[k] - step)


def limited(at: Floats, k: int, value: float) -> Floats:
    """Parameters with another value of k, within its bounds."""
    low, high = LIMITS.get(k, SLOWEST.get(k, (0.0, math.inf)))
    return with_value(at, k, min(max(value, low), high))


def jointly(evidence: Evidence, at: Floats) -> Floats:
    """The likeliest parameters nearby."""
    for _ in range(rules.REFINEMENTS):
        before = at
        at = _abruptly(evidence, _newton(evidence, at))
        if not evidence.gain_if_white(at, before) > rules.LIKELIER:
            break
    return at


def solved(A: Floats, b: Floats, damped: float = 0.0) -> Floats:
    """A⁻¹·b of a symmetric A whose diagonal grows by a share; 0 where it is 0."""
    diagonal = np.diagonal(A)
    held = np.where(diagonal > 0.0, (damped + rules.RIDGE) * diagonal, 1.0)
    return np.linalg.solve(A + np.diag(held), b)


def precision(evidence: Evidence, at: Floats) -> Floats:
    """Inverse covariance of the map's parameters (OF_MAP, OF_MAP), 0 for those that are fixed."""
    J, ks = slopes(evidence, at), smooth(at)
    noise, A = evidence.noise(at), np.zeros((paths.OF_MAP, paths.OF_MAP))
    for n in range(len(ks)):
        J[:, n] = evidence.whitened(J[:, n].copy(), noise)
    A[np.ix_(ks, ks)] = np.einsum("ij,ik->jk", J, J) / max(noise.innovation, 1e-300)
    return A


def _newton(evidence: Evidence, at: Floats) -> Floats:
    ks = smooth(at)
    if not ks:
        return at
    J = slopes(evidence, at)
    A, b = np.einsum("ij,ik->jk", J, J), np.einsum("ij,i->j", J, evidence.of(at).residual)
    for damped in DAMPED:
        moved = -solved(A, b, damped)
        tried = at
        for n, k in enumerate(ks):
            most = 0.5 * at[k]
            tried = limited(tried, k, at[k] + min(max(float(moved[n]), -most), most))
        if evidence.gain_if_white(tried, at) > 0.0:
            return tried
    return at


def _abruptly(evidence: Evidence, at: Floats) -> Floats:
    """Refine the parameters on which the residual depends by jumps, one after another."""
    for k in (k for k in ABRUPT if at[k]):
        for step in rules.ABRUPT_STEPS:
            for factor in (step, 1.0 / step):
                at = _climbed(evidence, at, k, factor)
    return at


def _climbed(evidence: Evidence, at: Floats, k: int, times: float) -> Floats:
    """Change parameter k, which stays above 0, as long as the rows become likelier."""
    while True:
        tried = limited(at, k, at[k] * times)
        if not 0.0 < tried[k] != at[k] or not evidence.gain_if_white(tried, at) > 0.0:
            return at
        at = tried
