"""Drift, sudden changes and wear, learnt from a stay."""

import math

import numpy as np

from valvemap.model.kernels import flow_begun as begins
from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_wear as wears
from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.kernels.flow_cells import (
    MEAN_S,
    MEAN_U,
)
from valvemap.model.kernels.flow_drift import Drift
from valvemap.model.kernels.flow_memory import (
    ALARMED,
    BEFORE,
    BEGAN,
    BEGAN_TIME,
    CALM,
    CHANGE_KIND,
    CHANGE_OF,
    CHANGE_SAMPLE,
    CHANGE_SIZE,
    CHANGE_TIME,
    CHANGES,
    CLOCK,
    STAY_CELL,
    STAY_SIDE,
    STAY_TIME,
    STAYS,
    USED,
    WANDERED,
    Memory,
    Room,
)
from valvemap.model.samples import Floats, Times


@inner
def tell(
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
