"""What U does from sample to sample beside its way: noise of its own, or of Q that it reacts to.

Either hides what the valve does: behind a lag, which smooths it, U would explain the flow better,
and lags of 10 ms to 300 ms are seen in signals without any. Taken off before, it shows none, and
hides none.
"""

from itertools import product
from typing import Final

import numpy as np

from valvemap.model.kernels import lag, reaction
from valvemap.model.samples import Floats

SMOOTHED: Final = 5  # rows to either side of one that its jitter is smoothed over
POWERS: Final = 6  # of U in a map that is coarse, but fits well enough to show the noise


def is_small(U: Floats) -> bool | None:
    """Whether U (N,) jitters, and little beside its way; None: nobody can tell jitter from way."""
    w = np.abs(np.diff(U, 2))
    jitter = w[w > reaction.LEAST]
    if len(jitter) < reaction.OFTEN * len(U):
        return False
    return True if jitter.mean() < reaction.SMALL * np.ptp(U) / 2.0 else None


def taken_off(U: Floats) -> Floats:
    """U (N,) as the mean of as many rows before as after: no lag is added."""
    ends = np.full(SMOOTHED, U[0]), np.full(SMOOTHED, U[-1])
    wide = np.concatenate([ends[0], U, ends[1]])
    total = sum(wide[k : k + len(U)] for k in range(2 * SMOOTHED + 1))
    return np.asarray(total / (2 * SMOOTHED + 1))


def reacts(rows: Floats) -> bool | None:
    """Whether U reacts to the noise of the same of ``rows``, see :func:`kernels.lag.keep`.

    As far as a coarse map without lags tells; None where nobody can tell.
    """
    U, s, Q = rows[:, lag.LEFT_U], rows[:, lag.LEFT_S] / 10.0, rows[:, lag.LEFT_Q]
    small = is_small(U)
    if not small or len(U) < reaction.FEWEST:
        return small if len(U) >= reaction.FEWEST else None
    terms = [s**k * (U / 100.0) ** j for k, j in product((1, 2), range(POWERS))]
    X = np.column_stack([np.ones(len(U)), *terms])
    return bool(reaction.reacts(reaction.weighed(U, Q - X @ np.linalg.lstsq(X, Q)[0]), 0))
