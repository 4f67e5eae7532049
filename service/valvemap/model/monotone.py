"""A monotone map: least squares under ∂Q/∂U >= 0."""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from valvemap.model.least_squares_answers import parameter_covariance
from valvemap.model.least_squares_state import RlsState
from valvemap.model.linear_map import LinearParameters
from valvemap.model.model_structures import Structure
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples, Trace
from valvemap.model.tensor_spline import TensorSpline
from valvemap.vocabulary.statuses import Adaptation

GRID_U: Final = np.linspace(0.0, 100.0, 21)
GRID_DP: Final = np.array([0.5, 2.0, 8.0, 25.0, 60.0, 110.0, 200.0])


@dataclass(frozen=True)
class Monotone:
    """Recursive least squares whose map never falls with U.

    The recursion is unconstrained. Its theta is projected to the nearest monotone one in the metric
    of its covariance P, which equals least squares under the constraint::

        theta_c = argmin (x - theta)ᵀ·P⁻¹·(x - theta)   subject to   D·x >= 0

    For a spline the rows of D are the steps of its coefficients along U (sufficient everywhere);
    for another structure the steps of the map over a grid of U and dp at 40 °C. The other
    constraint, Q(dp = 0) = 0, depends on the structure: ``TensorSpline(at_rest="zero")``, or a
    polynomial whose terms all contain s or dp. The standard deviations are those without the
    constraint, which is conservative.

    References
    ----------
    C. Lawson, R. Hanson, Solving Least Squares Problems, 1974, ch. 23 (the dual is solved by
    non-negative least squares).

    Examples
    --------
    >>> U, dp = np.meshgrid(np.linspace(0, 100, 11), np.linspace(1, 200, 9))
    >>> Q = np.maximum(U - 30, 0).ravel() * np.sqrt(dp.ravel()) / 7
    >>> samples = Samples.of(np.arange(99), U.ravel(), dp.ravel(), 0 * Q, Q)
    >>> free = RecursiveLeastSquares(structure=TensorSpline.uniform(6, 4))
    >>> state, _ = free.update(free.initial_state(), samples)
    >>> at = np.linspace(0, 100, 41), np.full(41, 150.0), np.full(41, 40.0)
    >>> float(np.diff(free.predict(state, *at)[0]).min().round(1))
    -0.5
    >>> bool(np.diff(Monotone(free).predict(state, *at)[0]).min() > -1e-9)
    True
    """

    estimator: RecursiveLeastSquares

    @property
    def structure(self) -> Structure:
        """The estimator's structure."""
        return self.estimator.structure

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The estimator's names."""
        return self.estimator.parameter_names

    @property
    def lam(self) -> float:
        """The estimator's forgetting factor."""
        return self.estimator.lam

    def with_forgetting(self, lam: float) -> Self:
        """Return the same estimator with another forgetting factor; its states stay valid."""
        return replace(self, estimator=self.estimator.with_forgetting(lam))

    def initial_state(self) -> RlsState:
        """State before the first sample."""
        return self.estimator.initial_state()

    def update(self, state: RlsState, samples: Samples) -> tuple[RlsState, Trace]:
        """Update with N samples; the trace is that of the unconstrained recursion."""
        return self.estimator.update(state, samples)

    def predict(self, state: RlsState, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Flow under the constraint (N,), and its standard deviation without it (N,)."""
        free, std = self.estimator.predict(state, U, dp, T)
        with np.errstate(all="ignore"):
            rows = self.structure.regressors(U, dp, T)
            Q = np.asarray((rows * self._theta(state)).sum(axis=1))
        return np.where(np.isfinite(free), Q, free), std

    def parameters(self, state: RlsState) -> tuple[Floats, Floats]:
        """Theta under the constraint, and its standard deviations without it."""
        return self._theta(state), self.estimator.parameters(state)[1]

    def adaptation(self, state: RlsState) -> Adaptation:
        """Return the assessment of the unconstrained recursion's residuals."""
        return self.estimator.adaptation(state)

    def covariance(self, state: RlsState) -> Floats:
        """Covariance (n, n) of theta without the constraint."""
        return self.estimator.covariance(state)

    def to_map(self, state: RlsState) -> LinearParameters:
        """Return structure, theta and covariance."""
        theta, _ = self.parameters(state)
        return LinearParameters.of(self.structure, theta, self.covariance(state))

    def information(self, state: RlsState) -> Floats:
        """P⁻¹ (n, n) of the unconstrained recursion."""
        return self.estimator.information(state)

    def _theta(self, state: RlsState) -> Floats:
        theta, _ = self.estimator.parameters(state)
        covariance = parameter_covariance(state, self.estimator.forgetting)
        return nearest(theta, covariance, monotone_rows(self.structure))


def monotone_rows(structure: Structure) -> Floats:
    """Rows D (m, n) with D·theta >= 0 where the map rises with U."""
    match structure:
        case TensorSpline():
            sites_U, sites_s = structure.sites
            rest = len(sites_s) * max(1, len(structure.T))
            return np.asarray(np.kron(np.diff(np.eye(len(sites_U)), axis=0), np.eye(rest)))
        case _:
            U, dp = (x.ravel() for x in np.meshgrid(GRID_U, GRID_DP, indexing="ij"))
            rows = structure.regressors(U, dp, np.full_like(U, 40.0))
            steps = np.diff(rows.reshape(len(GRID_U), -1), axis=0)
            return steps.reshape(-1, rows.shape[1])


def nearest(theta: Floats, covariance: Floats, D: Floats) -> Floats:
    """Return the nearest x to theta with D·x >= 0; theta itself if it is unknown or feasible."""
    scale = np.sqrt(np.diag(covariance))
    if not (np.isfinite(theta).all() and np.isfinite(covariance).all() and (scale > 0.0).all()):
        return theta
    rows, z = D * scale, theta / scale
    if (rows @ z >= 0.0).all():
        return theta
    from scipy.linalg import LinAlgError, cholesky, solve_triangular  # noqa: PLC0415 - 0.25 s
    from scipy.optimize import nnls  # noqa: PLC0415 - which a map that rises does not need

    correlation = covariance / np.outer(scale, scale)
    try:
        L = cholesky(correlation + 1e-12 * np.eye(len(z)), lower=True)
    except LinAlgError:
        return theta
    # x = z + C·Dᵀ·mu with mu >= 0 minimising |Lᵀ·Dᵀ·mu + L⁻¹·z|: the dual.
    norms = np.linalg.norm(rows @ L, axis=1)
    A = (rows @ L / np.where(norms > 0.0, norms, 1.0)[:, None]).T
    mu, _ = nnls(A, -solve_triangular(L, z, lower=True), maxiter=30 * A.shape[1])
    return np.asarray(scale * (z + L @ (A @ mu)), np.float64)
