"""Piecewise linear curves of a sweep's fit: knots, their functions, and bends."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from scipy import sparse

from valvemap.model.samples import Floats

EXACT: Final = 1e-6  # l/min; least residual: a recording without flow or noise has none


def knots_of(low: float, high: float, step: float) -> Floats:
    """Knots about ``step`` apart, with 0 among them where it lies between."""
    inside = sorted({low, high, 0.0} if low < 0.0 < high else {low, high})
    found: list[float] = []
    for a, b in pairwise(inside):
        found += np.linspace(a, b, max(math.ceil((b - a) / step), 1) + 1)[:-1].tolist()
    return np.array([*found, inside[-1]])


def hats_of(knots: Floats, x: Floats) -> sparse.csr_matrix:
    """Piecewise linear functions, 1 at a knot and 0 at the others, sparse (N, K)."""
    return of_hats([knots], x, [np.ones(len(x))])


def of_hats(curves: Sequence[Floats], x: Floats, by: Sequence[Floats]) -> sparse.csr_matrix:
    """Functions of several curves side by side, each times values ``by`` (N,), sparse (N, K)."""
    n, size = len(x), 0
    columns, values = np.empty((n, 2 * len(curves)), np.int32), np.empty((n, 2 * len(curves)))
    for k, (knots, each) in enumerate(zip(curves, by, strict=True)):
        right = np.clip(np.searchsorted(knots, x, side="right"), 1, len(knots) - 1)
        share = np.clip((x - knots[right - 1]) / (knots[right] - knots[right - 1]), 0.0, 1.0)
        columns[:, 2 * k], columns[:, 2 * k + 1] = size + right - 1, size + right
        values[:, 2 * k], values[:, 2 * k + 1] = each * (1.0 - share), each * share
        size += len(knots)
    ends = np.arange(n + 1) * columns.shape[1]
    return sparse.csr_matrix((values.ravel(), columns.ravel(), ends), shape=(n, size))


def bends_of(size: int) -> Floats:
    """Second differences of coefficients, (size - 2, size)."""
    return np.asarray(np.diff(np.eye(size), n=2, axis=0)) if size > 2 else np.zeros((0, size))
