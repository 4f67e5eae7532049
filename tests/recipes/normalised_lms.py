"""Normalised least mean squares on a structure that is linear in its parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.linear_map import LinearParameters
from valvemap.model.model_structures import FiveTerms, Structure
from valvemap.model.samples import Floats, Samples, Trace
from valvemap.vocabulary.statuses import Adaptation, Quality, Status

LARGEST = 1e6  # %, bar, l/min; larger magnitudes are no measurements
MEMORY = 0.99  # per sample; of the mean square of the residual
REGULAR = 1e-6  # of the squared length of a scaled row


@dataclass(frozen=True)
class LmsState(State):
    """Theta (n,) of scaled regressors, the number of samples and the residual's mean square."""

    theta: Floats
    monitor: Floats

    def contents(self) -> Mapping[str, Contents]:
        """Valid values of the arrays."""
        return {"monitor": Contents(self.monitor).within(0.0)}


@dataclass(frozen=True)
class NormalisedLms:
    """Normalised least mean squares: theta += mu·e·X/(XᵀX), with scaled regressors X."""

    structure: Structure = FiveTerms()  # noqa: RUF009 - frozen
    mu: float = 0.5

    std_of_residuals: ClassVar[Literal[True]] = True

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The structure's names."""
        return self.structure.parameter_names

    def initial_state(self) -> LmsState:
        """Return theta = 0."""
        return LmsState(np.zeros(len(self.parameter_names)), np.zeros(2))

    def update(self, state: LmsState, samples: Samples) -> tuple[LmsState, Trace]:
        """Update with N samples in sequence."""
        X, usable = self._rows(samples.U, samples.dp, samples.T)
        usable &= (np.abs(samples.Q) <= LARGEST) & (samples.quality != Quality.BAD)
        theta, (count, power) = state.theta.copy(), state.monitor
        predicted = np.full(len(samples), np.nan)
        status = np.full(len(samples), np.uint8(Status.REJECTED))
        for k in np.flatnonzero(usable):
            predicted[k] = (X[k] * theta).sum()
            e = samples.Q[k] - predicted[k]
            theta += self.mu * e * X[k] / (REGULAR + (X[k] * X[k]).sum())
            count, power = count + 1, MEMORY * power + (1.0 - MEMORY) * e * e
            status[k] = Status.OK if count > len(theta) else Status.WARMING_UP
        residual = samples.Q - predicted
        after = LmsState(theta, np.array([count, power]))
        return after, Trace(predicted, residual, residual, status)

    def predict(self, state: LmsState, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Flow (N,) and the running RMS of the residual (N,), l/min; NaN before any sample."""
        X, usable = self._rows(U, dp, T)
        known = usable & (state.monitor[0] > 0)
        Q = (np.where(known[:, None], X, 0.0) * state.theta).sum(axis=1)
        rms = np.sqrt(state.monitor[1])
        return np.where(known, Q, np.nan), np.where(known, rms, np.nan)

    def covariance(self, state: LmsState) -> Floats:
        """Return a coarse covariance of theta (n, n): the step's share of the residual's power."""
        return np.diag(self.mu * state.monitor[1] / self._scale() ** 2)

    def parameters(self, state: LmsState) -> tuple[Floats, Floats]:
        """Theta and its standard deviations."""
        return state.theta / self._scale(), np.sqrt(np.diag(self.covariance(state)))

    def to_map(self, state: LmsState) -> LinearParameters:
        """Return structure, theta and covariance."""
        theta, _ = self.parameters(state)
        return LinearParameters.of(self.structure, theta, self.covariance(state))

    def adaptation(self, _state: LmsState) -> Adaptation:
        """Return undecided: it does not assess residuals."""
        return Adaptation.UNDECIDED

    def _scale(self) -> Floats:
        """Magnitudes of the regressors at 100 %, 200 bar and 40 °C."""
        X = self.structure.regressors(*(np.array([x]) for x in (100.0, 200.0, 40.0)))
        return np.maximum(np.abs(X[0]), 1e-9)

    def _rows(self, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, np.ndarray]:
        """Return scaled rows (N, n), and a mask of the finite ones."""
        with np.errstate(all="ignore"):
            X = self.structure.regressors(U, dp, T) / self._scale()
            usable = np.isfinite(X).all(axis=1) & (np.abs(U) <= LARGEST) & (np.abs(dp) <= LARGEST)
        return X, usable
