"""What theta of eq. (29) lags by behind a plant that drifts, and what its interval makes of it."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.filtered_scores import BLOCKS, LATELY, SCORE
from valvemap.model.kernels.scores import BLOCK, FEWEST
from valvemap.model.maximum_likelihood_state import MaximumLikelihoodState, mirrored
from valvemap.model.samples import Floats

CHANCE: Final = 4.0  # squared standard deviations of the mean score that are no drift
UNEVEN: Final = 1.0 / 3.0  # variance of lags between none and twice their mean, over its square


@dataclass(frozen=True)
class Lags:
    """What theta lags by behind plants that surely drift, M of the models.

    The scores of the last samples have the mean M·Delta theta. A place that was visited just now
    lags by nothing, one that was visited long ago by more than that.

    Attributes
    ----------
    sure : (models,)
        Which models they are.
    score, theta : (M, s)
        Mean of the scores, and the lag.
    doubt : (M, s, s)
        Covariance of that lag; Omega holds the lag too, so it is rather too large.
    over_all : (M,)
        Mean square of the lag over the samples, (l/min)².
    """

    sure: NDArray[np.bool_]
    score: Floats
    theta: Floats
    doubt: Floats
    over_all: Floats

    def without(self, states: MaximumLikelihoodState) -> MaximumLikelihoodState:
        """States whose Omega is that of the noise: to scores, a lag is noise that lasts."""
        if not self.sure.any():
            return states
        omega = states.omega.copy()
        # Two blocks at a time, as Omega is gathered.
        omega[self.sure] -= 2.0 * BLOCK * self.score[:, :, None] * self.score[:, None, :]
        return replace(states, omega=omega)

    def beyond(self, X: Floats, std: Floats) -> Floats:
        """Standard deviations (models, N) at rows X with the lag, from those without."""
        if not self.sure.any():
            return std
        with np.errstate(all="ignore"):
            # No BLAS over the rows: each has the same bits alone and among others.
            here, chance = (X * self.theta[:, None]).sum(axis=2) ** 2, np.zeros(1)
            for j in range(X.shape[1]):
                chance = chance + X[:, j] * (X * self.doubt[:, None, j]).sum(axis=2)
            lags = np.maximum(here - chance, 0.0) + UNEVEN * self.over_all[:, None]
            lags = np.where(np.isfinite(lags), lags, 0.0)
            wider = std.copy()
            wider[self.sure] = np.sqrt(std[self.sure] ** 2 + lags)
        return wider


def lags_of(states: MaximumLikelihoodState) -> Lags:
    """Lags of those models whose last scores have a mean beyond chance."""
    samples = np.minimum(BLOCK * states.colour[:, BLOCKS], 2.0 * LATELY)
    sure = samples >= FEWEST * BLOCK
    M, Omega = (mirrored(square[sure]) for square in (states.moments, states.omega))
    score = states.blocks[sure, SCORE]
    with np.errstate(all="ignore"):
        inverse = np.linalg.pinv(M, hermitian=True)
        theta = (inverse @ score[:, :, None])[:, :, 0]
        doubt = inverse @ Omega @ inverse / samples[sure, None, None]
        over_all = (score * theta).sum(axis=1)
        chance = np.trace(doubt @ M, axis1=1, axis2=2)
        beyond = over_all > CHANCE * chance
    sure[sure] = beyond
    found = score[beyond], theta[beyond], doubt[beyond], (over_all - chance)[beyond]
    return Lags(sure, *found)
