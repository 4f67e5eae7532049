"""Lead: a demand asked for as much ahead as the spool lags behind its signal. Pure.

A spool of second order follows slow courses of its signal after the delay::

    d(t) = u(t - T),  T = dead time + 2ζ/ω

(its phase near 0 Hz), so that the demand is asked for t + T. Its value then is predicted by its
own slope, a straight line through its newest values. Three things bound the slope's use: it counts
as far as it stands out of the demand's own noise, a demand that is no longer changed has none, and
values that are old tell nothing.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np

from valvemap.model.samples import Floats

MOST_LEAD_S: Final = 0.25  # s; a longer delay is not of a spool
WINDOWS: Final = 2.0  # times the lead; length of the line through the newest values
LEAST: Final = 4  # values of a line
MOST: Final = 256  # values kept; all of them tell the noise
OLD_S: Final = 0.3  # s; older values tell no slope
SURE: Final = 2.0  # standard deviations up to which a slope is taken as noise
SHARES: Final = (1.0, 0.5, 0.25)  # of the lead that are tried before none

Answer = TypeVar("Answer")


def spool_delay(natural_frequency: float, damping: float, dead_time: float = 0.0) -> float:
    """Delay of slow courses behind a spool, s; 0 where it is none.

    Parameters
    ----------
    natural_frequency, damping, dead_time
        Hz, 1, s; a frequency that is not finite is that of a spool without inertia.

    Examples
    --------
    >>> round(spool_delay(8.0, 0.8, 0.005), 4)
    0.0368
    """
    lag = damping / (math.pi * natural_frequency) if natural_frequency > 0.0 else 0.0
    return min(max(lag + dead_time, 0.0), MOST_LEAD_S)


@dataclass(frozen=True)
class DemandCourse:
    """The newest values of a demand: ``t`` in ns on any clock, rising; ``values`` in its unit.

    Examples
    --------
    >>> course = DemandCourse()
    >>> for k in range(8):
    ...     course = course.after(10_000_000 * k, 2.0 * k)
    >>> round(course.advance(70_000_000, 0.03), 3)  # 200 per s
    6.0
    """

    t: tuple[int, ...] = ()
    values: tuple[float, ...] = ()

    def after(self, t: int, value: float) -> "DemandCourse":
        """Return it with the demand from ``t`` on; one that is not finite ends the course."""
        if not math.isfinite(value) or (self.t and t < self.t[-1]):
            return DemandCourse((t,), (value,)) if math.isfinite(value) else DemandCourse()
        kept = replace(self, t=self.t[:-1], values=self.values[:-1]) if t in self.t[-1:] else self
        return DemandCourse((*kept.t[1 - MOST :], t), (*kept.values[1 - MOST :], value))

    def advance(self, now: int, lead_s: float) -> float:
        """Return the demand's change from ``now`` (ns) to ``lead_s`` later; 0: it is not known.

        A demand that has not been written again for longer than usual stands since then.
        """
        if len(self.t) < LEAST or lead_s <= 0.0:
            return 0.0
        last = self.t[-1]
        t, values = 1e-9 * (np.array(self.t) - last), np.array(self.values)
        noise = _noise(t, values)
        pace = float(np.diff(t).max(initial=0.0, where=np.diff(t) < OLD_S))
        if 1e-9 * (now - last) > pace:
            t, values = np.append(t, 1e-9 * (now - last)), np.append(values, values[-1])
        newest = t >= t[-1] - WINDOWS * lead_s
        newest[-LEAST:] = True
        newest &= t >= t[-1] - OLD_S
        if newest.sum() < LEAST:
            return 0.0
        t, values = t[newest], values[newest]
        off = t - t.mean()
        spread = float(off @ off)
        slope = float(off @ values) / spread
        unsure = SURE * noise / math.sqrt(spread)
        if abs(slope) <= unsure:
            return 0.0
        return lead_s * slope * (1.0 - (unsure / slope) ** 2)


def led(
    answer: Callable[[float], Answer],
    demand: float,
    advance: float,
    is_good: Callable[[Answer], bool],
) -> Answer:
    """Return the answer to the advanced demand, as far as the answers are good up to there.

    ``answer`` is asked for the demand itself where none of `SHARES` of the advance has a good one.
    """
    if advance != 0.0:
        for share in SHARES:
            found = answer(demand + share * advance)
            if is_good(found):
                return found
    return answer(demand)


def lead_in_words(lead_s: float) -> str:
    """Return the lead as a sentence.

    >>> lead_in_words(0.0316)
    'RequiredU leads by 32 ms.'
    """
    if lead_s > 0.0:
        return f"RequiredU leads by {1e3 * lead_s:.2g} ms."
    return "RequiredU does not lead: no delay of the spool is identified."


def _noise(t: Floats, values: Floats) -> float:
    """Standard deviation of values (N,) about lines through their neighbours, robustly.

    A value's distance from the line between its neighbours has the variance (1 + a² + b²)σ², with
    their shares a and b in that line. The median is not moved by a step.
    """
    if len(t) < LEAST:
        return 0.0
    a = (t[2:] - t[1:-1]) / (t[2:] - t[:-2])
    off = values[1:-1] - a * values[:-2] - (1.0 - a) * values[2:]
    return 1.4826 * float(np.median(np.abs(off) / np.sqrt(1.0 + a**2 + (1.0 - a) ** 2)))
