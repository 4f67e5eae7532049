"""What coloured noise makes of theta: the long-run covariance of the scores x·e.

Least squares errs by P·Σ x·e. White noise makes Var(Σ x·e) = σ²·Σ x·xᵀ of it; noise that lasts
makes more of it along regressors that last, and no more along regressors drawn anew (at ρ = .95, 39
times the variance of the intercept, once that of the others). So the sums of x·e over blocks, long
against what noise lasts, are looked at as they are: Omega = mean of (Σ x·e)(Σ x·e)ᵀ/BLOCK. With
M = mean of x·xᵀ and N = n/tr(P·M), the samples that P holds, Var(theta) = N·P·Omega·P.

Twenty blocks know Omega worse than white noise knows σ²; so it serves only where consecutive e
agree more than chance lets them.

And what of regressors that react to the noise of the same sample, as U does in a loop without
delay? Their scores are zero at theta, yet not at the truth. The regressors of the sample before
know nothing of this noise: Γ = mean of (x(t) - x(t-1))·e(t) is zero unless x reacts, and theta is
off by about N·P·Γ.
"""

import numpy as np

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.places import LOOK_EVERY
from valvemap.model.kernels.row_layout import (
    BLOCK_PRODUCT,
    BLOCK_SQUARE,
    BLOCKS,
    GATHERED,
    LAST_SCORED,
    LOOKED,
    PRODUCT,
    SQUARE,
    Places,
    Size,
)
from valvemap.model.kernels.triangles import add_square
from valvemap.model.samples import Floats

SETTLED = 0.05  # xᵀPx below which an innovation is noise rather than ignorance
BLOCK = 512.0  # samples: 26 times what AR(.95) lasts
MEMORY = 32_768.0  # samples that Omega, M and the colour remember
FEWEST = 4.0  # blocks
COLOURED = 4.0  # standard deviations of the correlation of consecutive e
REACTS = 16.0  # squared standard deviations of Γ along one direction
ROUNDING = 1e-12  # of the flow, squared
STUDENT = (
    3.6  # over the number of blocks: what the quantile of so few grows by, squared; pairs overlap
)


@inlined
def gather(size: Size, s: Floats, at: Places, e: float, y: float) -> None:
    """Take a sample's score x·e in; ``y``: its flow, whose rounding is no colour."""
    n, g = len(size), at.detector
    s[g + BLOCK_PRODUCT] += e * s[g + LAST_SCORED]
    s[g + BLOCK_SQUARE] += e * e + ROUNDING * y * y
    s[g + LAST_SCORED] = e
    for j in range(n):
        s[at.block + j] += e * s[at.x + j]
        s[at.reaction + j] += e * (s[at.x + j] - s[at.previous + j])
        s[at.previous + j] = s[at.x + j]
    s[g + GATHERED] += 1.0
    if s[g + GATHERED] >= BLOCK:
        s[g + BLOCKS] += 1.0 - s[g + BLOCKS] * (BLOCK / MEMORY)
        part = 1.0 / s[g + BLOCKS]
        s[g + PRODUCT] += part * (s[g + BLOCK_PRODUCT] / BLOCK - s[g + PRODUCT])
        s[g + SQUARE] += part * (s[g + BLOCK_SQUARE] / BLOCK - s[g + SQUARE])
        root = np.sqrt(part / BLOCK)
        for j in range(n):
            s[at.g + j] = root * np.sqrt(0.5) * (s[at.block + j] + s[at.block_before + j])
            s[at.block_before + j] = s[at.block + j]
            s[at.block + j] = 0.0
        add_square(size, s, at.omega, at.g, 1.0 - part)
        for j in range(n):
            s[at.g + j] = root * s[at.reaction + j]
            s[at.reacted + j] += part * (s[at.reaction + j] / BLOCK - s[at.reacted + j])
            s[at.reaction + j] = 0.0
        add_square(size, s, at.doubt, at.g, 1.0 - part)
        s[g + GATHERED] = 0.0
        s[g + BLOCK_PRODUCT] = 0.0
        s[g + BLOCK_SQUARE] = 0.0


@inlined
def gather_moments(size: Size, s: Floats, at: Places) -> None:
    """Take a sample's x·xᵀ in: one of LOOK_EVERY will do."""
    g = at.detector
    s[g + LOOKED] += 1.0 - s[g + LOOKED] * (LOOK_EVERY / MEMORY)
    part = 1.0 / s[g + LOOKED]
    root = np.sqrt(part)
    for j in range(len(size)):
        s[at.g + j] = root * s[at.x + j]
    add_square(size, s, at.moments, at.g, 1.0 - part)


def coloured(s: Floats, g: int) -> bool:
    """Whether consecutive e agree more than chance lets them; ``g`` is the place of `detector`."""
    if s[g + BLOCKS] < FEWEST:
        return False
    return bool(abs(s[g + PRODUCT]) * np.sqrt(s[g + BLOCKS] * BLOCK) > COLOURED * s[g + SQUARE])


is_coloured = inlined(coloured)
