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
from numpy.typing import NDArray

from service.identification.kernels.compiled import inner
from service.identification.samples import Floats, Times

Counts = NDArray[np.int64]

# Places in `detector`.
EVIDENCE, SQUARES, LONG_SQUARES, MEAN, SCALE_WEIGHT, SCALE, STATISTIC, SUM, SIZE = range(9)
LAST, POWER, HASTE, FACTOR = range(9, 13)
PLACES_OF_DETECTOR = 13
# Places in `history`: number of changes, sample and time of the last and of the suspected one.
CHANGES, SAMPLE, TIME, SUSPECT_SAMPLE, SUSPECT_TIME = range(5)
PLACES_OF_HISTORY = 5

EVERY = 8
WINDOW = 1.0 / 100.0
MEAN_WINDOW = 1.0 / 400.0
SCALE_WINDOW = 1.0 / 1000.0
SETTLED = 20.0
CLIP = 4.0
FAMILIAR = 2.0
ENOUGH = 20.0
FAR = 0.1  # squared, in units of the columns' scales
RIDGE = 1e-9
POWER_WINDOW = 1.0 / 200.0
LEAST_POWER = 0.1
TOLERATED = 0.4
HASTE_STEP = 0.005
SUSPICIOUS = 3.0


@inner
def has_changed(
    detector: Floats,
    history: Counts,
    score: Floats,
    variance: Floats,
    X: Floats,
    residual: Floats,
    evidence: Floats,
    t: Times,
    lam: float,
    least: float,
    threshold: float,
    count: int,
    start: int,
    stop: int,
) -> bool:
    """Weigh samples start … stop - 1; True if the plant has changed, and evidence is dropped.

    Parameters
    ----------
    detector, history, score, variance : (13,), (5,), (n,), (n, n)
        State, written in place; of ``variance`` the lower triangle.
    X, residual, t
        Samples; NaN residual: not used.
    evidence : (N, 3)
        xᵀPx, |Δx|², and the variance of the innovation over σ² less 1.
    lam, least, threshold
        Forgetting factor and its lower bound; standard deviations that mean a change.
    count
        Number of samples used so far.
    """
    n = len(score)
    keep, keep_long = 1.0 - WINDOW, 1.0 - SCALE_WINDOW
    stationary = FAMILIAR * max(1.0 - lam, SCALE_WINDOW)
    for i in range(start, stop):
        e, r, moved, q = residual[i], evidence[i, 0], evidence[i, 1], evidence[i, 2]
        if np.isnan(e):
            continue
        z = 0.0
        if detector[SCALE] > 0.0:
            z = min(max(e / np.sqrt((1.0 + q) * detector[SCALE]), -CLIP), CLIP)
        square = e * e / (1.0 + q)
        if detector[SCALE_WEIGHT] > SETTLED:
            square = min(square, 9.0 * detector[SCALE])
        detector[SCALE_WEIGHT] += 1.0 - SCALE_WINDOW * detector[SCALE_WEIGHT]
        detector[SCALE] += (square - detector[SCALE]) / detector[SCALE_WEIGHT]

        independence = min(1.0, moved / FAR)
        detector[SUM] += e
        if detector[SCALE_WEIGHT] <= SETTLED:
            continue
        detector[POWER] += POWER_WINDOW * (z * z - detector[POWER])
        colour = z * detector[LAST] / max(detector[POWER], LEAST_POWER)
        most = np.log(max(1.0, (1.0 - least) / (1.0 - lam))) if lam < 1.0 else 0.0
        haste = detector[HASTE] + HASTE_STEP * (colour - TOLERATED)
        detector[HASTE] = min(max(haste, 0.0), most)
        detector[LAST] = z
        weight = independence * min(1.0, stationary / r) if r > 0.0 else 0.0
        step = weight * (z - detector[MEAN])
        detector[MEAN] += MEAN_WINDOW * independence * (z - detector[MEAN])
        detector[EVIDENCE] = keep * detector[EVIDENCE] + weight
        detector[SQUARES] = keep * keep * detector[SQUARES] + weight * weight
        detector[LONG_SQUARES] = keep_long * detector[LONG_SQUARES] + weight * weight
        for j in range(n):
            score[j] = keep * score[j] + step * X[i, j]
            share = step * step * X[i, j]
            for k in range(j + 1):
                variance[j, k] = keep_long * variance[j, k] + share * X[i, k]
    if count % EVERY != 0:
        return False
    detector[FACTOR] = np.exp(detector[HASTE])
    if detector[EVIDENCE] < ENOUGH:
        return False

    T = _squared_length(score, variance) * detector[LONG_SQUARES] / detector[SQUARES]
    spread = 2.0 / (9.0 * n)  # Wilson and Hilferty: of T's cube root, nearly normal
    deviation = (np.cbrt(T / n) - 1.0 + spread) / np.sqrt(spread)
    detector[STATISTIC] = deviation
    if deviation < SUSPICIOUS:
        history[SUSPECT_SAMPLE] = count + 1
        history[SUSPECT_TIME] = t[stop - 1]
        detector[SUM] = 0.0
    if deviation <= threshold:
        return False
    history[CHANGES] += 1
    history[SAMPLE] = history[SUSPECT_SAMPLE]
    history[TIME] = history[SUSPECT_TIME]
    detector[SIZE] = detector[SUM] / max(1, count + 1 - history[SUSPECT_SAMPLE])
    for place in (EVIDENCE, SQUARES, MEAN, SUM):
        detector[place] = 0.0
    for j in range(n):
        score[j] = 0.0
    return True


@inner
def _squared_length(b: Floats, V: Floats) -> float:
    """BᵀV⁻¹b by the factors L·D·Lᵀ of V, given as its lower triangle."""
    n = len(b)
    L, d, w = np.empty((n, n)), np.empty(n), np.empty(n)
    total = 0.0
    for j in range(n):
        d[j] = V[j, j] * (1.0 + RIDGE)
        w[j] = b[j]
        for k in range(j):
            L[j, k] = V[j, k]
            for i in range(k):
                L[j, k] -= L[j, i] * L[k, i] * d[i]
            if d[k] > 0.0:
                L[j, k] /= d[k]
            d[j] -= L[j, k] * L[j, k] * d[k]
            w[j] -= L[j, k] * w[k]
        if d[j] > RIDGE * V[j, j]:
            total += w[j] * w[j] / d[j]
    return total
