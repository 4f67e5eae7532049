"""The loop that accumulates one-step-ahead residuals."""

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Segments
from valvemap.pipeline.kernels.compiled import kernel

N, SQUARES, MEAN_Q, SCATTER_Q, LOWEST_Q, HIGHEST_Q, RECENT, WEIGHT, LARGEST, FIELDS = range(10)

KEEP = 1.0 - 1.0 / 1000.0


@kernel
def accumulate(
    residual: NDArray[np.float64],
    Q: NDArray[np.float64],
    scores: NDArray[np.float64],
    segments: Segments,
) -> None:
    """Add N residuals to ``scores`` (M, FIELDS) in place; NaN is ignored.

    MEAN_Q and SCATTER_Q follow Welford (1962); RECENT is the mean square over about the last
    1,000 residuals, WEIGHT the sum of their weights.
    """
    members, starts, stops = segments
    for k in range(len(members)):
        score = scores[members[k]]
        for i in range(starts[k], stops[k]):
            e = residual[i]
            if not np.isfinite(e):
                continue
            score[N] += 1
            score[SQUARES] += e * e
            step = Q[i] - score[MEAN_Q]
            score[MEAN_Q] += step / score[N]
            score[SCATTER_Q] += step * (Q[i] - score[MEAN_Q])
            score[LOWEST_Q] = min(score[LOWEST_Q], Q[i])
            score[HIGHEST_Q] = max(score[HIGHEST_Q], Q[i])
            score[LARGEST] = max(score[LARGEST], abs(e))
            score[RECENT] = KEEP * score[RECENT] + (1.0 - KEEP) * e * e
            score[WEIGHT] = KEEP * score[WEIGHT] + (1.0 - KEEP)
