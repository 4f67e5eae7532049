"""The budget of `Auto`: when a valve's map is refitted, and how many shapes may be tried.

The budget counts a valve's samples since its start or last change, and a model of a fit's cost. It
never uses elapsed time: the same samples lead to the same map on any machine.
"""

from typing import Final

import numpy as np

from valvemap.model.kernels import cells as memory

Counts = np.ndarray

YOUNG: Final = 1_500  # samples below which a map is young
YOUNG_NS: Final = 40_000  # ns of fits per sample of a young map: all valves start together
CHANGED_NS: Final = 60_000  # ns per sample after a change: changes are rare and need a new map soon
SETTLED_NS: Final = 7_000  # ns per sample later: with the cells, less than 10 µs per sample
FIT_NS: Final = 40_000  # ns of any fit
POINT_NS: Final = 180  # ns of a fit per cell
BAND_NS: Final = 1.0  # ns of a fit per parameter times the squared bandwidth
OVERHEAD: Final = 3  # fits of a climb besides its steps
FIRST_FIT: Final = 8  # samples before the first fit
SHORTEST: Final = 16  # minimum of samples between fits
SHARE: Final = 8  # a fit is due when the samples have grown by 1/8
TRIAL: Final = 512  # maximum of samples between fits while shapes compete
LONGEST: Final = 2_048  # maximum at rest: 20 s at 100 Hz, in which a drifting map is constant
REPAIR_NS: Final = 500_000  # ns of budget required for a fit on account of residuals
REPAIR_SHARE: Final = 64  # minimum growth of the samples before such a fit, 1/64
ON_CREDIT: Final = 3  # steps of a poor map that may exceed the budget ...
DEBT: Final = 2_000_000  # ns; ... up to this debt: 3 s at 100 Hz
PARTS: Final = 64  # number of phases that spread the fits, see `scattered`
FEWEST_NEW: Final = 8  # new cells that require a fit ...
NEW_SHARE: Final = 16  # ... or that share of the known cells, 1/16


def next_fit(counters: Counts, points: int, *, at_rest: bool) -> None:
    """Set the number of samples, or of new cells, at which the next fit is due."""
    since = _since(counters)
    longest = LONGEST if at_rest else TRIAL
    counters[memory.NEXT_FIT] = counters[memory.USED] + min(max(since // SHARE, SHORTEST), longest)
    counters[memory.NEW_CELLS] = max(FEWEST_NEW, points // NEW_SHARE)
    until_paid = max(REPAIR_NS - left(counters), 0) // SETTLED_NS
    soonest = max(until_paid, since // REPAIR_SHARE, SHORTEST)
    counters[memory.FIT_AT] = counters[memory.USED]
    counters[memory.MAY_ASK] = counters[memory.USED] + soonest


def cost(points: int, n: int, band: int) -> int:
    """Return the model cost of a fit, ns."""
    return int(FIT_NS + POINT_NS * points + BAND_NS * n * band**2)


def left(counters: Counts) -> int:
    """Return the available budget, ns."""
    since = _since(counters)
    young_ns = CHANGED_NS if counters[memory.OPENED] else YOUNG_NS
    granted = young_ns * min(since, YOUNG) + SETTLED_NS * max(since - YOUNG, 0)
    return int(granted - counters[memory.SPENT])


def steps(counters: Counts, each: int, most: int, *, poor: bool) -> int:
    """Return the number of shapes that may be tried now; a poor map may exceed the budget."""
    spare = left(counters)
    owed = ON_CREDIT if poor and spare > -DEBT else 0
    return int(min(most, max(spare // each - OVERHEAD, owed)))


def spend(counters: Counts, ns: int) -> None:
    """Add a cost to the spent budget."""
    counters[memory.SPENT] += ns


def scattered(counters: Counts, samples: int) -> int:
    """Vary a number of samples deterministically, depending on the valve's spent budget.

    Otherwise valves that started together would all refit at the same sample, which takes seconds.
    """
    return int(samples * (counters[memory.SPENT] % PARTS) // PARTS)


def _since(counters: Counts) -> int:
    return int(counters[memory.USED] - counters[memory.OPENED])
