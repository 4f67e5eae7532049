"""Effect of noise that D(q) does not whiten on RML's theta: long-run covariance of its scores.

As :mod:`valvemap.model.kernels.scores` for least squares, with the filtered regressors h_f and the
innovation. The error of theta along x is xᵀ·P·Σ h_f·ε. With any forgetting, its variance is that in
white innovations times gᵀ·Omega·g over σ²·gᵀ·M·g, g = P·x. The correction is 1 for white
innovations.

Regressors that react to the noise of the same sample bias theta by about N·P·Γ, Γ = mean of
(h_f(t) - h_f(t-1))·ε(t), N = s/tr(P·M) the samples that P holds.

If the plant drifts, theta lags: the mean of the last samples' scores is M times the lag.
"""

import numpy as np

from valvemap.model.kernels import reaction
from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.scores import BLOCK, COLOURED, FEWEST, MEMORY, REACTS, STUDENT
from valvemap.model.samples import Floats

# Rows of `blocks` (s each): sum of h_f·ε over this block, and over the one before; h_f of the
# sample before; sum of its step times ε over this block; mean of that, Γ; mean of its square; mean
# of h_f·ε over the last LATELY samples.
THIS, BEFORE, PREVIOUS, REACTION, REACTED, DOUBT, SCORE = range(7)
ROWS_OF_BLOCKS = 7
# Offsets in `colour`.
GATHERED, BLOCKS, PRODUCT, SQUARE, BLOCK_PRODUCT, BLOCK_SQUARE, LAST = range(7)
REACTING = 7  # from here on see `reaction`
PLACES_OF_COLOUR = REACTING + reaction.PLACES
ROUNDING = 1e-12  # of the flow, squared: rounding error
LATELY = 8192.0  # samples: a drift lasts longer


@inner
def gather(
    omega: Floats, moments: Floats, blocks: Floats, colour: Floats, hf: Floats, e: float, y: float
) -> None:
    """Add a sample's score: filtered regressors ``hf`` (s or more,), innovation, output."""
    ns = blocks.shape[1]
    colour[BLOCK_PRODUCT] += e * colour[LAST]
    colour[BLOCK_SQUARE] += e * e + ROUNDING * y * y
    colour[LAST] = e
    for j in range(ns):
        blocks[THIS, j] += e * hf[j]
        blocks[REACTION, j] += e * (hf[j] - blocks[PREVIOUS, j])
        blocks[PREVIOUS, j] = hf[j]
    if int(colour[GATHERED]) % 8 == 0:  # one of eight suffices
        part = 8.0 / min(8.0 + colour[GATHERED] + BLOCK * colour[BLOCKS], MEMORY)
        for j in range(ns):
            for k in range(j + 1):
                moments[j, k] += part * (hf[j] * hf[k] - moments[j, k])
    colour[GATHERED] += 1.0
    if colour[GATHERED] < BLOCK:
        return
    colour[BLOCKS] += 1.0 - colour[BLOCKS] * (BLOCK / MEMORY)
    part = 1.0 / colour[BLOCKS]
    colour[PRODUCT] += part * (colour[BLOCK_PRODUCT] / BLOCK - colour[PRODUCT])
    colour[SQUARE] += part * (colour[BLOCK_SQUARE] / BLOCK - colour[SQUARE])
    for j in range(ns):
        for k in range(j + 1):
            pair = (blocks[THIS, j] + blocks[BEFORE, j]) * (blocks[THIS, k] + blocks[BEFORE, k])
            omega[j, k] += part * (0.5 * pair / BLOCK - omega[j, k])
    lately = max(part, BLOCK / LATELY)
    for j in range(ns):
        blocks[SCORE, j] += lately * (blocks[THIS, j] / BLOCK - blocks[SCORE, j])
        blocks[BEFORE, j] = blocks[THIS, j]
        blocks[THIS, j] = 0.0
        step = blocks[REACTION, j] / BLOCK
        blocks[REACTED, j] += part * (step - blocks[REACTED, j])
        blocks[DOUBT, j] += part * (step * step - blocks[DOUBT, j])
        blocks[REACTION, j] = 0.0
    for place in (GATHERED, BLOCK_PRODUCT, BLOCK_SQUARE):
        colour[place] = 0.0


@inner
def inflation(
    omega: Floats, moments: Floats, colour: Floats, g: Floats, noise_variance: float
) -> float:
    """Ratio of the variance along ``g`` = P·x to that in white innovations; at least 1."""
    if colour[BLOCKS] < FEWEST:
        return 1.0
    chance = COLOURED * colour[SQUARE] / np.sqrt(colour[BLOCKS] * BLOCK)
    if abs(colour[PRODUCT]) <= chance:
        return 1.0
    long_run, white = 0.0, 0.0
    for j in range(len(omega)):
        for k in range(j + 1):
            both = g[j] * g[k] * (1.0 if j == k else 2.0)
            long_run += both * omega[j, k]
            white += both * moments[j, k]
    white *= noise_variance
    if not white > 0.0:
        return 1.0
    return float(max(1.0, long_run / white * (1.0 + STUDENT / colour[BLOCKS])))


@inner
def reacts(blocks: Floats, colour: Floats) -> bool:
    """Whether regressors react to the noise of the same sample."""
    if colour[BLOCKS] >= FEWEST:
        for j in range(blocks.shape[1]):
            if blocks[REACTED, j] ** 2 * colour[BLOCKS] > REACTS * blocks[DOUBT, j]:
                return True
    return False


@inner
def bias_along(blocks: Floats, g: Floats) -> float:
    """Bias of theta along ``g`` = P·x by reacting regressors, per effective sample in P."""
    total = 0.0
    for j in range(blocks.shape[1]):
        total += blocks[REACTED, j] * g[j]
    return total


@inner
def forget(omega: Floats, moments: Floats, blocks: Floats, colour: Floats) -> None:
    """Reset all statistics."""
    for j in range(len(omega)):
        for row in range(ROWS_OF_BLOCKS):
            blocks[row, j] = 0.0
        for k in range(len(omega)):
            omega[j, k] = 0.0
            moments[j, k] = 0.0
    for place in range(len(colour)):
        colour[place] = 0.0
