"""Errors of the paper's estimators during identification, and the criterion of convergence."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from paper import printed
from paper.data import Points
from valvemap.model.estimator import Estimator, State
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples

LAMBDAS: Final = (0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9998, 0.9999, 1.0)
SHOWN: Final = (0.99, 0.995, 0.999, 1.0)
PAPERS: Final = 0.995
EACH: Final = 100
CHECKS: Final = 220

USELESS: Final = 10.0
WHY_USELESS: Final = (
    "10 l/min is half the step of flow from one level of U to the next at full drop: a map that is "
    "off by more cannot tell neighbouring levels apart"
)
UNSETTLED: Final = float(np.sqrt(2.0))

PASSES: Final = 20
INSIDE: Final = (5.0, 95.0)
EQ_7: Final = RecursiveLeastSquares()

S = TypeVar("S", bound=State)


@dataclass(frozen=True)
class Course:
    """The error of a map during its identification.

    Attributes
    ----------
    after : (K,) int64
        Number of processed samples.
    rmse : (K,) float64
        Error over the verification points, l/min; infinite if it is undefined.

    Examples
    --------
    >>> course = Course.of([100, 200, 300], [50.0, 2.0, 2.0])
    >>> course.converged, round(course.unrest, 3), course.settled_after
    (True, 0.707, 200.0)
    """

    after: NDArray[np.int64]
    rmse: Floats

    @classmethod
    def of(cls, after: ArrayLike, rmse: ArrayLike) -> "Course":
        """Convert array-likes; non-finite errors become infinite."""
        errors = np.asarray(rmse, np.float64)
        return cls(np.asarray(after, np.int64), np.where(np.isfinite(errors), errors, np.inf))

    @property
    def final(self) -> float:
        """Median error over the last third, l/min."""
        return float(np.median(self._last_third))

    @property
    def unrest(self) -> float:
        """Measure of convergence; converged if ≤ 1.

        The 95th percentile of the error in the last third, divided by its limit: the lower one of
        USELESS and UNSETTLED times the median of the last third.
        """
        high = float(np.percentile(self._last_third, 95, method="lower"))
        return high / min(USELESS, UNSETTLED * self.final) if np.isfinite(high) else np.inf

    @property
    def converged(self) -> bool:
        """Whether the error has settled at a useful level."""
        return self.unrest <= 1.0

    @property
    def settled_after(self) -> float:
        """Samples until the error stays within UNSETTLED times its final value.

        Infinite if the map did not converge.
        """
        return self.within(UNSETTLED * self.final) if self.converged else np.inf

    def within(self, limit: float) -> float:
        """Return the samples until the error stays within a limit; infinite if it never does."""
        outside = np.flatnonzero(self.rmse > limit)
        first = outside[-1] + 1 if len(outside) else 0
        return float(self.after[first]) if first < len(self.after) else np.inf

    @property
    def _last_third(self) -> Floats:
        return np.asarray(self.rmse[3 * self.after > 2 * self.after[-1]])


@dataclass(frozen=True)
class Lessons:
    """Results of all estimators on one recording in one pass.

    Attributes
    ----------
    lsm : (5,)
        Batch least squares of eq. (7), eq. (16).
    lsm_rmse : float
        Its error over the verification points, i.e. the structural error, l/min.
    rls : {λ: Course}
        RLS with all LAMBDAS, and with their squares, which (28) as printed is equivalent to.
    theta : {λ: (N, 5)}
        Parameters after each sample, for the λ in SHOWN.
    rml, rbf : Course
        The correct forms; ``rml_theta`` and ``rbf_theta`` are their parameters (K, n) over time.
    rml_printed, rbf_printed : Course
        Eqs. (29) and (37) as printed.
    """

    lsm: Floats
    lsm_rmse: float
    rls: Mapping[float, Course]
    theta: Mapping[float, Floats]
    rml: Course
    rml_theta: Floats
    rml_printed: Course
    rbf: Course
    rbf_theta: Floats
    rbf_printed: Course


def lessons(samples: Samples, truth: Points, network: RbfNetwork) -> Lessons:
    """Run all estimators over one recording, sample by sample, once."""
    structure = FiveTerms()
    X = structure.regressors(samples.U, samples.dp, samples.T)
    XV = structure.regressors(truth.U, truth.dp, truth.T)
    lsm = batch_least_squares(X, samples.Q)
    wanted = sorted({*LAMBDAS, *(lam**2 for lam in LAMBDAS)})
    histories = {lam: recursive_least_squares(X, samples.Q, lam).theta_history for lam in wanted}
    rml, rml_theta = follow(MaximumLikelihood(), samples, truth)
    rbf, rbf_theta = follow(network, samples, truth)
    return Lessons(
        lsm=lsm,
        lsm_rmse=rmse(XV @ lsm, truth.Q),
        rls={lam: linear_course(theta, XV, truth.Q) for lam, theta in histories.items()},
        theta={lam: histories[lam] for lam in SHOWN},
        rml=rml,
        rml_theta=rml_theta,
        rml_printed=linear_course(printed.maximum_likelihood_map(X, samples.Q), XV, truth.Q),
        rbf=rbf,
        rbf_theta=rbf_theta,
        rbf_printed=_printed_network(samples, truth, network),
    )


def rmse(Q_hat: Floats, Q: Floats) -> float:
    """Return the root of the mean squared error, l/min; infinite if any value is not finite."""
    with np.errstate(all="ignore"):
        error = float(np.sqrt(np.mean((Q_hat - Q) ** 2)))
    return error if np.isfinite(error) else np.inf


def checkpoints(n: int) -> NDArray[np.int64]:
    """Return the sample numbers at which the error is computed: all of the first, then few.

    >>> checkpoints(2200)[[0, 99, 100, -1]]
    array([   1,  100,  101, 2200])
    """
    even = np.linspace(1, n, min(n, CHECKS)).round().astype(np.int64)
    return np.union1d(even, np.arange(1, min(n, EACH) + 1))


def linear_course(theta: Floats, X: Floats, Q: Floats) -> Course:
    """Return the course of a map Xᵀ·theta: theta (N, n) per sample, true X (V, n) and Q (V,)."""
    after = checkpoints(len(theta))
    return Course.of(after, [rmse(X @ theta[k - 1], Q) for k in after])


def follow(estimator: Estimator[S], samples: Samples, truth: Points) -> tuple[Course, Floats]:
    """Return the course of any estimator, and its parameters (K, n) at the same samples."""
    after = checkpoints(len(samples))
    state, errors, parameters = estimator.initial_state(), [], []
    for start, end in zip([0, *after[:-1].tolist()], after.tolist(), strict=True):
        state, _ = estimator.update(state, samples[start:end])
        Q_hat, _ = estimator.predict(state, truth.U, truth.dp, truth.T)
        errors.append(rmse(Q_hat, truth.Q))
        parameters.append(estimator.parameters(state)[0])
    return Course.of(after, errors), np.array(parameters)


def learnt(estimator: Estimator[S], samples: Samples, passes: int = 1) -> S:
    """Return the state after the given number of passes."""
    state = estimator.initial_state()
    for _ in range(passes):
        state, _ = estimator.update(state, samples)
    return state


def error_of(estimator: Estimator[S], state: S, truth: Points) -> float:
    """Return the error of a map over true points, l/min."""
    return rmse(estimator.predict(state, truth.U, truth.dp, truth.T)[0], truth.Q)


def error_of_U(U: Floats, truth: Points) -> float:
    """Return the root mean square error of U, %, without the ends, where U has no effect on Q.

    NaN is replaced by U = 0.
    """
    inside = (INSIDE[0] <= truth.U) & (INSIDE[1] >= truth.U)
    return rmse(np.nan_to_num(U[inside]), truth.U[inside])


def settling(samples: Samples, truth: Points, limit: float, pieces: int) -> Mapping[str, float]:
    """Return the samples until the error stays within a limit: median over restarted pieces."""
    length, structure = len(samples) // pieces, FiveTerms()
    XV = structure.regressors(truth.U, truth.dp, truth.T)
    found: dict[str, list[float]] = {"RLS": [], "RML": [], "RML as printed": []}
    for k in range(pieces):
        piece = samples[k * length : (k + 1) * length]
        X = structure.regressors(piece.U, piece.dp, piece.T)
        histories = {
            "RLS": recursive_least_squares(X, piece.Q).theta_history,
            "RML as printed": printed.maximum_likelihood_map(X, piece.Q),
        }
        courses = {name: linear_course(theta, XV, truth.Q) for name, theta in histories.items()}
        courses["RML"] = follow(MaximumLikelihood(), piece, truth)[0]
        for name, course in courses.items():
            found[name].append(course.within(limit))
    return {name: sorted(counts)[pieces // 2] for name, counts in found.items()}


def _printed_network(samples: Samples, truth: Points, settings: RbfNetwork) -> Course:
    x, xv = printed.normalised(samples, settings), printed.normalised(truth, settings)
    nets = printed.course(printed.start(settings), x, samples.Q, settings, printed.step_of_37)
    after, errors = checkpoints(len(samples)), []
    wanted = set(after.tolist())
    for count, net in enumerate(nets, start=1):
        if count in wanted:
            errors.append(rmse(settings.Q_scale * printed.output(net, xv), truth.Q))
    return Course.of(after, errors)
