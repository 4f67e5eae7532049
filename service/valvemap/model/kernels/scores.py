"""Effect of coloured noise on theta: the long-run covariance of the scores x·e.

The error of least squares is P·Σ x·e. In white noise Var(Σ x·e) = σ²·Σ x·xᵀ. Coloured noise
increases it along regressors that are correlated in time, but not along independent ones (at
ρ = .95, the variance of the intercept by a factor of 39, that of the others by 1). Therefore it is
estimated from the sums of x·e over blocks much longer than the noise's correlation:
Omega = mean of (Σ x·e)(Σ x·e)ᵀ/BLOCK. With M = mean of x·xᵀ and N = n/tr(P·M), the effective number
of samples in P, Var(theta) = N·P·Omega·P.

Omega from twenty blocks is less accurate than σ² in white noise. It is used only if consecutive e
are significantly correlated.

Regressors may react to the noise of the same sample, as U does in a loop without delay. Their
scores are zero at theta, but not at the true parameters. The regressors of the previous sample do
not depend on this noise: Γ = mean of (x(t) - x(t-1))·e(t) is zero unless x reacts, and the bias of
theta is about N·P·Γ.
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

SETTLED = 0.05  # xᵀPx below which an innovation is mainly noise
BLOCK = 512.0  # samples: 26 times the correlation time of AR(.95)
MEMORY = 32_768.0  # samples; memory of Omega, M and the correlation
FEWEST = 4.0  # blocks
COLOURED = 4.0  # standard deviations of the correlation of consecutive e that are significant
REACTS = 16.0  # squared standard deviations of Γ along one direction
ROUNDING = 1e-12  # of the flow, squared
STUDENT = (
    3.6  # over the number of blocks: squared correction of the quantile for few, overlapping pairs
)


@inlined
def gather(size: Size, s: Floats, at: Places, e: float, y: float) -> None:
    """Add a sample's score x·e; ``y``: its flow, whose rounding error is excluded."""
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
    """Add a sample's x·xᵀ; one of every LOOK_EVERY suffices."""
    g = at.detector
    s[g + LOOKED] += 1.0 - s[g + LOOKED] * (LOOK_EVERY / MEMORY)
    part = 1.0 / s[g + LOOKED]
    root = np.sqrt(part)
    for j in range(len(size)):
        s[at.g + j] = root * s[at.x + j]
    add_square(size, s, at.moments, at.g, 1.0 - part)


def coloured(s: Floats, g: int) -> bool:
    """Whether consecutive e are significantly correlated; ``g`` is the offset of `detector`."""
    if s[g + BLOCKS] < FEWEST:
        return False
    return bool(abs(s[g + PRODUCT]) * np.sqrt(s[g + BLOCKS] * BLOCK) > COLOURED * s[g + SQUARE])


is_coloured = inlined(coloured)
