"""Normal equations of the map: rows of all cells, the solution, and what each cell says then."""

import math
from typing import NamedTuple

from valvemap.model.kernels import flow_reading as readings
from valvemap.model.kernels import flow_slopes as slopes
from valvemap.model.kernels.banded import factorise, invert_band, substitute
from valvemap.model.kernels.compiled import inner, maker
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.kernels.flow_cells import COUNT, MEAN_Q, WORTH, Cells, design
from valvemap.model.samples import Floats, Times

# Places in `Solution.scalars`.
ZETA, ROOT, EVIDENCE = 0, 1, 2  # coefficient of s·|s|; its standard deviation; see `solve`
FREE, LEFT = 3, 4  # parameters that the cells determine; Σ precision·residual²
NOISE, NOISE_USED, MISFIT, MISFIT_USED = 5, 6, 7, 8  # squares and numbers of both parts
SOLVED = 9


class Design(NamedTuple):
    """What the cells that hold samples say, K rows: their means, and of some the slope along s.

    Attributes
    ----------
    firsts : (K,)
        The first parameter of each row.
    rows : (K, 9)
        See `flow_cells.design` and `flow_slopes.design`.
    squares : (K,)
        Mean of s·|s|.
    y, worth : (K,)
        Mean flow; what the samples are worth in white noise of variance σ².
    regular, precision : (K,)
        Probability that no outlier is in it; weight in the fit.
    """

    firsts: Times
    rows: Floats
    squares: Floats
    y: Floats
    worth: Floats
    regular: Floats
    precision: Floats


class Solution(NamedTuple):
    """What a round computes, for n parameters and a band of width b, see `kernels.banded`.

    Attributes
    ----------
    A, A_prior : (n·b,)
        Precisions with and without the cells; afterwards their Cholesky factors.
    Z, Z_prior : (n·(2·b - 1),)
        Inverses, within the band.
    Y : (2, n)
        Room.
    beta : (n,)
        Coefficients without those of s·|s|.
    lifted : (1, n)
        The covariance of β is Z + liftedᵀ·lifted.
    scalars : (SOLVED,)
    """

    A: Floats
    A_prior: Floats
    Z: Floats
    Z_prior: Floats
    Y: Floats
    beta: Floats
    lifted: Floats
    scalars: Floats


@inner
def gather(
    axis_U: Axis, axis_s: Axis, cells: Cells, known: slopes.Slopes, reading: Floats, work: Floats,
    of: Design,
) -> None:  # fmt: skip
    """Fill the rows of all cells that hold samples; ``reading`` as in `flow_reading`."""
    k = 0
    for c in range(len(cells)):
        if cells[c, COUNT] > 0.0:
            first = design(axis_U, axis_s, cells[c], c, work, of.rows[k])
            worth = cells[c, WORTH] / readings.ratio(reading, cells[c, MEAN_Q])
            _complete(axis_s, k, first, cells[c, MEAN_Q], worth, of)
            k += 1
            if slopes.owns(known, c):
                y = slopes.design(axis_U, axis_s, cells[c], c, known, work, of.rows[k])
                _complete(axis_s, k, first, y, worth, of)
                k += 1


@inner
def _complete(axis_s: Axis, k: int, first: int, y: float, worth: float, of: Design) -> None:
    """Fill what belongs to a row of the design."""
    n_s, square = len(axis_s.sites), 0.0
    for a in range(3):
        for b in range(3):
            square += of.rows[k, 3 * a + b] * axis_s.squares[first % n_s + b]
    of.firsts[k], of.y[k], of.worth[k] = first, y, worth
    of.regular[k], of.squares[k] = 1.0, square


@inner
def assemble(n_s: int, of: Design, sigma2: float, delta2: float, to: Solution) -> None:
    """Add the cells to the precision ``to.A`` and to both right-hand sides ``to.Y``."""
    band = 2 * n_s + 3
    for k in range(len(of.y)):
        precision = of.regular[k] / (delta2 + sigma2 / of.worth[k])
        of.precision[k] = precision
        first, row = of.firsts[k], of.rows[k]
        for a in range(3):
            for b in range(3):
                p, x = first + a * n_s + b, precision * row[3 * a + b]
                to.Y[0, p] += x * of.y[k]
                to.Y[1, p] += x * of.squares[k]
                at = p * band
                for d in range(b, 3):
                    to.A[at + d - b] += x * row[3 * a + d]
                for c in range(a + 1, 3):
                    for d in range(3):
                        to.A[at + (c - a) * n_s + d - b] += x * row[3 * c + d]


@maker
def solve(n_s: int, of: Design, free_border: float, to: Solution) -> bool:
    """Solve for β and ζ, whose prior precision is ``free_border``; False: it could not be done.

    EVIDENCE becomes -½·(log|A| + yᵀ·W·y - what is explained), but for the cells' own variances and
    for log|A_prior|.
    """
    n, band = len(to.beta), 2 * n_s + 3
    corner, of_border, square = free_border, 0.0, 0.0
    for k in range(len(of.y)):
        corner += of.precision[k] * of.squares[k] ** 2
        of_border += of.precision[k] * of.squares[k] * of.y[k]
        square += of.precision[k] * of.y[k] ** 2
    to.beta[:], to.lifted[0] = to.Y[0], to.Y[1]
    if not factorise(to.A, n, band):
        return False
    substitute(to.A, band, to.Y)
    determinant = 0.0
    for p in range(n):
        square -= to.beta[p] * to.Y[0, p]
        corner -= to.lifted[0, p] * to.Y[1, p]
        of_border -= to.lifted[0, p] * to.Y[0, p]
        determinant += 2.0 * math.log(to.A[p * band])
    corner = max(corner, 1e-9 * free_border)  # rounding
    zeta, root = of_border / corner, 1.0 / math.sqrt(corner)
    square -= zeta * of_border
    for p in range(n):
        to.beta[p] = to.Y[0, p] - zeta * to.Y[1, p]
        to.lifted[0, p] = root * to.Y[1, p]
    to.scalars[ZETA], to.scalars[ROOT] = zeta, root
    to.scalars[EVIDENCE] = -0.5 * (determinant + math.log(corner / free_border) + square)
    invert_band(to.A, n, band, to.Z)
    return True


@inner
def residual_of(n_s: int, of: Design, k: int, to: Solution) -> tuple[float, float]:
    """Residual of a cell, and the variance of what the map says there."""
    band = 2 * n_s + 3
    first, row, fitted, own, along = of.firsts[k], of.rows[k], 0.0, 0.0, 0.0
    for a in range(3):
        for b in range(3):
            p, x = first + a * n_s + b, row[3 * a + b]
            fitted += x * to.beta[p]
            along += x * to.lifted[0, p]
            here = p * (2 * band - 1) + band - 1
            for c in range(3):
                for d in range(3):
                    own += x * row[3 * c + d] * to.Z[here + (c - a) * n_s + d - b]
    fitted += to.scalars[ZETA] * of.squares[k]
    own += (to.scalars[ROOT] * of.squares[k] - along) ** 2
    return of.y[k] - fitted, own


@inner
def explain(n_s: int, of: Design, sigma2: float, delta2: float, to: Solution) -> None:
    """Sum what residuals say of the noise and of the misfit, and complete the evidence.

    Of a cell's residual, the share σ²/worth / (δ² + σ²/worth) is noise, the rest misfit.
    """
    to.scalars[FREE:SOLVED] = 0.0
    for k in range(len(of.y)):
        residual, own = residual_of(n_s, of, k, to)
        of_noise, precision = sigma2 / of.worth[k], of.precision[k]
        variance = delta2 + of_noise
        used = precision * max(1.0 - precision * own, 0.0)
        to.scalars[FREE] += precision * own
        to.scalars[LEFT] += precision * residual * residual
        to.scalars[NOISE] += of.regular[k] * of.worth[k] * (of_noise / variance * residual) ** 2
        to.scalars[NOISE_USED] += of_noise * used
        to.scalars[MISFIT] += of.regular[k] * (delta2 / variance * residual) ** 2
        to.scalars[MISFIT_USED] += delta2 * used
        to.scalars[EVIDENCE] -= 0.5 * of.regular[k] * math.log(variance)
