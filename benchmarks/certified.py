"""Figures on certified data: NIST StRD, and the recursion of R's strucchange."""

import math
import warnings
from collections.abc import Iterable, Sequence
from fractions import Fraction

import numpy as np
import scipy.linalg

from benchmarks import peers
from benchmarks.measured_data import Floats, Problem, Strucchange
from valvemap.model.least_squares_of_arrays import recursive_least_squares

MOST_DIGITS = 16.0  # what a double can hold
START_VALUES = tuple(10.0 ** (k / 2) for k in range(61))  # P(0) of the peers: the best one counts


def digits(estimate: Floats, exact: Sequence[Fraction]) -> float | None:
    """Correct digits of the worst element, -lg of its relative error; None: not finite."""
    if not np.isfinite(estimate).all():
        return None
    worst = MOST_DIGITS
    for value, truth in zip(estimate.tolist(), exact, strict=True):
        error = abs((Fraction(value) - truth) / truth)
        if error:
            worst = min(worst, -math.log10(error))
    return worst


def digits_of_theta(problem: Problem, others: Iterable[str]) -> dict[str, float | None]:
    """Ours, streamed; batch QR and SVD; those peers that ``others`` names, from their best P(0)."""
    X, y, exact = problem.X, problem.y, problem.theta
    Q, R = np.linalg.qr(X)
    batch = {
        "batch QR": scipy.linalg.solve_triangular(R, Q.T @ y),
        "batch SVD": scipy.linalg.lstsq(X, y)[0],
    }
    ours = {"valvemap": recursive_least_squares(X, y).theta}
    found = {name: digits(theta, exact) for name, theta in (ours | batch).items()}
    return found | {name: _best_digits(name, problem) for name in others}


def digits_of_std(problem: Problem) -> float | None:
    """Ours, of the standard deviations."""
    result = recursive_least_squares(problem.X, problem.y)
    return digits(np.sqrt(np.diag(result.covariance)), problem.std)


def _best_digits(name: str, problem: Problem) -> float | None:
    start_values = START_VALUES if name != "statsmodels" else (math.inf,)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        results = [
            digits(peers.PEERS[name](problem.X, problem.y, p0), problem.theta)
            for p0 in start_values
        ]
    return max((found for found in results if found is not None), default=None)


def strucchange_errors(data: Strucchange) -> dict[str, float]:
    """Largest relative errors over all steps, ours and R's, against rational least squares."""
    result = recursive_least_squares(data.X, data.y)
    theta, residuals, roots = _rational_recursion(data.exact)
    our_theta, our_residuals = result.theta_history[2:], result.innovations[2:] / roots
    return {
        "theta, valvemap": _relative(our_theta, theta),
        "theta, R": _relative(data.theta, theta),
        "theta, valvemap against R": _relative(our_theta, data.theta),
        "residual, valvemap": _relative(our_residuals, residuals),
        "residual, R": _relative(data.residuals, residuals),
        "residual, valvemap against R": _relative(our_residuals, data.residuals),
    }


def _rational_recursion(
    samples: Sequence[tuple[Fraction, Fraction]],
) -> tuple[Floats, Floats, Floats]:
    """Theta after the samples 2, 3 …, e/√(1 + XᵀPX) of each, and the root; rounded at the end."""
    n = sx = sxx = sy = sxy = Fraction(0)
    thetas, residuals, roots = [], [], []
    for t, (x, y) in enumerate(samples):
        if t >= 2:
            det = n * sxx - sx * sx
            e = y - ((sxx * sy - sx * sxy) + (n * sxy - sx * sy) * x) / det
            root = math.sqrt(1 + (sxx - 2 * sx * x + n * x * x) / det)
            residuals.append(float(e) / root)
            roots.append(root)
        n, sx, sxx, sy, sxy = n + 1, sx + x, sxx + x * x, sy + y, sxy + x * y
        if t >= 2:
            det = n * sxx - sx * sx
            thetas.append((float((sxx * sy - sx * sxy) / det), float((n * sxy - sx * sy) / det)))
    return np.array(thetas), np.array(residuals), np.array(roots)


def _relative(values: Floats, reference: Floats) -> float:
    return float(np.abs(values / reference - 1.0).max())
