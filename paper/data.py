"""Input data of the report: recordings of a valve, and its noise-free true flow.

The data are independent of their source. The command line uses the virtual rig.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Floats, Samples


@dataclass(frozen=True)
class Points:
    """Noise-free points of a flow map, all arrays of shape (N,).

    Attributes
    ----------
    U, dp, T, Q : float64
        Control voltage (%), pressure drop (bar), oil temperature (°C), flow (l/min).

    Examples
    --------
    >>> points = Points(*np.arange(8.0).reshape(4, 2))
    >>> len(points), len(points[points.U > 0])
    (2, 1)
    """

    U: Floats
    dp: Floats
    T: Floats
    Q: Floats

    def __len__(self) -> int:
        return len(self.U)

    def __getitem__(self, rows: slice | NDArray[np.bool_]) -> Self:
        return type(self)(self.U[rows], self.dp[rows], self.T[rows], self.Q[rows])


@dataclass(frozen=True)
class IdealValve:
    """An ideal valve: the solution of the paper's eqs. (1), (2), (4), (6) with a pilot.

    No springs, jets, friction or leakage; arrays of shape (N,), lengths in mm, flows in l/min.

    Attributes
    ----------
    phi, K_MP, K_c, K_PV, x_0 : float
        Area ratio, flow coefficients in l/(min·√bar·mm), negative overlap.
    x_PV, dp : float64
        Opening of the pilot and pressure drop, as given.
    Q_PV, x_MP, Q : float64
        Pilot flow, stroke of the main poppet and total flow, as solved.
    """

    phi: float
    K_MP: float
    K_c: float
    K_PV: float
    x_0: float
    x_PV: Floats
    dp: Floats
    Q_PV: Floats
    x_MP: Floats
    Q: Floats


@dataclass(frozen=True)
class PaperData:
    """All recordings and true values.

    Attributes
    ----------
    rate_hz : float
        Sampling rate of every recording, Hz.
    levels : (L,) float64
        U of the structured recording's levels, %.
    hysteresis : float
        Width of the valve's hysteresis, % of U; the limit of any static map's accuracy.
    structured, scattered, cycle : Samples
        The paper's two kinds of data, and the working cycle of a machine.
    damaged : Samples
        Scattered; the valve is damaged from the middle on.
    warm, hysteretic, lagging : Samples
        Scattered, with oil of 20 to 60 °C; of a valve with a wide loop; of one with a slow pilot.
    new, worn, hot, working : Points
        True flow: as new; after the damage; at 60 °C; as new, at the points of the cycle.
    curves : Points
        Q over dp at each of the levels, level by level; Q is NaN if the bench cannot reach it.
    ideal : IdealValve
        Data for the errata of the valve's equations.
    """

    rate_hz: float
    levels: Floats
    hysteresis: float
    structured: Samples
    scattered: Samples
    cycle: Samples
    damaged: Samples
    warm: Samples
    hysteretic: Samples
    lagging: Samples
    new: Points
    worn: Points
    hot: Points
    working: Points
    curves: Points
    ideal: IdealValve


def within(samples: Samples, U_max: float, dp_max: float) -> Samples:
    """Return the samples in a corner of the map."""
    return samples[(U_max >= samples.U) & (samples.dp <= dp_max)]


def exchanged(samples: Samples) -> Samples:
    """Exchange Q and U, to identify U = f(Q, dp) directly."""
    return replace(samples, U=samples.Q, Q=samples.U)
