"""Layout of the row of floats that holds a model's state, and of the scratch space after it.

All values that a step reads and writes are in one array, at offsets that depend on n only. If n is
known to the compiler, every offset is a constant: loops are unrolled and vectorized, and no value
is reloaded after another was written. Symmetric and triangular matrices are stored as lower
triangles, by rows.

A kernel gets n as the length of ``size``: that of a tuple is known to the compiler, that of an
array is not.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import reaction
from valvemap.model.kernels.compiled import inlined
from valvemap.model.samples import Floats

Counts = NDArray[np.int64]
Size = tuple[int, ...] | Floats

# Offsets in `counters`: of the recursion, then of change detection (number of changes; sample and
# time of the last and of the suspected one).
COUNT, FACTORED, HEAD, FILLED, STALE, OPENED = range(6)
CHANGES, SAMPLE, TIME, SUSPECT_SAMPLE, SUSPECT_TIME = range(6, 11)
PLACES_OF_COUNTERS = 11

# Offsets in `noise`.
WEIGHT, SQUARES, VARIANCE, TRACE = range(4)
PLACES_OF_NOISE = 4

# Offsets in `detector`: of change detection; of the memory of places.
EVIDENCE, SUM, SIZE, FLOOR, FLOOR_WEIGHT, LAST_D = range(6)
LAST_E, POWER, POWER_WEIGHT, LOCAL, NODE = range(6, 11)
VISIT_LENGTH, VISIT_SUM, VISIT_POWER, HASTE, FADING = range(11, 16)
MISFIT, MISFIT_POWER, NEW, LAG, GAP, VISIT_SQUARES, VISIT_WEIGHT, VISIT_COMMON = range(16, 24)
COMMON, CARRIED, LAST_MEAN, BEND, SUSPECTED, CLOSED = range(24, 30)
# Of the long-run covariance of the scores.
LOOKED, PRODUCT, SQUARE, LAST_SCORED, GATHERED, BLOCKS, BLOCK_PRODUCT, BLOCK_SQUARE = range(30, 38)
# Of the speed-up of forgetting with λ < 1.
SCALE, SCALE_WEIGHT, LATELY, LAST_Z, ATTENTIVE, SUMMED, REVISITED, SWEPT = range(38, 46)
# Of the clock by which places age.
CLOCK, LOOKED_AT, REST_A, REST_B, RESTED, VISIT_BEGAN, AWAY = range(46, 53)
COMMON_WEIGHT = 53  # of VISIT_COMMON
REACTION = 54  # from here on see `reaction`
PLACES_OF_DETECTOR = REACTION + reaction.PLACES

LOOKS = 2  # samples between predictions by the copied parameters: a power of two

# Numbers of terms with a specialized kernel, compiled when first needed: the five of eq. (7), and
# the nine of degree two in each of two variables. With more, specialization gains nothing.
_KNOWN = 5, 9


class Places(NamedTuple):
    """The first offset of each vector, triangle and group; see `RlsState` for their meaning.

    The row ends at ``x``; from there to ``end`` is scratch space of a step.
    """

    theta: int
    scale: int
    score: int
    early: int
    block: int
    block_before: int
    previous: int
    reaction: int
    reacted: int
    factor: int
    spread: int
    variance: int
    omega: int
    moments: int
    doubt: int
    noise: int
    detector: int
    x: int
    f: int
    Px: int
    unit: int
    g: int
    L: int
    end: int


def places(n: int) -> Places:
    """Return the offsets for n parameters."""
    triangle = n * (n + 1) // 2
    factor = 9 * n
    noise = factor + 6 * triangle
    detector = noise + PLACES_OF_NOISE
    x = detector + PLACES_OF_DETECTOR
    L = x + 5 * n
    return Places(
        0, n, 2 * n, 3 * n, 4 * n, 5 * n, 6 * n, 7 * n, 8 * n,
        factor, factor + triangle, factor + 2 * triangle, factor + 3 * triangle,
        factor + 4 * triangle, factor + 5 * triangle, noise, detector,
        x, x + n, x + 2 * n, x + 3 * n, x + 4 * n, L, L + triangle,
    )  # fmt: skip


places_of = inlined(places)


def size_of(n: int) -> Size:
    """Return n for a kernel; for few terms as a tuple, whose length is a compile-time constant.

    Examples
    --------
    >>> len(size_of(5)), len(size_of(7))
    (5, 7)
    """
    return (0,) * n if n in _KNOWN else np.empty(n)
