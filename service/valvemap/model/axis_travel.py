"""The position of an axis whose speed is measured: needed for the volumes of its lines alone.

At first the piston can be anywhere in its stroke. Each move excludes the places from which it would
have left the stroke, so that after the first long moves both ends of the range are known to the
part of the stroke that the axis never uses. The middle of the range is the position. In a
recording, moves after a sample exclude places as those before it do.
"""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from valvemap.model.axis import AxisSamples
from valvemap.model.kernels import axis_travel as kernel
from valvemap.model.samples import Floats, Times

ERROR_MM_S: Final = 0.2  # mm/s; of the speed's zero, up to which the piston is within the range
_LONGEST_S: Final = 1.0  # s; a longer gap tells nothing of the way


@dataclass(frozen=True)
class Travel:
    """The places that a piston can have; a value."""

    last: Times
    memory: Floats

    @classmethod
    def initial(cls) -> Self:
        """Return the value before the first sample."""
        return cls(np.zeros(1, np.int64), np.zeros(kernel.MEMORY))

    def update(self, samples: AxisSamples, stroke_mm: float) -> tuple["Travel", AxisSamples]:
        """Return the value after the samples, and the samples with their position.

        Examples
        --------
        >>> t = np.arange(1, 702) * 10_000_000
        >>> out = AxisSamples.of(t, v=np.full(701, 100.0))
        >>> Travel.initial().update(out, 800.0)[1].x[[0, -1]].round().tolist()
        [400.0, 749.0]
        """
        after, places = self.places_after(samples.t, samples.v, stroke_mm)
        return after, replace(samples, x=places.mean(axis=1))

    def places_after(self, t: Times, v: Floats, stroke_mm: float) -> tuple["Travel", Floats]:
        """Return the value after samples (N,), and the lowest and highest place at each (N, 2)."""
        after, places = Travel(self.last.copy(), self.memory.copy()), np.empty((len(t), 2))
        settings = np.array([stroke_mm, ERROR_MM_S, _LONGEST_S])
        kernel.places_of(t, v, after.last, after.memory, settings, places)
        return after, places

    @classmethod
    def both_ways(cls, samples: AxisSamples, stroke_mm: float) -> AxisSamples:
        """Return samples with their position by the moves before and after each.

        Examples
        --------
        >>> t = np.arange(1, 702) * 10_000_000
        >>> out = AxisSamples.of(t, v=np.full(701, 100.0))
        >>> Travel.both_ways(out, 800.0).x[[0, -1]].round().tolist()
        [51.0, 749.0]
        """
        _, before = cls.initial().places_after(samples.t, samples.v, stroke_mm)
        back = 1 + samples.t.max(initial=0) - samples.t[::-1]
        _, behind = cls.initial().places_after(back, -samples.v[::-1], stroke_mm)
        low = np.maximum(before[:, 0], behind[::-1, 0])
        high = np.minimum(before[:, 1], behind[::-1, 1])
        return replace(samples, x=0.5 * (low + high))


def placed(samples: AxisSamples, stroke_mm: float) -> AxisSamples:
    """Return samples of which the speed alone is measured with their position; others as they are.

    >>> there = AxisSamples.of([0], x=[3.0])
    >>> placed(there, 800.0) is there
    True
    """
    if np.isfinite(samples.x).any() or not np.isfinite(samples.v).any():
        return samples
    return Travel.both_ways(samples, stroke_mm)
