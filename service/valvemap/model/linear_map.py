"""A known map: theta of a structure and its covariance, from a file or by hand."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.model_structures import Structure
from valvemap.model.samples import Floats, Samples, Trace
from valvemap.vocabulary.statuses import Adaptation, Quality, Status


@dataclass(frozen=True)
class LinearMapState(State):
    """Theta (n,) and its covariance (n, n), NaN where unknown."""

    theta: Floats
    covariance: Floats

    def contents(self) -> Mapping[str, Contents]:
        """Valid values of the arrays."""
        return {
            "theta": Contents(self.theta).or_nan(),
            "covariance": Contents(self.covariance).or_nan(),
        }


@dataclass(frozen=True)
class LinearParameters:
    """A map as a value: a structure, theta (n,) and its covariance (n, n)."""

    structure: Structure
    theta: Floats
    covariance: Floats

    @classmethod
    def of(cls, structure: Structure, theta: Floats, covariance: Floats) -> Self:
        """Return the map of an estimator whose first n parameters are the structure's.

        Raises
        ------
        ValueError
            if theta or its covariance is not determined yet.
        """
        n = len(structure.parameter_names)
        found = cls(structure, theta[:n], covariance[:n, :n])
        if not np.isfinite(found.theta).all() or not np.isfinite(found.covariance).all():
            raise ValueError("its parameters are not determined yet")
        return found


@dataclass(frozen=True)
class LinearMap:
    """A structure with known parameters: it predicts, and never learns (status FROZEN).

    Examples
    --------
    >>> from valvemap.model.model_structures import FiveTerms
    >>> valve = LinearMap(FiveTerms())
    >>> state = LinearMapState(np.array([0.0, 0.0, 0.0, 0.1, 0.0]), 1e-6 * np.eye(5))
    >>> Q, std = valve.predict(state, np.array([50.0]), np.array([100.0]), np.array([40.0]))
    >>> Q, std.round(2)
    (array([50.]), array([0.51]))
    """

    structure: Structure

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The structure's names."""
        return self.structure.parameter_names

    def initial_state(self) -> LinearMapState:
        """Return unknown theta and covariance, NaN."""
        n = len(self.parameter_names)
        return LinearMapState(np.full(n, np.nan), np.full((n, n), np.nan))

    def update(self, state: LinearMapState, samples: Samples) -> tuple[LinearMapState, Trace]:
        """Predict N samples; the state does not change."""
        Q, _ = self.predict(state, samples.U, samples.dp, samples.T)
        usable = (samples.quality != Quality.BAD) & np.isfinite(Q + samples.Q)
        predicted = np.where(usable, Q, np.nan)
        status = np.where(usable, Status.FROZEN, Status.REJECTED).astype(np.uint8)
        residual = samples.Q - predicted
        return state, Trace(predicted, residual, residual, status)

    def predict(
        self, state: LinearMapState, U: Floats, dp: Floats, T: Floats
    ) -> tuple[Floats, Floats]:
        """Flow (N,) and its standard deviation (N,), l/min; NaN if unknown."""
        with np.errstate(all="ignore"):
            X = self.structure.regressors(U, dp, T)
            Q = (X * state.theta).sum(axis=1)
            variance = np.einsum("ij,jk,ik->i", X, state.covariance, X)
            std = np.sqrt(np.maximum(variance, 0.0))
        known = np.isfinite(Q)
        return np.where(known, Q, np.nan), np.where(known, std, np.nan)

    def covariance(self, state: LinearMapState) -> Floats:
        """Covariance of theta (n, n)."""
        return state.covariance

    def parameters(self, state: LinearMapState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations."""
        return state.theta.copy(), np.sqrt(np.maximum(np.diag(state.covariance), 0.0))

    def to_map(self, state: LinearMapState) -> LinearParameters:
        """Return structure, theta and covariance."""
        theta, _ = self.parameters(state)
        return LinearParameters.of(self.structure, theta, self.covariance(state))

    def adaptation(self, _state: LinearMapState) -> Adaptation:
        """Return undecided: it does not assess residuals."""
        return Adaptation.UNDECIDED
