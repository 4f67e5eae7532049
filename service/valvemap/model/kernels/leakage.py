"""The loop of `Leakage`: recursive least squares on the samples of a closed valve."""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.samples import Floats, Segments, Times
from valvemap.vocabulary.statuses import Status

# Places in `sums`: of x = -Δp, U and Q; residuals squared, by the one before, and their weight.
XX, XU, UU, XQ, UQ, RR, R_BEFORE, WEIGHT = 0, 1, 2, 3, 4, 5, 6, 7
LAST = 8  # l/min; the last residual
SUMS = 9
# Places in `counts`: closed samples; UTC ns of the first of the present rest, 0: it is open.
CLOSED, SINCE = 0, 1
COUNTS = 2

SETTLED_NS = 100_000_000  # rest after which a lagging meter shows the closed valve
KEPT = 1.0 - 1.0 / 20_000.0  # of the sums, per closed sample
USUAL_C, USUAL_G = 0.02, 0.1  # l/min/bar, l/min/%; standard deviations before the first sample
FEW = 20  # closed samples below which nothing is known
FEWER = 5  # below which the leakage counts as 0
CLIPPED = 4.0  # standard deviations at which a residual's weight ends
FEW_CLIPPED = 50  # samples from which residuals are clipped
KNOWN = 0.25  # largest share of `USUAL_C` of a standard deviation that is determined

_OK, _WARMING_UP, _REJECTED = int(Status.OK), int(Status.WARMING_UP), int(Status.REJECTED)
_HUGE = 1e9


@inner
def solve(sums: Floats, counts: Times) -> tuple[float, float, float]:
    """Leakage c (l/min/bar), its standard deviation, and the opening's slope g (l/min/%)."""
    if counts[CLOSED] < FEWER or sums[WEIGHT] <= 0.0:
        return 0.0, USUAL_C, 0.0
    variance = max(sums[RR] / sums[WEIGHT], 1e-12)
    xx = sums[XX] + variance / USUAL_C**2
    uu = sums[UU] + variance / USUAL_G**2
    det = xx * uu - sums[XU] * sums[XU]
    c = (uu * sums[XQ] - sums[XU] * sums[UQ]) / det
    g = (xx * sums[UQ] - sums[XU] * sums[XQ]) / det
    rho = min(max(sums[R_BEFORE] / max(sums[RR], 1e-12), 0.0), 0.98)
    std = math.sqrt(variance * uu / det * (1.0 + rho) / (1.0 - rho))
    return c, min(std, USUAL_C), g


@lean_kernel
def parameters(sums: Floats, counts: Times, out: Floats) -> None:
    """Write c and its standard deviation, NaN while nothing is known."""
    out[0], out[1], _ = solve(sums, counts)
    if counts[CLOSED] < FEW:
        out[0] = out[1] = math.nan


@lean_kernel
def used(sums: Floats, counts: Times, out: Floats) -> None:
    """Write c and its standard deviation as they are used, before anything is known, too."""
    out[0], out[1], _ = solve(sums, counts)


@lean_kernel
def learn(
    t: Times, U: Floats, dp: Floats, Q: Floats, usable: np.ndarray, closed: float, sums: Floats,
    counts: Times, predicted: Floats, residual: Floats, status: np.ndarray, segments: Segments,
) -> None:  # fmt: skip
    """Learn from the segments' samples; ``sums`` (M, SUMS) and ``counts`` (M, COUNTS)."""
    for k in range(len(segments.members)):
        m = segments.members[k]
        for i in range(segments.starts[k], segments.stops[k]):
            predicted[i] = residual[i] = math.nan
            known = math.isfinite(U[i] + dp[i] + Q[i])
            if not usable[i] or not known or max(abs(U[i]), abs(dp[i]), abs(Q[i])) > _HUGE:
                status[i] = _REJECTED
                continue
            status[i] = _learn(
                t[i], U[i], dp[i], Q[i], closed, sums[m], counts[m], i, predicted, residual
            )


@inner
def _learn(
    t: int, U: float, dp: float, Q: float, closed: float, sums: Floats, counts: Times, i: int,
    predicted: Floats, residual: Floats,
) -> int:  # fmt: skip
    """Predict the leakage at one sample, then learn if the valve is closed; give the status."""
    c, std, g = solve(sums, counts)
    predicted[i] = -c * dp
    known = counts[CLOSED] >= FEW and std < KNOWN * USUAL_C
    if abs(U) > closed:
        counts[SINCE] = 0
    elif counts[SINCE] == 0 or t < counts[SINCE]:
        counts[SINCE] = max(t, 1)
    elif t - counts[SINCE] >= SETTLED_NS:
        r = Q + c * dp - g * U
        residual[i] = r
        if counts[CLOSED] >= FEW_CLIPPED:
            limit = CLIPPED * math.sqrt(sums[RR] / sums[WEIGHT])
            r = min(max(r, -limit), limit)
            Q = r - c * dp + g * U
        for place in range(WEIGHT + 1):
            sums[place] *= KEPT
        sums[XX] += dp * dp
        sums[XU] -= dp * U
        sums[UU] += U * U
        sums[XQ] -= dp * Q
        sums[UQ] += U * Q
        sums[RR] += r * r
        sums[R_BEFORE] += r * sums[LAST]
        sums[WEIGHT] += 1.0
        sums[LAST] = r
        counts[CLOSED] += 1
    return _OK if known else _WARMING_UP
