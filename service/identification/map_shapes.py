"""The shapes of a map among which `Auto` chooses: sizes, kinks, play, trend with temperature."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Self

import numpy as np

from service.identification.kernels.surface import BORDER, FIVE_TERMS, T_REFERENCE, T_UNIT
from service.identification.model_structures import TensorSpline
from service.identification.samples import Floats

CELLS: Final = (0, 2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 26)
AXES: Final = (
    (0.0, 0.21, 0.56, 1.0),
    (0.0, 0.1, 0.28, 0.56, 1.0),
    (0.0, 0.05, 0.106, 0.21, 0.42, 0.7, 1.0),
)
PRESSURES: Final = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 350.0, 1000.0)
NODES_T: Final = np.array([T_REFERENCE, T_REFERENCE + T_UNIT])
MOST_U, MOST_S = CELLS[-1] + 3 + 2 * 3, len(AXES[-1]) + 2


@dataclass(frozen=True)
class Variety:
    """What the samples so far can tell apart.

    Attributes
    ----------
    both_directions
        More than 5 % of them lie where U came from below at one time, from above at another.
    temperatures
        T spread by more than 2 K.
    """

    both_directions: bool
    temperatures: bool


@dataclass(frozen=True)
class Shape:
    """One rung of the ladder.

    Attributes
    ----------
    cells
        Cells of the spline in U between the kinks; 0: no spline, eq. (7) alone.
    axis
        Which of three divisions of √dp, finer and finer, and finest near 0.
    dead_band, saturation
        Kinks in U, %.
    play
        Half the width of the hysteresis, %: the spline's argument lags so much behind U.
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
        """Read what :meth:`to_array` wrote."""
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
        """Six numbers; NaN for no kink."""
        kinks = [math.nan if x is None else x for x in (self.dead_band, self.saturation)]
        return np.array([self.cells, self.axis, *kinks, self.play, self.trend], np.float64)

    @property
    def columns(self) -> tuple[int, int]:
        """First and one past the last column beside the spline (kernels.surface.fit)."""
        return FIVE_TERMS if self.cells else 0, BORDER if self.trend else FIVE_TERMS

    @property
    def size(self) -> int:
        """Parameters of the spline; 0 without one."""
        kinks = sum(kink is not None for kink in (self.dead_band, self.saturation))
        return (self.cells + 3 + 3 * kinks) * (len(AXES[self.axis]) + 2) if self.cells else 0

    def spline(self, dp_top: float) -> TensorSpline:
        """The spline over dp up to ``dp_top``; without cells the smallest one, to hold eq. (7)."""
        return _spline(self, dp_top)

    def coefficients(self, theta: Floats, dp_top: float) -> Floats:
        """(n_U, n_s, 2): the spline at 40 and 60 °C from the fit's theta (n + BORDER,)."""
        spline = self.spline(dp_top)
        (sites_U, sites_s), knots_s = spline.sites, spline.knots[1]
        a, b, c = knots_s[1:-3], knots_s[2:-2], knots_s[3:-1]
        squares = (a * b + b * c + c * a) / 3.0  # the spline whose value is s²
        U, s = sites_U[:, None] / 100.0, sites_s[None, :] / 10.0
        beside = theta[-BORDER:]
        terms = (np.ones_like(U * s), U + 0 * s, s + 0 * U, U * s, squares[None, :] / 100.0 + 0 * U)
        cold = sum(b * term for b, term in zip(beside, terms, strict=False))
        if self.cells:
            cold = cold + theta[:-BORDER].reshape(len(sites_U), len(sites_s))
        trend = sum(b * term for b, term in zip(beside[FIVE_TERMS:], terms[2:], strict=True))
        return np.stack([cold, cold + trend], axis=2)

    def neighbours(self, variety: Variety) -> tuple["Shape", ...]:
        """Shapes one step away that samples of such variety can tell apart, in a fixed order."""
        return _neighbours(self, variety)

    @property
    def is_possible(self) -> bool:
        """Whether kinks and play lie where they can."""
        low, high = self.dead_band, self.saturation
        return (
            (low is None or 0.5 <= low <= 40.0)
            and (high is None or 60.0 <= high <= 99.5)
            and 0.0 <= self.play <= 6.0
            and (self.cells > 0 or (low is None and high is None and self.axis == 0))
        )

    def describe(self) -> str:
        """A line for the operator."""
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

    def steps(self, variety: Variety) -> Iterator["Shape"]:
        """All steps, possible or not."""
        yield Shape(play=self.play, trend=self.trend)
        for cells in sorted(CELLS[1:], key=lambda cells: abs(cells - self.cells)):
            yield replace(self, cells=cells)
        for axis in range(len(AXES)):
            yield replace(self, axis=axis)
        if variety.both_directions:
            for change in (0.25, -0.25, 0.1, -0.1, 0.03, -0.03, 1.0, -1.0):
                yield from self._replayed(change)
        if variety.temperatures or self.trend:
            yield replace(self, trend=1 - self.trend)
        for low in _kinks(self.dead_band, (2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0)):
            yield replace(self, dead_band=low)
        for high in _kinks(self.saturation, (98.0, 97.0, 95.0, 93.0, 90.0, 85.0, 80.0, 70.0)):
            yield replace(self, saturation=high)

    def _replayed(self, change: float) -> Iterator["Shape"]:
        """More or less play: about the same middle, the same rising or the same falling branch."""
        play = round(self.play + change, 3)
        for shift in (0.0, -change, change) if self.dead_band or self.saturation else (0.0,):
            yield replace(
                self,
                play=play,
                dead_band=_shifted(self.dead_band, shift),
                saturation=_shifted(self.saturation, shift),
            )


def dp_top(s_seen: float) -> float:
    """The smallest of a few pressures (bar) that covers the largest s seen."""
    return next((dp for dp in PRESSURES if dp >= 0.98 * s_seen**2), PRESSURES[-1])


def _kinks(kink: float | None, places: tuple[float, ...]) -> tuple[float | None, ...]:
    return places if kink is None else (*_around(kink, (0.25, 0.5, 1.0, 2.0)), None)


def _shifted(kink: float | None, shift: float) -> float | None:
    return None if kink is None else round(kink + shift, 3)


def _around(x: float, steps: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(round(x + sign * step, 3) for step in steps for sign in (1, -1))


@lru_cache(maxsize=256)
def _neighbours(shape: Shape, variety: Variety) -> tuple[Shape, ...]:
    return tuple(s for s in shape.steps(variety) if s != shape and s.is_possible)


@lru_cache(maxsize=2048)
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
