"""When the changes of a valve suffice to detect its timing: enough time, and enough values."""

from typing import Final

import numpy as np

from valvemap.model.samples import Flags, Times
from valvemap.pipeline.kernels.scans import Changed

LISTEN_NS: Final = 5_000_000_000  # detection of the timing needs this long …
LISTEN_VALUES: Final = 25  # … and this many values of the fastest signal, …
LISTEN_LONGEST_NS: Final = 60_000_000_000  # … or this time …
LISTEN_FEWEST: Final = 8  # … and this many values
MOST_HELD_BACK: Final = 8192  # changes held back per valve


def heard_long_enough(changes: Changed, there: Flags, horizon_ns: int) -> tuple[int, Changed]:
    """Return how many changes were needed to detect the timing, and those to judge by.

    A message may hold many scans, sorted by signal. So scans are judged once no value of them can
    still come.

    Parameters
    ----------
    changes
        Changes held back.
    there
        Which signals the valve has, (PER_VALVE,).
    horizon_ns
        Longest time that a value may be late.

    Returns
    -------
    tuple
        -1 and all changes if more are needed.
    """
    newest = np.maximum.accumulate(changes.time)
    enough = _enough(changes, there, newest)
    if enough == len(newest):
        return -1, changes
    until = int(newest[enough])
    seen = [_first_beyond(changes, int(j), until) for j in np.flatnonzero(there)]
    waited = int(np.searchsorted(newest, until + horizon_ns))
    end = min(max(enough, *seen), max(enough, waited), MOST_HELD_BACK - 1)
    if end == len(newest):
        return -1, changes
    judged = changes.time[: end + 1] <= until
    return end + 1, Changed._make(column[: end + 1][judged] for column in changes)


def has_one_instant(changes: Changed, there: Flags) -> bool:
    """Return whether all signals have a value at one time at least."""
    common: Times | None = None
    for j in np.flatnonzero(there):
        own = np.unique(changes.time[changes.signal == j])
        common = own if common is None else np.intersect1d(common, own, assume_unique=True)
        if not len(common):
            return False
    return True


def _enough(changes: Changed, there: Flags, newest: Times) -> int:
    """Index of the change with which enough time and values have passed."""
    second, counted, few = (
        _first_with(changes, there, number) for number in (2, LISTEN_VALUES, LISTEN_FEWEST)
    )
    if second == len(newest):
        return second
    since = newest[second:] - newest[second]
    soon = max(second + int(np.searchsorted(since, LISTEN_NS)), counted)
    late = max(second + int(np.searchsorted(since, LISTEN_LONGEST_NS)), few)
    return min(soon, late, MOST_HELD_BACK - 1)


def _first_beyond(changes: Changed, j: int, time: int) -> int:
    """Index of the first change of a signal at or after ``time``."""
    own = (changes.signal == j) & (changes.time >= time)
    return int(np.argmax(own)) if own.any() else len(own)


def _first_with(changes: Changed, there: Flags, number: int) -> int:
    """Index of the change at which a signal first has ``number`` values."""
    places = (np.flatnonzero(changes.signal == j) for j in np.flatnonzero(there))
    return min(
        (int(own[number - 1]) for own in places if len(own) >= number),
        default=len(changes.signal),
    )
