"""Stays: successive samples in one cell, from which drift and sudden changes are learnt."""

import math

import numpy as np

from valvemap.model.kernels import flow_begun as begins
from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_noise as noises
from valvemap.model.kernels import flow_oil as oil
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_play as plays
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_wear as wears
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.kernels.flow_basis import Axis, surface
from valvemap.model.kernels.flow_cells import (
    COUNT,
    MEAN_S,
    MEAN_U,
    REFUSALS,
)
from valvemap.model.kernels.flow_drift import Drift
from valvemap.model.kernels.flow_memory import (
    AGAINST,
    ALARMED,
    APART,
    BEFORE,
    BEGAN,
    BEGAN_TIME,
    BY,
    CALM,
    CHANGE_KIND,
    CHANGE_OF,
    CHANGE_SAMPLE,
    CHANGE_SIZE,
    CHANGE_TIME,
    CHANGES,
    CLOCK,
    FITTED,
    FLOW,
    KNOWN_COUNT,
    KNOWN_OFF,
    KNOWN_Z,
    LEARNT,
    LOOSE,
    NEXT_FIT,
    NEXT_START,
    NOISY,
    OF,
    OF_MAP,
    PAIR_CELL,
    PAIR_TIME,
    PLACE_S,
    PLACE_U,
    RESIDUAL,
    RIVAL_PARAMETERS,
    RIVAL_SUM,
    ROWS_SEEN,
    SAMPLES,
    SKIPPED,
    STAY_CELL,
    STAY_SIDE,
    STAY_TIME,
    STAYS,
    SURE,
    USED,
    WANDERED,
    Memory,
    Room,
)
from valvemap.model.samples import Floats, Singles, Times


@inner
def begin_again(memory: Memory) -> None:
    """Forget the cells, as their U was that of another play; scales stay."""
    memory.cells[:] = memory.slopes[:] = 0.0
    memory.begun[:] = 0
    memory.counters[FITTED] = 0
    memory.counters[NEXT_FIT] = memory.counters[USED] + rules.FIRST_FIT
    memory.counters[BEGAN] = memory.counters[USED]
    memory.counters[PAIR_TIME] = memory.counters[BEGAN_TIME] = 0
    memory.scalars[fits.WITHIN : fits.COLOUR + 1] = 0.0
    memory.scalars[fits.SLOW :] = 0.0
    wears.forget(memory.wear)
    for side in range(2):
        drifts.forget(memory.x[side], memory.P[side], memory.chance[side], memory.now[side])


@lean_kernel
def forget_motion(memory: Memory) -> None:
    """Forget what moved in time."""
    memory.counters[ALARMED] = memory.counters[SKIPPED] = memory.counters[STAYS] = 0
    memory.counters[CALM] = memory.counters[USED] + rules.MATURE
    memory.stay[:KNOWN_COUNT] = memory.stay[LOOSE:] = 0.0
    wears.forget(memory.wear)
    for side in range(2):
        drifts.forget(memory.x[side], memory.P[side], memory.chance[side], memory.now[side])


@lean_kernel
def begin_replay(memory: Memory, rows: int, T: float) -> None:
    """Begin again, about to learn from the last ``rows`` samples once more.

    Sudden changes among them were found before, if they were certain.
    """
    begin_again(memory)
    counters, play = memory.counters, memory.play
    counters[CALM] = counters[USED]
    counters[USED] = max(counters[USED] - rows, 1)
    counters[BEGAN] = counters[USED]
    counters[NEXT_FIT] = counters[USED] + rules.FIRST_FIT
    counters[NEXT_START] = rules.SECOND_START
    counters[ROWS_SEEN] = counters[SKIPPED] = counters[STAYS] = counters[CLOCK] = 0
    counters[CLOCK + 1] = counters[LEARNT] = 0
    memory.scalars[fits.FIRST_T] = T
    memory.scalars[fits.SURPRISE] = memory.scalars[fits.STAYS_SEEN] = 0.0
    memory.scalars[fits.PAIR_PRODUCT : fits.PAIRS + 1] = 0.0
    memory.path[paths.SEEN] = 0.0
    memory.stay[:KNOWN_COUNT] = memory.stay[LOOSE:] = 0.0
    play[plays.SEEN] = play[plays.SLOPES] = play[plays.ERRORS] = 0.0
    play[plays.GAINS :] = 0.0


@inner
def begin_stay(
    axis_U: Axis, axis_s: Axis, memory: Memory, gain: float, cell: Singles, room: Room
) -> None:
    """Note what the cell knows: later it knows the stay's own samples."""
    memory.stay[KNOWN_COUNT], memory.stay[KNOWN_OFF] = cell[COUNT], 0.0
    if cell[COUNT] > 0.0:
        own = surface(axis_U, axis_s, memory.theta, cell[MEAN_U], cell[MEAN_S], room.work)
        flow, z = oil.at_first(axis_s, memory, cell, room), memory.stay[KNOWN_Z:]
        memory.stay[KNOWN_OFF] = gain * (flow - own)
        oil.effects_of(axis_s, memory, gain * flow, cell, z)
        z[oil.EFFECTS - 1] *= gain


@inner
def apart(axis_U: Axis, axis_s: Axis, cell: Singles, number: int, at: Floats) -> float:
    """Squared distance of a sample from its cell's mean, in sizes of the cell."""
    parts = len(axis_s.breaks) - 1
    i, j = number // parts, number % parts
    du = (at[PLACE_U] - cell[MEAN_U]) / (axis_U.breaks[i + 1] - axis_U.breaks[i])
    ds = (at[PLACE_S] - cell[MEAN_S]) / (axis_s.breaks[j + 1] - axis_s.breaks[j])
    return float(du * du + ds * ds)


@inner
def note_stay(
    number: int, side: int, t: int, residual: float, weight: float, distance: float, loose: float,
    memory: Memory, at: Floats,
) -> None:  # fmt: skip
    """Add a sample to the stay in its cell; a single one that is refused is left out."""
    counters, stay = memory.counters, memory.stay
    if stay[SAMPLES] == 0.0:
        counters[STAYS] = counters[STAYS] + 1 if number == counters[STAY_CELL] else 1
    counters[STAY_CELL], counters[STAY_SIDE], counters[STAY_TIME] = number, side, t
    if weight < 0.5 and counters[SKIPPED] == 0:
        counters[SKIPPED] = 1
        return
    counters[SKIPPED] = 0 if weight >= 0.5 else 1
    stay[SAMPLES] += 1.0
    stay[RESIDUAL] += residual - at[AGAINST]  # as the cell is compared: with the map as fitted
    for k in range(drifts.RATES):
        stay[BY + k] += at[OF + k]
    stay[OF_MAP] += at[SURE]
    stay[APART] += distance
    stay[LOOSE] += loose
    stay[NOISY] += noises.of_sample(at[FLOW], memory.scalars)


@inner
def end_stay(axis_U: Axis, axis_s: Axis, memory: Memory, room: Room) -> None:
    """Let the drift learn from the stay that ends."""
    counters, scalars, stay = memory.counters, memory.scalars, memory.stay
    many = stay[SAMPLES]
    variance = stay[NOISY] / max(many, 1.0)
    noise = noises.of_stay(many, variance, scalars) + stay[LOOSE] / max(many, 1.0) ** 2
    if paths.filters(memory.path):  # the filter's errors are common to a stay
        noise = max(noise, rules.STAY_BEHIND_FILTER * variance)
    if counters[FITTED] and counters[STAY_CELL] < len(memory.cells):
        cell = memory.cells[counters[STAY_CELL]]
        is_refused = counters[SKIPPED] and many > 0.0
        if not is_refused or counters[STAYS] == 1:  # a visit counts once: it may be a change
            cell[REFUSALS] = cell[REFUSALS] + 1.0 if is_refused else 0.0
    if many > 0.0 and stay[KNOWN_COUNT] >= rules.VISITED and not paths.filters(memory.path):
        _note_pair(noise + variance / stay[KNOWN_COUNT], variance, memory)
    is_sure = stay[OF_MAP] < many * variance or stay[KNOWN_COUNT] >= rules.SURE_CELL
    age = 1e-9 * float(counters[STAY_TIME] - counters[BEGAN_TIME])
    learnt = counters[USED] - counters[BEGAN]
    is_settled = age >= rules.SETTLED_FOR or learnt >= rules.MATURE
    is_sure = is_sure and learnt >= rules.SETTLED_MAP
    if many > 0.0 and is_sure and stay[KNOWN_COUNT] >= rules.VISITED:
        side = counters[STAY_SIDE]
        of_cell, off = variance / stay[KNOWN_COUNT], stay[KNOWN_OFF]
        # Where a cell's mean is known, the map errs oppositely at its ends, half a cell away.
        of_cell += 4.0 * stay[APART] / many * stay[OF_MAP] / many
        of_map = max(stay[OF_MAP] / many, off * off - of_cell)  # a map that the cell refutes
        share = of_map / (of_map + of_cell)
        residual = stay[RESIDUAL] / many - share * off
        drift = Drift(
            memory.x[side], memory.P[side], memory.chance[side], memory.now[side], room.drift
        )
        by = stay[BY : BY + drifts.RATES]
        for k in range(drifts.RATES):
            by[k] /= many
        for k in range(oil.EFFECTS):  # the law tells of the difference to the cell
            by[drifts.LEVELS + k] -= stay[KNOWN_Z + k]
        law = rules.OTHER_LAW * oil.warm(memory, side, by[drifts.LEVELS :])
        alike = _alike(memory)
        noise += alike * law * law
        noise += by[drifts.EDGE] * by[drifts.EDGE] * _may_lag_behind(memory, axis_U)
        doubt = counters[STAYS] * (noise + share * of_cell)
        if is_settled:
            _tell(axis_U, axis_s, drift, residual, by, doubt, memory, room)
        elif alike == 1.0:  # stays of one oil have the error of a young map in common
            drifts.learn_of_T(drift, residual, by, doubt)
    stay[:KNOWN_COUNT] = stay[LOOSE:] = 0.0


@inner
def _tell(
    axis_U: Axis, axis_s: Axis, drift: Drift, residual: float, by: Floats, variance: float,
    memory: Memory, room: Room,
) -> None:  # fmt: skip
    """Let a stay tell what moves.

    Before the samples were searched for operators, what seems to change may be one of them: a
    sudden change is found then only where many stays were compared with places known before.
    """
    counters, scalars = memory.counters, memory.scalars
    side, now = counters[STAY_SIDE], counters[STAY_TIME]
    last = counters[CLOCK + side]
    dt = min(max(1e-9 * float(now - last), 0.0), rules.OLDEST) if last != 0 else 0.0
    counters[CLOCK + side] = now
    age = 1e-9 * float(now - counters[BEGAN_TIME])
    is_mature = counters[USED] - counters[BEGAN] >= rules.LOOKS[0] and age >= rules.SETTLED_FOR
    young = not is_mature and scalars[fits.STAYS_SEEN] < rules.STAY_MEMORY
    young = young or counters[USED] < counters[CALM]
    jumps = 0.0 if young else min(dt / rules.BETWEEN_JUMPS, 0.1)
    nameless = rules.ODDS * jumps if is_mature else 0.0
    off = residual
    for k in range(drifts.LEVELS):
        off += by[k] * drift.now[0, k]
    of_valve = off
    for k in range(drifts.OF_VALVE, drifts.LEVELS):
        of_valve -= by[k] * drift.now[0, k]
    _expect_as_other_side(drift, side, last, memory)
    over = _over(drift, dt, now, counters)
    surprise = drifts.step(drift, dt, jumps, over, nameless, residual, by, variance)
    _trust_begun(drift, side, jumps, memory)
    scalars[fits.STAYS_SEEN] = min(scalars[fits.STAYS_SEEN] + 1.0, rules.STAY_MEMORY)
    scalars[fits.SURPRISE] += (surprise - scalars[fits.SURPRISE]) / scalars[fits.STAYS_SEEN]
    _note_change(drift, side, now, off, by, memory)
    _note_wear(axis_U, axis_s, drift, side, dt, of_valve, by, variance, young, memory, room)


@inner
def _trust_begun(drift: Drift, side: int, jumps: float, memory: Memory) -> None:
    """Trust the cells that began, once stays exclude that a sudden change came before them."""
    begun, expected = memory.begun[side], memory.scalars[fits.MAY_HAVE_CHANGED :]
    expected[side] = expected[side] + jumps if begun[begins.MANY] > 0 else 0.0
    is_excluded = drifts.jumped(drift.chance) <= rules.OVER * expected[side]
    if is_excluded and not memory.counters[ALARMED]:
        begins.confirm(begun, memory.counters[STAY_CELL])


@inner
def _expect_as_other_side(drift: Drift, side: int, last: int, memory: Memory) -> None:
    """Expect the change of a sensor that the other side has shown since the last stay of this."""
    counters, size = memory.counters, float(memory.stay[CHANGE_OF])
    kind = counters[CHANGE_KIND] - (1 - side) * drifts.NAMED
    if not (drifts.OTHER_ZERO <= kind <= drifts.OTHER_PRESSURE) or size == 0.0:
        return
    if last != 0 and counters[CHANGE_TIME] > last:
        level = kind - drifts.OTHER_GAIN
        drifts.expect(drift, kind, size, float(memory.now[1 - side, 1 + level, level]))


@inner
def _note_wear(
    axis_U: Axis, axis_s: Axis, drift: Drift, side: int, dt: float, off: float, by: Floats,
    variance: float, is_young: bool, memory: Memory, room: Room,  # noqa: FBT001
) -> None:  # fmt: skip
    """Add the stay, ``off`` the map as it was at first, to the evidence of wear."""
    cell, scalars = memory.cells[memory.counters[STAY_CELL]], memory.scalars
    head = memory.wear[side, wears.NODES]
    u, s = float(cell[MEAN_U]), float(cell[MEAN_S])
    wears.note(memory.wear, axis_U, axis_s, side, u, s, off, by, drift.now, variance)
    moved = drifts.jumped(drift.chance)
    if is_young or moved > rules.WORTH_SAYING:
        wears.drop(memory.wear, side)
    head[wears.SINCE] += dt
    head[wears.STAYS] += 1.0
    if moved < rules.OVER and wears.is_due(head):  # gain and edge are one value for all sums
        wears.settle(memory.wear, side, drift.now, math.sqrt(scalars[fits.SCALE]))
        of_part = head[wears.CHANCE] * (1.0 - drifts.drifting(drift.chance))  # none of a whole edge
        if of_part > rules.WORTH_SAYING:
            gain = 1.0 + drift.now[0, drifts.GAIN]
            wears.move(
                memory.wear, axis_U, axis_s, side, gain, memory.theta, memory.cells, scalars,
                room.work,
            )  # fmt: skip


@inner
def _note_pair(doubt: float, variance: float, memory: Memory) -> None:
    """Compare the errors of two stays in different cells, longer apart than any lag lasts.

    Each counts in standard deviations of the noise where it is, times the mean one.

    Noise that is as coloured as it seems would have a part of them in common.
    """
    counters, scalars, stay = memory.counters, memory.scalars, memory.stay
    now, before = counters[STAY_TIME], counters[PAIR_TIME]
    apart_s = 1e-9 * float(now - before)
    if before != 0 and 0.0 <= apart_s < 2.0 * rules.METER_LASTS:
        return
    error, most = stay[RESIDUAL] / stay[SAMPLES] - stay[KNOWN_OFF], math.sqrt(doubt)
    error = min(max(error, -rules.MOST_STAY * most), rules.MOST_STAY * most)
    error *= math.sqrt(scalars[fits.VARIANCE] / variance)
    if before != 0 and counters[PAIR_CELL] != counters[STAY_CELL]:
        keep, other = 1.0 - 1.0 / rules.STAY_MEMORY, scalars[fits.PAIR_ERROR]
        square = 0.5 * (error * error + other * other)
        alike = scalars[fits.SLOW] * math.exp(-max(apart_s, 0.0) / rules.METER_LASTS)
        for place in (fits.PAIR_PRODUCT, fits.PAIR_SQUARE, fits.PAIRS):
            scalars[place] *= keep
        scalars[fits.PAIR_PRODUCT] += error * other - alike * square
        scalars[fits.PAIR_SQUARE] += square
        scalars[fits.PAIRS] += 1.0
    scalars[fits.PAIR_ERROR] = error
    counters[PAIR_CELL], counters[PAIR_TIME] = counters[STAY_CELL], now


@inner
def _may_lag_behind(memory: Memory, axis_U: Axis) -> float:
    """Variance of an edge's shift, %², by the likeliest hysteresis that is not in use yet.

    The cell and the stay may be of one branch each.
    """
    rivals, most = memory.rivals, 0.0
    in_use = memory.play[plays.HALF] + memory.path[paths.STICK] + memory.path[paths.RELAYS]
    for row in range(len(rivals)):
        half = -in_use
        for k in (paths.PLAY, paths.STICK, paths.RELAYS):
            half += np.float64(rivals[row, RIVAL_PARAMETERS + k])
        likely = 1.0 - math.exp(-max(np.float64(rivals[row, RIVAL_SUM]), 0.0))
        most = max(most, 2.0 * likely * half * half)
    end = axis_U.breaks[-1] if memory.counters[STAY_SIDE] == 0 else axis_U.breaks[0]
    half_cell = 0.5 * (axis_U.breaks[1] - axis_U.breaks[0])
    to_end = abs(end) - abs(memory.cells[memory.counters[STAY_CELL], MEAN_U])
    return float(most * (end / max(to_end, half_cell)) ** 2)  # an edge shifts full opening by none


@inner
def _alike(memory: Memory) -> float:
    """Number of stays, of this oil: they have an error of the law in common."""
    scalars, x = memory.scalars, oil.viscosity(memory, memory.scalars[fits.NOW_T])
    if abs(x - scalars[fits.STAY_X]) > rules.SAME_OIL:
        scalars[fits.STAY_X], scalars[fits.ALIKE] = x, 0.0
    scalars[fits.ALIKE] += 1.0
    return float(scalars[fits.ALIKE])


@inner
def _over(drift: Drift, dt: float, now: int, counters: Times) -> float:
    """Probability that a jump of before is a hypothesis of its own no longer.

    While one of a sensor's offset is likely, and for a while after a change was published, all
    kinds of change, and that there is none, compete over what follows. Then what was found stands.
    """
    if counters[ALARMED]:
        return 1.0 if 1e-9 * float(now - counters[CHANGE_TIME]) > rules.AFTER_JUMP else 0.0
    of_sensor = drift.chance[drifts.OTHER_ZERO] + drift.chance[drifts.OTHER_PRESSURE]
    of_visit = 1.0 / float(counters[STAYS])  # its later stays tell less, so doubt lasts longer
    return 0.0 if of_sensor > rules.OVER else min(dt / rules.AFTER_JUMP, 0.5) * of_visit


@inner
def _note_change(
    drift: Drift, side: int, now: int, off: float, by: Floats, memory: Memory
) -> None:  # fmt: skip
    """Count a sudden change that is certain, and note how much of what it is, if it has a name.

    ``off`` is the stay against the map as it was at first. The change's size is the root mean
    square of what the stays since are off the map as it was before: the first of them may be where
    little flows.
    """
    counters, stay = memory.counters, memory.stay
    before = stay[BEFORE + side * drifts.LEVELS :]
    changed_s = 1e-9 * float(now - counters[CHANGE_TIME])
    if drift.chance[drifts.WANDERING] > rules.CERTAIN and changed_s > rules.AFTER_JUMP:
        counters[WANDERED] = now
    jumped = drifts.jumped(drift.chance)
    moved = max(jumped, drift.chance[drifts.WANDERING])
    if moved > rules.CERTAIN and not counters[ALARMED]:
        counters[ALARMED] = 1
        counters[CHANGES] += 1
        begins.forget(memory.begun[side], memory.cells)
        counters[CHANGE_SAMPLE], counters[CHANGE_TIME] = counters[USED], now
        counters[CHANGE_KIND], changed_s = drifts.OTHER_GAIN + side * drifts.NAMED, 0.0
        stay[CHANGE_SIZE], stay[CHANGE_OF] = 0.0, 0.0
    is_own, is_recent = counters[CHANGE_KIND] // drifts.NAMED == side, changed_s <= rules.AFTER_JUMP
    if moved < rules.OVER and counters[ALARMED]:
        other = memory.chance[1 - side]
        is_over = max(drifts.jumped(other), other[drifts.WANDERING]) < rules.OVER
        is_drift = is_own and is_recent and drifts.drifting(drift.chance) > rules.CERTAIN
        if is_drift:  # it was the beginning of one
            counters[CHANGES] -= 1
            stay[CHANGE_OF] = 0.0
        if is_drift or (is_over and not is_recent):
            counters[ALARMED] = 0
    if moved < rules.OVER and not counters[ALARMED]:
        for k in range(drifts.LEVELS):
            before[k] = drift.now[0, k]
    if is_recent and is_own:
        for k in range(drifts.LEVELS):
            off -= by[k] * before[k]
        share = 1.0 if changed_s == 0.0 else rules.OF_CHANGE
        mean = (1.0 - share) * stay[CHANGE_SIZE] + share * off
        square = (1.0 - share) * stay[CHANGE_SIZE] ** 2 + share * off * off
        stay[CHANGE_SIZE] = math.copysign(math.sqrt(square), mean)
    if counters[ALARMED] and jumped > rules.WORTH_SAYING:
        kind = drifts.OTHER_GAIN + int(np.argmax(drift.chance[drifts.OTHER_GAIN : drifts.NAMED]))
        k = kind - drifts.OTHER_GAIN
        counters[CHANGE_KIND] = kind + side * drifts.NAMED
        stay[CHANGE_OF] = drift.x[kind, k] - before[k]
