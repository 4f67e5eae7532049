"""Effects of the oil's viscosity, relative to that at the first sample: x = ln ν, linear in T.

    Q = (1 + a)·(g + Σ θ_k·z_k),    y = x² + .3·x³
    z = g·x, g·L·x, g·L·y, g·K·x, s·|s|·(y - x)

L = s₀ / (|s| + s₀) is large where flow is laminar, K the same for a smaller s₀. Cells keep the flow
as it was, and means of x and y: their flow at the first temperature follows the law as it becomes
known, and a later sample gives θ by the difference to its own cell.
"""

import math

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.kernels.flow_cells import (
    COUNT,
    MEAN_BEND,
    MEAN_Q,
    MEAN_S,
    MEAN_U,
    MEAN_X,
    Cells,
)
from valvemap.model.kernels.flow_memory import FLOWS, Memory, Room
from valvemap.model.kernels.flow_slopes import PLACES, WITH_Q, Slopes, owns
from valvemap.model.samples import Floats, Singles

EFFECTS = drifts.RATES - drifts.LEVELS


@inner
def viscosity(memory: Memory, T: float) -> float:
    """Give ln ν; 0 where T is not known."""
    first = memory.scalars[fits.FIRST_T]
    if not (math.isfinite(T) and math.isfinite(first)):
        return 0.0
    return float(min(max(rules.THINNING * (first - T), -2.0), 2.0))


@inner
def bend(x: float) -> float:
    """Give y: oils thin the less the warmer they are."""
    return x * x * (1.0 + rules.FLATTENS * x)


@inner
def effects(
    axis_s: Axis, memory: Memory, flow: float, s: float, x: float, y: float, z: Floats
) -> None:  # fmt: skip
    """Fill z (EFFECTS,) from x and y or their means."""
    top = axis_s.breaks[-1]
    laminar = rules.STRONG * flow * rules.LAMINAR * top / (abs(s) + rules.LAMINAR * top)
    creeping = rules.STRONG * flow * rules.CREEPING * top / (abs(s) + rules.CREEPING * top)
    z[0], z[1], z[2], z[3] = flow * x, laminar * x, laminar * y, creeping * x
    z[4] = (y - x) * s * abs(s) / (top * top) * math.sqrt(memory.scalars[fits.SCALE])


@inner
def effects_at(axis_s: Axis, memory: Memory, flow: float, s: float, x: float, z: Floats) -> None:
    """Fill z (EFFECTS,) at one x."""
    effects(axis_s, memory, flow, s, x, bend(x), z)


@inner
def effects_of(axis_s: Axis, memory: Memory, flow: float, cell: Singles, z: Floats) -> None:
    """Fill z (EFFECTS,) with means over the samples of a cell."""
    x, y = float(cell[MEAN_X]), float(cell[MEAN_BEND])
    effects(axis_s, memory, flow, float(cell[MEAN_S]), x, y, z)


@inner
def warm(memory: Memory, side: int, z: Floats) -> float:
    """Flow due to temperature, of a gain of 1."""
    total = 0.0
    for k in range(EFFECTS):
        total += z[k] * memory.now[side, 0, drifts.LEVELS + k]
    return total


@inner
def at_first(axis_s: Axis, memory: Memory, cell: Singles, room: Room) -> float:
    """Mean flow of a cell, had the oil always been as it was at first."""
    leakage, factor = _since_first(axis_s, memory, cell, room)
    return float((cell[MEAN_Q] - leakage) / factor)


@inner
def _since_first(
    axis_s: Axis, memory: Memory, cell: Singles, room: Room
) -> tuple[float, float]:  # fmt: skip
    """What leaks since, and what all other flow is times that at first."""
    z, side = room.at[FLOWS : FLOWS + EFFECTS], 0 if cell[MEAN_U] >= 0.0 else 1
    effects_of(axis_s, memory, 0.0, cell, z)
    leakage = warm(memory, side, z)
    effects_of(axis_s, memory, 1.0, cell, z)
    return leakage, max(1.0 + warm(memory, side, z) - leakage, rules.LEAST_WARM)


@lean_kernel
def all_at_first(
    axis_s: Axis, memory: Memory, cells: Cells, slopes: Slopes, room: Room
) -> None:  # fmt: skip
    """Write `at_first` of the memory's cells as the flow of ``cells`` and ``slopes``."""
    for c in range(len(cells)):
        if cells[c, COUNT] > 0.0:
            leakage, factor = _since_first(axis_s, memory, memory.cells[c], room)
            cells[c, MEAN_Q] = (memory.cells[c, MEAN_Q] - leakage) / factor
            if owns(slopes, c):
                slopes[c % PLACES, WITH_Q] = memory.slopes[c % PLACES, WITH_Q] / factor
