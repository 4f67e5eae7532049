"""A 4/3 spool valve: four unlike edges, overlap, play, a spool with dynamics, leakage A-B.

::

    PA, BT    open for U > 0:  Q = K·f(u)·√Δp,  u = (|y| - overlap)/(100 % - overlap)
    PB, AT    open for U < 0   f(u) = share·u + (1 - share)·uⁿ
    y         spool: U through play, then 2nd order with a limited speed
    leakage   c·(p_A - p_B), laminar, at 46 mm²/s

Flows are positive in the direction of the edge's name; they turn where the pressures do. Defaults:
a valve of about 95 l/min at 70 bar per edge.
"""

import math
from collections.abc import Mapping
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike

from valvemap_rig import machine_kernels as kernels
from valvemap_rig.parameters import Parameters, parameter
from valvemap_rig.records import Floats, Numbers

Edge = Literal["PA", "AT", "PB", "BT"]
EDGES: Final[tuple[Edge, ...]] = ("PA", "AT", "PB", "BT")
OPENS: Final[Mapping[Edge, int]] = {"PA": 1, "AT": -1, "PB": -1, "BT": 1}
"""Sign of U for which an edge opens."""

_TRIAL = "own choice for a size 10 valve with notched edges"
_SPOOL = "own choice for a proportional valve of size 10"


class EdgeCurve(Parameters):
    """The flow of one edge over the spool's position."""

    K: float = parameter(12.0, "l/min/√bar", "flow coefficient fully open", _TRIAL, gt=0, le=1000)
    overlap_percent: float = parameter(
        8.0, "%", "spool position at which the edge opens", _TRIAL, ge=0, le=50
    )
    linear_share: float = parameter(
        0.0, "1", "share of the straight line in f(u)", _TRIAL, ge=0, le=1
    )
    exponent: float = parameter(1.2, "1", "exponent n of the rest", _TRIAL, ge=1, le=4)


class DirectionalValve(Parameters):
    """Data sheet of a 4/3 valve."""

    PA: EdgeCurve = EdgeCurve()
    AT: EdgeCurve = EdgeCurve(K=11.0, overlap_percent=7.0, linear_share=0.5, exponent=2.0)
    PB: EdgeCurve = EdgeCurve(K=10.0, exponent=1.1)
    BT: EdgeCurve = EdgeCurve(K=9.0, overlap_percent=6.0, linear_share=0.4, exponent=2.0)
    play_percent: float = parameter(
        1.0, "%", "width of the loop between rising and falling signal", _SPOOL, ge=0, le=20
    )
    natural_frequency_hz: float = parameter(40.0, "Hz", "of the spool", _SPOOL, ge=5, le=300)
    damping: float = parameter(0.8, "1", "of the spool", _SPOOL, ge=0.1, le=3)
    slew_percent_s: float = parameter(
        5000.0, "%/s", "highest speed of the spool", _SPOOL, ge=50, le=1e5
    )
    leakage_l_min_bar: float = parameter(
        0.01, "l/(min·bar)", "between the ports A and B at 46 mm²/s", _SPOOL, ge=0, le=1
    )


def true_edge_flow(
    valve: DirectionalValve, edge: Edge, U: ArrayLike, dp: ArrayLike, factor: float = 1.0
) -> Floats:
    """Return an edge's flow (l/min) at a spool position |U| (%) and its own drop (bar), (N,).

    It is the steady map in the middle of the play's loop, without leakage; ``factor`` is the
    edge's condition relative to the new valve.

    >>> true_edge_flow(DirectionalValve(), "PA", [8, 54, 100], 100).round(1)
    array([  0. ,  52.2, 120. ])
    """
    curve: EdgeCurve = getattr(valve, edge)
    u = (np.abs(np.asarray(U, np.float64)) - curve.overlap_percent) / (100 - curve.overlap_percent)
    u = np.clip(u, 0.0, 1.0)
    f = curve.linear_share * u + (1 - curve.linear_share) * u**curve.exponent
    drop = np.asarray(dp, np.float64)
    return np.asarray(factor * curve.K * f * drop / np.sqrt(np.hypot(drop, kernels.DROP_BAR)))


def numbers(valve: DirectionalValve) -> Numbers:
    """Return the parameters of a valve for the compiled loop."""
    edges = [
        (curve.K, curve.overlap_percent, curve.linear_share, curve.exponent)
        for curve in (valve.PA, valve.AT, valve.PB, valve.BT)
    ]
    row = (
        *(value for edge in edges for value in edge),
        0.5 * valve.play_percent,
        2 * math.pi * valve.natural_frequency_hz,
        valve.damping,
        valve.slew_percent_s,
        valve.leakage_l_min_bar,
    )
    return np.array([row], dtype=kernels.DIRECTIONAL)
