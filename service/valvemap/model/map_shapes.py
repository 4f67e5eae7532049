"""Shapes of a map for `Auto`'s structure selection: sizes, kinks, play, temperature trend."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Self

import numpy as np

from valvemap.model.kernels import ladder
from valvemap.model.kernels.map_fit import Plan, plan_of
from valvemap.model.model_structures import TensorSpline
from valvemap.model.samples import Floats

CELLS: Final = tuple(ladder.CELLS.tolist())
AXES: Final = tuple(
    tuple(axis[:n].tolist()) for axis, n in zip(ladder.AXES, ladder.BREAKS, strict=True)
)
MOST: Final = ladder.MOST
PRESSURES: Final = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 350.0, 1000.0)
MOST_U, MOST_S = CELLS[-1] + 3 + 2 * 3, len(AXES[-1]) + 2
KEPT: Final = 32  # shapes whose neighbours and splines are cached


@dataclass(frozen=True)
class Variety:
    """Resolution of the samples so far.

    Attributes
    ----------
    least_play
        The smallest identifiable play, %; infinite unless 5 % of the samples are in cells that U
        reached both from below and from above.
    temperatures
        Whether T varies by more than 2 K.
    """

    least_play: float
    temperatures: bool


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape of the structure selection.

    Attributes
    ----------
    cells
        Cells of the spline in U between the kinks; 0: no spline, eq. (7) alone.
    axis
        Index of the grid in √dp: three grids, increasingly fine, each finest near 0.
    dead_band, saturation
        Kinks in U, %.
    play
        Half the width of the hysteresis, %, by which the spline's argument lags behind U.
    trend
        1 if the flow depends on T like (T - 40 °C)·(b1·s + b2·U·s + b3·dp).
    """

    cells: int = 0
    axis: int = 0
    dead_band: float | None = None
    saturation: float | None = None
    play: float = 0.0
    trend: int = 0

    @classmethod
    def from_array(cls, numbers: Floats) -> Self:
        """Decode an array of :meth:`to_array`."""
        cells, axis, dead_band, saturation, play, trend = numbers.tolist()
        return cls(
            int(cells),
            int(axis),
            None if math.isnan(dead_band) else dead_band,
            None if math.isnan(saturation) else saturation,
            play,
            int(trend),
        )

    def to_array(self) -> Floats:
        """Encode as six numbers; NaN for no kink."""
        kinks = [math.nan if x is None else x for x in (self.dead_band, self.saturation)]
        return np.array([self.cells, self.axis, *kinks, self.play, self.trend], np.float64)

    @property
    def size(self) -> int:
        """Number of parameters of the spline; 0 without one."""
        kinks = sum(kink is not None for kink in (self.dead_band, self.saturation))
        return (self.cells + 3 + 3 * kinks) * (len(AXES[self.axis]) + 2) if self.cells else 0

    def spline(self, dp_top: float) -> TensorSpline:
        """The spline over dp up to ``dp_top``; without cells the smallest one, for eq. (7)."""
        return _spline(self, dp_top)

    def plan(self, dp_top: float) -> Plan:
        """Return the plan of its fit, with a spline over dp up to ``dp_top``."""
        return plan_of(self.to_array(), dp_top)

    def neighbours(self, variety: Variety) -> tuple["Shape", ...]:
        """Return the shapes one step away that ``variety`` can resolve, in a fixed order."""
        return _neighbours(self, variety)

    def describe(self) -> str:
        """Return a line for the operator."""
        parts = [f"spline, {self.cells} x {len(AXES[self.axis]) - 1} cells"]
        if not self.cells:
            parts = ["eq. (7)"]
        if self.dead_band is not None:
            parts.append(f"dead band {self.dead_band:.4g} %")
        if self.saturation is not None:
            parts.append(f"saturation {self.saturation:.4g} %")
        if self.play:
            parts.append(f"hysteresis {2 * self.play:.3g} %")
        if self.trend:
            parts.append("trend with temperature")
        return ", ".join(parts)


def dp_top(s_seen: float) -> float:
    """Return the smallest of a few pressures (bar) that covers the largest s seen."""
    return next((dp for dp in PRESSURES if dp >= 0.98 * s_seen**2), PRESSURES[-1])


@lru_cache(maxsize=KEPT)
def _neighbours(shape: Shape, variety: Variety) -> tuple[Shape, ...]:
    found = np.empty((ladder.MOST_NEIGHBOURS, 6))
    many = ladder.neighbours(shape.to_array(), variety.least_play, int(variety.temperatures), found)
    return tuple(Shape.from_array(row) for row in found[:many])


@lru_cache(maxsize=KEPT)
def _spline(shape: Shape, top: float) -> TensorSpline:
    low = 0.0 if shape.dead_band is None else shape.dead_band
    high = 100.0 if shape.saturation is None else shape.saturation
    inner = np.linspace(low, high, max(shape.cells, 1) + 1)[1:-1]
    axis = AXES[shape.axis] if shape.cells else (0.0, 1.0)
    return TensorSpline(
        U=(0.0, *inner.tolist(), 100.0),
        s=tuple(share * math.sqrt(top) for share in axis),
        dead_band=shape.dead_band,
        saturation=shape.saturation,
    )
