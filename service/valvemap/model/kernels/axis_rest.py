"""Where an axis rests: its position has not moved for seconds, whatever its sensor's noise."""

import math
from typing import Final

from valvemap.model.kernels.compiled import kernel
from valvemap.model.samples import Flags, Floats, Times

MEMORY: Final = 3  # quickly and slowly filtered position, mm; how long they have been close, s


@kernel
def moving_samples(
    t: Times, x: Floats, last: Times, memory: Floats, settings: Floats, moves: Flags
) -> None:
    """Mark the samples (N,) at which an axis moves.

    Parameters
    ----------
    t, x
        UTC ns, and position in mm; where x is NaN, the axis counts as moving.
    last, memory
        Time of the last position (1,), 0 before the first; `MEMORY`. Both are advanced.
    settings
        Time constants of both filters (s), difference up to which they are close (mm), time until
        this is rest (s), longest gap (s).
    moves
        Out.
    """
    for i in range(len(t)):
        moves[i] = True
        if not math.isfinite(x[i]):
            continue
        dt = 1e-9 * (t[i] - last[0])
        if last[0] == 0 or not 0.0 <= dt <= settings[4]:
            memory[0], memory[1], memory[2] = x[i], x[i], 0.0
        else:
            for k in range(2):
                memory[k] += -math.expm1(-dt / settings[k]) * (x[i] - memory[k])
            is_close = abs(memory[0] - memory[1]) <= settings[2]
            memory[2] = memory[2] + dt if is_close else 0.0
        last[0] = t[i]
        moves[i] = memory[2] < settings[3]
