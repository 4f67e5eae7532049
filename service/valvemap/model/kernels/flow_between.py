"""What is not known of a row of `flow_evidence` whose place lies between two rows, or is a mean.

A dead time ends between two rows, where spool and root are on a straight line or beside it. Such a
row has the variance c·(σ² + e), with e that of its flow by the coarse map. Its residual is divided
by √(1 + e/σ²) and multiplied by the geometric mean of these: its mean square is the likelihood.

A value between two rows, and a mean of several, has less of the pressures' noise than one at a row.
A dead time that ends halfway would leave less, and so would a meter that averages. With n the
variance of the flow by the noise that is averaged out, and s² the mean square of the residual, the
residual is multiplied by √(1 + n/s²) besides.
"""

import math

import numpy as np

from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, maker
from valvemap.model.kernels.flow_basis import Axis, interval, values
from valvemap.model.samples import Floats

ALONG_S = 3  # functions of s of the coarse map
# Columns of places on the way: spool and share of the largest root; what both may be off by; the
# part of the root's noise that is averaged out
SPOOL, SHARE, OFF_U, OFF_S, NOISE_S = range(5)
WAYS = 5


@maker
def weigh(
    axis: Axis, b: Floats, ways: Floats, used: np.ndarray, noise: float, residual: Floats,
    scale: Floats,
) -> tuple[float, bool]:  # fmt: skip
    """Weigh the rows by their variance, the residual in place; σ² and whether it is as it was."""
    N, many, square, work = len(residual), 0, 0.0, np.empty(3)
    loose, averaged = np.zeros(N), np.zeros(N)
    for i in range(N):
        if used[i]:
            many, square, way = many + 1, square + residual[i] ** 2, ways[i]
            loose[i] = _beside(axis, b, way, way[OFF_U], way[OFF_S], work)
            averaged[i] = _beside(axis, b, way, 0.0, way[NOISE_S], work)
    noise = noise if noise > 0.0 else max(square / max(many, 1), 1e-300)
    likeliest, logs, by, left = math.inf, 0.0, 1.0, noise
    for factor in rules.NOISE_STEPS:
        total, square, limit = 0.0, 0.0, math.inf
        for k_step in range(rules.ROBUST_STEPS):
            square = 0.0
            for i in range(N):
                if used[i]:
                    ratio = 1.0 + loose[i] / (factor * noise)
                    total += math.log(ratio) if k_step == 0 else 0.0
                    square += min(residual[i] ** 2 / ratio, limit)
            limit = rules.MOST_STAY**2 * square / max(many, 1)
        value = total / max(many, 1) + math.log(max(square, 1e-300))
        if value < likeliest:
            likeliest, logs, by = value, total / max(many, 1), factor
            left = max(square / max(many, 1), 1e-300)
    noise *= by
    for i in range(N):
        if used[i]:
            calm = left / (left + averaged[i])
            scale[i] = 1.0 / (1.0 + loose[i] / noise)
            residual[i] *= math.sqrt(scale[i] / calm) * math.exp(0.5 * logs)
    return noise, by == 1.0


@inner
def bends(x: Floats, at: int, base: int, share: float, usual: float) -> float:
    """Standard deviation of ``x`` from the straight line, at a share of the way to the next row.

    A corner between two rows, at κ of the way, bends the signal by 1 - κ of its size at the older
    one, by κ at the newer one, and is off by κ·(1 - κ) of it. A corner elsewhere bends it at one
    row, and not between them. Bends up to ``usual`` are noise. The signal goes one way.
    """
    older, newer = x[at], x[at + 1]
    before = x[at - 1] if at > base else older
    at_older = abs(newer - 2.0 * older + before)
    at_newer = abs(x[at + 2] - 2.0 * newer + older) if at + 2 < len(x) else at_older
    at_older, at_newer = max(at_older - usual, 0.0), max(at_newer - usual, 0.0)
    both = at_older + at_newer
    if both == 0.0:
        return 0.0
    corner = 4.0 * share * (1.0 - share) * at_older * at_newer / both
    return float(min(corner, paths.one_way(older, newer, share)))


@maker
def usual_bend(x: Floats) -> float:
    """Second difference by which noise, or two of its smallest steps, bend a signal at most."""
    bends = np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2])
    if len(bends) == 0:
        return 0.0
    least = math.inf
    for i in range(len(x) - 1):
        step = abs(x[i + 1] - x[i])
        least = step if 0.0 < step < least else least
    least = least if least < math.inf else 0.0
    return max(rules.MOST_STAY * rules.TENTH_TO_STD * tenth(bends), 2.0 * least)


@maker
def noise_of(x: Floats) -> float:
    """Standard deviation of white noise, from second differences."""
    bends = np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2])
    if len(bends) == 0:
        return 0.0
    return rules.TENTH_TO_STD * tenth(bends) / math.sqrt(6.0)


@inner
def tenth(x: Floats) -> float:
    """The tenth quantile of values, which are reordered (Hoare 1961: FIND).

    That of numpy compiles for 8 s.
    """
    rank = 0.1 * (len(x) - 1)
    k, low, high = int(rank), 0, len(x) - 1
    while low < high:
        pivot, i, j = x[(low + high) // 2], low, high
        while i <= j:
            while x[i] < pivot:
                i += 1
            while x[j] > pivot:
                j -= 1
            if i <= j:
                x[i], x[j] = x[j], x[i]
                i, j = i + 1, j - 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    after = x[k]
    for i in range(k + 1, len(x)):
        after = x[i] if i == k + 1 else min(after, x[i])
    return float(x[k] + (rank - k) * (after - x[k]))


@inner
def kept(share: float) -> float:
    """Of the variance of white noise, the part that a value on the way between two rows has."""
    return float(1.0 - 2.0 * share * (1.0 - share))


@inner
def kept_by_meter(step: float, given: Floats) -> float:
    """Of the variance of white noise, the part that a meter's mean and lag leave."""
    kept = 1.0
    if 0.0 < step < given[paths.AVERAGE]:
        kept = step / given[paths.AVERAGE]
    if given[paths.LAG_Q] > 0.0:
        of_last = math.exp(-step / given[paths.LAG_Q])
        kept *= (1.0 - of_last) / (1.0 + of_last)
    return float(kept)


@inner
def _beside(
    axis: Axis, b: Floats, way: Floats, du: float, ds: float, work: Floats
) -> float:  # fmt: skip
    """Variance of the coarse map's flow where spool and share of the root have du and ds."""
    total = 0.0
    if du + ds == 0.0:
        return 0.0
    flow = _flow(axis, b, way[SPOOL], way[SHARE], work)
    for of_u, of_s in ((du, 0.0), (0.0, ds)):
        most = 0.0
        for sign in (-1.0, 1.0):
            x = min(max(way[SPOOL] + sign * of_u, axis.breaks[0]), axis.breaks[-1])
            y = min(max(way[SHARE] + sign * of_s, -1.0), 1.0)
            most = max(most, abs(_flow(axis, b, x, y, work) - flow))
        total += most * most
    return total


@inner
def _flow(axis: Axis, b: Floats, u: float, share: float, work: Floats) -> float:
    """Flow of the coarse map."""
    k, flow = interval(axis, u), b[ALONG_S * len(axis.sites)]
    values(axis, k, u, 0.0, work)
    for a in range(3):
        at = ALONG_S * (k + a)
        along = share * (b[at] + abs(share) * b[at + 1] + b[at + 2] / (abs(share) + rules.LAMINAR))
        flow += work[a] * along
    return float(flow)
