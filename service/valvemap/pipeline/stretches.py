"""Samples that are learnt from, in stretches between those that are passed over. Pure."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from valvemap.model.samples import Flags, Segments, Times


@dataclass(frozen=True)
class Turn:
    """The next stretch of each valve: rows that are passed over, then rows that are learnt from.

    Both have the same valves in the same order; either may be empty.
    """

    passed: Segments
    learnt: Segments


def turns(segments: Segments, used: Flags) -> Iterator[Turn]:
    """Yield the stretches of all valves, a stretch of each valve at a time.

    ``used`` (N,) is the mask of the rows that are learnt from.

    Examples
    --------
    >>> used = np.array([True, False, False, True, True, False])
    >>> for turn in turns(Segments.one(6), used):
    ...     print(*(array.tolist() for array in (*turn.passed[1:], *turn.learnt[1:])))
    [0] [0] [0] [1]
    [1] [3] [3] [5]
    [5] [6] [6] [6]
    """
    bounds = [_bounds(used, first, last) for _, first, last in zip(*segments, strict=True)]
    for turn in range(max((len(of_valve) for of_valve in bounds), default=0)):
        own = np.array([len(of_valve) > turn for of_valve in bounds], np.bool_)
        begin, middle, end = np.array([b[turn] for b in bounds if len(b) > turn], np.int64).T
        members = segments.members[own]
        yield Turn(Segments(members, begin, middle), Segments(members, middle, end))


def _bounds(used: Flags, first: int, last: int) -> list[tuple[int, int, int]]:
    """Return begin, middle and end of the stretches among rows first … last - 1."""
    changes: Times = first + 1 + np.flatnonzero(np.diff(used[first:last]))
    edges = [first, *changes.tolist(), last]
    if used[first]:
        edges.insert(0, first)
    if len(edges) % 2 == 0:
        edges.append(last)
    return list(zip(edges[0:-2:2], edges[1:-1:2], edges[2::2], strict=True))
