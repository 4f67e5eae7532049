"""Rules of forgetting in numbers, and what all forms of the recursion hold to."""

from typing import NamedTuple

import numpy as np

from valvemap.model.kernels.compiled import inner
from valvemap.model.samples import Codes, Floats
from valvemap.vocabulary.statuses import Status

# Kinds of forgetting; up to RESETTING P is divided by λ.
EXPONENTIAL, VARIABLE, RESETTING, DIRECTIONAL, SUBSPACE, WINDOW = range(6)

LARGEST = 1e100  # a value beyond it cannot be squared and summed safely
EVERY_NTH = 8  # `Adaptive` forgets on one of so many samples
TRACE_LIMIT = 1e10  # of P in units of the columns' scales: beyond it λ forgets along X alone

_OK = int(Status.OK)
_REJECTED = int(Status.REJECTED)
_HELD = int(Status.HELD)


class Rule(NamedTuple):
    """A rule of forgetting in numbers."""

    kind: int
    lam: float
    least: float = 1.0  # smallest λ; for RESETTING the information that is put back
    suspicious: float = np.inf  # statistic of a change that may have begun
    threshold: float = np.inf  # and of one that has happened; infinite: none is looked for
    every_nth: int = 1  # SUBSPACE forgets on one of so many samples, as much as all of them would
    most: float = 0.0  # logarithm of how many times faster it may forget


@inner
def rejection(X: Floats, y: Floats, usable: Codes, i: int) -> int:
    """Why sample i cannot be used; OK if it can."""
    size = abs(y[i]) if np.isfinite(y[i]) else np.inf
    for j in range(X.shape[1]):
        size = max(size, abs(X[i, j])) if np.isfinite(X[i, j]) else np.inf
    if usable[i] == 0 or size == np.inf:
        return _REJECTED
    return _OK if size <= LARGEST else _HELD
