"""Eq. (7) beside the smooth map: which of the two the cells need.

Eq. (7), 1, U, s, U·s, s·|s|, lies in the space of the splines: it is a map without bends. Its
probability follows from Mallows' Cp of both, as Akaike's weights do; the published map is their
mean.
"""

import math

import numpy as np

from valvemap.model.kernels.banded import invert
from valvemap.model.kernels.compiled import inner, maker
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.kernels.flow_solve import Design
from valvemap.model.samples import Floats, Singles

TERMS = 5


@inner
def coefficient(axis_U: Axis, axis_s: Axis, term: int, i: int, j: int) -> float:
    """Coefficient (i, j) of a term; U and s in shares of their ranges."""
    u = float(axis_U.sites[i] / (axis_U.breaks[-1] - axis_U.breaks[0]))
    top = float(axis_s.breaks[-1])
    s = float(axis_s.sites[j]) / top
    if term == 0:
        return 1.0
    if term == 1:
        return u
    if term == 2:
        return s
    if term == 3:
        return u * s
    return float(axis_s.squares[j]) / (top * top)


@maker
def mix(
    axis_U: Axis, axis_s: Axis, of: Design, least: float, free: float, known: Floats,
    theta: Singles, std: Singles,
) -> float:  # fmt: skip
    """Replace the map by its mean with eq. (7); give the probability of the latter.

    ``least`` is what the smooth map leaves, Σ precision·residual², by ``free`` parameters;
    ``known`` (TERMS,) are the precisions of the terms before there is a sample: where Δp goes with
    U the samples do not tell them apart.
    """
    n_s, firsts, rows, y, precision = len(axis_s.sites), of.firsts, of.rows, of.y, of.precision
    A, b, x = np.zeros((TERMS, TERMS)), np.zeros(TERMS), np.empty(TERMS)
    square = 0.0
    for k in range(len(y)):
        i, j = firsts[k] // n_s, firsts[k] % n_s
        for term in range(TERMS):
            x[term] = 0.0
            for p in range(3):
                for q in range(3):
                    x[term] += rows[k, 3 * p + q] * coefficient(axis_U, axis_s, term, i + p, j + q)
        square += precision[k] * y[k] * y[k]
        for p in range(TERMS):
            b[p] += precision[k] * x[p] * y[k]
            for q in range(TERMS):
                A[p, q] += precision[k] * x[p] * x[q]
    for p in range(TERMS):
        A[p, p] += known[p]
    if len(y) <= TERMS or not invert(A):
        return 0.0
    for p in range(TERMS):
        x[p] = 0.0
        for q in range(TERMS):
            x[p] += A[p, q] * b[q]
    left = square
    for p in range(TERMS):
        left -= x[p] * b[p]
    better = 0.5 * (left + 2.0 * TERMS - least - 2.0 * free)
    if not math.isfinite(better):
        return 0.0
    share = 1.0 / (1.0 + math.exp(min(max(better, -50.0), 50.0)))
    if share < 1e-6:
        return 0.0
    z = np.empty(TERMS)
    for p in range(len(theta)):
        plain, variance = 0.0, 0.0
        for term in range(TERMS):
            z[term] = coefficient(axis_U, axis_s, term, p // n_s, p % n_s)
            plain += x[term] * z[term]
        for q in range(TERMS):
            for r in range(TERMS):
                variance += z[q] * z[r] * A[q, r]
        off = plain - theta[p]
        theta[p] += share * off
        between = share * (1.0 - share) * off * off
        std[p] = math.sqrt(share * max(variance, 0.0) + (1.0 - share) * std[p] ** 2 + between)
    return share
