"""Permitted content of the alignment's arrays, checked when they are restored."""

import numpy as np

from valvemap.model.contents import Contents
from valvemap.pipeline.kernels import waiting as slots
from valvemap.pipeline.kernels.waiting import Waiting

_COUNTED = [slots.GIVEN_UP, slots.GAPS_KEPT, slots.DOUBTFUL, slots.TIMES_KEPT]


def contents_of_waiting(like: Waiting) -> dict[str, Contents]:
    """Return the limits by array; ``like.order`` has the number of samples of each valve."""
    found = {name: Contents(getattr(like, name)) for name in Waiting._fields}
    for name in ("values", "held_value"):
        found[name].or_nan().or_infinite()
    for name in ("slots", "held_time", "lost", "left", "order"):
        found[name].any_time()
    for valve, size in enumerate(like.order[:, slots.SIZE].tolist()):
        found["order"].within(size, size, (valve, slots.SIZE))
        in_use = valve, slice(size), slots.FILLED  # a slot that is free holds remains
        found["slots"].within(0, 2**slots.STRIDE - 1, in_use)
    found["order"].within(0, np.inf, (slice(None), _COUNTED))
    found["order"].within(0, slots.ENOUGH, (slice(None), slots.REGULAR))
    found["order"].within(0, slots.NEW_PACE, (slice(None), slots.LONG_STEPS))
    return found
