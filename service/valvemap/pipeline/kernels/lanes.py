"""The loop that stores an estimator's last results for many valves."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Segments
from valvemap.pipeline.kernels.compiled import kernel
from valvemap.vocabulary.statuses import Status

NO_STATUS = 255

_UNEXCITED = int(Status.UNEXCITED)  # OK, WARMING_UP, UNEXCITED: the estimator used the sample


class Notes(NamedTuple):
    """Last results of M lanes, all (M,); ``status`` is NO_STATUS before the first sample."""

    learnt: NDArray[np.int64]
    t: NDArray[np.int64]
    predicted: NDArray[np.float64]
    residual: NDArray[np.float64]
    status: NDArray[np.uint8]


def nothing(M: int) -> Notes:
    """Return the notes of M lanes before the first sample."""
    return Notes(
        learnt=np.zeros(M, np.int64),
        t=np.zeros(M, np.int64),
        predicted=np.full(M, np.nan),
        residual=np.full(M, np.nan),
        status=np.full(M, NO_STATUS, np.uint8),
    )


@kernel
def note(
    t: NDArray[np.int64],
    predicted: NDArray[np.float64],
    residual: NDArray[np.float64],
    status: NDArray[np.uint8],
    notes: Notes,
    segments: Segments,
) -> None:
    """Count the samples used, and store the results of the last; no segment may be empty."""
    for s in range(len(segments.members)):
        m = segments.members[s]
        for i in range(segments.starts[s], segments.stops[s]):
            notes.learnt[m] += status[i] <= _UNEXCITED
        last = segments.stops[s] - 1
        notes.t[m] = t[last]
        notes.predicted[m] = predicted[last]
        notes.residual[m] = residual[last]
        notes.status[m] = status[last]


@kernel
def last_T(
    T: NDArray[np.float64],
    quality: NDArray[np.uint8],
    kept: NDArray[np.float64],
    segments: Segments,
) -> None:
    """Store the last temperature (M,) that is finite and not BAD."""
    for s in range(len(segments.members)):
        for i in range(segments.stops[s] - 1, segments.starts[s] - 1, -1):
            if np.isfinite(T[i]) and quality[i] != 2:
                kept[segments.members[s]] = T[i]
                break
