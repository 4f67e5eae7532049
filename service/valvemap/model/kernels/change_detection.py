"""Detection of abrupt plant changes: a score test on the new part of the residuals.

Let d be the new part of a sample's residual (:mod:`valvemap.model.kernels.places`), and z = d over
the standard deviation of white noise. The score b = Σ w·z·x of the last hundred or so samples is
the direction in which theta would move, and T = bᵀV⁻¹b, V = Σ x·xᵀ, its significance. Without a
change, T is at most χ² with n degrees of freedom. Wilson and Hilferty's transform converts it to
standard deviations for any n.

d contains no misfit that was measured before. Other correlated parts of d could accumulate without
any change. Within a visit these are the error of the place's memory and misfit between the nodes
(variance LOCAL); over the whole window they are slow noise, lag, and wear since the last visit
(variance COMMON). The weight of a sample is reduced so that b varies, in the worst case, no more
than with white noise. The variance of white noise is half the mean square of the difference of
consecutive d, in which common parts cancel.

Only one of several samples is tested. An outlier with respect to theta makes the test use all
samples for a while. That does not change the result, but the detection is earlier.
"""

import numpy as np

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.place_layout import CLIP, PROVEN, Remembered
from valvemap.model.kernels.place_visits import noise_lasts
from valvemap.model.kernels.places import POWER_MEMORY, shake
from valvemap.model.kernels.row_layout import (
    ATTENTIVE,
    CHANGES,
    COMMON,
    COUNT,
    EVIDENCE,
    FLOOR,
    FLOOR_WEIGHT,
    HASTE,
    LAST_D,
    LOCAL,
    MISFIT,
    MISFIT_POWER,
    POWER,
    REVISITED,
    SAMPLE,
    SIZE,
    SUM,
    SUMMED,
    SUSPECT_SAMPLE,
    SUSPECT_TIME,
    SUSPECTED,
    SWEPT,
    TIME,
    VISIT_LENGTH,
    Counts,
    Places,
    Size,
)
from valvemap.model.kernels.rules import Rule
from valvemap.model.kernels.scores import ROUNDING, is_coloured
from valvemap.model.kernels.triangles import add_square, squared_length
from valvemap.model.samples import Floats

WINDOW = 1.0 / 100.0
IN_WINDOW = 60.0  # of 2/WINDOW, the squared sum of the weights over the sum of their squares: a
# part that is constant over the window may add 3n to T, far below any threshold
IN_SWEEP = 1.0  # looks; a sweep of neighbours prolongs a visit by this
IN_VISIT = 2.5  # the same for each sample of the current visit
SETTLED = 20.0
FEWEST_BETWEEN = 8  # looks between two changes, at least
MISFIT_HERE = 10.0  # limit of misfit at one place, times its mean square
FITS = 0.1  # times the noise: misfit below which theta is used at unknown places
MISFIT_UNSEEN = 0.02  # times the noise: undetectable misfit
TINY = 1e-300
FIRST = 1500  # samples; earlier changes are part of the first identification
PATIENCE = 300  # samples after which a suspicion is dismissed as noise
EXPERIENCE = 100.0  # looks at known places, before which no change is detected
STARTLING = 36.0  # times the mean square of residuals: more than drift in one step
UNEXPECTED = 10.0  # times its variance: limit of the squared new part by chance
ATTENTION = 32.0  # looks after an outlier
SUSPICIOUS = 3.0  # standard deviations of a suspicion

_KEEP = 1.0 - WINDOW


def value_of(deviations: float, n: int) -> float:
    """T for a number of standard deviations (Wilson, Hilferty: its cube root is nearly normal)."""
    spread = 2.0 / (9.0 * n)
    return float(n * max(0.0, 1.0 - spread + deviations * np.sqrt(spread)) ** 3)


@inlined
def lasts(s: Floats, g: int) -> bool:
    """Whether noise clearly lasts, so that consecutive samples carry no independent information."""
    return is_coloured(s, g) and noise_lasts(s, g)


@inlined
def attend(s: Floats, g: int) -> None:
    """Test every sample for a while, after an outlier in a steady plant."""
    if s[g + REVISITED] >= EXPERIENCE and s[g + HASTE] <= PROVEN and not lasts(s, g):
        s[g + ATTENTIVE] = ATTENTION


@inlined
def weigh(
    size: Size, s: Floats, at: Places, d: float, e: float, y: float, r: float, count: int
) -> None:
    """Add a sample to the score.

    Parameters
    ----------
    size, s, at
        The row: regressor in ``x``; ``score``, ``variance`` and ``detector`` are written.
    d, e, y, r
        New part of its residual, NaN at unknown places; innovation; flow; xᵀPx.
    count
        Samples so far.
    """
    g = at.detector
    step = d - s[g + LAST_D]
    s[g + LAST_D] = d
    if not np.isnan(step):
        square = 0.5 * step * step + ROUNDING * y * y
        if s[g + SUSPECTED] > 0.0:
            square = s[g + FLOOR]
        elif s[g + FLOOR_WEIGHT] > SETTLED:
            square = min(square, CLIP * CLIP * s[g + FLOOR])
        s[g + FLOOR_WEIGHT] += 1.0 - s[g + FLOOR_WEIGHT] / POWER_MEMORY
        s[g + FLOOR] += (square - s[g + FLOOR]) / s[g + FLOOR_WEIGHT]
    local = s[g + LOCAL] if not np.isnan(step) else np.inf
    if s[g + MISFIT_POWER] > 0.0:  # where the structure fits, theta is more accurate than the place
        misfit = max(0.0, s[g + MISFIT])
        doubt = MISFIT_HERE * misfit + MISFIT_UNSEEN * s[g + MISFIT_POWER] + r * s[g + POWER]
        if not np.isnan(step):
            doubt += (e - d) * (e - d)
        elif s[g + REVISITED] < EXPERIENCE or misfit > FITS * s[g + MISFIT_POWER]:
            doubt = np.inf  # unknown place
        if doubt < local:
            local = doubt
            d = e
    if local == np.inf or s[g + FLOOR_WEIGHT] <= SETTLED or count < FIRST or r == 0.0:
        return
    # During drift, theta lags; the new part does not, beyond COMMON.
    unexpected = d * d > UNEXPECTED * (s[g + FLOOR] + local + s[g + COMMON])
    if unexpected and s[g + REVISITED] >= EXPERIENCE and not lasts(s, g):
        s[g + ATTENTIVE] = ATTENTION
    s[g + SUM] += d
    s[g + SUMMED] += 1.0
    alike = s[g + VISIT_LENGTH] + IN_SWEEP * s[g + SWEPT]
    doubt = IN_WINDOW * s[g + COMMON] + IN_VISIT * alike * local
    z = d / np.sqrt(s[g + FLOOR] + doubt + ROUNDING * y * y + TINY)
    z = min(max(z, -CLIP), CLIP)
    s[g + EVIDENCE] = _KEEP * s[g + EVIDENCE] + 1.0
    for j in range(len(size)):
        s[at.score + j] = _KEEP * s[at.score + j] + z * s[at.x + j]
    add_square(size, s, at.variance, at.x, _KEEP * _KEEP)


@inlined
def has_changed(
    size: Size,
    s: Floats,
    at: Places,
    own: Remembered,
    counters: Counts,
    t: int,
    rule: Rule,
    every: int,
) -> bool:
    """Return whether the plant has changed, and if so, reset the evidence; called after each look.

    Parameters
    ----------
    size, s, at, own, counters
        State, written in place.
    t
        Time of the last sample.
    every
        Stride of looks without suspicion.
    """
    n = len(size)
    g = at.detector
    if s[g + EVIDENCE] < 0.9 * FEWEST_BETWEEN:
        return False

    T = squared_length(size, s, at.score, at.variance, at.f, at.Px, at.L)
    if not rule.suspicious <= T:  # also for NaN: no evidence
        counters[SUSPECT_SAMPLE] = counters[COUNT] + 1
        counters[SUSPECT_TIME] = t
        s[g + SUM] = 0.0
        s[g + SUMMED] = 0.0
        s[g + SUSPECTED] = 0.0
    elif counters[COUNT] - counters[SUSPECT_SAMPLE] < PATIENCE and s[g + FLOOR_WEIGHT] > EXPERIENCE:
        s[g + SUSPECTED] = 1.0  # a possible change must not affect the noise estimate
    else:
        s[g + SUSPECTED] = 0.0
    # Under suspicion every sample is tested, unless noise lasts: it would be counted repeatedly.
    s[g + ATTENTIVE] = max(s[g + ATTENTIVE] - 1.0, s[g + SUSPECTED])
    if s[g + ATTENTIVE] > 0.0 and lasts(s, g):
        s[g + ATTENTIVE] = 0.0
    if not rule.threshold < T:
        return False
    # T has grown linearly since the change; extrapolate to the looks before the suspicion.
    before = s[g + SUMMED] * rule.suspicious / max(T - rule.suspicious, TINY)
    apart = every if s[g + ATTENTIVE] <= 1.0 else 1  # the first one was an outlier
    since = counters[SUSPECT_SAMPLE] - int(apart * min(before, 0.5 / WINDOW))
    counters[CHANGES] += 1
    counters[SAMPLE] = max(since, 1)
    counters[TIME] = counters[SUSPECT_TIME]
    s[g + SIZE] = s[g + SUM] / max(1.0, s[g + SUMMED])
    for place in (EVIDENCE, SUM, SUMMED, SUSPECTED, ATTENTIVE, REVISITED):
        s[g + place] = 0.0
    for j in range(n):
        s[at.score + j] = 0.0
    shake(own)
    return True
