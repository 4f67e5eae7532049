"""Operating points of a valve: the newest sample of each small region of the map. Pure."""

import math

_STEP_U, _STEP_DP = 2.5, 5.0  # %, bar: finer than a screen shows
_MOST = 2_000  # regions; 40 × 40 cover the usual range


class Points:
    """Samples (U, dp, Q), at most one for each region.

    >>> points = Points()
    >>> points.add(50.0, 100.0, 60.0)
    >>> points.add(50.1, 100.1, 61.0)
    >>> points.rows
    [(50.1, 100.1, 61.0)]
    """

    def __init__(self) -> None:
        self._regions: dict[tuple[int, int], tuple[float, float, float]] = {}

    def add(self, U: float, dp: float, Q: float) -> None:
        """Add one sample: %, bar, l/min."""
        if not (math.isfinite(U) and math.isfinite(dp) and math.isfinite(Q)):
            return
        region = (math.floor(U / _STEP_U), math.floor(dp / _STEP_DP))
        self._regions.pop(region, None)
        self._regions[region] = (U, dp, Q)
        if len(self._regions) > _MOST:
            del self._regions[next(iter(self._regions))]

    @property
    def rows(self) -> list[tuple[float, float, float]]:
        """All samples, the newest last."""
        return list(self._regions.values())
