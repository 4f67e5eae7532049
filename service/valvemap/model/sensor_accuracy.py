"""Systematic errors of the sensors, which no number of samples averages out."""

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass

import numpy as np

from valvemap.model.samples import Floats

Flow = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True)
class SensorAccuracy:
    """Limits ± of each sensor's systematic error: U %, p1 and p2 bar, Q l/min, T °C; 0: none.

    The error is constant and uniformly distributed within its limits, as accuracy classes are
    defined (ISO 9110-1): its standard deviation is the limit over √3.
    """

    U: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    Q: float = 0.0
    T: float = 0.0

    @property
    def is_stated(self) -> bool:
        """Whether any sensor has a systematic error."""
        return bool(self.U or self.p1 or self.p2 or self.Q or self.T)

    def beside(self, *limits: float) -> "SensorAccuracy":
        """Combine with further independent uniform errors with limits ±, by signal.

        Examples
        --------
        >>> SensorAccuracy(p1=3.0).beside(0.0, 4.0, 0.0, 0.5, 0.0)
        SensorAccuracy(U=0.0, p1=5.0, p2=0.0, Q=0.5, T=0.0)
        """
        return SensorAccuracy(*map(math.hypot, astuple(self), limits))


EXACT = SensorAccuracy()


def systematic_std(
    accuracy: SensorAccuracy,
    flow: Flow,
    points: tuple[Floats, Floats, Floats],
    U_range: tuple[float, float] = (0.0, 100.0),
) -> Floats:
    """Standard deviation of a map due to the sensors' systematic errors, l/min, (N,).

    ``√(s_Q² + (∂Q/∂Δp)²·(s_p1² + s_p2²) + (∂Q/∂U)²·s_U² + (∂Q/∂T)²·s_T²)``, each slope that of the
    secant over the limits, which includes an edge within them.

    Parameters
    ----------
    accuracy
        Accuracy of the sensors.
    flow
        The map: U (%), dp (bar) and T (°C), each (N,), to Q (l/min).
    points
        Points of evaluation: U, dp and T, each (N,).
    U_range
        Range of U in which the map is defined, %.

    Examples
    --------
    >>> point = (np.array([50.0]), np.array([100.0]), np.array([40.0]))
    >>> root = lambda U, dp, T: 0.1 * U * np.sqrt(dp)  # Q = 50 l/min; ∂Q/∂Δp = 0.25 l/min/bar
    >>> systematic_std(SensorAccuracy(p1=1.0, p2=1.0), root, point).round(3)  # 0.25·√(2/3)
    array([0.204])
    """
    variance = np.full(len(points[0]), accuracy.Q**2)
    for k, limit in enumerate((accuracy.U, math.hypot(accuracy.p1, accuracy.p2), accuracy.T)):
        if limit == 0.0:
            continue
        below, middle, above = (list(points) for _ in range(3))
        if k == 0:
            middle[0] = np.clip(points[0], U_range[0] + limit, U_range[1] - limit)
        below[k], above[k] = middle[k] - limit, middle[k] + limit
        half = (flow(*above) - flow(*below)) / 2.0
        variance += np.where(np.isfinite(half), half, 0.0) ** 2  # if unknown, the map's std is NaN
    return np.sqrt(variance / 3.0)
