"""The ladder's climb: one shape fitted to the cells of the memory, and its neighbours by BIC."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels import climb as kernel
from valvemap.model.kernels import map_fit
from valvemap.model.kernels.climb import IDLE
from valvemap.model.kernels.grid import MEAN_T, WEIGHT
from valvemap.model.kernels.surface import BORDER, FIVE_TERMS, PAIRS
from valvemap.model.map_shapes import Shape, Variety
from valvemap.model.samples import Floats

STARTS: Final = tuple(product((None, 4.0, 8.0, 14.0), (None, 97.0)))
RICH: Final = 5  # numbers that are kept of the richest spline, see `noise`
LEAST_SHARE: Final = 0.05  # of the samples where U came from either side: a loop could be seen
LEAST_PLAY: Final = 0.1  # %: less is not told from a lag of a few ms
LAG_DOUBT: Final = 2.0  # %/s: play that 2 % of doubt about a lag makes at 100 %/s
LEAST_SPREAD: Final = 2.0  # K of T: a trend could be seen


@dataclass(frozen=True)
class Fit:
    """A shape's least-squares fit; arrays as :func:`kernels.map_fit.fit` fills them.

    But for ``mixed`` (n, TREND): beside a spline there is no eq. (7).
    """

    theta: Floats
    inverse: Floats
    mixed: Floats
    corner: Floats
    rss: float
    penalty: float
    fall: float
    n_effective: float


def fit(points: Floats, shape: Shape, top: float) -> Fit:
    """Weighted least squares, eq. (16), of a shape up to ``top`` bar to the cells' means."""
    n = shape.size
    theta, corner = np.empty(n + BORDER), np.empty((BORDER, BORDER))
    inverse, mixed = np.empty((n, PAIRS)), np.empty((n, BORDER))
    said = map_fit.fit(points, shape.plan(top), theta, inverse, mixed, corner)
    return Fit(theta, inverse, mixed[:, FIVE_TERMS:], corner, *said)


def noise(points: Floats, shape: Shape, top: float, rich: Floats | None = None) -> float:
    """σ² that the richest spline with the shape's kinks, play and trend leaves.

    ``rich`` (5,) is what such a spline has left before, and is written.
    """
    return float(kernel.noise(points, shape.to_array(), top, _known(rich)))


def variety(shared: float, points: Floats, lag: float = 0.0) -> Variety:
    """What the memory can tell apart, behind lags of ``lag`` s in all.

    ``shared`` is the share of the samples where U came from either side, see :mod:`kernels.held`.
    """
    weight = points[:, WEIGHT] / points[:, WEIGHT].sum()
    T = points[:, MEAN_T]
    return Variety(
        least_play=max(LEAST_PLAY, LAG_DOUBT * lag) if shared > LEAST_SHARE else math.inf,
        temperatures=math.sqrt(float(weight @ (T - weight @ T) ** 2)) > LEAST_SPREAD,
    )


def climb(
    points: Floats,
    shape: Shape,
    top: float,
    varied: Variety,
    steps: int,
    progress: NDArray[np.int64],
    least: float = 0.0,
    rich: Floats | None = None,
) -> Shape:
    """Try the next ``steps`` neighbours in turn; go to each that lowers the BIC, and on that way.

    ``progress`` (2,) is carried on: the number of the next neighbour, and how many were tried in
    vain since the last gain. ``least`` is what σ² is at least; ``rich`` see `noise`.
    """
    numbers, trends = shape.to_array(), int(varied.temperatures)
    kernel.climb(
        *(points, numbers, top, varied.least_play, trends, steps, progress, least, _known(rich))
    )
    return Shape.from_array(numbers)


def is_resting(shape: Shape, varied: Variety, progress: NDArray[np.int64]) -> bool:
    """Whether all neighbours were tried in vain."""
    return bool(progress[IDLE] > len(shape.neighbours(varied)))


def is_better(
    points: Floats,
    shape: Shape,
    than: Shape,
    top: float,
    least: float = 0.0,
    rich: Floats | None = None,
) -> bool:
    """Whether a shape has the smaller BIC, with the σ² of the other; ``rich`` is that one's."""
    sigma_2 = max(noise(points, than, top, rich), least)
    own, other = (kernel.bic(points, x.to_array(), top, sigma_2) for x in (shape, than))
    return bool(own < other - kernel.LEAST_GAIN)


def _known(rich: Floats | None) -> Floats:
    return np.zeros(RICH) if rich is None else rich


def fresh_start(number: int, like: Shape) -> Shape:
    """A coarse shape with kinks somewhere, and the play and trend of another."""
    low, high = STARTS[number % len(STARTS)]
    return Shape(2, 2, low, high, like.play, like.trend)
