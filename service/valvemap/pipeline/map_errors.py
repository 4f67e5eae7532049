"""What errors at places say of a map elsewhere: the standard deviation that they show. Pure."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Singles, Times
from valvemap.pipeline.kernels.place_numbers import places_of
from valvemap.pipeline.kernels.places import TOLERATED

NEIGHBOURS: Final = 2.0  # weight of the mean over all places in the error of each


@dataclass(frozen=True)
class MapErrors:
    """The errors of one estimator at a valve's places, and its map's error elsewhere.

    Attributes
    ----------
    axes, seen
        The valve's places.
    past : (places,)
        Error of the newest map at each place, l/min.
    noise, excess : float
        Mean square of the noise in these errors, and of the rest, (l/min)².
    tail, multiple : float
        95 % quantile of these errors over that of a Gaussian of the same mean square; factor on the
        published interval, so that it holds 95 % of new visits.
    """

    axes: Floats
    seen: Times
    past: Singles
    noise: float
    excess: float
    tail: float
    multiple: float

    def widened(self, own: Floats, U: Floats, dp: Floats, T: Floats) -> Floats:
        """Return the standard deviation (N,) of the map; ``own`` is the estimator's."""
        found, near = np.empty(len(U), np.int64), np.empty(len(U))
        U, dp, T = (np.require(x, np.float64, ["C", "A", "W"]) for x in (U, dp, T))
        places_of(U, dp, T, self.axes, self.seen, found, near)
        overall = self.noise + self.excess
        past = np.where(found >= 0, self.past[found].astype(np.float64) ** 2, overall)
        past = overall + near * (past - overall)
        shown = shown_std(past, self.noise, self.excess, self.tail)
        factor = self.multiple if self.multiple > TOLERATED else 1.0
        return factor * np.fmax(own, shown) + 0.0 * own


def shown_std(past: Floats, noise: float, excess: float, tail: float) -> Floats:
    """Standard deviation of a map that errors ``past`` (squared) at places show, without noise."""
    if excess <= 0.0:
        return np.zeros_like(past)
    local = (past + NEIGHBOURS * (noise + excess)) / (1.0 + NEIGHBOURS)
    return tail * np.sqrt(np.maximum(local - noise, 0.0))
