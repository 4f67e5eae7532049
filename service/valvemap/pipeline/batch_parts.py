"""A batch of samples that is processed in parts: by rounds, or valve by valve. Pure."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from valvemap.model.samples import Codes, Flags, Samples, Segments, Times, Trace
from valvemap.pipeline.lane_traces import nothing_of

Taken = tuple[Samples, Mapping[str, Trace]]
"""Gated samples, and the trace of each estimator."""


class BatchParts:
    """Joins the results of the parts of a batch.

    Parameters
    ----------
    samples
        The whole batch.
    names
        Of the estimators.
    quality
        That of samples that no part has (N,).
    """

    def __init__(self, samples: Samples, names: Iterable[str], quality: Codes) -> None:
        self._judged = replace(samples, quality=quality)
        self._traces = {name: nothing_of(len(samples)) for name in names}

    def put(self, rows: slice | Flags, part: Taken) -> None:
        """Add the part at these rows."""
        found, traces = part
        self._judged.quality[rows] = found.quality
        for name, trace in self._traces.items():
            trace.put(rows, traces[name])

    @property
    def whole(self) -> Taken:
        """The batch."""
        return self._judged, self._traces


def in_rounds(
    samples: Samples,
    segments: Segments,
    names: Iterable[str],
    next_stops: Callable[[Segments], Times],
    take: Callable[[Samples, Segments], Taken],
) -> Taken:
    """Process samples in rounds.

    Parameters
    ----------
    samples, segments
        The batch, and its assignment to valves.
    names
        Of the estimators.
    next_stops
        Gives the rows up to which the given segments are processed at once.
    take
        Processes a round.
    """
    if (next_stops(segments) == segments.stops).all():
        return take(samples, segments)
    parts, left = BatchParts(samples, names, samples.quality.copy()), segments
    while len(left.members):
        now = left._replace(stops=next_stops(left))
        rows = _rows_of(now, len(samples))
        parts.put(rows, take(samples[rows], now.among(rows)))
        left = left._replace(starts=now.stops).of(now.stops < left.stops)
    return parts.whole


def _rows_of(segments: Segments, N: int) -> Flags:
    """Mask (N,) of the rows of all segments."""
    steps = np.zeros(N + 1, np.int64)
    np.add.at(steps, segments.starts, 1)
    np.add.at(steps, segments.stops, -1)
    return np.asarray(np.cumsum(steps[:-1]) > 0)
