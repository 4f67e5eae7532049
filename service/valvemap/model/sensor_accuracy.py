"""What the sensors themselves may be off by: an error that no number of samples averages out."""

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass

import numpy as np

from valvemap.model.samples import Floats

Flow = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True)
class SensorAccuracy:
    """Limits ± of each sensor's systematic error: U %, p1 and p2 bar, Q l/min, T °C; 0: none.

    The error is constant and anywhere within its limits alike, as accuracy classes are meant
    (ISO 9110-1): its standard deviation is the limit over √3.
    """

    U: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    Q: float = 0.0
    T: float = 0.0

    @property
    def is_stated(self) -> bool:
        """Whether any sensor is said to be off."""
        return any(astuple(self))

    def beside(self, *limits: float) -> "SensorAccuracy":
        """The same, and beside it what is anywhere within other limits ± alike, by signal.

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
    """How far a map is off for its sensors' sake, one standard deviation, l/min, (N,).

    ``√(s_Q² + (∂Q/∂Δp)²·(s_p1² + s_p2²) + (∂Q/∂U)²·s_U² + (∂Q/∂T)²·s_T²)``, each slope that of the
    secant over the limits, so that an edge within them counts.

    Parameters
    ----------
    accuracy
        Of the sensors that the map was learnt from.
    flow
        The map: U (%), dp (bar) and T (°C), each (N,), to Q (l/min).
    points
        Where it is asked: U, dp and T, each (N,).
    U_range
        Beyond which the map says nothing of U, %.

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
        variance += np.where(np.isfinite(half), half, 0.0) ** 2  # unknown: its own std says so
    return np.sqrt(variance / 3.0)
