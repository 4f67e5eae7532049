"""Positions of samples on the grid of the memory of places."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from valvemap.model.kernels.place_layout import NODES_A, NODES_B, TOP_DP
from valvemap.model.model_structures import Structure
from valvemap.model.samples import Floats

FULL_U = 100.0  # %: the last node along U
T_OF_NODES = 40.0  # °C: the temperature of the nodes' flows


class Grid(NamedTuple):
    """Positions of N samples.

    Attributes
    ----------
    a, b : (N,)
        Coordinates in steps of the grid; NaN: nowhere.
    nodes : (K, n)
        Regressors at the nodes.
    """

    a: Floats
    b: Floats
    nodes: Floats


def nowhere(n: int) -> Grid:
    """Return n samples without positions."""
    return Grid(np.empty(0), np.empty(0), np.empty((0, n)))


def grid_of(structure: Structure, U: Floats, dp: Floats) -> Grid:
    """Return positions by U and √dp.

    Examples
    --------
    >>> from valvemap.model.model_structures import FiveTerms
    >>> grid = grid_of(FiveTerms(), np.array([50.0]), np.array([225.0]))
    >>> grid.a, grid.b, grid.nodes.shape
    (array([8.]), array([11.]), (204, 5))
    """
    with np.errstate(all="ignore"):
        a = U * ((NODES_A - 1) / FULL_U)
        b = np.sqrt(dp) * ((NODES_B - 1) / np.sqrt(TOP_DP))
    return Grid(a, b, _regressors_at_nodes(structure))


@lru_cache(maxsize=64)
def _regressors_at_nodes(structure: Structure) -> Floats:
    s = np.linspace(0.0, np.sqrt(TOP_DP), NODES_B)
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(0, FULL_U, NODES_A), s**2, indexing="ij"))
    return np.ascontiguousarray(structure.regressors(U, dp, np.full_like(U, T_OF_NODES)))


def grid_of_rows(X: Floats) -> Grid:
    """Return positions by the first two columns of X (N, n) that vary.

    A node's regressors are means of the rows around it.
    """
    N, n = X.shape
    usable = np.isfinite(X).all(axis=1)
    if not usable.any():
        return nowhere(n)
    low, high = X[usable].min(axis=0), X[usable].max(axis=0)
    varied = np.flatnonzero(high > low)[:2]
    steps = NODES_A - 1, NODES_B - 1
    where = np.zeros((2, N))
    for axis, column in enumerate(varied):
        with np.errstate(all="ignore"):
            share = (X[:, column] - low[column]) / (high[column] - low[column])
        where[axis] = np.where(usable, share * steps[axis], np.nan)
    a, b = where
    i = np.minimum(a[usable].astype(np.int64), NODES_A - 2)
    j = np.minimum(b[usable].astype(np.int64), NODES_B - 2)
    p, q = a[usable] - i, b[usable] - j
    k = i * NODES_B + j
    corners = np.concatenate((k, k + 1, k + NODES_B, k + NODES_B + 1))
    shares = np.concatenate(((1 - p) * (1 - q), (1 - p) * q, p * (1 - q), p * q))

    def at_nodes(values: Floats) -> Floats:
        return np.bincount(corners, values, NODES_A * NODES_B).astype(np.float64, copy=False)

    sums = [at_nodes(shares * np.tile(column, 4)) for column in X[usable].T]
    return Grid(a, b, np.stack(sums, axis=1) / np.maximum(at_nodes(shares), 1e-9)[:, None])
