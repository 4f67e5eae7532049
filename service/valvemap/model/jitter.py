"""Jitter of U: fast variation beside its trend, as noise or as feedback of the noise of Q.

Jitter biases the estimation of lags. A lag smooths it, so that the smoothed U seems to explain the
flow better, and signals without any lag appear to have lags of 10 ms to 300 ms. Without the jitter
there is no such bias, and real lags are still found.
"""

from itertools import product
from typing import Final

import numpy as np

from valvemap.model.kernels import lag, reaction
from valvemap.model.samples import Floats

SMOOTHED: Final = 5  # rows on either side in the moving average
POWERS: Final = 6  # powers of U in the coarse map that is used to estimate the noise


def is_small(U: Floats) -> bool | None:
    """Whether U (N,) has a jitter that is small against its trend; None if it is not separable."""
    w = np.abs(np.diff(U, 2))
    jitter = w[w > reaction.LEAST]
    if len(jitter) < reaction.OFTEN * len(U):
        return False
    return True if jitter.mean() < reaction.SMALL * np.ptp(U) / 2.0 else None


def taken_off(U: Floats) -> Floats:
    """U (N,) as a centred moving average, which adds no lag."""
    ends = np.full(SMOOTHED, U[0]), np.full(SMOOTHED, U[-1])
    wide = np.concatenate([ends[0], U, ends[1]])
    total = sum(wide[k : k + len(U)] for k in range(2 * SMOOTHED + 1))
    return np.asarray(total / (2 * SMOOTHED + 1))


def reacts(rows: Floats) -> bool | None:
    """Whether U reacts to the noise of its own row in ``rows``, see :func:`kernels.lag.keep`.

    The test uses a coarse map without lags; None if it is inconclusive.
    """
    U, s, Q = rows[:, lag.LEFT_U], rows[:, lag.LEFT_S] / 10.0, rows[:, lag.LEFT_Q]
    small = is_small(U)
    if not small or len(U) < reaction.FEWEST:
        return small if len(U) >= reaction.FEWEST else None
    terms = [s**k * (U / 100.0) ** j for k, j in product((1, 2), range(POWERS))]
    X = np.column_stack([np.ones(len(U)), *terms])
    return bool(reaction.reacts(reaction.weighed(U, Q - X @ np.linalg.lstsq(X, Q)[0]), 0))
