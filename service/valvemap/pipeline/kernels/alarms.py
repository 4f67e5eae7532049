"""The loop that updates the alarms of many valves, sample by sample.

Times are source times, UTC ns; nothing depends on how the samples were cut into batches.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valvemap.model.kernels.compiled import inlined, lean_kernel
from valvemap.model.kernels.prefetch import fetch
from valvemap.model.samples import Flags, Floats, Segments, Times
from valvemap.vocabulary.signals import COUNT, IS_OPTIONAL, Signal

# Alarms of a valve, numbered as `pipeline.alarms.Alarm`; those that are judged here.
RESIDUAL, SENSOR_LOST, SENSOR_FROZEN, UNEXCITED = 1, 3, 4, 5

CELLS_U, CELLS_S = 10, 12
WIDTH_U, WIDTH_S = 10.0, 1.5  # %, √bar; size of the cells in which residuals are compared
BLOCK = 16.0  # residuals per average: a persistent error exceeds the averaged noise
RECENT_BLOCKS = 32.0  # blocks; memory of the recent mean square: 5 s at 100 Hz
USUAL_BLOCKS = 1_000.0  # blocks; memory of the usual mean square: minutes
ENOUGH_BLOCKS = 64.0  # blocks until the usual mean square is known
SETTLED_BLOCKS = 400.0  # blocks until the map has converged and residuals are the valve's: minutes
PLACE_MEMORY = 1_000.0  # samples; memory of one cell
KNOWN_PLACE = 50.0  # samples until a cell's usual residual is known
OUTLIER = 25.0  # times the usual square; larger squares are clipped in the usual mean
LARGEST = 400.0  # times the usual square; larger blocks are clipped: a spike must not last seconds
NEGLIGIBLE = 0.0035  # of the flow's range; a smaller increase of the residuals is no alarm
CONFIRMED = 1.6  # times the usual; residuals that confirm a change
USUAL_SAMPLES = 5_000.0  # samples; memory of the usual mean square over all cells
STILL_TIMES = 10.0  # times its longest standstill, after which a signal is frozen
ENOUGH_MOVES = 100  # changes of a signal, and of the others since, before it can be frozen
PAUSE_NS = 2_000_000_000  # a longer gap between samples restarts the standstills
OIL_MEMORY_S = 1_800.0  # s; time constant of the oil's usual temperature
CAUSE_MEMORY = 1.0 - 1.0 / 1000.0  # per sample; memory of the sums that distinguish causes
AS_USUAL = 4.0  # times the usual square; a smaller block carries no information on causes
HALF_FORGOTTEN = 0.5  # factor of the sums at such a block: older samples blur a new cause
LEAST_DP = 1.0  # bar; lower bound of dp in Q̂/dp

# Regressors of the causes in the residual: 1, √dp, Q̂, Q̂/dp, dQ̂/dt.
CONSTANT, ROOT_DP, FLOW, FLOW_BY_DP, FLOW_RATE, DIRECTIONS = range(6)

# Possible causes, numbered as `pipeline.alarm_words.Cause`.
NO_CAUSE, EDGE, METER, SIGNAL, LAG, HOT_OIL, CAUSES = range(7)
TELLING = 0.15  # share of the squares; causes whose shares differ by less are equivalent
RULED_OUT = 4.0  # times the part that the best cause leaves unexplained; more excludes a cause
LEFT = 0.1  # share of the squares that no cause explains: noise
CLEAR = 0.1  # share that a lag must explain beyond the others: a constant error resembles one
LEAST_SHARE = 1e-6  # least share of an edge, a meter and an offset: always possible
OTHER_OIL_K = 3.0  # K from the usual temperature, beyond which the oil is named first

# Indices into `Senses.memory` and `Senses.times`.
CELL, KNOWN, BLOCK_SUM, BLOCK_N, RECENT, RECENT_N, USUAL, USUAL_N, T_USUAL, Q_BEFORE = range(10)
SQUARES, RATIO, LOST, TAKEN, LOST_BEFORE, TAKEN_BEFORE, CHANGES_SEEN = range(10, 17)
USUAL_SQUARE, USUAL_SQUARE_N, LAG_BEFORE, MEMORY = range(17, 21)
NEWEST, USABLE, EXCITED, LOSS_TIME, LARGE_SINCE, LARGE_UNTIL, TIMES = range(7)
NEVER = np.iinfo(np.int64).min


class Conditions(NamedTuple):
    """State of A alarms of each of M valves, (M, A) unless stated otherwise.

    ``over`` is the time from which the limit is exceeded, 0 if it is not; ``since`` the start of
    the last activation, ``at`` its last activation, deactivation or acknowledgement, both UTC ns;
    ``value`` the largest value during it; ``detail`` (M, A, 2) and ``causes`` (M, A, 3) describe
    it; ``came`` counts activations; ``version`` (M,) counts changes of any alarm. ``at`` never
    decreases: clocks of service and source differ, and samples arrive late.
    """

    over: Times
    since: Times
    at: Times
    active: Flags
    acked: Flags
    value: Floats
    detail: Floats
    causes: NDArray[np.uint8]
    came: Times
    version: Times


class Senses(NamedTuple):
    """Statistics of M valves by which their alarms are judged.

    ``last``, ``still``, ``longest``, ``moves``, ``others`` (M, 5): each signal's value, time of its
    last change, longest standstill (ns), number of changes, and number of changes of the others
    since its last. ``weight``, ``bias``, ``square`` (M, 120): number of samples in each cell, mean
    and mean square of the residuals there, l/min. ``sums`` (M, 6, 6): sums of products of the
    regressors and, last, the residual.
    """

    last: Floats
    still: Times
    longest: Times
    moves: Times
    others: Times
    weight: NDArray[np.float32]
    bias: NDArray[np.float32]
    square: NDArray[np.float32]
    sums: Floats
    memory: Floats
    times: Times


_U, _P1, _P2, _T = int(Signal.U), int(Signal.P1), int(Signal.P2), int(Signal.T)


class Watched(NamedTuple):
    """N gated samples, and the estimator's trace of them, all (N,) but ``values`` (N, COUNT)."""

    t: Times
    values: Floats
    quality: NDArray[np.uint8]
    predicted: Floats
    residual: Floats
    status: NDArray[np.uint8]


@lean_kernel
def watch(
    seen: Watched,
    patient: Flags,
    rules: Floats,
    conditions: Conditions,
    senses: Senses,
    segments: Segments,
    Q_span: float,
    shares: Floats,
) -> None:
    """Update the alarms with N samples.

    Parameters
    ----------
    Q_span
        Range of the flow, l/min.
    shares : (CAUSES,)
        Scratch array.
    patient : (M,)
        Mask of the valves with on-change signals: their silence is no loss.
    rules : (A, 3)
        Limit, limit less hysteresis, delay (ns).
    """
    for s in range(len(segments.members)):
        m = segments.members[s]
        if s + 1 < len(segments.members):
            fetch(conditions, segments.members[s + 1])
            fetch(senses, segments.members[s + 1])
        for i in range(segments.starts[s], segments.stops[s]):
            before = senses.times[m, NEWEST]
            _keep_time(m, seen.t[i], seen.values[i, _T], conditions, senses)
            if patient[m] and senses.times[m, USABLE] == before:
                senses.times[m, USABLE] = seen.t[i]
            _look_for_losses(m, i, seen, rules, conditions, senses)
            _look_for_standstills(m, i, seen, rules, conditions, senses)
            _look_at_excitation(m, i, seen, rules, conditions, senses)
            _look_at_residual(m, i, seen, rules, conditions, senses, Q_span, shares)


@lean_kernel
def move_on(
    valves: Times,
    t: Times,
    began: Times,
    x: Floats,
    alarm: int,
    rules: Floats,
    conditions: Conditions,
    came: Flags,
) -> None:
    """Judge one alarm of K valves by its quantity ``x`` (K,); set ``came`` (K,) on activation."""
    for k in range(len(valves)):
        came[k] = _step(valves[k], alarm, t[k], began[k], x[k], rules, conditions)


@inlined
def _step(
    m: int, a: int, t: int, began: int, x: float, rules: Floats, conditions: Conditions
) -> bool:
    """Judge one alarm; True if it is activated now. NaN changes nothing."""
    limit, release, delay = rules[a, 0], rules[a, 1], rules[a, 2]
    if np.isnan(x):
        return False
    if conditions.active[m, a]:
        conditions.value[m, a] = max(conditions.value[m, a], x)
        if x < release or (x <= limit and release == limit):
            conditions.active[m, a] = False
            conditions.over[m, a] = 0
            conditions.at[m, a] = max(t, conditions.at[m, a])
            conditions.version[m] += 1
        return False
    if not x > limit:
        conditions.over[m, a] = 0
        return False
    if conditions.over[m, a] == 0:
        conditions.over[m, a] = began
        conditions.value[m, a] = x
    conditions.value[m, a] = max(conditions.value[m, a], x)
    if t - conditions.over[m, a] < delay:
        return False
    conditions.active[m, a] = True
    conditions.acked[m, a] = False
    conditions.since[m, a] = conditions.over[m, a]
    conditions.at[m, a] = max(t, conditions.at[m, a])
    conditions.came[m, a] += 1
    conditions.version[m] += 1
    return True


@inlined
def _keep_time(m: int, t: int, T: float, conditions: Conditions, senses: Senses) -> None:
    """Restart timers after a clock step back or an outage; update the usual oil temperature."""
    times, newest, memory = senses.times[m], senses.times[m, NEWEST], senses.memory[m]
    first, back = newest == NEVER, t < newest
    if np.isfinite(T):
        known = np.isfinite(memory[T_USUAL]) and not (first or back)
        share = min((t - newest) * 1e-9 / OIL_MEMORY_S, 1.0) if known else 1.0
        memory[T_USUAL] = memory[T_USUAL] + share * (T - memory[T_USUAL]) if known else T
    if first or back:
        times[USABLE] = t
        if back or times[EXCITED] == NEVER:
            times[EXCITED] = t
        for a in range(conditions.over.shape[1]):
            if not conditions.active[m, a]:
                conditions.over[m, a] = 0
    if first or back or t - newest > PAUSE_NS:
        senses.still[m, :] = t
        senses.others[m, :] = 0
    times[NEWEST] = t


@inlined
def _look_for_losses(
    m: int, i: int, seen: Watched, rules: Floats, conditions: Conditions, senses: Senses
) -> None:
    """Judge the time without a usable sample, s; a usable sample ends it."""
    t, usable = seen.t[i], senses.times[m, USABLE]
    _step(m, SENSOR_LOST, t, usable, (t - usable) * 1e-9, rules, conditions)
    if seen.quality[i] != 2:
        senses.times[m, USABLE] = t
        _step(m, SENSOR_LOST, t, t, 0.0, rules, conditions)


@inlined
def _look_for_standstills(
    m: int, i: int, seen: Watched, rules: Floats, conditions: Conditions, senses: Senses
) -> None:
    """Judge how long a sensor's value has been bitwise constant while others moved, s.

    The limit is relative to the signal's own longest standstill, so that a signal that often rests
    is not called frozen. U is a command and is exempt; so is a value of 0, as of a meter without
    flow.
    """
    t = seen.t[i]
    values = seen.values[i]
    last, still = senses.last[m], senses.still[m]
    was_dead = conditions.active[m, SENSOR_FROZEN]
    moved = 0
    for j in range(COUNT):
        if values[j] == last[j] or np.isnan(values[j]):
            continue
        stood = t - still[j]
        if stood > senses.longest[m, j] and not (was_dead and conditions.detail[m, 4, 0] == j):
            senses.longest[m, j] = stood
        last[j] = values[j]
        still[j] = t
        senses.moves[m, j] += 1
        senses.others[m, j] = 0
        moved += 1 if j != _U and not IS_OPTIONAL[j] else 0
    longest, dead = 0.0, 0
    for j in range(1, COUNT):
        if still[j] == t:
            continue
        senses.others[m, j] += moved > 0
        stood = t - still[j]
        own = STILL_TIMES * senses.longest[m, j]
        enough = min(senses.moves[m, j], senses.others[m, j]) >= ENOUGH_MOVES
        if enough and last[j] != 0.0 and stood > own and stood * 1e-9 > longest:
            longest, dead = stood * 1e-9, j
    if _step(m, SENSOR_FROZEN, t, still[dead] if dead else t, longest, rules, conditions):
        conditions.detail[m, SENSOR_FROZEN, 0] = dead


@inlined
def _look_at_excitation(
    m: int, i: int, seen: Watched, rules: Floats, conditions: Conditions, senses: Senses
) -> None:
    """Judge the time without excitation, s; rejected samples are ignored."""
    t, times = seen.t[i], senses.times[m]
    if seen.status[i] != 2:  # Status.UNEXCITED
        times[EXCITED] = t
    held = (t - times[EXCITED]) * 1e-9
    _step(m, UNEXCITED, t, times[EXCITED], held, rules, conditions)


@inlined
def _look_at_residual(
    m: int,
    i: int,
    seen: Watched,
    rules: Floats,
    conditions: Conditions,
    senses: Senses,
    Q_span: float,
    shares: Floats,
) -> None:
    """Judge the ratio of the recent block-averaged residuals to their usual size.

    Only in known cells: in a new cell the map is an extrapolation.
    """
    t, e, predicted = seen.t[i], seen.residual[i], seen.predicted[i]
    U, dp, status = seen.values[i, _U], seen.values[i, _P1] - seen.values[i, _P2], seen.status[i]
    if seen.quality[i] == 2 or not (abs(e) < 1e100 and np.isfinite(U) and np.isfinite(dp)):
        return
    if status > 2 and status not in (4, 8):  # OK, WARMING_UP, UNEXCITED; FROZEN, UNRELIABLE
        return
    memory, weight = senses.memory[m], senses.weight[m]
    bias, square = senses.bias[m], senses.square[m]
    _add_up(m, i, seen, senses)
    memory[SQUARES] += (e * e - memory[SQUARES]) / (BLOCK * RECENT_BLOCKS)
    row = min(max(U / WIDTH_U, 0.0), CELLS_U - 1.0)
    column = min(np.sqrt(abs(dp)) / WIDTH_S, CELLS_S - 1.0)
    c = int(row) * CELLS_S + int(column)
    if c != memory[CELL]:
        memory[CELL], memory[KNOWN] = c, weight[c] >= KNOWN_PLACE
    usual_now = memory[RATIO] <= rules[RESIDUAL, 1]
    if memory[KNOWN] and square[c] > 0.0:
        memory[BLOCK_SUM] += (e - bias[c]) / np.sqrt(square[c])
        memory[BLOCK_N] += 1.0
        if memory[BLOCK_N] >= BLOCK:
            if _take_block(memory, usual_now):
                for j in range(DIRECTIONS + 1):
                    for k in range(DIRECTIONS + 1):
                        senses.sums[m, j, k] *= HALF_FORGOTTEN
            enough = memory[USUAL_N] >= SETTLED_BLOCKS
            ratio = np.sqrt(memory[RECENT] / memory[USUAL]) if enough else 0.0
            times = senses.times[m]
            if ratio > CONFIRMED:
                times[LARGE_SINCE] = times[LARGE_SINCE] if memory[RATIO] > CONFIRMED else t
                times[LARGE_UNTIL] = t
            memory[RATIO] = ratio
            more = memory[SQUARES] - memory[USUAL_SQUARE]
            matters = more >= (NEGLIGIBLE * Q_span) ** 2
            if _step(m, RESIDUAL, t, t, ratio if matters else 0.0, rules, conditions):
                conditions.detail[m, RESIDUAL, 0] = np.sqrt(memory[SQUARES])
                _name_causes(m, RESIDUAL, conditions, senses, shares)
    if usual_now:
        memory[USUAL_SQUARE_N] = min(memory[USUAL_SQUARE_N] + 1.0, USUAL_SAMPLES)
        seldom = memory[USUAL_SQUARE_N] >= KNOWN_PLACE
        new = min(e * e, OUTLIER * memory[USUAL_SQUARE]) if seldom else e * e
        memory[USUAL_SQUARE] += (new - memory[USUAL_SQUARE]) / memory[USUAL_SQUARE_N]
    if usual_now or weight[c] < KNOWN_PLACE:
        weight[c] = min(weight[c] + 1.0, PLACE_MEMORY)
        most = OUTLIER * square[c] if weight[c] >= KNOWN_PLACE else 1e30
        bias[c] += (min(max(e, -np.sqrt(most)), np.sqrt(most)) - bias[c]) / weight[c]
        square[c] += (min(e * e, most) - square[c]) / weight[c]
    memory[Q_BEFORE] = predicted


@inlined
def _take_block(memory: Floats, usual_now: bool) -> bool:  # noqa: FBT001 - numba takes positions
    """End a block: update the recent and the usual mean square; True if the block is as usual."""
    mean = memory[BLOCK_SUM] / memory[BLOCK_N]
    memory[BLOCK_SUM] = memory[BLOCK_N] = 0.0
    new = mean * mean
    if memory[USUAL_N] >= ENOUGH_BLOCKS:
        new = min(new, LARGEST * memory[USUAL])
    memory[RECENT_N] = min(memory[RECENT_N] + 1.0, RECENT_BLOCKS)
    memory[RECENT] += (new - memory[RECENT]) / memory[RECENT_N]
    if usual_now:
        memory[USUAL_N] = min(memory[USUAL_N] + 1.0, USUAL_BLOCKS)
        memory[USUAL] += (new - memory[USUAL]) / memory[USUAL_N]
        memory[USUAL] = max(memory[USUAL], 1.0 / BLOCK)  # that of white noise
    return bool(new < AS_USUAL * memory[USUAL])


@inlined
def _add_up(m: int, i: int, seen: Watched, senses: Senses) -> None:
    """Add a sample to the sums of products of the regressors and the residual."""
    memory, sums = senses.memory[m], senses.sums[m]
    e, Q, dp = seen.residual[i], seen.predicted[i], seen.values[i, _P1] - seen.values[i, _P2]
    rate = Q - memory[Q_BEFORE] if np.isfinite(memory[Q_BEFORE]) else 0.0
    row = (1.0, np.sqrt(max(dp, 0.0)), Q, Q / max(dp, LEAST_DP), rate, e)
    for j in range(DIRECTIONS + 1):
        for k in range(DIRECTIONS + 1):
            sums[j, k] = CAUSE_MEMORY * sums[j, k] + row[j] * row[k]


@lean_kernel
def name_causes(
    valves: Times, alarm: int, conditions: Conditions, senses: Senses, shares: Floats
) -> None:
    """Write the possible causes for K valves: up to three that explain most of the residual.

    A cause that explains it nearly as well as the best cannot be distinguished from it. ``shares``
    (CAUSES,) is a scratch array.
    """
    for k in range(len(valves)):
        _name_causes(valves[k], alarm, conditions, senses, shares)


@inlined
def _name_causes(
    m: int, alarm: int, conditions: Conditions, senses: Senses, shares: Floats
) -> None:
    sums, causes = senses.sums[m], conditions.causes[m, alarm]
    shares[:] = 0.0
    shares[EDGE] = _explained(sums, FLOW, ROOT_DP)
    shares[METER] = _explained(sums, FLOW, CONSTANT)
    shares[SIGNAL] = _explained(sums, ROOT_DP, FLOW_BY_DP)
    shares[LAG] = _explained(sums, FLOW_RATE, FLOW_RATE)
    if abs(shares[EDGE] - shares[METER]) < TELLING:  # 5 % less flow is 5 % less shown
        shares[EDGE] = shares[METER] = max(shares[EDGE], shares[METER], LEAST_SHARE)
    shares[SIGNAL] = max(shares[SIGNAL], LEAST_SHARE)
    if shares[LAG] < CLEAR + max(shares[EDGE], shares[METER], shares[SIGNAL]):
        shares[LAG] = 0.0
    if abs(senses.last[m, 4] - senses.memory[m, T_USUAL]) > OTHER_OIL_K:
        shares[HOT_OIL] = 2.0
    causes[:] = NO_CAUSE
    best = 0.0
    for place in range(len(causes)):
        chosen = NO_CAUSE
        for cause in range(1, CAUSES):
            if shares[cause] > shares[chosen]:
                chosen = cause
        share = min(shares[chosen], 1.0)
        if chosen == NO_CAUSE or (place > 0 and 1.0 - share > LEFT + RULED_OUT * (1.0 - best)):
            return
        best = share if shares[chosen] <= 1.0 and best == 0.0 else best
        causes[place] = chosen
        shares[chosen] = 0.0


@inlined
def _explained(sums: Floats, j: int, k: int) -> float:
    """Share of the residual's squares explained by two regressors together."""
    e, squares = DIRECTIONS, sums[DIRECTIONS, DIRECTIONS]
    if not squares > 0.0:
        return 0.0
    first = sums[j, e] ** 2 / sums[j, j] if sums[j, j] > 0.0 else 0.0
    second = sums[k, e] ** 2 / sums[k, k] if sums[k, k] > 0.0 else 0.0
    determinant = sums[j, j] * sums[k, k] - sums[j, k] ** 2
    if determinant <= 1e-9 * sums[j, j] * sums[k, k]:
        return float(max(first, second) / squares)
    both = sums[j, e] ** 2 * sums[k, k] + sums[k, e] ** 2 * sums[j, j]
    both -= 2.0 * sums[j, e] * sums[k, e] * sums[j, k]
    return float(both / determinant / squares)
