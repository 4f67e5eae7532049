"""Signs of an operator: when the next one is due, and by how much it is late. Pure."""

import math
from dataclasses import dataclass, replace
from typing import Final

MOST: Final = 8  # intervals that are kept
LEAST: Final = 2  # intervals that tell how often signs come
AWAKE_S: Final = 0.06  # s; longest interval between two looks in which no sign can be missed
RANK: Final = 0.75  # of the intervals: one long or many short ones are ignored


@dataclass(frozen=True)
class OperatorSigns:
    """The times of the newest signs, s; their rhythm is learnt from them.

    A service that was held up has not heard signs, either: what passes between two looks beyond
    `AWAKE_S` is no delay of the operator. ``asleep_s`` is that time since the newest sign.

    Examples
    --------
    >>> signs = OperatorSigns()
    >>> for t in (0.0, 0.1, 0.2, 0.3):
    ...     signs = signs.after(t)
    >>> round(signs.period_s, 3), round(signs.late_s(0.45), 3)
    (0.1, 0.05)
    """

    heard: tuple[float, ...] = ()
    looked: float = math.inf
    asleep_s: float = 0.0

    def after(self, now: float) -> "OperatorSigns":
        """Return the signs with one at ``now``."""
        return replace(self, heard=(*self.heard[-MOST:], now), asleep_s=0.0)

    def at(self, now: float) -> "OperatorSigns":
        """Return the signs at ``now``; call it at every step."""
        slept = max(now - self.looked - AWAKE_S, 0.0)
        return replace(self, looked=now, asleep_s=self.asleep_s + slept)

    @property
    def period_s(self) -> float:
        """Interval between signs, s; infinite while too few were heard."""
        intervals = sorted(b - a for a, b in zip(self.heard, self.heard[1:], strict=False))
        if len(intervals) < LEAST:
            return math.inf
        return intervals[math.ceil(RANK * len(intervals)) - 1]

    def late_s(self, now: float) -> float:
        """Time since the next sign was due, s; 0 before that."""
        if not self.heard:
            return 0.0
        return max(now - self.heard[-1] - self.period_s - self.asleep_s, 0.0)
