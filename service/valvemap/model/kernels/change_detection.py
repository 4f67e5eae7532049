"""Has the plant changed? A score test on what is new of each residual.

With d what a sample differs from what its place is known for
(:mod:`valvemap.model.kernels.places`), and z = d over the deviation of white noise, the
score b = Σ w·z·x of the last hundred or so samples tells in which direction theta would have to
move, and T = bᵀV⁻¹b, V = Σ x·xᵀ, how sure that is: at most χ² with n degrees of freedom while the
plant stays. Wilson and Hilferty's transform makes standard deviations of it, whatever n.

d is free of misfit that has been seen before. What it still has in common from sample to sample
without any change could add up: within a visit the error of what the place is known for, and misfit
between the nodes (variance LOCAL); over the whole window slow noise, lag, and wear since the last
visit (variance COMMON). So a sample weighs less by as much as makes b vary by them, at the worst,
no more than by white noise. The variance of white noise itself is that of half the difference of
consecutive d, which knows nothing of what they have in common.

One of a few samples is looked at. One that theta did not expect makes all be looked at for a while:
what is said of the plant does not change by that, but it is said sooner.
"""

import numpy as np

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.places import (
    CLIP,
    POWER_MEMORY,
    PROVEN,
    Remembered,
    noise_lasts,
    shake,
)
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
IN_WINDOW = 60.0  # of 2/WINDOW, the squared sum of the weights over the sum of their squares: what
# is the same all along the window may add 3n to T, far below any threshold
IN_SWEEP = 1.0  # looks by which neighbours that are swept one after another prolong a visit
IN_VISIT = 2.5  # the same for the samples of a visit so far, each
SETTLED = 20.0
FEWEST_BETWEEN = 8  # looks at least from a change to the next
MISFIT_HERE = 10.0  # times its mean square that misfit may be at one place
FITS = 0.1  # times the noise: misfit below which theta is believed where no place is known
MISFIT_UNSEEN = 0.02  # times the noise that misfit may be without being seen
TINY = 1e-300
FIRST = 1500  # samples before which a map is learnt rather than changed
PATIENCE = 300  # samples after which what was suspected is taken for noise
EXPERIENCE = 100.0  # looks at places known before, before which all is noise
STARTLING = 36.0  # times the mean square of residuals: no drift comes to that in one step
UNEXPECTED = 10.0  # times its variance that the square of what is new may be by chance
ATTENTION = 32.0  # looks that follow a startling sample
SUSPICIOUS = 3.0  # standard deviations

_KEEP = 1.0 - WINDOW


def value_of(deviations: float, n: int) -> float:
    """T of so many standard deviations: Wilson and Hilferty, its cube root is nearly normal."""
    spread = 2.0 / (9.0 * n)
    return float(n * max(0.0, 1.0 - spread + deviations * np.sqrt(spread)) ** 3)


@inlined
def lasts(s: Floats, g: int) -> bool:
    """Whether noise lasts, beyond doubt: then to look at every sample tells the same again."""
    return is_coloured(s, g) and noise_lasts(s, g)


@inlined
def attend(s: Floats, g: int) -> None:
    """Look at every sample for a while: one was far from what theta says, in a steady plant."""
    if s[g + REVISITED] >= EXPERIENCE and s[g + HASTE] <= PROVEN and not lasts(s, g):
        s[g + ATTENTIVE] = ATTENTION


@inlined
def weigh(
    size: Size, s: Floats, at: Places, d: float, e: float, y: float, r: float, count: int
) -> None:
    """Take a sample into the score.

    Parameters
    ----------
    size, s, at
        The row: regressor in ``x``; ``score``, ``variance`` and ``detector`` are written.
    d, e, y, r
        What is new of its residual, NaN where its place is not known; innovation; flow; xᵀPx.
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
    if s[g + MISFIT_POWER] > 0.0:  # where the structure fits, theta knows better than the place
        misfit = max(0.0, s[g + MISFIT])
        doubt = MISFIT_HERE * misfit + MISFIT_UNSEEN * s[g + MISFIT_POWER] + r * s[g + POWER]
        if not np.isnan(step):
            doubt += (e - d) * (e - d)
        elif s[g + REVISITED] < EXPERIENCE or misfit > FITS * s[g + MISFIT_POWER]:
            doubt = np.inf  # nobody knows this place
        if doubt < local:
            local = doubt
            d = e
    if local == np.inf or s[g + FLOOR_WEIGHT] <= SETTLED or count < FIRST or r == 0.0:
        return
    # Where places drift, theta lags behind; what is new does not, beyond COMMON.
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
    """Whether the plant has changed, and then the evidence is dropped; asked after each look.

    Parameters
    ----------
    size, s, at, own, counters
        State, written in place.
    t
        Time of the last sample.
    every
        One of so many samples is looked at without suspicion.
    """
    n = len(size)
    g = at.detector
    if s[g + EVIDENCE] < 0.9 * FEWEST_BETWEEN:
        return False

    T = squared_length(size, s, at.score, at.variance, at.f, at.Px, at.L)
    if not rule.suspicious <= T:  # NaN: no evidence
        counters[SUSPECT_SAMPLE] = counters[COUNT] + 1
        counters[SUSPECT_TIME] = t
        s[g + SUM] = 0.0
        s[g + SUMMED] = 0.0
        s[g + SUSPECTED] = 0.0
    elif counters[COUNT] - counters[SUSPECT_SAMPLE] < PATIENCE and s[g + FLOOR_WEIGHT] > EXPERIENCE:
        s[g + SUSPECTED] = 1.0  # what may be a change is no measure of noise
    else:
        s[g + SUSPECTED] = 0.0
    # Every sample is looked at under suspicion, unless noise lasts: it would count once too often.
    s[g + ATTENTIVE] = max(s[g + ATTENTIVE] - 1.0, s[g + SUSPECTED])
    if s[g + ATTENTIVE] > 0.0 and lasts(s, g):
        s[g + ATTENTIVE] = 0.0
    if not rule.threshold < T:
        return False
    # T has grown evenly since the change: from so many looks before it was suspicious.
    before = s[g + SUMMED] * rule.suspicious / max(T - rule.suspicious, TINY)
    apart = every if s[g + ATTENTIVE] <= 1.0 else 1  # the first one was startling
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
