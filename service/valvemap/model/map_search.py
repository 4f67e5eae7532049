"""Structure search: fits a shape to the cells of the memory, and compares its neighbours by BIC."""

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
RICH: Final = 5  # values kept of the richest spline, see `noise`
LEAST_SHARE: Final = 0.05  # share of samples reached from both sides that makes a loop identifiable
LEAST_PLAY: Final = 0.1  # %; a smaller play cannot be distinguished from a lag of a few ms
LAG_DOUBT: Final = 2.0  # %/s; play caused by 2 % uncertainty of a lag at 100 %/s
LEAST_SPREAD: Final = 2.0  # K; spread of T that makes a trend identifiable


@dataclass(frozen=True)
class Fit:
    """A shape's least-squares fit; arrays as :func:`kernels.map_fit.fit` fills them.

    Only ``mixed`` (n, TREND) differs: a spline has no additional eq. (7).
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
    """Return σ² of the residual of the richest spline with the shape's kinks, play and trend.

    ``rich`` (5,) caches the result of such a spline, and is written.
    """
    return float(kernel.noise(points, shape.to_array(), top, _known(rich)))


def variety(shared: float, points: Floats, lag: float = 0.0) -> Variety:
    """Return the resolution of the memory with lags of ``lag`` s in total.

    ``shared`` is the share of the samples in cells that U reached from both sides, see
    :mod:`kernels.held`.
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
    """Try the next ``steps`` neighbours in turn; move to each that lowers the BIC.

    ``progress`` (2,) is updated: the number of the next neighbour, and the number of failed trials
    since the last gain. ``least`` is the lower bound of σ²; for ``rich`` see `noise`.
    """
    numbers, trends = shape.to_array(), int(varied.temperatures)
    kernel.climb(
        *(points, numbers, top, varied.least_play, trends, steps, progress, least, _known(rich))
    )
    return Shape.from_array(numbers)


def is_resting(shape: Shape, varied: Variety, progress: NDArray[np.int64]) -> bool:
    """Whether all neighbours have been tried without a gain."""
    return bool(progress[IDLE] > len(shape.neighbours(varied)))


def is_better(
    points: Floats,
    shape: Shape,
    than: Shape,
    top: float,
    least: float = 0.0,
    rich: Floats | None = None,
) -> bool:
    """Whether a shape has a smaller BIC than another, with the other's σ² (and ``rich``)."""
    sigma_2 = max(noise(points, than, top, rich), least)
    own, other = (kernel.bic(points, x.to_array(), top, sigma_2) for x in (shape, than))
    return bool(own < other - kernel.LEAST_GAIN)


def _known(rich: Floats | None) -> Floats:
    return np.zeros(RICH) if rich is None else rich


def fresh_start(number: int, like: Shape) -> Shape:
    """Return a coarse shape with new kinks, and the play and trend of another."""
    low, high = STARTS[number % len(STARTS)]
    return Shape(2, 2, low, high, like.play, like.trend)
