"""What the map says at a point now: flow, its derivatives, its variance."""

import math

from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_oil as oil
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_reading as readings
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_wear as wears
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis, between_sites, surface_and_slopes
from valvemap.model.kernels.flow_memory import (
    AGAINST,
    AS_LEARNT,
    FITTED,
    FLOW,
    FLOWS,
    MOVED,
    OF,
    PLACE_S,
    PLACE_U,
    SLOPE,
    SURE,
    TOTAL,
    WARM,
    Memory,
    Room,
)
from valvemap.model.samples import Floats


@inner
def clipped(axis: Axis, x: float) -> tuple[float, bool]:
    """Nearest point of the axis, and whether x lies too far beyond it to count there."""
    low, high = axis.breaks[0], axis.breaks[-1]
    slack = rules.BEYOND * (high - low)
    return min(max(x, low), high), x < low - slack or x > high + slack


@inner
def place(axis_U: Axis, memory: Memory, side: int, u: float, r: float, at: Floats) -> None:
    """Where a point lies on the map as it was at first."""
    end = abs(axis_U.breaks[-1] if side == 0 else axis_U.breaks[0])
    shifted = u - memory.now[side, 0, drifts.EDGE] * max(1.0 - abs(u) / max(end, 1e-9), 0.0)
    at[PLACE_U] = min(max(shifted, axis_U.breaks[0]), axis_U.breaks[-1])
    at[PLACE_S] = r


@inner
def look(
    axis_U: Axis, axis_s: Axis, memory: Memory, side: int, u: float, x: float, room: Room,
    shown: bool,  # noqa: FBT001 - numba knows no keyword
) -> None:  # fmt: skip
    """Fill what the map says at a place: flow, derivatives, variances without and with drift.

    ``shown``: of what the sensors show, not of the valve's flow alone.
    """
    at, now = room.at, memory.now[side]
    gain = 1.0 + now[0, drifts.GAIN]
    end = abs(axis_U.breaks[-1] if side == 0 else axis_U.breaks[0])
    flow, slope, along = surface_and_slopes(
        axis_U, axis_s, memory.theta, at[PLACE_U], at[PLACE_S], room.work
    )
    allowed = paths.forward(flow, side, at[PLACE_S], memory.scalars[fits.LEAST])
    at[AGAINST] = gain * (flow - allowed)
    if flow != allowed:
        flow, slope, along = allowed, 0.0, 0.0
    spread = between_sites(axis_U, axis_s, memory.std, at[PLACE_U], at[PLACE_S])
    of_path = between_sites(axis_U, axis_s, memory.doubt, at[PLACE_U], at[PLACE_S])
    at[OF + drifts.GAIN] = flow
    at[SLOPE] = gain * slope
    at[OF + drifts.EDGE] = -gain * slope * max(1.0 - abs(u) / max(end, 1e-9), 0.0)
    at[OF + drifts.ZERO], top = memory.scalars[fits.ZERO_SCALE], axis_s.breaks[-1]
    root = max(abs(at[PLACE_S]), rules.LAMINAR * top)  # there the root is no straight line
    at[OF + drifts.PRESSURE] = -gain * along * top * top / (2.0 * root)
    z, known = at[OF + drifts.LEVELS : OF + drifts.RATES], at[FLOWS : FLOWS + oil.EFFECTS]
    oil.effects_at(axis_s, memory, flow, at[PLACE_S], x, z)
    learnt = oil.viscosity(memory, memory.scalars[fits.LEARNT_T])
    oil.effects_at(axis_s, memory, flow, at[PLACE_S], learnt, known)
    warm = oil.warm(memory, side, z)
    at[OF + drifts.GAIN] += warm
    at[WARM], at[AS_LEARNT] = gain * warm, gain * oil.warm(memory, side, known)
    for k in range(oil.EFFECTS):
        z[k] *= gain
        known[k] = z[k] - gain * known[k]  # what a doubt about the law makes of what cells say
    at[FLOW] = gain * flow + at[WARM]
    at[SURE] = gain * gain * (spread * spread + of_path * of_path + memory.scalars[fits.MISFIT])
    moved = of_levels = 0.0
    for k in range(drifts.RATES):
        for j in range(drifts.RATES):
            if shown or not (_is_of_sensor(k) or _is_of_sensor(j)):
                part = _by(at, k) * _by(at, j) * now[1 + k, j]
                moved += part
                of_levels += part if max(k, j) < drifts.LEVELS else 0.0
    at[MOVED], at[TOTAL] = max(of_levels, 0.0), at[SURE] + max(moved, 0.0)


@inner
def _by(at: Floats, k: int) -> float:
    return float(at[OF + k] if k < drifts.LEVELS else at[FLOWS + k - drifts.LEVELS])


@inner
def _is_of_sensor(k: int) -> bool:
    return drifts.OF_VALVE <= k < drifts.LEVELS


@inner
def _unnoticed(x: Floats, chance: Floats, at: Floats) -> float:
    """Variance by what cells learnt of drifts of sensors before these were noticed."""
    total = 0.0
    for k in range(drifts.LEVELS):
        if chance[drifts.SENSING] > rules.WORTH_SAYING:
            rate = x[drifts.SENSING, drifts.RATES + k]
            total += (at[OF + k] * rate * rules.UNNOTICED) ** 2
    return total


@inner
def in_common(scalars: Floats) -> float:
    """Probability that something nameless moves the flow: errors in different cells are alike.

    At times longer apart than a meter's noise lasts. Schwarz's criterion: by their correlation,
    less half the logarithm of the number of pairs.
    """
    pairs, square = max(scalars[fits.PAIRS], 1.0), max(scalars[fits.PAIR_SQUARE], 1e-300)
    shared = min(max(scalars[fits.PAIR_PRODUCT] / square, 0.0), 0.999)
    gain = -0.5 * (pairs * math.log(1.0 - shared * shared) + math.log(pairs))
    return float(1.0 / (1.0 + math.exp(-min(max(gain, -50.0), 50.0)) / rules.ODDS))


@lean_kernel
def in_common_many(scalars: Floats, found: Floats) -> None:
    """`in_common` of each of M models: (M, SCALARS), (M,)."""
    for m in range(len(scalars)):
        found[m] = in_common(scalars[m])


@lean_kernel
def evaluate(
    axis_U: Axis, axis_s: Axis, memory: Memory, U: Floats, dp: Floats, T: Floats, Q: Floats,
    spread: Floats,
    room: Room,
) -> None:  # fmt: skip
    """Flow and its standard deviation at N points; NaN before the first fit."""
    at, scalars = room.at, memory.scalars
    common = max(scalars[fits.PAIR_PRODUCT], 0.0) / max(scalars[fits.PAIRS], 1.0)
    common *= in_common(scalars)
    for i in range(len(U)):
        Q[i] = spread[i] = math.nan
        if not (memory.counters[FITTED] and math.isfinite(U[i] + dp[i])):
            continue
        u, _ = clipped(axis_U, U[i])
        r, _ = clipped(axis_s, paths.effective(dp[i], math.inf, memory.path))
        side = 0 if u >= 0.0 else 1
        place(axis_U, memory, side, u, r, at)
        look(axis_U, axis_s, memory, side, u, oil.viscosity(memory, T[i]), room, False)  # noqa: FBT003
        width = memory.path[paths.STICK] + memory.path[paths.RELAYS]
        law = (rules.OTHER_LAW * (at[WARM] - at[AS_LEARNT])) ** 2
        worn = wears.variance_at(memory.wear, axis_U, axis_s, side, at[PLACE_U], at[PLACE_S])
        both = at[SLOPE] * rules.BOTH_BRANCHES * width
        worn += _unnoticed(memory.x[side], memory.chance[side], at)
        worn += common * readings.ratio(scalars[fits.READING :], at[FLOW])
        Q[i], spread[i] = at[FLOW], math.sqrt(at[TOTAL] + law + worn + both * both)


@lean_kernel
def warmth(
    axis_U: Axis, axis_s: Axis, memory: Memory, U: float, dp: float, step: float, room: Room
) -> tuple[float, float]:
    """(dQ/dT) / Q at a point now, 1/K, and its standard deviation; 0 where T is not known."""
    at, now = room.at, memory.now[0]
    T = memory.scalars[fits.NOW_T]
    if not (memory.counters[FITTED] and math.isfinite(T - memory.scalars[fits.FIRST_T])):
        return 0.0, rules.WARMTH * rules.THINNING
    place(axis_U, memory, 0, U, math.sqrt(dp), at)
    look(axis_U, axis_s, memory, 0, U, oil.viscosity(memory, T), room, False)  # noqa: FBT003
    z, rises = at[OF + drifts.LEVELS : OF + drifts.RATES], at[FLOWS : FLOWS + oil.EFFECTS]
    x, gain = oil.viscosity(memory, T + step), 1.0 + now[0, drifts.GAIN]
    flow = at[OF + drifts.GAIN] - at[WARM] / gain
    oil.effects_at(axis_s, memory, flow, at[PLACE_S], x, rises)
    slope = variance = 0.0
    for k in range(oil.EFFECTS):
        rises[k] = (gain * rises[k] - z[k]) / step
        slope += rises[k] * now[0, drifts.LEVELS + k]
        for j in range(k + 1):
            both = rises[k] * rises[j] * now[1 + drifts.LEVELS + k, drifts.LEVELS + j]
            variance += both if j == k else 2.0 * both
    if not at[FLOW] > 0.0:
        return 0.0, rules.WARMTH * rules.THINNING
    return slope / at[FLOW], math.sqrt(max(variance, 0.0)) / at[FLOW]
