"""Processing intervals, and the rules for their status (Part 13)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_Times = NDArray[np.int64]


@dataclass(frozen=True)
class Rules:
    """AggregateConfiguration: treatment of values that are not Good (Part 13, 4.2.1.2); in %."""

    treat_uncertain_as_bad: bool = True
    percent_bad: int = 100
    percent_good: int = 100
    sloped: bool = False

    def __post_init__(self) -> None:
        for percent in (self.percent_bad, self.percent_good):
            if not 0 <= percent <= 100:
                raise ValueError(f"{percent} %: allowed is 0 to 100")
        if self.percent_bad < 100 - self.percent_good:
            raise ValueError("PercentDataGood must be at least 100 - PercentDataBad")


@dataclass(frozen=True)
class Intervals:
    """Successive intervals that begin at ``edges[k]`` and end before ``edges[k + 1]``.

    Times have the direction of the request: negated in a backward request.

    Examples
    --------
    >>> Intervals.of(0, 25, 10, most=9)[0].edges
    array([ 0, 10, 20, 25])
    >>> Intervals.of(25, 0, 10, most=9)[0].edges
    array([-25, -15,  -5,   0])
    """

    edges: _Times
    backwards: bool
    truncated: bool  # the last interval is shorter than the others

    @classmethod
    def of(cls, start: int, end: int, width: int, most: int) -> tuple["Intervals", int | None]:
        """Return at most ``most`` intervals, and the start of the next one, None if there is none.

        ``width`` 0 gives a single interval; times in UTC ns.
        """
        backwards, sign = start > end, -1 if start > end else 1
        first, last = sign * start, sign * end
        step = width or last - first
        n = -(-(last - first) // step)
        edges = first + step * np.arange(min(n, most) + 1, dtype=np.int64)
        truncated = bool(edges[-1] > last)
        if truncated:
            edges[-1] = last
        return cls(edges, backwards, truncated), sign * int(edges[-1]) if n > most else None

    def __len__(self) -> int:
        return len(self.edges) - 1

    @property
    def sign(self) -> int:
        """Sign of the times: -1 if they are negated."""
        return -1 if self.backwards else 1
