"""The inverse of a cubic tensor spline in U: exact for each piece, without sampling."""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.kernels.spline import basis, hats
from valvemap.model.samples import Floats
from valvemap.vocabulary.statuses import InverseStatus

FALL = 0.05
STEPS = 60

_OK, _ABOVE, _BELOW = (
    int(InverseStatus.OK),
    int(InverseStatus.ABOVE_REACH),
    int(InverseStatus.BELOW_REACH),
)
_NOT_MONOTONE, _UNIDENTIFIED = int(InverseStatus.NOT_MONOTONE), int(InverseStatus.UNIDENTIFIED)


@kernel
def invert(
    knots_U: Floats,
    knots_s: Floats,
    nodes_T: Floats,
    theta: Floats,
    Q: Floats,
    dp: Floats,
    T: Floats,
    U: Floats,
    unclipped: Floats,
    slope: Floats,
    status: np.ndarray,
) -> None:
    """Fill U (the smallest on a rising branch), U without its bounds, dQ/dU there and the status.

    Along U the map is a cubic between breaks. A piece whose coefficients are all on one side of Q
    is skipped (convex hull); any other is split at its extrema and searched by Newton's method
    within brackets.
    """
    to_powers, spans = _power_forms(knots_U)
    n_U = len(knots_U) - 4
    along, cubic = np.empty(n_U), np.empty(4)
    for i in range(len(Q)):
        size = _section(knots_s, nodes_T, theta, dp[i], T[i], along)
        U[i] = unclipped[i] = slope[i] = math.nan
        if not math.isfinite(size):
            status[i] = _UNIDENTIFIED
            continue
        tolerance = 1e-13 * max(size, abs(Q[i]))
        _powers(to_powers, spans, along, 0, cubic)
        start, start_slope = cubic[0], cubic[1] / (knots_U[spans[0] + 4] - knots_U[spans[0] + 3])
        found = -1.0
        if abs(start - Q[i]) <= tolerance and start_slope >= -tolerance:
            found, slope[i] = knots_U[3], start_slope
        k = 0
        while found < 0.0 and k < len(spans):
            j = spans[k]
            highest = max(along[j], along[j + 1], along[j + 2], along[j + 3])
            lowest = min(along[j], along[j + 1], along[j + 2], along[j + 3])
            if highest >= Q[i] - tolerance and lowest < Q[i]:
                _powers(to_powers, spans, along, k, cubic)
                t = _rise(cubic, Q[i], tolerance)
                if t >= 0.0:
                    width = knots_U[j + 4] - knots_U[j + 3]
                    found = knots_U[j + 3] + t * width
                    slope[i] = (cubic[1] + t * (2.0 * cubic[2] + t * 3.0 * cubic[3])) / width
            k += 1
        if found >= 0.0:
            U[i] = unclipped[i] = found
            status[i] = _OK
            continue
        highest, lowest = -math.inf, math.inf
        for k in range(len(spans)):
            _powers(to_powers, spans, along, k, cubic)
            highest, lowest = _extremes(cubic, highest, lowest)
        end = cubic[0] + cubic[1] + cubic[2] + cubic[3]
        dip = FALL * (highest - lowest)
        if highest < Q[i] and end >= highest - dip:
            j = spans[len(spans) - 1]
            status[i], U[i] = _ABOVE, knots_U[n_U]
            slope[i] = (cubic[1] + 2.0 * cubic[2] + 3.0 * cubic[3]) / (
                knots_U[j + 4] - knots_U[j + 3]
            )
            unclipped[i] = U[i] + (Q[i] - end) / slope[i]
        elif lowest > Q[i] and start <= lowest + dip:
            status[i], U[i], slope[i] = _BELOW, knots_U[3], start_slope
            unclipped[i] = U[i] + (Q[i] - start) / slope[i]
        else:
            status[i] = _NOT_MONOTONE


@kernel
def variances(
    knots_U: Floats,
    knots_s: Floats,
    nodes_T: Floats,
    covariance: Floats,
    without: int,
    U: Floats,
    dp: Floats,
    T: Floats,
    out: Floats,
) -> None:
    """Variance of Q̂ at N points from the covariance of all n_U·n_s·n_T parameters.

    The first ``without`` functions of s are not among the parameters.
    """
    n_s, n_T = len(knots_s) - 4 - without, max(1, len(nodes_T))
    in_U, in_s, slope, in_T = np.empty(4), np.empty(4), np.empty(4), np.empty(2)
    at, x = np.empty(32, np.int64), np.empty(32)
    for i in range(len(U)):
        first_U = basis(knots_U, U[i], in_U, slope)
        first_s = basis(knots_s, math.copysign(math.sqrt(abs(dp[i])), dp[i]), in_s, slope)
        first_T = hats(nodes_T, T[i], in_T)
        count = 0
        for a in range(4):
            for b in range(max(0, without - first_s), 4):
                for c in range(min(2, n_T)):
                    at[count] = ((first_U + a) * n_s + first_s - without + b) * n_T + first_T + c
                    x[count] = in_U[a] * in_s[b] * in_T[c]
                    count += 1
        total = 0.0
        for a in range(count):
            along = 0.0
            for b in range(a):
                along += x[b] * covariance[at[a], at[b]]
            total += x[a] * (2.0 * along + x[a] * covariance[at[a], at[a]])
        out[i] = total


@maker
def _section(
    knots_s: Floats, nodes_T: Floats, theta: Floats, dp: float, T: float, along: Floats
) -> float:
    """Fill the map's coefficients along U at one (dp, T); return the largest, NaN if any is."""
    in_s, slope, in_T = np.empty(4), np.empty(4), np.empty(2)
    first_s = basis(knots_s, math.copysign(math.sqrt(abs(dp)), dp), in_s, slope)
    first_T = hats(nodes_T, T, in_T)
    size = 0.0
    for a in range(len(along)):
        total = 0.0
        for b in range(4):
            for c in range(min(2, theta.shape[2])):
                total += in_s[b] * in_T[c] * theta[a, first_s + b, first_T + c]
        along[a] = total
        size = max(size, abs(total)) if math.isfinite(total) else math.nan
        if not math.isfinite(size):
            return math.nan
    return size


@maker
def _power_forms(knots: Floats) -> tuple[Floats, np.ndarray]:
    """For each non-empty span: the matrix (4, 4) from its coefficients to powers of t."""
    n = len(knots) - 4
    spans = np.array([j for j in range(n - 3) if knots[j + 4] > knots[j + 3]])
    forms = np.empty((len(spans), 4, 4))
    value, slope, f = np.empty(4), np.empty(4), np.empty((4, 4))
    for k in range(len(spans)):
        left, right = knots[spans[k] + 3], knots[spans[k] + 4]
        for p in range(4):
            # Inside the span, so that the basis is that of this span at both its ends.
            first = basis(knots, left + (right - left) * (p + 0.5) / 4.0, value, slope)
            for r in range(4):
                f[p, r] = value[r] if first == spans[k] else math.nan
        for r in range(4):
            d1, d2 = f[1, r] - f[0, r], f[2, r] - 2.0 * f[1, r] + f[0, r]
            d3 = f[3, r] - 3.0 * f[2, r] + 3.0 * f[1, r] - f[0, r]
            # Newton's forward form in u = 4·t - 1/2, written in powers of t.
            c1, c2, c3 = d1 - d2 / 2.0 + d3 / 3.0, d2 / 2.0 - d3 / 2.0, d3 / 6.0
            forms[k, 0, r] = f[0, r] - c1 / 2.0 + c2 / 4.0 - c3 / 8.0
            forms[k, 1, r] = 4.0 * (c1 - c2 + 0.75 * c3)
            forms[k, 2, r] = 16.0 * (c2 - 1.5 * c3)
            forms[k, 3, r] = 64.0 * c3
    return forms, spans


@inner
def _powers(forms: Floats, spans: np.ndarray, along: Floats, k: int, cubic: Floats) -> None:
    for p in range(4):
        total = 0.0
        for r in range(4):
            total += forms[k, p, r] * along[spans[k] + r]
        cubic[p] = total


@inner
def _at(cubic: Floats, t: float) -> float:
    total: float = cubic[0] + t * (cubic[1] + t * (cubic[2] + t * cubic[3]))
    return total


@inner
def _turns(cubic: Floats) -> tuple[float, float]:
    """Extrema of the cubic, ascending, clipped to [0, 1]."""
    a, b, c = 3.0 * cubic[3], cubic[2], cubic[1]
    root_2 = b * b - a * c
    if not root_2 > 0.0:
        return 0.0, 1.0
    q = -(b + math.copysign(math.sqrt(root_2), b))
    first, second = (c / q, q / a) if a != 0.0 else (c / q, math.inf)
    low, high = min(first, second), max(first, second)
    return min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)


@inner
def _extremes(cubic: Floats, highest: float, lowest: float) -> tuple[float, float]:
    first, second = _turns(cubic)
    for t in (0.0, first, second, 1.0):
        f = _at(cubic, t)
        highest, lowest = max(highest, f), min(lowest, f)
    return highest, lowest


@inner
def _rise(cubic: Floats, Q: float, tolerance: float) -> float:
    """Smallest t in [0, 1] at which the cubic rises through Q; -1 if there is none."""
    first, second = _turns(cubic)
    a, fa = 0.0, cubic[0] - Q
    for piece in range(3):
        b = first if piece == 0 else (second if piece == 1 else 1.0)
        fb = _at(cubic, b) - Q
        if fa < 0.0 and fb >= -tolerance:
            return b if fb <= 0.0 else _root(cubic, Q, tolerance, a, b)
        a, fa = b, fb
    return -1.0


@inner
def _root(cubic: Floats, Q: float, tolerance: float, low: float, high: float) -> float:
    """Newton's method between low (below Q) and high (above Q), bisection where it leaves them."""
    t = 0.5 * (low + high)
    for _ in range(STEPS):
        f = _at(cubic, t) - Q
        if abs(f) <= 0.05 * tolerance or high - low <= 4e-16:
            break
        if f < 0.0:
            low = t
        else:
            high = t
        t -= f / (cubic[1] + t * (2.0 * cubic[2] + t * 3.0 * cubic[3]))
        if not low < t < high:
            t = 0.5 * (low + high)
    return t
