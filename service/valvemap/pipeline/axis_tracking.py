"""How an axis follows its set position: the newest seconds, and the RMS error. Pure."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from valvemap.model.samples import Floats, Times

SPAN_S: Final = 20.0  # s that are shown, and over which the error is averaged
STEP_S: Final = 0.05  # s between two shown points
RENEWED_S: Final = 1.0  # s between two courses


@dataclass(frozen=True)
class AxisTracking:
    """The newest seconds of an axis with a set position.

    Attributes
    ----------
    t
        UTC ns, (n,).
    position, set_position
        (n,), mm.
    rms
        Root mean square of position less set position over all samples of the span, mm.
    """

    t: Times
    position: Floats
    set_position: Floats
    rms: float


class Tracking:
    """Collects positions; renews its `course` once a second.

    Examples
    --------
    >>> tracking = Tracking()
    >>> t = np.arange(1, 401) * 10_000_000
    >>> tracking.take(t, np.full(400, 103.0), np.full(400, 100.0))
    >>> tracking.course.rms, len(tracking.course.t)
    (3.0, 61)
    """

    def __init__(self) -> None:
        self.course: AxisTracking | None = None
        self._points: list[tuple[int, float, float]] = []
        self._seconds: list[tuple[int, float, int]] = []  # its end, Σ of squares, samples
        self._point_due = self._second_due = 0
        self._squares, self._n = 0.0, 0

    def take(self, t: Times, position: Floats, set_position: Floats) -> None:
        """Take samples; those without one of both are left out."""
        known = np.isfinite(position) & np.isfinite(set_position)
        rows = zip(
            t[known].tolist(), position[known].tolist(), set_position[known].tolist(), strict=True
        )
        for moment, x, x_set in rows:
            self._squares, self._n = self._squares + (x - x_set) ** 2, self._n + 1
            if moment >= self._point_due:
                self._points.append((moment, x, x_set))
                self._point_due = moment + round(1e9 * STEP_S)
            if moment >= self._second_due:
                self._renew(moment)

    def _renew(self, now: int) -> None:
        oldest = now - round(1e9 * SPAN_S)
        self._second_due = now + round(1e9 * RENEWED_S)
        self._seconds.append((now, self._squares, self._n))
        self._squares, self._n = 0.0, 0
        self._seconds = [one for one in self._seconds if one[0] > oldest]
        self._points = [one for one in self._points if one[0] > oldest]
        t, x, x_set = (np.array(column) for column in zip(*self._points, strict=True))
        squares, n = (sum(column) for column in list(zip(*self._seconds, strict=True))[1:])
        self.course = AxisTracking(t, x, x_set, math.sqrt(squares / n))
