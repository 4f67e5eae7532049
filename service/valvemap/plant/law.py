r"""The orifice law as a test of an assignment: Q = f(U) · sign(Δp) √|Δp|.

f is a broken line through quantiles of U, so the scales of U and Q do not matter; a first-order lag
of the flow meter and a play of the spool are chosen from a few. The test compares the variance that
the law leaves with the variance of Q, both no smaller than the noise of Q: its change from sample
to sample, or what the law leaves, if that is less.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

KNOTS: Final = (0.0, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85)  # shares of the samples below each
LAGS_S: Final = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0)  # s, of a flow meter
_FINER: Final = (1.25, 1.12)  # times the best lag, and of those again
PLAYS: Final = (0.02, 0.04, 0.07)  # of the span of U, between command and spool
LEAST_ROWS: Final = 20  # samples; fewer test nothing
_RIDGE: Final = 1e-6
_NO_WEIGHT: Final = 1e-17  # of an earlier sample: less changes no double
_CLEAR_DP: Final = 1.0  # bar
_CLEAR_FLOW: Final = 0.1  # of the largest flow
_CLEAR_NOISE: Final = 5.0  # times the noise of the flow
_NOISE_STEPS: Final = 6.0**0.5 * 0.6745  # of the median of second differences
_MOVES: Final = 0.02  # of its largest value: a part that moves
_CLEAR_SHARE: Final = 0.05  # of the largest Δp; smaller ones are raised to this
_ENDS: Final = (0.1, 0.9)  # shares of the samples below
_TELLS: Final = 2.0  # times more is left without U, if U tells something of the flow
_FALLS: Final = 0.7  # share of the flow at the lower end
_LEAST_NOISE: Final = 0.04  # of the spread of Q: the least residual of a law of these parts
LEAST_LEFT: Final = _LEAST_NOISE**2  # share of the variance of Q that each fit leaves


@dataclass(frozen=True)
class Fit:
    """Result of the test: variances (squared unit of Q), and the share of reversed samples.

    ``residual`` is the remaining variance less the least noise; ``freed`` the same if the pressures
    may have an offset and other weights (``parts_freed``), as those of another place, or in another
    scale, would. ``parts_beside`` is the number of parts that other valves add to the law and that
    move. A flow that ``falls`` while the valve opens is not explained.
    """

    left: float
    total: float
    noise: float
    reversed_share: float
    rows: int
    residual: float = 0.0
    freed: float = 0.0
    parts_freed: int = 1
    parts_beside: int = 0
    falls: bool = False

    @property
    def explained(self) -> float:
        """The explained share of the variance of Q; NaN if Q does not move."""
        if not self.moves:
            return float("nan")
        return max(0.0, 1.0 - max(self.left - self.noise, 0.0) / (self.total - self.noise))

    @property
    def misfit(self) -> float:
        """What the law leaves beyond the noise, as a share of the spread of Q; 0 without test.

        The pressures have noise, too, and that of Q is an estimate: it counts twice.
        """
        if not self.moves:
            return 0.0
        noise = 2.0 * self.noise - LEAST_LEFT * self.total
        return float(np.sqrt(max(self.left - noise, 0.0) / self.total))

    @property
    def moves(self) -> bool:
        """Whether Q moves by more than its noise."""
        return self.rows >= LEAST_ROWS and self.total > 4.0 * self.noise + 1e-12


NOT_TESTED: Final = Fit(0.0, 0.0, 0.0, 0.0, 0)


def fit(
    U: Floats,
    dp: Floats,
    Q: Floats,
    step_s: float,
    beside: Sequence[tuple[Floats, Floats]] = (),
    p1: Floats | None = None,
) -> Fit:
    """Fit the law to N samples at equal steps; NaN are left out.

    ``beside`` are U and Δp of other valves whose flows are in Q, too. With ``p1``, another weight
    of it than that of p2 is tried, too.

    >>> t = np.linspace(0, 20, 400)
    >>> U, dp = 50 + 40 * np.sin(t), 90 + 60 * np.sin(0.7 * t)
    >>> bool(fit(U, dp, 0.05 * U * dp**0.5, 0.05).explained > 0.99)
    True
    >>> bool(fit(U, dp, 0.05 * dp * U**0.5 - U, 0.05).explained > 0.9)
    False
    """
    good = np.isfinite(Q)
    for signal in ((U, dp), *beside):
        good &= np.isfinite(signal[0]) & np.isfinite(signal[1])
    if good.sum() < LEAST_ROWS:
        return NOT_TESTED
    U, dp, Q = U[good], dp[good], Q[good]
    total = float(np.var(Q))
    others = [part for U2, dp2 in beside for part in _parts(U2[good], dp2[good])]
    lags = [lag / step_s for lag in LAGS_S if lag < len(Q) * step_s or lag == 0.0]
    columns = _columns(U, dp, others)
    best = min((_fitted(U, columns, Q, lag) for lag in lags), key=lambda one: one.left)
    for step in _FINER if best.lag else ():
        near = (best.lag / step, best.lag * step)
        best = min(best, *(_fitted(U, columns, Q, lag) for lag in near),
                   key=lambda one: one.left)  # fmt: skip
    for play in PLAYS:
        spool = _played(U, play * float(np.ptp(U)))
        other = _fitted(spool, _columns(spool, dp, others), Q, best.lag)
        best = min(best, other, key=lambda one: one.left)
    U, columns, lag, weights = best.U, best.columns, best.lag, best.weights
    rows, parts = columns.shape
    own = columns[:, : parts - len(others)]
    left = best.left * rows / max(rows - parts - 1, 1)
    residual, noise = left, min(noise_variance(Q), left) + _LEAST_NOISE**2 * total
    moving = sum(float(part.std()) > _MOVES * float(np.abs(part).max()) for part in others)
    without_U, _ = _least_squares(_lagged(columns[:, [0]], lag), Q)
    falls = without_U > _TELLS * max(left, noise) and _falls(U, weights[: own.shape[1]])
    return Fit(
        left=total if falls else max(left, noise),
        total=total,
        noise=min(noise, total),
        reversed_share=0.0 if beside else _reversed_share(dp, Q),
        rows=rows,
        residual=residual,
        freed=_freed(best, dp, Q, None if p1 is None else p1[good]) if not others else residual,
        parts_freed=1 if p1 is None else 2,
        parts_beside=moving,
        falls=falls,
    )


class _Fitted(NamedTuple):
    """Mean square of the residuals, and the data of the fit."""

    left: float
    weights: Floats
    columns: Floats
    U: Floats
    lag: float


def _columns(U: Floats, dp: Floats, others: Sequence[Floats]) -> Floats:
    return np.stack([*_parts(U, dp), *others], axis=1)


def _fitted(U: Floats, columns: Floats, Q: Floats, lag: float) -> _Fitted:
    left, weights = _least_squares(_lagged(columns, lag), Q)
    return _Fitted(left, weights, columns, U, lag)


def _freed(best: _Fitted, dp: Floats, Q: Floats, p1: Floats | None) -> float:
    """Return the residuals if the pressures may have an offset, and p1 another weight than p2.

    To first order: √(Δp + a + b·p1) = √Δp + (a + b·p1) / (2 √Δp).
    """
    f = np.stack(_parts(best.U, np.ones_like(dp)), axis=1) @ best.weights
    size = np.abs(dp)
    slope = f / np.sqrt(np.maximum(size, _CLEAR_SHARE * size.max()) + 1e-12)
    more = [slope] if p1 is None else [slope, slope * (p1 - p1.mean())]
    columns = np.column_stack([best.columns, *more])
    left, _ = _least_squares(_lagged(columns, best.lag), Q)
    rows, parts = columns.shape
    return float(left * rows / max(rows - parts - 1, 1))


def _played(U: Floats, width: float) -> Floats:
    """Return the middle of a spool that follows N values of U through a play of this width."""
    half, found, at = width / 2.0, [], float(U[0])
    for u in U.tolist():
        if at < u - half:
            at = u - half
        elif at > u + half:
            at = u + half
        found.append(at)
    return np.array(found)


def moves(values: Floats) -> bool:
    """Whether N finite values at equal steps move by more than their noise.

    >>> moves(np.sin(np.arange(50) / 5)), moves(np.ones(50))
    (True, False)
    """
    return (
        len(values) >= LEAST_ROWS and float(np.var(values)) > 4.0 * noise_variance(values) + 1e-12
    )


def quantile(values: Floats, share: float) -> float:
    """Return the quantile of N values, interpolated; numpy's takes ten times as long for few.

    >>> quantile(np.array([3.0, 1.0, 2.0]), 0.25)
    1.5
    """
    return quantiles(values, (share,))[0]


def quantiles(values: Floats, shares: Sequence[float]) -> list[float]:
    """Return several of them."""
    ordered = np.sort(values)
    found = []
    for share in shares:
        at = share * (len(ordered) - 1)
        low = int(at)
        below, above = float(ordered[low]), float(ordered[min(low + 1, len(ordered) - 1)])
        found.append(below + (at - low) * (above - below))
    return found


def _parts(U: Floats, dp: Floats, at: Floats | None = None) -> list[Floats]:
    """Return the parts of the law with knots among U, for U or ``at``."""
    root = np.copysign(np.sqrt(np.abs(dp)), dp)
    knots = sorted(set(quantiles(U, KNOTS)))
    there = U if at is None else at
    return [root, *(root * np.maximum(there - knot, 0.0) for knot in knots)]


def noise_variance(values: Floats) -> float:
    """Return the variance of the noise by the second differences, which a movement hardly has."""
    return (quantile(np.abs(np.diff(values, n=2)), 0.5) / _NOISE_STEPS) ** 2


def _falls(U: Floats, weights: Floats) -> bool:
    """Whether f is clearly smaller where the valve is more open; U < 0 is another direction."""
    ahead = U[U >= 0.0]
    if len(ahead) < LEAST_ROWS:
        return False
    ends = np.array([*quantiles(ahead, _ENDS), *quantiles(U, _ENDS)])
    low, high, *every = (np.stack(_parts(U, np.ones(4), ends), axis=1) @ weights).tolist()
    least = _LEAST_NOISE * max(map(abs, every))  # around U = 0 there may be nothing but noise
    return bool(high < _FALLS * low - least)


def _least_squares(columns: Floats, Q: Floats) -> tuple[float, Floats]:
    """Return the mean square of the residuals, and the weight of each column."""
    rows, parts = columns.shape
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns) / rows) + 1e-12
    X = columns / scale
    normal = X.T @ X
    normal.flat[:: parts + 1] += _RIDGE * rows
    weights = np.linalg.solve(normal, X.T @ Q)
    residual = Q - X @ weights
    return float(residual @ residual) / rows, weights / scale


def _lagged(columns: Floats, steps: float) -> Floats:
    """Filter by a first-order lag of ``steps`` samples, whose response ends after six of them.

    The sum over earlier samples is formed by doubling, in a third of a convolution's time.
    """
    if steps < 0.3:
        return columns
    decay, first, rows = np.exp(-1.0 / steps), columns[0], len(columns)
    moved = (1.0 - decay) * (columns - first)
    end = min(int(np.ceil(6.0 * steps)), rows)
    weight, shift = decay, 1
    while shift < rows and weight > _NO_WEIGHT:
        moved[shift:] += weight * moved[:-shift]
        weight, shift = weight * weight, 2 * shift
    if end < rows:
        moved[end:] -= decay**end * moved[:-end]
    return np.asarray(moved + first)


def _reversed_share(dp: Floats, Q: Floats) -> float:
    """Return the share of the samples of a clear flow against the pressures; 0 without flow."""
    least = max(
        _CLEAR_FLOW * float(np.abs(Q).max(initial=0.0)), _CLEAR_NOISE * noise_variance(Q) ** 0.5
    )
    clear = (np.abs(dp) > _CLEAR_DP) & (np.abs(Q) > least)
    if not clear.any():
        return 0.0
    return float((np.sign(dp[clear]) * np.sign(Q[clear]) < 0.0).mean())
