"""Types of the kernels' arguments: arrays, numbers, and the records of parameters."""

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Numbers = NDArray[np.void]  # of one record of the types below
Record: TypeAlias = Any  # one of those records; numba resolves its fields
N: TypeAlias = Any  # a number; in the formulas of the oil also an array of numbers

OIL = np.dtype([(name, np.float64) for name in ("A", "B", "rho_15", "expansion", "heat_capacity")])
VALVE = np.dtype(
    [
        (name, np.float64)
        for name in (
            "phi",
            "K_MP",
            "K_c",
            "K_PV",
            "x_0",
            "stroke",
            "bar_per_N",
            "preload",
            "rate",
            "cos_jet",
            "pilot_jet",
            "poppet_re",
            "slot_re",
            "C_d",
            "slot_width",
            "pilot_width",
            "pilot_stroke",
            "pilot_leakage",
            "seat_leakage",
        )
    ]
)
CIRCUIT = np.dtype(
    [(name, np.float64) for name in ("p0", "Q_pump", "override", "load_minimum", "load_resistance")]
)


class Setting(NamedTuple):
    """What a bench is set to at one point, or arrays (N,) of N points.

    ``y`` opening of the pilot, 0 … 1; ``p2_set`` set point of the load, bar; ``T`` at the inlet,
    °C; ``edge`` share of the new valve's K_MP; ``gap`` worn into the edge, l/min per √bar.
    """

    y: N
    p2_set: N
    T: N
    edge: N
    gap: N


class Point(NamedTuple):
    """A valve's pilot opening, pressures (bar), oil, and ``edge`` as in `Setting`.

    ``rho`` in kg/m³; ``nu`` in mm²/s, and ``nu_gap`` behind half of the heat of throttling.
    """

    y: float
    p1: float
    p2: float
    rho: float
    nu: float
    nu_gap: float
    edge: float
