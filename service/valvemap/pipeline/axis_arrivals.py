"""The arrivals of an axis in numbers and words: its two lines together. Pure.

Rows 2k and 2k + 1 of the arrivals are the lines A and B of axis k.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from valvemap.pipeline.alignment import COUNTER_NAMES
from valvemap.pipeline.arrivals import Arrivals

LINES: Final = 2
_PORTS: Final = (("pS", "pA"), ("pB", "pT"))  # before and behind the edge that extends
_OTHERS: Final = ("T", "set_position")  # in the place of T


def line_words(line: int, *, has_speed: bool) -> dict[str, str]:
    """Return the names of a line's signals in the configuration.

    Examples
    --------
    >>> line_words(1, has_speed=False)
    {'U': 'U', 'p1': 'pB', 'p2': 'pT', 'Q': 'position', 'T': 'set_position'}
    """
    p1, p2 = _PORTS[line]
    piston = "speed" if has_speed else "position"
    return {"U": "U", "p1": p1, "p2": p2, "Q": piston, "T": _OTHERS[line]}


def counted(arrivals: Arrivals, number: int, unpaired: int) -> dict[str, int]:
    """Return the counters of an axis: a sample is lost once, whichever line lacks it.

    Those of line A, and ``unpaired``: its samples that never met one of line B.
    """
    row = arrivals.counts(np.array([LINES * number]))[0]
    counts = dict(zip(COUNTER_NAMES, row.tolist(), strict=True))
    counts["missing"] += unpaired
    counts["aligned"] -= unpaired
    return counts


def awaited(
    arrivals: Arrivals,
    remarks: Mapping[int, tuple[str, ...]],
    number: int,
    *,
    has_speed: bool,
    is_stale: bool,
) -> tuple[str, ...]:
    """Return what the source says of an axis' nodes, else the signals missing while it is stale."""
    rows = range(LINES * number, LINES * (number + 1))
    said = [words for row in rows for words in remarks.get(row, ())]
    if not said and is_stale:
        for line, row in enumerate(rows):
            said += arrivals.waited_for(row, line_words(line, has_speed=has_speed))
    return tuple(dict.fromkeys(said))
