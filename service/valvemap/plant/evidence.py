"""Evidence of values for a reading of a valve's signals: ranges, magnitudes, rating, orifice law.

Each function returns a log likelihood in nats, 0 where nothing speaks against the reading.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import inf, log
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.plant.law import LEAST_LEFT, LEAST_ROWS, Fit, moves, quantile, quantiles
from valvemap.plant.priors import ODD
from valvemap.plant.roles import Role

Floats = NDArray[np.float64]

_SOME_OUTSIDE, _MOST_OUTSIDE = 0.01, 0.2  # shares of the values beyond a range
_SLACK: Final = 0.03  # of a range
_TINY: Final = 0.03  # of a range; smaller values are unlikely for a pressure or a flow
_EFFECTIVE: Final = 25.0  # independent samples at most
_PER_SAMPLE: Final = 5.0  # samples that count as one
_EXACT: Final = 1e-6  # of a variance; less is not distinguished from 0
_REVERSED: Final = 60.0  # nats for pressures that are reversed throughout
_FEW_REVERSED: Final = 0.05
_NONE_EXPLAINS: Final = 0.5  # explained share of the hypothesis that no reading is right
_CLEAR_DP, _MOST = 1.0, 0.8  # bar; share of the samples
_HARDLY_OPEN: Final = 15.0  # % of U
_FLOWS_SHUT: Final = -5.0  # nats
_SHUT: Final = 2.0  # % of U
_LEAKY: Final = (
    0.3  # of the largest flow, and of the smallest valve's: no shut valve lets it through
)

_OF_FLOW: Final = (Role.P1, Role.P2, Role.DP, Role.Q)

Plateau = tuple[float, float, float, float]
"""Lowest and highest usual value, and the log widths of the flanks below and above."""

PLATEAUS: Final[Mapping[Role, Plateau]] = {
    Role.U: (30.0, 105.0, 0.42, 0.05),  # %, of the largest |U|
    Role.P1: (20.0, 420.0, 0.35, 0.15),  # bar
    Role.P2: (0.0, 420.0, 1.0, 0.15),
    Role.DP: (5.0, 420.0, 0.5, 0.15),
    Role.Q: (1.0, 3_000.0, 0.5, 0.5),  # l/min
}
COEFFICIENT: Final[Plateau] = (0.3, 45.0, 0.5, 0.35)  # l/min/√bar, of the valve as far open as seen
MISFIT: Final[Plateau] = (0.0, 0.025, 1.0, 0.3)
"""What the law leaves of a valve's Q beyond noise, as a share of its spread: spool, lag, oil."""
MISFIT_OF_OTHERS: Final[Plateau] = (0.06, 1.0, 0.5, 1.0)
"""The same of readings that are wrong: a law seldom fits by chance."""
_BY_CHANCE: Final = -3.0  # nats at most
_LEAST_MISFIT: Final = 0.015  # of the spread of Q; less is not distinguished from noise
_MOVING, _MOVING_U = 0.3, 15.0  # share of U √Δp, and % of U, by which a valve moves
_UNMOVED: Final = -6.0  # nats for a flow that does not move with it
_LEAST_RATED: Final = 0.5  # share of the rated flow, at U = 100 %; below, with the square of U
_VACUUM: Final = -2.0  # bar; a sensor's offset may be as low
_ODD: Final = log(ODD)
OIL: Final = (-5.0, 95.0, 15.0)  # °C, lowest and highest usual value and the width of the flanks


RATED_DROP_BAR: Final = 35.0
"""Pressure drop per edge at which servo valves are rated."""


@dataclass(frozen=True)
class Rating:
    """What the name plate states: rated pressure, and rated flow at a pressure drop; 0: unknown."""

    pressure_bar: float = 0.0
    flow_l_min: float = 0.0
    drop_bar: float = RATED_DROP_BAR


def of_range(values: Floats, bounds: tuple[float, float] | None, role: Role) -> float:
    """Judge values by the stated range, in the range's own unit."""
    good = values[np.isfinite(values)]
    if bounds is None or not len(good):
        return 0.0
    low, high = bounds
    slack = _SLACK * (high - low)
    outside = float(((good < low - slack) | (good > high + slack)).mean())
    if outside > _MOST_OUTSIDE:
        return -14.0
    if outside > _SOME_OUTSIDE:
        return -8.0
    tiny = np.abs(good).max() < _TINY * max(abs(low), abs(high))
    return -2.0 if tiny and role in {Role.P1, Role.DP, Role.Q} else 0.0


class Signal:
    """Values of one signal in the internal unit, with statistics that are used repeatedly."""

    def __init__(self, values: Floats) -> None:
        self.values = values

    @cached_property
    def top(self) -> float:
        """Largest magnitude but for one in a hundred; NaN without a value."""
        return quantile(np.abs(self._good), 0.99) if len(self._good) else float("nan")

    @cached_property
    def median(self) -> float:
        """Median; NaN without a value."""
        return quantile(self._good, 0.5) if len(self._good) else float("nan")

    @cached_property
    def moves(self) -> bool:
        """Whether it moves by more than its noise."""
        return moves(self._good)

    @cached_property
    def _good(self) -> Floats:
        return self.values[np.isfinite(self.values)]


def of_magnitudes(signals: Mapping[Role, Signal], rating: Rating) -> dict[str, float]:
    """Judge values by what valves have and by the name plate; by sentence.

    Of a machine at rest (:func:`rests`), nothing is too small.
    """
    least = 0.0 if rests(signals) else -inf
    found = {}
    for role, plateau in PLATEAUS.items():
        if role in signals:
            found[f"{role} is unusual"] = _on_plateau(signals[role].top, plateau, least)
    for role in (Role.P1, Role.P2):
        if role in signals and signals[role].median < _VACUUM:
            found[f"{role} is negative"] = -6.0
    if Role.T in signals:
        found["T is unusual"] = _of_oil(signals[Role.T].median)
    k = coefficient(_of_flow(signals))
    if k > 0.0:
        found["Q is unusual for this Δp"] = _on_plateau(k, COEFFICIENT, least)
    return found | _of_rating(signals, k, rating)


def rests(signals: Mapping[Role, Signal]) -> bool:
    """Whether the valve is hardly open all the time, and Q does not move."""
    return signals[Role.U].top < _HARDLY_OPEN and not signals[Role.Q].moves


def of_size(values: Mapping[Role, Floats], times: float) -> float:
    """Judge a valve whose flow is ``times`` as large by the sizes of valves, against this one."""
    k = coefficient(values)
    return _of_size(times * k) - _of_size(k) if k > 0.0 else 0.0


def of_direction(values: Mapping[Role, Floats]) -> float:
    """Judge pressures of which the one behind the valve is the higher one all the time."""
    dp = pressure_drop(values)
    dp = dp[np.isfinite(dp)]
    return _ODD if len(dp) and float((dp < -_CLEAR_DP).mean()) > _MOST else 0.0


def of_dead_sensor(values: Floats) -> float:
    """Judge a pressure beside a valve at work that is exactly 0 all the time: no sensor is there.

    A return line may be without pressure; a sensor of it has noise, or steps.
    """
    good = values[np.isfinite(values)]
    return _ODD if len(good) >= LEAST_ROWS and not good.any() else 0.0


def coefficient(values: Mapping[Role, Floats]) -> float:
    """Return the largest Q / √Δp seen, l/min/√bar; 0 if there is none."""
    dp = pressure_drop(values)
    clear = np.isfinite(dp) & (np.abs(dp) > 1.0) & np.isfinite(values[Role.Q])
    if not clear.any():
        return 0.0
    ratios = np.abs(values[Role.Q][clear]) / np.sqrt(np.abs(dp[clear]))
    return quantile(ratios, 0.95)


def pressure_drop(values: Mapping[Role, Floats]) -> Floats:
    """Return Δp, measured or as the difference of two pressures."""
    if Role.DP in values:
        return values[Role.DP]
    return values[Role.P1] - values[Role.P2]


def of_shut_valve(signals: Mapping[Role, Signal]) -> float:
    """Judge the flow at U = 0, against the largest seen and against that of the smallest valve."""
    U, Q = signals[Role.U].values, signals[Role.Q].values
    shut = np.isfinite(Q) & (np.abs(U) < _SHUT)
    if shut.sum() < _PER_SAMPLE:
        return 0.0
    flow = quantile(np.abs(Q[shut]), 0.5)
    dp = np.abs(pressure_drop(_of_flow(signals))[shut])
    root = float(np.sqrt(np.nanmedian(dp))) if np.isfinite(dp).any() else 0.0
    leaks = _LEAKY * signals[Role.Q].top < flow and _LEAKY * COEFFICIENT[0] * root < flow
    return _FLOWS_SHUT if leaks else 0.0


def of_response(values: Mapping[Role, Floats], fit: Fit) -> float:
    """Judge a flow that does not move by more than its noise while the valve does."""
    U, dp = values[Role.U], pressure_drop(values)
    good = np.isfinite(U) & np.isfinite(dp)
    if fit.moves or good.sum() < LEAST_ROWS:
        return 0.0
    drive = U[good] * np.sqrt(np.abs(dp[good]))
    low, high = quantiles(drive, (0.1, 0.9))
    moves = high - low > _MOVING * max(abs(low), abs(high)) and np.ptp(U[good]) > _MOVING_U
    return _UNMOVED if moves else 0.0


def of_law(fit: Fit) -> float:
    """Judge by the orifice law, against Q's mean as the explanation."""
    total = -_REVERSED * max(0.0, fit.reversed_share - _FEW_REVERSED)
    if not fit.moves:
        return total
    total += _on_plateau(fit.misfit, MISFIT)
    return total - 0.5 * _rows(fit) * log(fit.left / fit.total)


def of_others(alone: Fit, joint: Fit) -> float:
    """Judge that other valves' flows are in Q: the share of the rest explained, at BIC's price."""
    least = _EXACT * alone.total
    if not joint.rows or least == 0.0:
        return 0.0
    left = (joint.residual + least) / (alone.residual + least)
    rows = _rows(joint)
    return -0.5 * rows * log(left) - 0.5 * joint.parts_beside * log(rows)


def most_of_law(rows: int) -> float:
    """Return the most that :func:`of_law` can give for so many samples."""
    return -0.5 * min(rows / _PER_SAMPLE, _EFFECTIVE) * log(LEAST_LEFT)


def of_no_law(fit: Fit) -> float:
    """Return the same for the hypothesis that none of the readings is right.

    Q follows U, and pressures that are not seen; or those that are, in another scale or from
    another place (at BIC's price).
    """
    if not fit.moves:
        return 0.0
    rows, least = _rows(fit), _LEAST_MISFIT**2 * fit.total
    left = max(min(fit.left, _NONE_EXPLAINS * fit.total), fit.noise)
    law = -0.5 * rows * log(left / fit.total)
    freed = (min(fit.freed, fit.residual) + least) / (fit.residual + least)
    elsewhere = -0.5 * rows * log(freed) - 0.5 * fit.parts_freed * log(rows)
    unseen = _on_plateau(max(fit.misfit, _LEAST_MISFIT), MISFIT_OF_OTHERS, _BY_CHANCE)
    return law + max(unseen, elsewhere)


def _of_flow(signals: Mapping[Role, Signal]) -> dict[Role, Floats]:
    return {role: signals[role].values for role in _OF_FLOW if role in signals}


def _rows(fit: Fit) -> float:
    return min(fit.rows / _PER_SAMPLE, _EFFECTIVE)


def _of_rating(signals: Mapping[Role, Signal], k: float, rating: Rating) -> dict[str, float]:
    found = {}
    if rating.pressure_bar and Role.P1 in signals:
        plateau = (0.04 * rating.pressure_bar, 1.05 * rating.pressure_bar, 0.3, 0.05)
        found["p1 contradicts the rated pressure"] = _on_plateau(signals[Role.P1].top, plateau)
    if rating.flow_l_min and k > 0.0:
        rated = rating.flow_l_min / rating.drop_bar**0.5
        opened = min(signals[Role.U].top / 100.0, 1.0)
        plateau = (_LEAST_RATED * opened**2 * rated, 1.5 * rated, 0.3, 0.15)
        found["Q contradicts the rated flow"] = _on_plateau(k, plateau)
    return found


def _of_size(k: float) -> float:
    """Return the log density of a coefficient: log-normal, most of it on the usual plateau."""
    low, high, _, _ = COEFFICIENT
    spread = log(high / low) / 4.0  # two standard deviations on either side
    off = log(k / (low * high) ** 0.5) / spread
    return -0.5 * off * off


def _of_oil(T: float) -> float:
    if np.isnan(T):
        return 0.0
    low, high, width = OIL
    off = max(low - T, T - high, 0.0) / width
    return -0.5 * off * off


def _on_plateau(value: float, plateau: Plateau, least: float = -inf) -> float:
    """Judge a value; one below the plateau costs no more than ``least``."""
    low, high, below, above = plateau
    if not np.isfinite(value) or value <= 0.0:
        return 0.0
    if value < low:
        off = log(low / value) / below
        return max(-0.5 * off * off, -50.0, least)
    if value > high:
        off = log(value / high) / above
    else:
        return 0.0
    return max(-0.5 * off * off, -50.0)
