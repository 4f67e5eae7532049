"""Range of Δp that a map needs, where no configuration states one."""

from typing import Final

import numpy as np

from valvemap.model.extrapolation import ABOUT_DP
from valvemap.model.samples import Samples
from valvemap.model.support import DP_DEFAULT
from valvemap.vocabulary.statuses import Quality

USUAL: Final = DP_DEFAULT[1]  # bar
TOPS: Final = (USUAL, 250.0, 315.0, 400.0, 500.0, 630.0, 800.0, 1000.0)  # bar; preferred numbers
STRAY: Final = 0.005  # of the samples at each end; a spike widens no range


def dp_range_of_samples(samples: Samples) -> tuple[float, float]:
    """Range of p1 - p2, bar, that covers samples: (0, 200) unless they need more.

    Examples
    --------
    >>> t, p = np.arange(1000), np.linspace(0.0, 330.0, 1000)
    >>> dp_range_of_samples(Samples.of(t, 50.0 + 0 * p, p, 0 * p, p))
    (0.0, 315.0)
    >>> dp_range_of_samples(Samples.of(t, 50.0 + 0 * p, p, p[::-1], p))
    (-315.0, 315.0)
    """
    dp = samples.dp[(samples.quality != Quality.BAD) & np.isfinite(samples.dp)]
    if not len(dp):
        return 0.0, USUAL
    low, high = np.quantile(dp, [STRAY, 1.0 - STRAY])
    return dp_range_that_covers(float(low), float(high))


def dp_range_that_covers(low: float, high: float) -> tuple[float, float]:
    """Range of Δp, bar, for drops from ``low`` to ``high``; both signs if they reverse.

    >>> dp_range_that_covers(3.0, 210.0), dp_range_that_covers(-60.0, 340.0)
    ((0.0, 200.0), (-315.0, 315.0))
    """
    most = max(high, -low) / (1.0 + ABOUT_DP)
    top = next((top for top in TOPS if most <= top), TOPS[-1])
    return (-top if low < -ABOUT_DP * USUAL else 0.0), top
