"""What coloured noise makes of theta: the long-run covariance of the scores x·e.

Least squares errs by P·Σ x·e. White noise makes Var(Σ x·e) = σ²·Σ x·xᵀ of it; noise that lasts
makes more of it along regressors that last, and no more along regressors drawn anew (at ρ = .95, 39
times the variance of the intercept, once that of the others). So the sums of x·e over blocks, long
against what noise lasts, are looked at as they are: Omega = mean of (Σ x·e)(Σ x·e)ᵀ/BLOCK. With
M = mean of x·xᵀ and N = n/tr(P·M), the samples that P holds, Var(theta) = N·P·Omega·P.

Twenty blocks know Omega worse than white noise knows σ²; so it serves only where consecutive e
agree more than chance lets them.
"""

import numpy as np

from service.identification.kernels.compiled import inlined
from service.identification.kernels.row_layout import (
    BLOCKS,
    GATHERED,
    LAST_SCORED,
    LOOKED,
    PRODUCT,
    SQUARE,
    Places,
    Size,
)
from service.identification.kernels.triangles import add_square
from service.identification.samples import Floats

BLOCK = 256.0  # samples: thirteen times what AR(.95) lasts
MEMORY = 32_768.0  # samples that Omega, M and the colour remember
FEWEST = 4.0  # blocks
COLOURED = 4.0  # standard deviations of the correlation of consecutive e
STUDENT = 2.5  # over the number of blocks: what the quantile of so few grows by, squared


@inlined
def gather(size: Size, s: Floats, at: Places, e: float, r: float) -> None:
    """Take a sample's score x·e/√(1 + r) in; r = xᵀPx."""
    n, g = len(size), at.detector
    u = e / np.sqrt(1.0 + r)
    s[g + LOOKED] += 1.0 - s[g + LOOKED] / MEMORY
    s[g + PRODUCT] += (u * s[g + LAST_SCORED] - s[g + PRODUCT]) / s[g + LOOKED]
    s[g + SQUARE] += (u * u - s[g + SQUARE]) / s[g + LOOKED]
    s[g + LAST_SCORED] = u
    for j in range(n):
        s[at.block + j] += u * s[at.x + j]
    s[g + GATHERED] += 1.0
    if s[g + GATHERED] >= BLOCK:
        s[g + BLOCKS] += 1.0 - s[g + BLOCKS] * (BLOCK / MEMORY)
        keep = 1.0 - 1.0 / s[g + BLOCKS]
        root = np.sqrt(1.0 / (s[g + BLOCKS] * BLOCK))
        for j in range(n):
            s[at.g + j] = root * s[at.block + j]
            s[at.block + j] = 0.0
        add_square(size, s, at.omega, at.g, keep)
        s[g + GATHERED] = 0.0
    if int(s[g + GATHERED]) & 7 == 0:
        few = 8.0 / s[g + LOOKED]
        part = min(1.0, few)
        root = np.sqrt(part)
        for j in range(n):
            s[at.g + j] = root * s[at.x + j]
        add_square(size, s, at.moments, at.g, 1.0 - part)


def coloured(s: Floats, g: int) -> bool:
    """Whether consecutive e agree more than chance lets them; ``g`` is the place of `detector`."""
    if s[g + BLOCKS] < FEWEST:
        return False
    return bool(abs(s[g + PRODUCT]) * np.sqrt(s[g + LOOKED]) > COLOURED * s[g + SQUARE])


is_coloured = inlined(coloured)
