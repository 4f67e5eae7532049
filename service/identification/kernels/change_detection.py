"""Has the plant changed? A score test on the whitened innovations of recursive least squares.

With z the innovation over its standard deviation, clipped and freed of its slow mean, the weighted
score b = Σ wᵢ·xᵢ·zᵢ of late tells in which direction theta would have to move, and T = bᵀV⁻¹b, with
V the variance of b, how sure that is: χ² with n degrees of freedom while the plant stays. Wilson
and Hilferty's transform makes standard deviations of it, whatever n.

A structure that does not fit leaves innovations that look like a change as the operating point
moves. Four things keep them from accusing the plant:

- independence: a sample weighs w = min(1, |Δx|²/FAR), Δx the way from the regressor before in units
  of the columns' scales. A slow sweep brings next to no new evidence about the map as a whole,
  however many samples it has: the same misfit over and over is no evidence;
- familiarity: a sample from where the estimator knows little (r = xᵀPx above what forgetting leaves
  in the steady state) counts less;
- z is in units of all innovations of late, misfit included;
- V is taken from the scores themselves, Σ w²·z²·x·xᵀ, not from the noise: misfit is larger here and
  smaller there, and V knows where.

Where innovations stay coloured although the plant has not changed (it drifts, or the structure
fits here and there but not both), the memory is too long: the rate of forgetting grows as long as
z(t)·z(t-1) exceeds what coloured noise may show, and falls back where it does not.
"""

import numpy as np

from service.identification.kernels.compiled import inlined
from service.identification.kernels.row_layout import (
    CHANGES,
    COUNT,
    EVIDENCE,
    FACTOR,
    HASTE,
    LAST,
    LATELY,
    MEAN,
    POWER,
    RECENT,
    SAMPLE,
    SCALE,
    SCALE_WEIGHT,
    SIZE,
    SUM,
    SUSPECT_SAMPLE,
    SUSPECT_TIME,
    TIME,
    Counts,
    Places,
    Size,
)
from service.identification.kernels.rules import Rule
from service.identification.kernels.triangles import add_square, squared_length
from service.identification.samples import Floats

EVERY = 8
WINDOW = 1.0 / 100.0
MEAN_WINDOW = 1.0 / 400.0
SCALE_WINDOW = 1.0 / 1000.0
SETTLED = 20.0
CLIP = 4.0
FAMILIAR = 2.0
ENOUGH = 20.0
FAR = 0.1  # squared, in units of the columns' scales
POWER_WINDOW = 1.0 / 200.0
LEAST_POWER = 0.1
TOLERATED = 0.4
HASTE_STEP = 0.005
SUSPICIOUS = 3.0  # standard deviations

_KEEP, _KEEP_LONG = 1.0 - WINDOW, 1.0 - SCALE_WINDOW


def value_of(deviations: float, n: int) -> float:
    """T of so many standard deviations: Wilson and Hilferty, its cube root is nearly normal."""
    spread = 2.0 / (9.0 * n)
    return float(n * max(0.0, 1.0 - spread + deviations * np.sqrt(spread)) ** 3)


@inlined
def weigh(size: Size, s: Floats, at: Places, e: float, square: float, r: float, rule: Rule) -> None:
    """Take a sample into the score.

    Parameters
    ----------
    size, s, at
        The row: regressor in ``x``; of the state, ``previous``,
        ``score``, ``variance`` and ``detector`` are written.
    e, square
        Innovation, and its square over what its variance is in units of σ².
    r
        xᵀPx.
    """
    n = len(size)
    d = at.detector
    moved = 0.0
    for j in range(n):
        step = (s[at.x + j] - s[at.previous + j]) * s[at.unit + j]
        moved += step * step
        s[at.previous + j] = s[at.x + j]
    z = 0.0
    if s[d + SCALE] > 0.0:
        z = np.copysign(min(np.sqrt(square / s[d + SCALE]), CLIP), e)
    settled = s[d + SCALE_WEIGHT] > SETTLED
    if settled:
        square = min(square, 9.0 * s[d + SCALE])
    s[d + SCALE_WEIGHT] += 1.0 - SCALE_WINDOW * s[d + SCALE_WEIGHT]
    s[d + SCALE] += (square - s[d + SCALE]) / s[d + SCALE_WEIGHT]
    s[d + SUM] += e
    if s[d + SCALE_WEIGHT] <= SETTLED:
        return
    s[d + POWER] += POWER_WINDOW * (z * z - s[d + POWER])
    colour = z * s[d + LAST] / max(s[d + POWER], LEAST_POWER)
    haste = s[d + HASTE] + HASTE_STEP * (colour - TOLERATED)
    s[d + HASTE] = min(max(haste, 0.0), rule.most)
    s[d + LAST] = z
    independence = min(1.0, moved * (1.0 / FAR))
    stationary = FAMILIAR * max(1.0 - rule.lam, SCALE_WINDOW)
    weight = independence * min(1.0, stationary / r) if r > 0.0 else 0.0
    step = weight * (z - s[d + MEAN])
    s[d + MEAN] += MEAN_WINDOW * independence * (z - s[d + MEAN])
    s[d + EVIDENCE] = _KEEP * s[d + EVIDENCE] + weight
    s[d + RECENT] = _KEEP * _KEEP * s[d + RECENT] + weight * weight
    s[d + LATELY] = _KEEP_LONG * s[d + LATELY] + weight * weight
    for j in range(n):
        s[at.g + j] = step * s[at.x + j]
        s[at.score + j] = _KEEP * s[at.score + j] + s[at.g + j]
    add_square(size, s, at.variance, at.g, _KEEP_LONG)


@inlined
def has_changed(size: Size, s: Floats, at: Places, counters: Counts, t: int, rule: Rule) -> bool:
    """Whether the plant has changed, and then the evidence is dropped; asked after EVERY samples.

    Parameters
    ----------
    size, s, at, counters
        State, written in place.
    t
        Time of the last sample.
    """
    n = len(size)
    d = at.detector
    s[d + FACTOR] = np.exp(s[d + HASTE])
    if s[d + EVIDENCE] < ENOUGH:
        return False

    T = squared_length(size, s, at.score, at.variance, at.f, at.Px, at.L)
    T *= s[d + LATELY] / s[d + RECENT]
    if rule.suspicious > T:
        counters[SUSPECT_SAMPLE] = counters[COUNT] + 1
        counters[SUSPECT_TIME] = t
        s[d + SUM] = 0.0
    if rule.threshold >= T:
        return False
    counters[CHANGES] += 1
    counters[SAMPLE] = counters[SUSPECT_SAMPLE]
    counters[TIME] = counters[SUSPECT_TIME]
    s[d + SIZE] = s[d + SUM] / max(1, counters[COUNT] + 1 - counters[SUSPECT_SAMPLE])
    for place in (EVIDENCE, RECENT, MEAN, SUM):
        s[d + place] = 0.0
    for j in range(n):
        s[at.score + j] = 0.0
    return True
