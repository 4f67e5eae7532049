"""Where a piston is, by its speed: the places that it can have, kept within the stroke."""

import math
from typing import Final

from valvemap.model.kernels.compiled import kernel
from valvemap.model.samples import Floats, Times

MEMORY: Final = 3  # lowest and highest place, mm; speed of the last sample, mm/s


@kernel
def places_of(
    t: Times, v: Floats, last: Times, memory: Floats, settings: Floats, places: Floats
) -> None:
    """Advance the places that a piston can have by N samples of its speed.

    Parameters
    ----------
    t, v
        UTC ns, and speed in mm/s; NaN: not measured.
    last, memory
        Time of the last speed (1,), 0 before the first; `MEMORY`. Both are advanced.
    settings
        Stroke (mm), error of the speed (mm/s), longest gap (s): after it every place is possible.
    places
        Out: the lowest and the highest of the places (N, 2), mm; NaN without a speed.
    """
    stroke, error = settings[0], settings[1]
    for i in range(len(t)):
        places[i] = math.nan
        if not math.isfinite(v[i]):
            continue
        dt = 1e-9 * (t[i] - last[0])
        if last[0] == 0 or not 0.0 < dt <= settings[2]:
            memory[0], memory[1] = 0.0, stroke
        else:
            way, wider = 0.5 * (memory[2] + v[i]) * dt, error * dt
            memory[0] = min(max(memory[0] + way - wider, 0.0), stroke)
            memory[1] = min(max(memory[1] + way + wider, 0.0), stroke)
        memory[2], last[0] = v[i], t[i]
        places[i, 0], places[i, 1] = memory[0], memory[1]
