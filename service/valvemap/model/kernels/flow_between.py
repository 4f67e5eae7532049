"""What is not known of a row of `flow_evidence` whose place lies between two rows, or is a mean.

A dead time ends between two rows, where spool and root are on a straight line or beside it. Such a
row has the variance c·(σ² + e), with e that of its flow by the coarse map. Its residual is divided
by √(1 + e/σ²) and multiplied by the geometric mean of these: its mean square is the likelihood.

A value between two rows, and a mean of several, has less of the noise of U and pressures than one
at a row. A dead time that ends halfway would leave less, and so would a meter that averages; a
hysteresis keeps noise from the spool. What U's noise is, where it is never calm, is not known: what
of it passes is in the residual, and bounds it. With n the
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
# Columns of places on the way: spool and share of the largest root; of the variance of U's noise
# what filters keep; what both places may be off by; the parts of their noise that are averaged out
SPOOL, SHARE, KEPT, OFF_U, OFF_S, NOISE_U, NOISE_S = range(7)
WAYS = 7


@maker
def weigh(
    axis: Axis, b: Floats, ways: Floats, used: np.ndarray, noise: float, residual: Floats,
    scale: Floats, averaged: Floats,
) -> tuple[float, bool]:  # fmt: skip
    """Weigh the rows by their variance, the residual in place; σ² and whether it is as it was."""
    N, many, square, work = len(residual), 0, 0.0, np.empty(3)
    loose, most = np.zeros(N), 0.0
    for i in range(N):
        if used[i]:
            many, square, way = many + 1, square + residual[i] ** 2, ways[i]
            loose[i] = _beside(axis, b, way, way[OFF_U], way[OFF_S], work)
            averaged[i] = _beside(axis, b, way, way[NOISE_U], way[NOISE_S], work)
            most = max(most, loose[i])
    noise = noise if noise > 0.0 else max(square / max(many, 1), 1e-300)
    likeliest, logs, by, left = math.inf, 0.0, 1.0, noise
    for factor in rules.NOISE_STEPS:
        if most == 0.0 and factor != 1.0:
            break  # no place is uncertain: σ² is of no matter
        total, square, limit = 0.0, 0.0, math.inf
        for k_step in range(rules.ROBUST_STEPS):
            square = 0.0
            for i in range(N):
                if used[i]:
                    ratio = 1.0 + loose[i] / (factor * noise)
                    total += math.log(ratio) if k_step == 0 and ratio > 1.0 else 0.0
                    square += min(residual[i] ** 2 / ratio, limit)
            limit = rules.MOST_STAY**2 * square / max(many, 1)
        value = total / max(many, 1) + math.log(max(square, 1e-300))
        if value < likeliest:
            likeliest, logs, by = value, total / max(many, 1), factor
            left = max(square / max(many, 1), 1e-300)
    noise *= by
    passed = 0.0  # what of the averaged noise is left; it is in the residual, so it is no more
    for i in range(N):
        if averaged[i] > 0.0:
            kept = ways[i, KEPT]
            passed += averaged[i] * kept / max(1.0 - kept, 1e-9) / max(many, 1)
    averaged *= min(left / max(passed, 1e-300), 1.0)
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
    return max(rules.MOST_STAY * rules.TENTH_TO_STD * tenth(bends), 2.0 * rounded_to(x))


@maker
def noise_of(x: Floats, steps: Floats) -> float:
    """Standard deviation of white noise, from second differences; at least that of rounding."""
    bends = np.abs(x[2:] - 2.0 * x[1:-1] + x[:-2])
    if len(bends) == 0:
        return 0.0
    return max(rules.TENTH_TO_STD * tenth(bends) / math.sqrt(6.0), rounding_of(x, steps))


@inner
def rounded_to(x: Floats) -> float:
    """Least step of a signal all of whose steps are multiples of it; 0: it is not rounded."""
    least = math.inf
    for i in range(len(x) - 1):
        step = abs(x[i + 1] - x[i])
        least = step if 0.0 < step < least else least
    if least == math.inf:
        return 0.0
    for i in range(len(x) - 1):
        step = abs(x[i + 1] - x[i])
        if abs(step - least * np.rint(step / least)) > rules.OFF_ROUNDED * least:
            return 0.0
    return float(least)


@inner
def rounding_of(x: Floats, steps: Floats) -> float:
    """Standard deviation of a signal's rounding error, as far as it shows while it moves.

    White noise of the variance step²/12 bends a signal that moves by step²/2 in the mean square. A
    command that continues by equal steps is bent at turns alone; its steps are its own. Moves with
    a rest between, which lasts ``rules.LONGEST_HELD`` s at least, may be those of a slow signal.
    """
    step, square, many, since = rounded_to(x), 0.0, 0, math.inf
    if step == 0.0:
        return 0.0
    before = 0.0  # the last move, ``since`` s ago
    for i in range(1, len(x)):
        since += steps[i]
        if x[i] != x[i - 1]:
            move = x[i] - x[i - 1]
            if since <= rules.LONGEST_HELD:
                square += min(abs(move - before), step) ** 2
                many += 1
            before, since = move, 0.0
    shown = square / many / 6.0 if many else math.inf
    return math.sqrt(min(shown, step * step / 12.0))


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
def kept_by_spool(step: float, of_U: float, given: Floats) -> float:
    """Of the variance of white noise of U, ``of_U`` %, the part that hysteresis and lag let pass.

    A hysteresis stops what is narrower than half of it.
    """
    half, kept = given[paths.PLAY] + given[paths.STICK] + given[paths.RELAYS], 1.0
    if half > 0.0 and of_U > 0.0:
        kept = max(1.0 - half / of_U, 0.0) ** 2
    return float(kept * _kept_by_lag(step, given[paths.LAG_U]))


@inner
def kept_by_meter(step: float, given: Floats) -> float:
    """Of the variance of white noise, the part that a meter's mean and lag leave."""
    kept = 1.0
    if 0.0 < step < given[paths.AVERAGE]:
        kept = step / given[paths.AVERAGE]
    return float(kept * _kept_by_lag(step, given[paths.LAG_Q]))


@inner
def beside(kept: float) -> float:
    """Covariance of neighbours in filtered white noise, as a share of the variance it has lost.

    Exact behind a lag of first order; a value between two rows has ½, a mean ``kept``.
    """
    return kept / (1.0 + kept)


@inner
def _kept_by_lag(step: float, lag: float) -> float:
    of_last = math.exp(-step / lag) if lag > 0.0 else 0.0
    return (1.0 - of_last) / (1.0 + of_last)


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
