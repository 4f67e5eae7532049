"""Into which intervals a variable's past is cut, and what counts as Good there (Part 13)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_Times = NDArray[np.int64]


@dataclass(frozen=True)
class Rules:
    """How values that are not Good count (Part 13, 4.2.1.2); the shares in %."""

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

    Times run as the request does: backwards they are negated.

    Examples
    --------
    >>> Intervals.of(0, 25, 10, most=9)[0].edges
    array([ 0, 10, 20, 25])
    >>> Intervals.of(25, 0, 10, most=9)[0].edges
    array([-25, -15,  -5,   0])
    """

    edges: _Times
    backwards: bool
    truncated: bool  # the last one is shorter than the others

    @classmethod
    def of(cls, start: int, end: int, width: int, most: int) -> tuple["Intervals", int | None]:
        """At most ``most`` of them, and where the others begin.

        ``width`` 0 makes one; times in UTC ns.
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
        """-1 where times are negated."""
        return -1 if self.backwards else 1
