"""The budget of `Auto`: when a valve's map is fitted anew, and how much may be tried then.

Everything is counted in the valve's own samples since it was new or last changed, and in a model of
what a fit costs, never in time that passed: the same samples lead to the same map anywhere.
"""

from typing import Final

import numpy as np

from valvemap.model.kernels import cells as memory

Counts = np.ndarray

YOUNG: Final = 1_500  # samples for which a map counts as young
YOUNG_NS: Final = 40_000  # ns of fits per sample of a young map: all valves begin together
CHANGED_NS: Final = 60_000  # ... of one that begins anew: few do together, and soon it is needed
SETTLED_NS: Final = 7_000  # the same later: with the cells, less than 10 µs per sample
FIT_NS: Final = 40_000  # ns of a fit, whatever its size
POINT_NS: Final = 180  # ... for each cell
BAND_NS: Final = 1.0  # ... for each parameter, times the bandwidth squared
OVERHEAD: Final = 3  # fits that a climb needs besides its steps
FIRST_FIT: Final = 8  # samples before the first fit
SHORTEST: Final = 16  # samples between fits, at least
SHARE: Final = 8  # a fit is due when the samples grew by 1/8
TRIAL: Final = 512  # samples between fits at most while shapes compete
LONGEST: Final = 2_048  # the same at rest: 20 s at 100 Hz, in which a map that drifts stands still
REPAIR_NS: Final = 500_000  # ns that must be left for residuals to ask for a fit
REPAIR_SHARE: Final = 64  # ... and the samples must have grown by that share
ON_CREDIT: Final = 3  # steps that a poor map may try though nothing is left for them ...
DEBT: Final = 2_000_000  # ... while it owes less than that, ns: 3 s of 100 Hz
PARTS: Final = 64  # in which samples are cut, see `scattered`
FEWEST_NEW: Final = 8  # new cells that call for a fit ...
NEW_SHARE: Final = 16  # ... or that share of those known


def next_fit(counters: Counts, points: int, *, at_rest: bool) -> None:
    """Set after how many samples, or new cells, the next fit is due."""
    since = _since(counters)
    longest = LONGEST if at_rest else TRIAL
    counters[memory.NEXT_FIT] = counters[memory.USED] + min(max(since // SHARE, SHORTEST), longest)
    counters[memory.NEW_CELLS] = max(FEWEST_NEW, points // NEW_SHARE)
    until_paid = max(REPAIR_NS - left(counters), 0) // SETTLED_NS
    soonest = max(until_paid, since // REPAIR_SHARE, SHORTEST)
    counters[memory.FIT_AT] = counters[memory.USED]
    counters[memory.MAY_ASK] = counters[memory.USED] + soonest


def cost(points: int, n: int, band: int) -> int:
    """What a fit costs, ns."""
    return int(FIT_NS + POINT_NS * points + BAND_NS * n * band**2)


def left(counters: Counts) -> int:
    """What may be spent now, ns."""
    since = _since(counters)
    young_ns = CHANGED_NS if counters[memory.OPENED] else YOUNG_NS
    granted = young_ns * min(since, YOUNG) + SETTLED_NS * max(since - YOUNG, 0)
    return int(granted - counters[memory.SPENT])


def steps(counters: Counts, each: int, most: int, *, poor: bool) -> int:
    """How many steps of the ladder may be tried now; where the map is poor, some on credit."""
    spare = left(counters)
    owed = ON_CREDIT if poor and spare > -DEBT else 0
    return int(min(most, max(spare // each - OVERHEAD, owed)))


def spend(counters: Counts, ns: int) -> None:
    """Note what was spent."""
    counters[memory.SPENT] += ns


def scattered(counters: Counts, samples: int) -> int:
    """Some of so many samples, more or fewer by what was spent on this valve so far.

    Valves that began together would all be due at one sample otherwise, seconds of work at once.
    """
    return int(samples * (counters[memory.SPENT] % PARTS) // PARTS)


def _since(counters: Counts) -> int:
    return int(counters[memory.USED] - counters[memory.OPENED])
