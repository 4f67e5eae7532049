"""The figures of a valve's flow curve; a row of `OF_SIDES` or `OF_VALVE` declares each.

Names are those of ISO 10770-1 (four ports) and -2 (three ports), tests of flow over input signal at
a constant pressure drop; what a definition here departs in is part of it.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from valvemap.model.samples import Floats

GRID: Final = 201  # points of a side's curve
LEAVES_ZERO: Final = 0.01  # of the rated flow; from there on the valve is open
LEVELS: Final = np.linspace(0.1, 0.9, 17)  # of the rated flow; points of the gain's line
FLAT: Final = 0.5  # of the gain; a slope below that is saturation
SLOPE_OVER: Final = 6.0  # %; over which a slope is taken


class Side(NamedTuple):
    """Curves of one side over the spool's position |x|: one row is the estimate or a draw."""

    x: Floats
    Q: Floats  # (D, G), positive
    play: Floats  # (D,)
    first: int  # point that the sweep has reached
    top: int  # the last one

    def closed(self) -> Floats:
        """Flow at U = 0, reached from above: half a play short of the middle."""
        return self._at(np.maximum(0.5 * np.maximum(self.play, 0.0), self.x[self.first]))

    def rated(self) -> Floats:
        """Flow where the rated signal is reached from below: half a play short of it."""
        return self._at(self.x[-1] - 0.5 * np.maximum(self.play, 0.0))

    def _at(self, x: Floats) -> Floats:
        return np.array([np.interp(a, self.x, row) for a, row in zip(x, self.Q, strict=True)])

    def line(self) -> tuple[Floats, Floats]:
        """Slope and ordinate of the line through the curve's points at `LEVELS`."""
        Q = np.outer(self.rated(), LEVELS)
        x = np.array(
            [
                np.interp(level, np.maximum.accumulate(row), self.x)
                for level, row in zip(Q, self.Q, strict=True)
            ]
        )
        apart = x - x.mean(axis=1, keepdims=True)
        slope = np.sum(apart * Q, axis=1) / np.sum(apart**2, axis=1)
        return slope, Q.mean(axis=1) - slope * x.mean(axis=1)


class Row(NamedTuple):
    """Declares a figure; ``of`` gives the estimate and its draws, (D,), ``least`` bounds it."""

    key: str
    name: str
    unit: str
    definition: str
    of: Callable[[tuple[Side, ...]], Floats]  # of one side, or of all of a valve
    not_reached: str = ""
    least: float = 0.0
    sides: int = 1  # that a valve must have


class Elsewhere(NamedTuple):
    """Declares a figure that no sweep tells, and why."""

    key: str
    name: str
    unit: str
    reason: str


def of_side(of: Callable[[Side], Floats]) -> Callable[[tuple[Side, ...]], Floats]:
    """Return a figure's function for the one side that it is of."""
    return lambda sides: of(*sides)


def _symmetry(sides: tuple[Side, ...]) -> Floats:
    """Difference of the flow gains of both sides over the larger one, %, (D,)."""
    gains = np.array([side.line()[0] for side in sides])
    return np.asarray(100.0 * np.ptp(gains, axis=0) / gains.max(axis=0))


def _dead_band(side: Side) -> Floats:
    level = side.closed() + LEAVES_ZERO * side.rated()
    x, Q = side.x[side.first :], side.Q[:, side.first :]
    return np.array([_first_above(x, row, limit) for row, limit in zip(Q, level, strict=True)])


def _first_above(x: Floats, Q: Floats, limit: float) -> float:
    above = np.flatnonzero(limit <= Q)
    if not len(above) or not above[0]:
        return math.nan
    k = int(above[0])
    share = (limit - Q[k - 1]) / (Q[k] - Q[k - 1])
    return float(x[k - 1] + share * (x[k] - x[k - 1]))


def _linearity(side: Side) -> Floats:
    slope, ordinate = side.line()
    least = LEVELS[0] * side.rated()
    found = []
    for row, flow, play, a, b in zip(side.Q, least, side.play, slope, ordinate, strict=True):
        begin = np.interp(flow, np.maximum.accumulate(row), side.x)
        x = np.linspace(begin, side.x[-1] - 0.5 * max(play, 0.0), GRID)
        found.append(float(np.abs(np.interp(x, side.x, row) - a * x - b).max()))
    return np.asarray(100.0 * np.array(found) / side.rated())


def _saturation(side: Side) -> Floats:
    step = max(round(SLOPE_OVER / (side.x[1] - side.x[0])), 1)
    slopes = (side.Q[:, step:] - side.Q[:, :-step]) / (side.x[step] - side.x[0])
    middle = side.x[:-step] + 0.5 * (side.x[step] - side.x[0])
    limit = FLAT * side.line()[0]
    last = side.top - step
    found = []
    for row, least in zip(slopes, limit, strict=True):
        steep = np.flatnonzero(row[: last + 1] >= least)
        ends = int(steep[-1]) if len(steep) else last
        found.append(math.nan if ends >= last else float(middle[ends]))
    return np.array(found)


OF_SIDES: Final = (
    Row(
        *("rated_flow", "rated flow", "l/min"),
        "Flow at the rated signal, reached from below, at the rated Δp.",
        of_side(Side.rated),
    ),
    Row(
        *("dead_band", "dead band", "% of U"),
        "Spool position, in the middle of the loop, where the flow is 1 % of the rated one above "
        "the leakage. The standard draws the overlap from the tangents.",
        of_side(_dead_band),
    ),
    Row(
        *("flow_gain", "flow gain", "l/min per % of U"),
        "Slope of the line through the curve from 10 to 90 % of the rated flow.",
        of_side(lambda side: side.line()[0]),
    ),
    Row(
        *("linearity", "linearity", "% of rated flow"),
        "Largest departure of the curve from the flow gain's line, from 10 % of the rated flow on.",
        of_side(_linearity),
    ),
    Row(
        *("saturation", "saturation", "% of U"),
        "Signal beyond which the slope stays below half the flow gain.",
        of_side(_saturation),
        "the slope does not fall below half the flow gain",
    ),
    Row(
        *("leakage", "leakage", "l/min"),
        "Flow at the rated Δp and U = 0, reached from an open valve.",
        of_side(Side.closed),
        least=-math.inf,
    ),
)
"""Figures of each side. Another one is another row."""

OF_VALVE: Final = (
    Row(
        *("hysteresis", "hysteresis", "% of U"),
        "Width of the loop between rising and falling signal, one for the whole range. The "
        "standard takes the largest width.",
        lambda sides: sides[0].play,
    ),
    Row(
        *("symmetry", "symmetry", "% of flow gain"),
        "Difference of the flow gains of both sides over the larger one.",
        _symmetry,
        sides=2,
    ),
)
"""Figures of a valve with all its sides."""

ELSEWHERE: Final = (
    Elsewhere(*("threshold", "threshold", "% of U"), "needs small steps of U about a standstill"),
    Elsewhere(*("pressure_gain", "pressure gain", "bar per % of U"), "needs blocked service ports"),
)

LEAST: Final = {row.key: row.least for row in (*OF_SIDES, *OF_VALVE)} | {
    row.key: 0.0 for row in ELSEWHERE
}
"""The smallest value that a figure can have, by its key."""


def names_of(sides: int) -> dict[str, str]:
    """Return the names of the figures of a valve with one side or two, by their keys.

    >>> "symmetry" in names_of(1), names_of(2)["symmetry"]
    (False, 'symmetry')
    """
    of_valve = [row for row in OF_VALVE if row.sides <= sides]
    rows: list[Row | Elsewhere] = [*OF_SIDES, *of_valve, *ELSEWHERE]
    return {row.key: row.name for row in rows}
