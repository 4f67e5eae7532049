"""The law of the pressure drop of a sweep's fit: what all openings share of a departure from √Δp.

Flow at an opening goes with h(s), s = √Δp with its sign: that of an orifice is s, a laminar gap or
a compensator departs from it. h is s plus four smooth functions plus a piecewise linear one, whose
knots lie `STEP` apart. Each of the four, and each bend, has a scale of its own, decided by the
evidence (MacKay 1992, doi 10.1162/neco.1992.4.3.415): nearly all vanish, and a compensator's knee
stays sharp.
"""

from typing import Final

import numpy as np
from scipy import linalg, sparse

from valvemap.model.samples import Floats
from valvemap.model.sweep_curves import EXACT, bends_of, hats_of, knots_of

STEP: Final = 0.4  # √bar; distance of knots
SHARP, SOFT = 0.05, 0.25  # of the largest √Δp; where two of the smooth functions bend
SMOOTH_ONES: Final = 4
STEPS: Final = 5  # of a search
LEAST_TOLD, LEAST_SIZE = 1e-3, 1e-9  # of a part: share that the samples tell, square of its size


class DropLaw:
    """Law of the pressure drop at samples; `factor` (N,) is h(s)/h(s_rated) there."""

    def __init__(self, s: Floats, s_rated: float) -> None:
        low, high = float(s.min()) - STEP, float(s.max()) + STEP
        self._top, self._knots = max(-low, high), knots_of(low, high, STEP)
        self._orifice = s / s_rated
        rated = self._functions(np.array([s_rated]))
        self.columns = np.asarray(self._functions(s) - np.outer(self._orifice, rated))
        self._parts: Floats = linalg.block_diag(np.eye(SMOOTH_ONES), bends_of(len(self._knots)))
        self._values = np.zeros(self.columns.shape[1])
        self._weights = np.zeros(len(self._parts))
        self.factor = self._orifice

    def prior(self) -> Floats:
        """Information of the law before anything is measured, (J, J)."""
        of_parts = (self._parts.T * self._weights) @ self._parts
        return np.asarray(of_parts + np.eye(len(self._values)))

    def fit(
        self, hats: sparse.csr_matrix, weight: Floats, Q: Floats, prior_K: Floats, many: float
    ) -> None:
        """Fit it beside the curve at the rated pressure drop, by Gauss-Newton.

        Parameters
        ----------
        hats
            Functions of the curve at the samples, (N, K); ``prior_K`` (K, K) its prior.
        weight, Q
            Of the samples; Q is weighted. ``many`` is the sum of squares of the weights.
        """
        D = self._parts
        for _ in range(STEPS):
            A = sparse.csr_matrix(sparse.diags(weight * self.factor) @ hats)
            AA, AQ = np.asarray((A.T @ A).todense()) + prior_K, np.asarray(A.T @ Q)
            K = np.linalg.solve(AA, AQ)
            squares = float(np.sum((Q - A @ K) ** 2)) + many * EXACT**2
            C, prior = self.columns * (weight * (hats @ K))[:, None], self.prior()
            across = np.asarray(A.T @ C)
            both = np.block([[AA, across], [across.T, C.T @ C + prior]])
            spread = np.linalg.inv(both)[len(K) :]
            right = np.concatenate([AQ, C.T @ Q - prior @ self._values])
            self._values = self._values + spread @ right
            self.factor = self._orifice + self.columns @ self._values
            variance = np.einsum("ij,jk,ik->i", D, spread[:, len(K) :], D)
            size = (D @ self._values) ** 2 * many / squares
            told = np.maximum(1.0 - self._weights * variance, LEAST_TOLD)
            self._weights = told / np.maximum(size, LEAST_SIZE)

    def _functions(self, s: Floats) -> Floats:
        z = s / self._top
        size = np.abs(z)
        smooth = z * size, z**3, z / (size + SHARP), z / (size + SOFT)
        return np.column_stack([*smooth, hats_of(self._knots, s).toarray()])
