"""The map of `Auto` as a value: shape, parameters, and the information behind its std."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from valvemap.model.auto_state import AutoState, empty, write_map
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels.surface import APART, BORDER, FIVE_TERMS
from valvemap.model.map_shapes import MOST, Shape
from valvemap.model.samples import Floats

BAND: Final = 31  # of the inverse information: a point's parameters lie no farther apart


@dataclass(frozen=True)
class AutoMap:
    """The champion's map.

    Attributes
    ----------
    shape : (6,)
        The step of the ladder, see :class:`~valvemap.model.map_shapes.Shape`; n parameters.
    dp_top
        Pressure to which its splines reach, bar.
    theta, beside : (n,), (BORDER,)
        Parameters of the spline, and those beside it.
    inverse, mixed, corner : (n, BAND), (n, BORDER), (BORDER, BORDER)
        Inverse information, in bands by the distance of two parameters.
    variance, gain_variance
        Of the noise, (l/min)², and of the map's relative error.
    """

    shape: Floats
    dp_top: float
    theta: Floats
    beside: Floats
    inverse: Floats
    mixed: Floats
    corner: Floats
    variance: float
    gain_variance: float

    @classmethod
    def of(cls, state: AutoState) -> Self:
        """Return the map of a state.

        Raises
        ------
        ValueError
            if it is not determined yet.
        """
        if not state.counters[memory.FITTED]:
            raise ValueError("its map is not determined yet")
        n = Shape.from_array(state.shapes[0]).size
        return cls(
            shape=state.shapes[0],
            dp_top=float(state.top[0]),
            theta=state.theta[:n],
            beside=state.theta[MOST:],
            inverse=_band(state)[:n],
            mixed=np.pad(state.mixed[:n].astype(np.float64), ((0, 0), (FIVE_TERMS, 0))),
            corner=state.corner,
            variance=float(state.scalars[memory.VARIANCE]),
            gain_variance=float(state.scalars[memory.GAIN_VARIANCE]),
        )

    def state(self) -> AutoState:
        """Return a state of `Auto` with this map, and nothing that an update needs."""
        blank = empty(None, None)
        shape = Shape.from_array(self.shape)
        n = shape.size
        blank.theta[:n], blank.theta[MOST:] = self.theta, self.beside
        blank.mixed[:n] = self.mixed.reshape(n, BORDER)[:, FIVE_TERMS:]
        blank.corner[:] = self.corner
        blank.shapes[:], blank.top[:] = self.shape, self.dp_top
        blank.scalars[memory.VARIANCE] = self.variance
        blank.scalars[memory.GAIN_VARIANCE] = self.gain_variance
        blank.counters[memory.FITTED] = 1
        theta = np.concatenate([self.theta, self.beside])
        for which in (0, 1):
            write_map(blank, which, shape, theta, self.dp_top)
        kept, filed = _pairs(int(blank.sizes[0, 1]))
        blank.inverse[:n, kept] = self.inverse.reshape(n, BAND)[:, filed]
        return blank


def _band(state: AutoState) -> Floats:
    """Return the inverse information in bands by the distance of two parameters."""
    found = np.zeros((MOST, BAND))
    kept, filed = _pairs(int(state.sizes[0, 1]))
    found[:, filed] = state.inverse[:, kept]
    return found


def _pairs(n_s: int) -> tuple[list[int], list[int]]:
    """Return the indices of parameter pairs in memory and in bands; ``n_s`` is the size per U."""
    apart = [(u, v) for u in range(4) for v in range(-3, 4) if u or v >= 0]
    return [u * APART + v for u, v in apart], [u * n_s + v for u, v in apart]
