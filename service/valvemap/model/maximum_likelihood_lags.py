"""Lag of eq. (29)'s theta behind a drifting plant, and its effect on the interval."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.filtered_scores import BLOCKS, LATELY, SCORE
from valvemap.model.kernels.scores import BLOCK, FEWEST
from valvemap.model.maximum_likelihood_state import MaximumLikelihoodState, mirrored
from valvemap.model.samples import Floats

CHANCE: Final = 4.0  # squared standard deviations of the mean score within chance
UNEVEN: Final = 1.0 / 3.0  # relative variance of lags uniform between 0 and twice their mean


@dataclass(frozen=True)
class Lags:
    """Lag of theta behind the M models whose plants drift significantly.

    The mean of the last samples' scores is M·Delta theta. The lag is 0 at a place just visited, and
    larger than the mean at one visited long ago.

    Attributes
    ----------
    sure : (models,)
        Mask of the drifting models.
    score, theta : (M, s)
        Mean of the scores, and the lag.
    doubt : (M, s, s)
        Covariance of the lag; it is overestimated, since Omega contains the lag, too.
    over_all : (M,)
        Mean square of the lag over the samples, (l/min)².
    """

    sure: NDArray[np.bool_]
    score: Floats
    theta: Floats
    doubt: Floats
    over_all: Floats

    def without(self, states: MaximumLikelihoodState) -> MaximumLikelihoodState:
        """Return states whose Omega contains the noise only, without the lasting lag."""
        if not self.sure.any():
            return states
        omega = states.omega.copy()
        # Two blocks at a time, like the updates of Omega.
        omega[self.sure] -= 2.0 * BLOCK * self.score[:, :, None] * self.score[:, None, :]
        return replace(states, omega=omega)

    def beyond(self, X: Floats, std: Floats) -> Floats:
        """Return standard deviations (models, N) at rows X with the lag, from those without."""
        if not self.sure.any():
            return std
        with np.errstate(all="ignore"):
            # No BLAS over the rows: results must not depend on the other rows.
            here, chance = (X * self.theta[:, None]).sum(axis=2) ** 2, np.zeros(1)
            for j in range(X.shape[1]):
                chance = chance + X[:, j] * (X * self.doubt[:, None, j]).sum(axis=2)
            lags = np.maximum(here - chance, 0.0) + UNEVEN * self.over_all[:, None]
            lags = np.where(np.isfinite(lags), lags, 0.0)
            wider = std.copy()
            wider[self.sure] = np.sqrt(std[self.sure] ** 2 + lags)
        return wider


def lags_of(states: MaximumLikelihoodState) -> Lags:
    """Return the lags of the models whose recent scores have a significant mean."""
    samples = np.minimum(BLOCK * states.colour[:, BLOCKS], 2.0 * LATELY)
    sure = samples >= FEWEST * BLOCK
    score, M = states.blocks[sure, SCORE], mirrored(states.moments[sure])
    if not sure.any():
        return Lags(sure, score, score, M, samples[sure])
    Omega = mirrored(states.omega[sure])
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
