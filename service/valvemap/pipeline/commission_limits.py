"""Limits of a commissioning run, and the one function that every written command passes. Pure."""

import math
from dataclasses import dataclass
from typing import Final, Self

Range = tuple[float, float]

MOST_STEP_S: Final = 0.2  # s; longest interval for which one command may slew


@dataclass(frozen=True)
class Limits:
    """Limits of one valve while it is commissioned.

    Attributes
    ----------
    U_range : (float, float)
        Range of commands, %.
    slew_percent_per_s : float
        Largest rate of change of commands, %/s.
    safe_U : float
        Command that the valve returns to, %.
    load_range : (float, float), optional
        Range of the load's set point, bar; None: no load is written.
    load_slew_bar_per_s : float
        Largest rate of change of the load's set point, bar/s.
    safe_load : float
        Set point that the load returns to, bar.
    p1_range, p2_range, Q_range : (float, float)
        Measured values that the run keeps within, bar and l/min.
    p_most : float
        Pressure that ends the run, bar.
    """

    U_range: Range = (0.0, 100.0)
    slew_percent_per_s: float = 400.0
    safe_U: float = 0.0
    load_range: Range | None = None
    load_slew_bar_per_s: float = 400.0
    safe_load: float = 0.0
    p1_range: Range = (0.0, math.inf)
    p2_range: Range = (-math.inf, math.inf)
    Q_range: Range = (-math.inf, math.inf)
    p_most: float = math.inf

    @property
    def U_span(self) -> float:
        """Width of the range of commands, %."""
        return self.U_range[1] - self.U_range[0]

    @property
    def safe_within_s(self) -> float:
        """Longest time from any permitted command to the safe one, s."""
        low, high = self.U_range
        of_U = max(self.safe_U - low, high - self.safe_U) / self.slew_percent_per_s
        if self.load_range is None:
            return of_U
        low, high = self.load_range
        return max(
            of_U, max(self.safe_load - low, high - self.safe_load) / self.load_slew_bar_per_s
        )


@dataclass(frozen=True)
class Point:
    """Commands of valve (%) and load (bar, NaN without one)."""

    U: float = math.nan
    load: float = math.nan

    @property
    def is_known(self) -> bool:
        """Whether a command of this run is in effect."""
        return not math.isnan(self.U)

    def near(self, other: Self, U: float, load: float) -> bool:
        """Whether ``other`` is within ``U`` (%) and ``load`` (bar); unknown loads are equal."""
        return abs(self.U - other.U) <= U and not abs(self.load - other.load) > load


def bounded(limits: Limits, before: Point, wanted: Point, elapsed_s: float) -> Point:
    """Return the command nearest to ``wanted`` that range and slew permit after ``before``.

    ``elapsed_s`` is the time since ``before`` was accepted; intervals over `MOST_STEP_S` count as
    that. What is not a number repeats ``before``.

    Examples
    --------
    >>> bounded(Limits(slew_percent_per_s=100.0), Point(40.0), Point(90.0), 0.05).U
    45.0
    """
    step_s = min(max(elapsed_s, 0.0), MOST_STEP_S)
    U = _moved(before.U, wanted.U, limits.slew_percent_per_s * step_s, limits.U_range)
    if limits.load_range is None or math.isnan(before.load):
        return Point(U)
    most = limits.load_slew_bar_per_s * step_s
    return Point(U, _moved(before.load, wanted.load, most, limits.load_range))


def _moved(before: float, wanted: float, most: float, bounds: Range) -> float:
    if math.isnan(wanted):
        wanted = before
    x = min(max(wanted, before - most), before + most)
    return min(max(x, bounds[0]), bounds[1])
