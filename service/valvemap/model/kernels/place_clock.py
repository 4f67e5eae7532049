"""The clock by which places age: it stops while the valve rests, and is set back in time."""

from valvemap.model.kernels.compiled import inlined, inner
from valvemap.model.kernels.place_layout import TOUCHED, VISITED
from valvemap.model.kernels.row_layout import CLOCK, LOOKED_AT, REST_A, REST_B, RESTED
from valvemap.model.samples import Floats, Singles

LATE, BACK = 2.0**23, 2.0**22  # samples: clock value at which it is set back, and the amount
REST = 1024.0  # samples at one place after which the clock stops: a valve at rest does not wear
AT_REST = 0.05  # steps of the grid that count as one place


@inlined
def tick(s: Floats, g: int, a: float, b: float, count: float) -> None:
    """Advance the clock by which places age, unless the valve rests."""
    if abs(a - s[g + REST_A]) + abs(b - s[g + REST_B]) > AT_REST:
        s[g + REST_A] = a
        s[g + REST_B] = b
        s[g + RESTED] = 0.0
    step = min(count - s[g + LOOKED_AT], REST - s[g + RESTED])
    s[g + LOOKED_AT] = count
    s[g + RESTED] += step
    s[g + CLOCK] += step


@inner
def set_back(s: Floats, g: int, places: Singles) -> None:
    """Set the clock and all its timestamps back; ages stay the same.

    Timestamps of millions of samples thus stay integers within single precision. Earlier ones,
    below 0, keep their age to seven digits.
    """
    s[g + CLOCK] -= BACK
    for k in range(len(places)):
        places[k, TOUCHED] -= BACK
        places[k, VISITED] -= BACK
