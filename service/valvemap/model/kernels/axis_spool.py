"""Where the spool of an axis is by U: in its play, and at its largest speed."""

import math

from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.samples import Floats


@lean_kernel
def limited(U: Floats, most: float, x: Floats) -> None:
    """Write where a spool is that moves by ``most`` per sample into ``x``; both (N,), %.

    Where U is not a number, nor is the spool's place; at the next number it is there.
    """
    at = U[0]
    for k in range(len(U)):
        off = U[k] - at
        at = at + math.copysign(most, off) if abs(off) > most else U[k]
        x[k] = at


@inner
def held(memory: float, U: float, half: float) -> float:
    """Return the nearest to ``memory`` of what is within ``half`` of U, %."""
    return min(max(memory, U - half), U + half)
