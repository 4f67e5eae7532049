"""The ladder's climb: one shape fitted to the cells of the memory, and its neighbours by BIC."""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from service.identification.kernels import surface as kernel
from service.identification.kernels.cells import MEAN_Q, MEAN_T, WEIGHT
from service.identification.map_shapes import MOST_S, MOST_U, Shape, Variety
from service.identification.samples import Floats

MOST: Final = MOST_U * MOST_S
BAND: Final = 3 * MOST_S + 4
RICH: Final = {"cells": 20, "axis": 2}
LEAST_GAIN: Final = 0.1
NEVER_BELOW: Final = 1e-5
FALLING: Final = 0.2  # weight of a fall in the choice
STARTS: Final = tuple(product((None, 4.0, 8.0, 14.0), (None, 97.0)))
MOVE, IDLE = 0, 1


@dataclass(frozen=True)
class Fit:
    """A shape's least-squares fit; arrays as :func:`kernels.surface.fit` fills them."""

    theta: Floats
    inverse: Floats
    mixed: Floats
    corner: Floats
    rss: float
    penalty: float
    fall: float
    n_effective: float

    def bic(self, sigma_2: float, n_points: int) -> float:
        """(Σ w·e² + penalty + fall) / σ² + n_effective · ln(points); infinite if no number."""
        misfit = (self.rss + self.penalty + self.fall) / sigma_2
        bic = misfit + self.n_effective * math.log(n_points)
        return bic if math.isfinite(bic) else math.inf


def fit(points: Floats, shape: Shape, top: float) -> Fit:
    """Weighted least squares, eq. (16), of a shape up to ``top`` bar to the cells' means."""
    spline = shape.spline(top)
    (knots_U, knots_s), (along_U, along_s) = spline.knots, spline.roughness
    n = shape.size
    rough_U = along_U.T @ along_U if n else np.zeros((0, 0))
    theta = np.zeros(n + kernel.BORDER)
    inverse = np.zeros((MOST, BAND))
    mixed, corner = np.zeros((MOST, kernel.BORDER)), np.zeros((kernel.BORDER, kernel.BORDER))
    rss, penalty, n_effective = kernel.fit(
        points,
        shape.play,
        knots_U,
        knots_s,
        rough_U,
        along_s.T @ along_s,
        shape.columns,
        theta,
        inverse[:n],
        mixed[:n],
        corner,
    )
    fall = _fall(shape.coefficients(theta, top)[:, :, 0])
    return Fit(theta, inverse, mixed, corner, rss, penalty, fall, n_effective)


def _fall(coefficients: Floats) -> float:
    """How far the map falls where U rises, (l/min)²: between levels of U nothing else forbids it.

    A valve opens with U; a fall that the samples do show outweighs this.
    """
    falls = np.minimum(np.diff(coefficients, axis=0), 0.0).sum(axis=0)
    return FALLING * float(np.square(falls).sum())


def noise(points: Floats, shape: Shape, top: float) -> float:
    """σ² that the richest spline with the shape's kinks and play leaves."""
    rich = fit(points, replace(shape, **RICH), top)
    floor = (NEVER_BELOW * float(np.abs(points[:, MEAN_Q]).max())) ** 2
    return max(rich.rss / max(len(points) - rich.n_effective, 1.0), floor, 1e-30)


def variety(cells: Floats, points: Floats) -> Variety:
    """What the memory can tell apart."""
    weight = points[:, WEIGHT] / points[:, WEIGHT].sum()
    falling, rising = cells[::2, WEIGHT], cells[1::2, WEIGHT]
    shared = np.minimum(falling, rising).sum() / (falling + rising).sum()
    T = points[:, MEAN_T]
    return Variety(
        both_directions=shared > 0.05,
        temperatures=math.sqrt(float(weight @ (T - weight @ T) ** 2)) > 2.0,
    )


def climb(
    points: Floats,
    shape: Shape,
    top: float,
    varied: Variety,
    steps: int,
    progress: NDArray[np.int64],
) -> Shape:
    """Try the next ``steps`` neighbours in turn; go to each that lowers the BIC, and on that way.

    ``progress`` (2,) is carried on: the number of the next neighbour, and how many were tried in
    vain since the last gain.
    """
    around = shape.neighbours(varied)
    sigma_2 = noise(points, shape, top)
    best = fit(points, shape, top).bic(sigma_2, len(points))
    for _ in range(steps):
        candidate = around[progress[MOVE] % len(around)]
        if fit(points, candidate, top).bic(sigma_2, len(points)) >= best - LEAST_GAIN:
            progress += 1
        else:
            shape, progress[IDLE] = candidate, 0
            around = shape.neighbours(varied)
            sigma_2 = noise(points, shape, top)
            best = fit(points, shape, top).bic(sigma_2, len(points))
    return shape


def is_resting(shape: Shape, varied: Variety, progress: NDArray[np.int64]) -> bool:
    """Whether all neighbours were tried in vain."""
    return bool(progress[IDLE] > len(shape.neighbours(varied)))


def is_better(points: Floats, shape: Shape, than: Shape, top: float) -> bool:
    """Whether a shape has the smaller BIC, with the σ² of the other."""
    sigma_2 = noise(points, than, top)
    old, new = (fit(points, x, top).bic(sigma_2, len(points)) for x in (than, shape))
    return new < old - LEAST_GAIN


def fresh_start(number: int, like: Shape) -> Shape:
    """A coarse shape with kinks somewhere, and the play and trend of another."""
    low, high = STARTS[number % len(STARTS)]
    return Shape(2, 2, low, high, like.play, like.trend)
