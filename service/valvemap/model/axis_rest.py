"""An axis at rest: its samples tell nothing of the edges, and must not displace those that do."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from valvemap.model.axis import AxisSamples
from valvemap.model.kernels import axis_rest as kernel
from valvemap.model.samples import Flags, Floats, Times

_QUICK_S, _SLOW_S = 0.2, 2.0  # s; filters of the position
_LEAST_MM: Final = 1.0  # mm between both: 0.55 mm/s; noise of 0.5 mm at 50 Hz passes with 0.11 mm
_STILL_S: Final = 2.0  # s; the filters cross where the axis turns: that is no rest
_LONGEST_S: Final = 10.0  # s; after a longer gap the axis is assumed to move
_SETTINGS: Final = np.array([_QUICK_S, _SLOW_S, _LEAST_MM, _STILL_S, _LONGEST_S])


@dataclass(frozen=True)
class Rest:
    """Filters of the position that tell rest from movement; a value.

    After a move of 300 mm it takes 13 s until an axis is at rest: short rests between moves
    belong to its work.
    """

    last: Times
    memory: Floats

    @classmethod
    def initial(cls) -> Self:
        """Return the value before the first sample."""
        return cls(np.zeros(1, np.int64), np.zeros(kernel.MEMORY))

    def update(self, samples: AxisSamples) -> tuple["Rest", Flags]:
        """Return the value after the samples, and where the axis moves, (N,).

        Examples
        --------
        >>> still = AxisSamples.of(np.arange(1, 2001) * 10_000_000, x=np.full(2000, 400.0))
        >>> _, moves = Rest.initial().update(still)
        >>> int(moves.sum()), bool(moves[-1])
        (200, False)
        """
        after = Rest(self.last.copy(), self.memory.copy())
        moves = np.empty(len(samples), np.bool_)
        kernel.moving_samples(samples.t, samples.x, after.last, after.memory, _SETTINGS, moves)
        return after, moves
