"""The regressors of an axis' edges: K(y)·√Δp, K a quadratic spline of the spool's position y."""

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from valvemap.model.kernels import axis_rows as kernel
from valvemap.model.kernels.axis_edges import ROOT
from valvemap.model.kernels.axis_oil import KELVIN, WALTHER_SHIFT, thinness
from valvemap.model.kernels.flow_basis import axis as spline_axis
from valvemap.model.samples import Floats
from valvemap.vocabulary.edges import EDGES

BREAKS: Final = np.array([0.0, *range(2, 14, 2), *range(15, 31, 3), *range(35, 101, 5)])
"""Breaks of the spool's position, %: fine where the edges open."""
KNOTS: Final = len(BREAKS) + 2  # spline functions, and the departure from √Δp
COMMON: Final = len(EDGES) * KNOTS  # where the columns begin that no edge has
SIZE: Final = COMMON + kernel.COMMON


def leakage_share(T: float) -> float:
    """Return the leakage at T (°C) over that at 40 °C; 1 where T is not a number.

    >>> round(leakage_share(60.0), 2), leakage_share(math.nan)
    (2.23, 1.0)
    """
    share = float(thinness(T, *WALTHER))
    return share if math.isfinite(share) else 1.0


def columns(edge: str) -> slice:
    """Return the columns of an edge among the coefficients."""
    at = EDGES.index(edge) * KNOTS
    return slice(at, at + KNOTS)


def edge_regressors(U: ArrayLike, dp: ArrayLike) -> Floats:
    """Return an edge's regressors, (..., KNOTS)."""
    y, drop = np.broadcast_arrays(np.abs(np.asarray(U, np.float64)), np.asarray(dp, np.float64))
    y = np.minimum(y, BREAKS[-1])
    s = np.copysign(np.sqrt(np.abs(drop)), drop)
    low = np.clip(np.searchsorted(BREAKS, y, side="right") - 1, 0, len(BREAKS) - 2)
    off = y - BREAKS[low]
    X = np.zeros((*y.shape, KNOTS))
    powers = np.stack([np.ones_like(off), off, off * off], axis=-1)
    for b in range(3):
        values = np.sum(SPLINE.table[low, b] * powers, axis=-1) * s
        np.put_along_axis(X, (low + b)[..., None], values[..., None], axis=-1)
    X[..., KNOTS - 1] = 0.01 * y * s * (np.abs(s) / ROOT - 1.0)
    return X


def moved_edge(gain: float, shift: float) -> Floats:
    """Return M (KNOTS, KNOTS): M·θ is an edge of θ whose gain and shift have changed.

    Q = (1 + gain)·g(y - shift·(1 - y/100)): a shift moves where the edge opens; full opening stays.

    >>> bool(np.allclose(moved_edge(0.5, 0.0), 1.5 * np.eye(KNOTS)))
    True
    """
    y = np.arange(0.0, 100.5, 0.5)
    plain = edge_regressors(y, ROOT**2)[:, :-1]  # there, s is 10 and the departure 0
    shifted = edge_regressors(np.maximum(y - shift * (1.0 - y / 100.0), 0.0), ROOT**2)
    M = np.eye(KNOTS)
    if shift != 0.0:
        M[:-1, :-1] = np.linalg.lstsq(plain, shifted[:, :-1], rcond=None)[0]
    return (1.0 + gain) * M


def _walther(nu_40: float, nu_100: float) -> tuple[float, float]:
    """Return a and b of lg lg(ν + 0.7) = a - b·lg(T in K) from two viscosities, mm²/s."""
    at_40, at_100 = (math.log10(math.log10(nu + WALTHER_SHIFT)) for nu in (nu_40, nu_100))
    lg_40, lg_100 = (math.log10(T + KELVIN) for T in (40.0, 100.0))
    b = (at_40 - at_100) / (lg_100 - lg_40)
    return at_40 + b * lg_40, b


WALTHER: Final = _walther(46.0, 6.8)  # mm²/s; ISO VG 46 with a viscosity index near 100
SPLINE: Final = spline_axis(BREAKS)
PLACES: Final = np.array(
    [
        [*range(2 * KNOTS), *range(COMMON, SIZE)],
        [*range(2 * KNOTS, 4 * KNOTS), *range(COMMON, SIZE)],
    ],
    dtype=np.int64,
)
