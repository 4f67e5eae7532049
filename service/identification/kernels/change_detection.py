"""Has the plant changed? A score test on the whitened innovations of recursive least squares.

With r = xᵀPx and z the innovation over its standard deviation, clipped and freed of its slow mean,
the weighted score b = Σ wᵢ·xᵢ·zᵢ tells how theta would have to move, and T = n·bᵀPb/Σ wᵢ·rᵢ, made
χ²-like with n degrees of freedom, how much it should.

A structure that does not fit leaves innovations that look like a change as the operating point
moves. Three things keep them from accusing the plant:

- independence: a sample weighs w = 1 - cos², the angle taken in P's metric between its regressor
  and the one before. A slow sweep brings next to no new evidence about the map as a whole, however
  many samples it has: the same misfit over and over is no evidence;
- familiarity: a sample from where the estimator knows little (r above what forgetting leaves in the
  steady state) counts less;
- z is in units of all innovations of late, misfit included.
"""

import numpy as np
from numpy.typing import NDArray

from service.identification.kernels.compiled import inner
from service.identification.kernels.factors import project
from service.identification.samples import Floats, Times

Counts = NDArray[np.int64]

# Places in `detector`.
EVIDENCE, SQUARES, LEVERAGE, MEAN, SCALE_WEIGHT, SCALE, BEFORE, STATISTIC, SUM, SIZE = range(10)
PLACES_OF_DETECTOR = 10
# Places in `history`: number of changes, sample and time of the last and of the suspected one.
CHANGES, SAMPLE, TIME, SUSPECT_SAMPLE, SUSPECT_TIME = range(5)
PLACES_OF_HISTORY = 5

EVERY = 8
WINDOW = 1.0 / 200.0
SCALE_WINDOW = 1.0 / 1000.0
SETTLED = 20.0
CLIP = 4.0
FAMILIAR = 2.0
ENOUGH = 10.0
SUSPICIOUS = 20.0


@inner
def has_changed(
    detector: Floats,
    history: Counts,
    score: Floats,
    ut: Floats,
    X: Floats,
    residual: Floats,
    evidence: Floats,
    t: Times,
    lam: float,
    threshold: float,
    count: int,
    start: int,
    stop: int,
) -> bool:
    """Weigh samples start … stop - 1; True if the plant has changed, and evidence is dropped.

    Parameters
    ----------
    detector, history, score
        State, written in place.
    ut
        Factor of P, after the samples.
    X, residual, t
        Samples; NaN residual: not used.
    evidence : (N, 3)
        xᵀPx, xᵀP·(x before), and the variance of the innovation over σ² less 1.
    lam, threshold
        Forgetting factor; T that means a change.
    count
        Number of samples used so far.
    """
    n = len(score)
    keep = 1.0 - WINDOW
    stationary = FAMILIAR * max(1.0 - lam, SCALE_WINDOW)
    for i in range(start, stop):
        e, r, along, q = residual[i], evidence[i, 0], evidence[i, 1], evidence[i, 2]
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

        both = r * detector[BEFORE]
        independence = max(0.0, 1.0 - along * along / both) if both > 0.0 else 0.0
        detector[BEFORE] = r * lam / (lam + r)  # about what r of this x is from now on
        detector[SUM] += e
        if detector[SCALE_WEIGHT] <= SETTLED:
            continue
        weight = independence * min(1.0, stationary / r) if r > 0.0 else 0.0
        step = weight * (z - detector[MEAN])
        detector[MEAN] += WINDOW * independence * (z - detector[MEAN])
        detector[EVIDENCE] = keep * detector[EVIDENCE] + independence
        detector[SQUARES] = keep * keep * detector[SQUARES] + independence * independence
        detector[LEVERAGE] = keep * detector[LEVERAGE] + independence * min(r, 1.0)
        for j in range(n):
            score[j] = keep * score[j] + step * X[i, j]
    if count % EVERY != 0 or detector[EVIDENCE] < ENOUGH:
        return False

    T = n * project(ut, score, np.empty(n), np.empty(n)) / detector[LEVERAGE]
    T *= detector[EVIDENCE] / detector[SQUARES]
    detector[STATISTIC] = T
    if T < SUSPICIOUS:
        history[SUSPECT_SAMPLE] = count + 1
        history[SUSPECT_TIME] = t[stop - 1]
        detector[SUM] = 0.0
    if threshold >= T:
        return False
    history[CHANGES] += 1
    history[SAMPLE] = history[SUSPECT_SAMPLE]
    history[TIME] = history[SUSPECT_TIME]
    detector[SIZE] = detector[SUM] / max(1, count + 1 - history[SUSPECT_SAMPLE])
    for place in (EVIDENCE, SQUARES, LEVERAGE, MEAN, SUM):
        detector[place] = 0.0
    for j in range(n):
        score[j] = 0.0
    return True
