"""Numeric parameters of forgetting rules, and limits shared by all forms of the recursion."""

from typing import NamedTuple

import numpy as np

from valvemap.model.kernels.compiled import inner
from valvemap.model.samples import Codes, Floats
from valvemap.vocabulary.statuses import Status

# Kinds of forgetting; up to RESETTING P is divided by λ.
EXPONENTIAL, VARIABLE, RESETTING, DIRECTIONAL, SUBSPACE, WINDOW = range(6)

LARGEST = 1e100  # a larger value cannot be squared and summed without overflow
EVERY_NTH = 8  # `Adaptive` forgets at one of 8 samples
TRACE_LIMIT = 1e10  # of P in units of the columns' scales; beyond it, λ forgets along X only

_OK = int(Status.OK)
_REJECTED = int(Status.REJECTED)
_HELD = int(Status.HELD)


class Rule(NamedTuple):
    """Numeric parameters of a forgetting rule."""

    kind: int
    lam: float
    least: float = 1.0  # smallest λ; for RESETTING the information that is added
    suspicious: float = np.inf  # statistic of a suspected change
    threshold: float = np.inf  # statistic of a detected change; infinite: no detection
    every_nth: int = 1  # SUBSPACE forgets at every n-th sample, as much as in n samples
    most: float = 0.0  # logarithm of the largest speed-up of forgetting


@inner
def rejection(X: Floats, y: Floats, usable: Codes, i: int) -> int:
    """Return the reason why sample i cannot be used; OK if it can."""
    size = abs(y[i]) if np.isfinite(y[i]) else np.inf
    for j in range(X.shape[1]):
        size = max(size, abs(X[i, j])) if np.isfinite(X[i, j]) else np.inf
    if usable[i] == 0 or size == np.inf:
        return _REJECTED
    return _OK if size <= LARGEST else _HELD
