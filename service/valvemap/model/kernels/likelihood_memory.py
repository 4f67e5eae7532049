"""What the recursion of maximum likelihood keeps, its settings, and vectors of one step."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inner, maker, spliced
from valvemap.model.samples import Floats

Orders = NDArray[np.int64]

EXPONENTIAL = 0
DIRECTIONAL = 1

# Offsets in `monitor`.
RAMP, COUNT, SINCE, RESTARTS, DETERMINED, WEIGHT, VARIANCE = range(7)
POWER, RLS_POWER, OUTPUT_POWER = range(7, 10)
PLACES = 10
SCRATCH = 6  # vectors of one step

RAMP_START = 0.95  # the ramp's factor at the first sample; it tends to 1
RAMP_RATE = 0.99
NOISE_PRIOR = 0.1  # variance of d before the first sample, in units of the noise variance
OPEN = 1e6  # smallest prior variance (scaled regressors) without information
BOUNDLESS = 1e20  # stands for an infinite prior variance
UNDETERMINED = 1e-2  # share of the prior variance above which a direction is undetermined
LARGEST = 1e30  # larger inputs are rejected
LARGEST_RESULT = 1e100  # beyond it, the state has overflowed
HALVINGS = 12
FADING = 0.01
PATIENCE = 200  # samples before RML is compared with plain RLS
LOUDER = 4.0  # growth of the noise variance after which d's prior is reduced
TOO_BAD = 1.5  # times the mean square of plain RLS
ROUNDING = 1e-14  # relative to the terms of a sum


class Memory(NamedTuple):
    """Arrays of a state, written in place.

    See :class:`~valvemap.model.maximum_likelihood_state.MaximumLikelihoodState`.
    """

    theta: Floats
    factor: Floats
    spread: Floats
    prior: Floats
    rls_theta: Floats
    rls_factor: Floats
    raw: Floats
    filtered: Floats
    monitor: Floats
    early: Floats
    omega: Floats
    moments: Floats
    blocks: Floats
    colour: Floats


class Rule(NamedTuple):
    """Forgetting, and the bound on the roots of D(q)."""

    kind: int
    lam: float
    radius: float


class Scratch(NamedTuple):
    """Vectors of one step."""

    h: Floats
    hf: Floats
    f: Floats
    Ph: Floats
    Sh: Floats
    work: Floats


@maker
def scratch_of(n: int) -> Scratch:
    """Vectors for models of ``n`` parameters."""
    return rows_of(np.zeros((SCRATCH, n)))


@spliced
def rows_of(scratch: Floats) -> Scratch:
    """Rows of a matrix as vectors."""
    return Scratch(scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5])


@inner
def dot(a: Floats, b: Floats, n: int) -> float:
    """Product of the first ``n`` elements."""
    total = 0.0
    for j in range(n):
        total += a[j] * b[j]
    return total
